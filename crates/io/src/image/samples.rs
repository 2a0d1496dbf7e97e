//! Interleaved samples of one to four channels to linear RGB and alpha; curves of integer samples.

use luxel_core::{Image, Remedy};

use super::{ReadOptions, SampleDepth, Transfer};
use crate::IoError;
use crate::input::Input;

/// The curve of samples that are proportional to light.
pub(super) const LINEAR: Curve = Curve::Named(Transfer::Linear);

/// A curve that is known: from the user, from the file or from a standard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Curve {
    /// One of those with a name.
    Named(Transfer),
    /// light = sample ^ exponent (PNG's gAMA).
    Power(f64),
    /// One of those with a name, of codes in the narrow range of video, of 8 or 16 bits.
    Narrow { transfer: Transfer, bits: u8 },
}

impl Curve {
    /// Returns the light of a sample, of 0 to 1 if it is a code.
    pub(super) fn decode(self, sample: f64) -> f32 {
        let light = match self {
            Self::Named(transfer) => transfer.light(sample),
            Self::Power(exponent) => sample.powf(exponent),
            // ITU-R BT.2100, table 9: black is 16 and white 235, of 8 bits.
            Self::Narrow { transfer, bits } => {
                let unit = f64::from(1u32 << (bits.max(8) - 8));
                let code = sample * f64::from((1u32 << bits) - 1);
                transfer.light(((code / unit - 16.0) / 219.0).max(0.0))
            }
        };
        light as f32
    }

    /// Returns the curve that the options give, else the one that the file states, else an error
    /// that asks for it.
    pub(super) fn choose(input: Input<'_>, options: &ReadOptions, stated: Option<Self>, bits: u8) -> Result<Self, IoError> {
        options.transfer.map(Self::Named).or(stated).ok_or_else(|| {
            let message = format!("{bits}-bit integer samples, and the file does not state their transfer curve");
            let of_plates = Remedy::advice("for a camera's plate the name of its curve, such as logc4");
            let remedy = Remedy::set("transfer", "linear").or(Remedy::set("transfer", "srgb")).or(of_plates);
            input.unsupported(message).with_remedy(remedy)
        })
    }
}

/// The warning about every image of 8 bits.
pub(super) const NOT_HDR: &str = "8 bits: not HDR";

/// How far a pixel aspect ratio may be off 1: rounding of sizes and resolutions.
const SQUARE_TOLERANCE: f64 = 1e-3;

/// Returns the warning about pixels that are not square, by their width over their height; a ratio
/// that is no positive number says nothing.
pub(super) fn aspect_warning(aspect: f64) -> Option<String> {
    let is_stated = aspect.is_normal() && aspect > 0.0 && (aspect - 1.0).abs() > SQUARE_TOLERANCE;
    is_stated.then(|| {
        format!(
            "the pixel aspect ratio is {aspect:.4}: pixels are read as square, as cameras of data sets take them; resize the image if it looks \
             squeezed"
        )
    })
}

/// Returns the warnings that follow from the precision.
pub(super) fn depth_warnings(depth: SampleDepth) -> Vec<String> {
    match depth {
        SampleDepth::Integer8 => vec![NOT_HDR.to_string()],
        SampleDepth::FewBits(bits) => vec![format!("{bits} bits: not HDR")],
        SampleDepth::Integer16 | SampleDepth::Float => Vec::new(),
    }
}

/// Size and channels of interleaved samples: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
#[derive(Clone, Copy, Debug)]
pub(super) struct SampleGrid {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) channels: usize,
}

impl SampleGrid {
    /// Returns the image and alpha of `samples`, through `color` and `alpha` by channel.
    pub(super) fn assemble<T: Copy>(
        self,
        input: Input<'_>,
        samples: &[T],
        color: impl Fn(T) -> f32,
        alpha: impl Fn(T) -> f32,
    ) -> Result<(Image, Option<Vec<f32>>), IoError> {
        let Self { width, height, channels } = self;
        let count = width * height;
        if !(1..=4).contains(&channels) || count.checked_mul(channels) != Some(samples.len()) {
            let message = format!(
                "{} samples for {width} x {height} pixels of {channels} channels, expected 1 to 4 channels of each pixel",
                samples.len()
            );
            return Err(input.unsupported(message));
        }
        let mut pixels = input.zeroed::<[f32; 3]>(count)?;
        for (pixel, of) in pixels.iter_mut().zip(samples.chunks_exact(channels)) {
            *pixel = match *of {
                [r, g, b] | [r, g, b, _] => [color(r), color(g), color(b)],
                [grey, ..] => [color(grey); 3],
                [] => [0.0; 3],
            };
        }
        let opacity =
            channels.is_multiple_of(2).then(|| samples.chunks_exact(channels).filter_map(|of| of.last().map(|&a| alpha(a))).collect());
        Ok((Image { width, height, pixels }, opacity))
    }

    /// Assembles 8-bit samples, see [`Self::assemble`].
    pub(super) fn assemble8(self, input: Input<'_>, samples: &[u8], curve: Curve) -> Result<(Image, Option<Vec<f32>>), IoError> {
        let table: Vec<f32> = (0..=u8::MAX).map(|v| curve.decode(f64::from(v) / 255.0)).collect();
        self.assemble(input, samples, |v| table.get(usize::from(v)).copied().unwrap_or(f32::NAN), |v| f32::from(v) / 255.0)
    }

    /// Assembles 16-bit samples, see [`Self::assemble`].
    pub(super) fn assemble16(self, input: Input<'_>, samples: &[u16], curve: Curve) -> Result<(Image, Option<Vec<f32>>), IoError> {
        let table: Vec<f32> = (0..=u16::MAX).map(|v| curve.decode(f64::from(v) / 65535.0)).collect();
        self.assemble(input, samples, |v| table.get(usize::from(v)).copied().unwrap_or(f32::NAN), |v| f32::from(v) / 65535.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_curve_is_the_standard_one() {
        let srgb = Curve::Named(Transfer::Srgb);
        assert_eq!(srgb.decode(0.0), 0.0);
        assert_eq!(srgb.decode(1.0), 1.0);
        assert!((srgb.decode(0.5) - 0.214_041_14).abs() < 1e-7);
        assert!((srgb.decode(0.04) - 0.04 / 12.92).abs() < 1e-9);
        // Both pieces meet.
        assert!((srgb.decode(0.04045) - srgb.decode(0.040_450_001)).abs() < 1e-7);
    }

    #[test]
    fn missing_curve_names_the_remedy() {
        let error = Curve::choose(Input::new("a.png", &[]), &ReadOptions::default(), None, 10).unwrap_err();
        assert!(error.message.contains("10-bit"), "{error}");
        let remedy = "set transfer to linear, or set transfer to srgb, or for a camera's plate the name of its curve, such as logc4";
        assert_eq!(error.remedy.unwrap().to_string(), remedy);
    }

    #[test]
    fn channels_that_do_not_fit_are_an_error() {
        let layout = SampleGrid { width: 2, height: 2, channels: 3 };
        assert!(layout.assemble8(Input::new("a", &[]), &[0; 11], Curve::Power(1.0)).is_err());
        assert!(SampleGrid { channels: 5, ..layout }.assemble8(Input::new("a", &[]), &[0; 20], Curve::Power(1.0)).is_err());
    }
}

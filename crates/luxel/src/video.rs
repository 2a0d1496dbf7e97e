//! Mastering of video: the code values of frames, and what a stream says of its light.
//!
//! In: frames in scene-linear light, and the gain that brings the scene's white to 1. Out: bytes
//! for an encoder, in one of two forms:
//! - SDR: display values of a curve, 8 bits a channel;
//! - HDR10: Rec.2020 primaries, perceptual quantizer (SMPTE ST 2084), 16 bits a channel, with the
//!   content's light levels (CTA-861.3). 1 is reference white, 203 cd/m2 (ITU-R BT.2408), and
//!   highlights roll off towards the peak.

use luxel_core::tone::{REFERENCE_WHITE_NITS, display_rgb8, pq_encode, rec709_of};
use luxel_core::{ColorSpace, Conversion, Image};
use rayon::prelude::*;

use crate::Result;
use crate::preview::{Curve, Look};

/// Highlights keep their values up to this part of the peak.
const KNEE: f32 = 0.5;

/// The form of a video.
#[derive(Clone, Debug)]
pub enum Mastering {
    /// Display values of a curve.
    Sdr(Curve),
    /// Rec.2020 and the perceptual quantizer.
    Hdr10 {
        /// Peak of the mastering display, cd/m2.
        peak: f32,
    },
}

impl Mastering {
    /// Returns what decides the code values.
    pub fn recipe(&self) -> String {
        match self {
            Self::Sdr(curve) => format!("Sdr({})", curve.recipe()),
            Self::Hdr10 { peak } => format!("Hdr10 {{ peak: {peak:?} }}"),
        }
    }

    /// Returns the code values of a frame in row order, multiplied by `gain`: R, G and B of 8 bits,
    /// or of 16 bits, little-endian, for HDR10.
    ///
    /// ```
    /// use luxel::ColorSpace;
    /// use luxel::video::Mastering;
    /// use luxel_core::Image;
    ///
    /// let grey = Image::filled(2, 1, [0.18; 3]);
    /// let hdr10 = Mastering::Hdr10 { peak: 1000.0 };
    /// let bytes = hdr10.code_values(&grey, ColorSpace::LinearRec709, 1.0)?;
    /// assert_eq!(bytes.len(), 2 * 3 * 2);
    /// # Ok::<(), luxel::Error>(())
    /// ```
    ///
    /// # Errors
    /// A display that does not take the colours.
    pub fn code_values(&self, frame: &Image, color_space: ColorSpace, gain: f32) -> Result<Vec<u8>> {
        Ok(match self {
            Self::Sdr(Curve::Tonemap(tonemap)) => frame
                .pixels
                .par_iter()
                .flat_map_iter(|p| display_rgb8(*tonemap, 0.0, rec709_of(color_space, p.map(|c| c * gain))))
                .collect(),
            Self::Sdr(curve) => {
                let mut shown = frame.clone();
                shown.pixels.par_iter_mut().for_each(|p| *p = color_space.light(*p).map(|c| c * gain));
                Look { curve: curve.clone(), exposure_ev: 0.0 }.rgb8(&shown, color_space.linear())?.into_flattened()
            }
            Self::Hdr10 { peak } => {
                let conversion = Conversion::between(color_space, ColorSpace::LinearRec2020);
                let word = |nits: f32| ((pq_encode(nits) * 65535.0 + 0.5) as u16).to_le_bytes();
                frame.pixels.par_iter().flat_map_iter(|p| nits(&conversion, *p, gain, *peak).into_iter().flat_map(word)).collect()
            }
        })
    }
}

/// Light levels of HDR10 content (CTA-861.3), measured frame by frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightLevels {
    peak: f32,
    brightest: f32,
    average: f64,
}

impl LightLevels {
    /// Returns the levels of no frames, for a peak in cd/m2.
    pub fn new(peak: f32) -> Self {
        Self { peak, brightest: 0.0, average: 0.0 }
    }

    /// Adds a frame that is multiplied by `gain`.
    pub fn add(&mut self, frame: &Image, color_space: ColorSpace, gain: f32) {
        let conversion = Conversion::between(color_space, ColorSpace::LinearRec2020);
        let light: Vec<f32> =
            frame.pixels.par_iter().map(|p| nits(&conversion, *p, gain, self.peak).into_iter().fold(0.0, f32::max)).collect();
        self.brightest = light.iter().copied().fold(self.brightest, f32::max);
        self.average = self.average.max(light.iter().map(|v| f64::from(*v)).sum::<f64>() / light.len().max(1) as f64);
    }

    /// Returns MaxCLL, cd/m2: the brightest channel of any pixel.
    pub fn most_of_a_pixel(&self) -> u32 {
        self.brightest.ceil() as u32
    }

    /// Returns MaxFALL, cd/m2: the greatest mean of the brightest channels of a frame.
    pub fn most_of_a_frame(&self) -> u32 {
        self.average.ceil() as u32
    }
}

/// Returns the display light of a radiance in cd/m2: the largest channel rolls off above the knee
/// towards the peak, and hue is kept.
fn nits(conversion: &Conversion, radiance: [f32; 3], gain: f32, peak: f32) -> [f32; 3] {
    let rgb = conversion.apply(radiance).map(|c| if c > 0.0 { (c * gain * REFERENCE_WHITE_NITS).min(1e9) } else { 0.0 });
    let largest = rgb.into_iter().fold(0.0, f32::max);
    let knee = KNEE * peak;
    if largest <= knee {
        return rgb;
    }
    // x / (1 + x) above the knee: continuous in value and slope.
    let x = (largest - knee) / (peak - knee);
    let rolled = knee + (peak - knee) * x / (1.0 + x);
    rgb.map(|c| c * rolled / largest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn highlights_roll_off_smoothly_and_below_the_peak() {
        let same = Conversion::between(ColorSpace::LinearRec2020, ColorSpace::LinearRec2020);
        let of = |v: f32| nits(&same, [v, 0.5 * v, 0.0], 1.0, 1000.0);
        assert_eq!(of(1.0), [203.0, 101.5, 0.0]);
        let mut last = 0.0;
        for step in 0..2000 {
            let [r, g, _] = of(0.05 * step as f32);
            assert!(r >= last && r < 1000.0 && r - last < 12.0 && (g - 0.5 * r).abs() < 1e-3, "{r} after {last}");
            last = r;
        }
        assert_eq!(of(f32::NAN), [0.0; 3]);
        assert!(of(f32::INFINITY)[0] <= 1000.0);
    }

    #[test]
    fn levels_are_of_the_brightest_pixel_and_the_brightest_frame() {
        let mut levels = LightLevels::new(1000.0);
        let mut frame = Image::filled(2, 2, [0.5; 3]);
        levels.add(&frame, ColorSpace::LinearRec709, 1.0);
        assert_eq!([levels.most_of_a_pixel(), levels.most_of_a_frame()], [102; 2]);
        frame.pixels[0] = [0.9; 3];
        levels.add(&frame, ColorSpace::LinearRec709, 1.0);
        assert_eq!([levels.most_of_a_pixel(), levels.most_of_a_frame()], [183, 122]);
    }
}

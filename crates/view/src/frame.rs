//! Pictures as the page takes them: half floats, with what tells how to read them.
//!
//! In: radiance `[H,W,3]` in the units of the data set, and coverage and depth `[H*W]` if asked
//! for. Out: a body of little-endian planes one after the other: radiance as interleaved half
//! floats, coverage as half floats, depth as single floats. Radiance is divided by a power of two,
//! stated beside it, so that neither suns nor moonlight leave the range of half floats: each value
//! is rounded to 11 bits, a relative error of at most 4.9e-4, and nothing else is lost.

use half::f16;
use half::slice::HalfFloatSliceExt;
use luxel_core::Image;
use serde::Serialize;

/// Largest exponent of the power of two, either way: 2^126 is still a normal number.
const MAX_EXPONENT: i32 = 126;

/// A picture for the page.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// How to read the body.
    pub(crate) head: FrameHead,
    /// The planes.
    pub(crate) body: Vec<u8>,
}

/// How to read a [`Frame`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct FrameHead {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Factor from the half floats to radiance, a power of two.
    pub(crate) scale: f32,
    /// Whether there is a plane of radiance.
    pub(crate) rgb: bool,
    /// Whether there is a plane of coverage.
    pub(crate) alpha: bool,
    /// Whether there is a plane of depth.
    pub(crate) depth: bool,
    /// Version of the scene.
    pub(crate) version: u64,
    /// Time of rendering, seconds.
    pub(crate) seconds: f64,
}

/// The planes of a picture; those that there are not are empty.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Planes<'a> {
    pub(crate) pixels: &'a [[f32; 3]],
    pub(crate) alpha: &'a [f32],
    pub(crate) depth: &'a [f32],
}

impl<'a> Planes<'a> {
    /// Returns the planes of an image alone.
    pub(crate) fn of_image(image: &'a Image, alpha: &'a [f32]) -> Self {
        Self { pixels: &image.pixels, alpha, depth: &[] }
    }

    /// Encodes the planes of a picture of `size` pixels.
    pub(crate) fn encode(self, size: [usize; 2], version: u64, seconds: f64) -> Frame {
        let scale = scale_for(self.pixels);
        let mut body = Vec::with_capacity(6 * self.pixels.len() + 2 * self.alpha.len() + 4 * self.depth.len());
        push_halves(&mut body, self.pixels.as_flattened(), scale.recip());
        push_halves(&mut body, self.alpha, 1.0);
        for depth in self.depth {
            body.extend_from_slice(&depth.to_le_bytes());
        }
        let [width, height] = size;
        let (rgb, alpha, depth) = (!self.pixels.is_empty(), !self.alpha.is_empty(), !self.depth.is_empty());
        let head = FrameHead { width, height, scale, rgb, alpha, depth, version, seconds };
        Frame { head, body }
    }
}

/// Returns the power of two by which radiance is divided: 1, but for pictures beyond the range of
/// half floats, and dark ones that would fall below their normal numbers.
fn scale_for(pixels: &[[f32; 3]]) -> f32 {
    /// Largest half float, and the exponent below which pictures are brightened.
    const LARGEST: f32 = 65504.0;
    const TARGET: i32 = 10;
    let peak = pixels.as_flattened().iter().fold(0.0f32, |peak, value| if value.is_finite() { peak.max(value.abs()) } else { peak });
    let exponent = if peak > LARGEST {
        (peak / LARGEST).log2().ceil() as i32
    } else if peak > 0.0 && peak < 1.0 {
        peak.log2().floor() as i32 - TARGET
    } else {
        0
    };
    2f32.powi(exponent.clamp(-MAX_EXPONENT, MAX_EXPONENT))
}

fn push_halves(body: &mut Vec<u8>, values: &[f32], factor: f32) {
    const LEN: usize = 1024;
    let (mut scaled, mut halves) = ([0.0f32; LEN], [f16::ZERO; LEN]);
    for chunk in values.chunks(LEN) {
        let (scaled, halves) = (&mut scaled[..chunk.len()], &mut halves[..chunk.len()]);
        for (scaled, value) in scaled.iter_mut().zip(chunk) {
            *scaled = value * factor;
        }
        halves.convert_from_f32_slice(scaled);
        body.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(frame: &Frame) -> Vec<f32> {
        let halves = frame.body.chunks(2).take(3 * frame.head.width * frame.head.height);
        halves.map(|pair| f16::from_le_bytes([pair[0], pair[1]]).to_f32() * frame.head.scale).collect()
    }

    #[test]
    fn radiance_of_any_size_keeps_eleven_bits() {
        for factor in [1e-30f32, 1e-6, 1.0, 300.0, 1e5, 1e30] {
            let pixels: Vec<[f32; 3]> = (1..100).map(|i| [i as f32 * 0.01 * factor, 0.5 * factor, factor]).collect();
            let frame = Planes { pixels: &pixels, alpha: &[], depth: &[] }.encode([99, 1], 0, 0.0);
            assert_eq!(frame.body.len(), 6 * 99);
            for (found, expected) in decoded(&frame).iter().zip(pixels.as_flattened()) {
                assert!((found / expected - 1.0).abs() < 4.9e-4, "{found} for {expected}");
            }
        }
    }

    #[test]
    fn usual_pictures_are_not_scaled_and_black_ones_stay_black() {
        for (pixel, scale) in
            [([1.0, 65504.0, 0.0], 1.0), ([0.0; 3], 1.0), ([65505.0, 0.0, 0.0], 2.0), ([f32::NAN, 2.0, f32::INFINITY], 1.0)]
        {
            assert_eq!(scale_for(&[pixel]), scale, "{pixel:?}");
        }
    }

    #[test]
    fn planes_follow_one_another() {
        let frame = Planes { pixels: &[[1.0; 3]; 2], alpha: &[0.25, 1.0], depth: &[3.5, f32::INFINITY] }.encode([2, 1], 7, 0.1);
        assert_eq!(
            (frame.body.len(), frame.head.rgb, frame.head.alpha, frame.head.depth, frame.head.version),
            (12 + 4 + 8, true, true, true, 7)
        );
        assert_eq!(frame.body[12..14], f16::from_f32(0.25).to_le_bytes());
        assert_eq!(frame.body[16..20], 3.5f32.to_le_bytes());
    }
}

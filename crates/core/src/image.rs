//! Linear floating-point images.

use crate::{Mask, mask};

/// Linear RGB radiance, `[H,W,3]`, rows from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Pixels `[H*W]`, row-major.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// Returns an image of one colour.
    pub fn filled(width: usize, height: usize, rgb: [f32; 3]) -> Self {
        Self { width, height, pixels: vec![rgb; width * height] }
    }

    /// Returns the image of `width * height` pixels, row-major; `None` if there are more or fewer.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Option<Self> {
        (pixels.len() == width.checked_mul(height)?).then_some(Self { width, height, pixels })
    }

    /// Returns the sum with an image of the same size.
    #[must_use]
    pub fn plus(mut self, other: Self) -> Self {
        self.pixels.as_flattened_mut().iter_mut().zip(other.pixels.as_flattened()).for_each(|(sum, value)| *sum += value);
        self
    }

    /// Returns the pixel in column `x` of row `y`.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> [f32; 3] {
        self.pixels[y * self.width + x]
    }

    /// Returns the mean of the valid pixels (by row-major index) of the `factor` x `factor` block
    /// whose top left pixel is `corner`, and their number.
    ///
    /// The mean is in linear light, as a larger pixel would receive it. It is black if no pixel is
    /// valid.
    pub fn block_mean(&self, corner: [usize; 2], factor: usize, is_valid: impl Fn(usize) -> bool) -> ([f32; 3], usize) {
        let [left, top] = corner;
        // Sums are in f64, so that a filament does not absorb the dark pixels beside it.
        let (mut sum, mut count) = ([0.0f64; 3], 0usize);
        for y in top..top + factor {
            for at in (left..left + factor).map(|x| y * self.width + x) {
                if let Some(pixel) = self.pixels.get(at).filter(|_| is_valid(at)) {
                    sum = [0, 1, 2].map(|c| sum[c] + f64::from(pixel[c]));
                    count += 1;
                }
            }
        }
        (if count == 0 { [0.0; 3] } else { sum.map(|s| (s / count as f64) as f32) }, count)
    }

    /// Reduces the `factor` x `factor` block whose top left pixel is `corner` to one pixel.
    ///
    /// All reductions of masked images use this step.
    pub fn reduce_block(&self, mask: Option<&Mask>, corner: [usize; 2], factor: usize) -> ReducedBlock {
        let (mean, valid) = self.block_mean(corner, factor, |at| mask::is_valid(mask, at));
        let [left, top] = corner;
        let pixels = (top..top + factor).flat_map(|y| (left..left + factor).map(move |x| y * self.width + x));
        let total: f64 = pixels.map(|at| f64::from(mask::weight(mask, at))).sum();
        ReducedBlock { mean, valid, weight: (total / valid.max(1) as f64) as f32 }
    }

    /// Returns the image of the means of all whole `factor` x `factor` blocks of pixels.
    #[must_use]
    pub fn block_means(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let mean = |i: usize| self.block_mean([i % width * factor, i / width * factor], factor, |_| true).0;
        Self { width, height, pixels: (0..width * height).map(mean).collect() }
    }

    /// Multiplies every channel of every pixel by `factor`.
    pub fn scale(&mut self, factor: f32) {
        for value in self.pixels.as_flattened_mut() {
            *value *= factor;
        }
    }
}

/// A block of pixels reduced to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReducedBlock {
    /// Mean of the valid pixels; black if there are none.
    pub mean: [f32; 3],
    /// Number of valid pixels.
    pub valid: usize,
    /// Mean weight of the valid pixels, 0 to 1.
    pub weight: f32,
}

/// Returns the paper's luminance, R + G + B (LCD-GS eq. 4: the chromaticity sums to 1).
#[inline]
pub fn luminance_sum(rgb: [f32; 3]) -> f32 {
    rgb[0] + rgb[1] + rgb[2]
}

/// Returns the relative luminance Y of linear Rec.709 (ITU-R BT.709).
#[inline]
pub fn luminance_rec709(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

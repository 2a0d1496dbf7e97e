//! A frame as decoded: samples, the table that makes signals of them, noise.
//!
//! Signals are linear, 0 at black and 1 where the sensor or the file saturates; noise may bring
//! them below 0. Samples are `[H*W*C]`, row-major, C = 3 for [`SampleLayout::Rgb`] and 1 for
//! [`SampleLayout::Mosaic`]. A sample's phase selects its table: the channel, or the
//! place in the mosaic's 2x2 cell.

use std::sync::Arc;

use luxel_core::photo::{Codes, RawCorrections};

/// Colours of the 2x2 cell of a mosaic, row by row: 0 red, 1 green, 2 blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cell([u8; 4]);

impl Cell {
    /// Returns a Bayer cell: two greens on a diagonal, one red, one blue. `None` otherwise.
    pub fn bayer(colors: [u8; 4]) -> Option<Self> {
        matches!(colors, [0, 1, 1, 2] | [2, 1, 1, 0] | [1, 0, 2, 1] | [1, 2, 0, 1]).then_some(Self(colors))
    }

    /// Returns the colour of the pixel in column `x` of row `y`.
    #[inline]
    pub fn color(self, x: usize, y: usize) -> usize {
        usize::from(self.0[(y % 2) * 2 + x % 2])
    }
}

/// The arrangement of samples in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleLayout {
    /// Three samples per pixel.
    Rgb,
    /// One sample per pixel.
    Mosaic(Cell),
}

impl SampleLayout {
    /// Returns the number of samples per pixel.
    pub fn samples_per_pixel(self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Mosaic(_) => 1,
        }
    }

    /// Returns the number of tables that a frame of this layout has.
    pub fn phases(self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Mosaic(_) => 4,
        }
    }
}

/// Signal by code.
#[derive(Clone, Debug, PartialEq)]
pub struct CodeTransfer {
    /// Signal, rising, one per code.
    signal: Vec<f32>,
    /// Variance due to rounding to a code.
    rounding: Vec<f32>,
    /// First code that means "at least".
    clip_code: usize,
    /// Last code that means "at most".
    dark_code: usize,
}

impl CodeTransfer {
    /// Returns the table of `signal` by code (rising). From `clip_code` on a sample is saturated,
    /// up to `dark_code` it is black; `code_sigma` is the uncertainty of a code in codes, 0.29
    /// (1/sqrt(12)) where it is rounded and nothing else.
    pub fn new(signal: Vec<f32>, dark_code: usize, clip_code: usize, code_sigma: f32) -> Self {
        let at = |i: usize| signal.get(i).copied().unwrap_or(0.0);
        let last = signal.len().saturating_sub(1);
        let slope = |i: usize| {
            let (low, high) = (i.saturating_sub(1), (i + 1).min(last));
            (at(high) - at(low)) / (high - low).max(1) as f32
        };
        let rounding = (0..signal.len()).map(|i| (slope(i) * code_sigma).powi(2)).collect();
        Self { signal, rounding, clip_code, dark_code }
    }

    /// Returns the signal of a code.
    #[inline]
    pub fn signal(&self, code: usize) -> f32 {
        self.signal.get(code).copied().unwrap_or(1.0)
    }

    #[inline]
    pub(crate) fn rounding(&self, code: usize) -> f32 {
        self.rounding.get(code).copied().unwrap_or(0.0)
    }

    /// Returns whether the code means "at least".
    #[inline]
    pub fn is_clipped(&self, code: usize) -> bool {
        code >= self.clip_code
    }

    /// Returns whether the code means "at most".
    #[inline]
    pub fn is_dark(&self, code: usize) -> bool {
        code <= self.dark_code
    }

    /// Returns the smallest signal that is saturated.
    pub fn clip_signal(&self) -> f32 {
        self.signal(self.clip_code.min(self.signal.len().saturating_sub(1)))
    }
}

/// Variance of a signal s: shot * s + read^2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalNoise {
    /// Variance per signal: photons.
    pub shot: f32,
    /// Standard deviation without light.
    pub read: f32,
}

impl SignalNoise {
    /// Returns the noise of a typical sensor at this ISO speed: 20,000 electrons at saturation and
    /// 4 of read noise at ISO 100. Only the ratio of the two weighs in merging.
    pub fn typical(iso: f64) -> Self {
        let gain = (iso / 100.0).clamp(0.1, 1e4) as f32;
        Self { shot: gain / 20_000.0, read: 4.0 * gain.sqrt() / 20_000.0 }
    }

    /// Returns the variance of a signal.
    #[inline]
    pub fn variance(&self, signal: f32) -> f32 {
        self.shot * signal.max(0.0) + self.read * self.read
    }
}

/// One photograph.
#[derive(Clone, Debug)]
pub struct CapturedFrame {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Arrangement of the samples.
    pub layout: SampleLayout,
    /// `[H*W*C]`.
    pub samples: Codes,
    /// One per phase, see [`SampleLayout::phases`].
    pub transfers: Arc<[CodeTransfer]>,
    /// Signal of a radiance of 1, above 0.
    pub signal_per_radiance: f32,
    /// Noise of the signal.
    pub noise: SignalNoise,
    /// Corrections of the lens, if the file asks for any.
    pub corrections: Option<Arc<RawCorrections>>,
}

/// Explains why a frame cannot be used, or does not fit the others.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Nothing to merge.
    #[error("no frames to merge")]
    None,
    /// Samples and size.
    #[error("{found} samples, expected {expected} for {width} x {height} pixels")]
    Samples {
        /// Number found.
        found: usize,
        /// Number that size and layout call for.
        expected: usize,
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// Exposure.
    #[error("signal per radiance is {0}, expected a number above 0")]
    Exposure(f32),
    /// Differs from the first.
    #[error("{0} x {1} pixels, but the first frame of the bracket has {2} x {3} or another mosaic: a bracket is of one camera, unchanged")]
    Mixed(usize, usize, usize, usize),
}

impl CapturedFrame {
    /// Checks a frame by itself.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn validate(&self) -> Result<(), FrameError> {
        let expected = self.width.saturating_mul(self.height).saturating_mul(self.layout.samples_per_pixel());
        if self.samples.len() != expected || expected == 0 || self.transfers.len() != self.layout.phases() {
            return Err(FrameError::Samples { found: self.samples.len(), expected, width: self.width, height: self.height });
        }
        if !(self.signal_per_radiance.is_normal() && self.signal_per_radiance > 0.0) {
            return Err(FrameError::Exposure(self.signal_per_radiance));
        }
        Ok(())
    }

    /// Returns the gain of each sample in row `y`; `None` where nothing is multiplied. The lens let
    /// through one over it, which is as if the exposure had been that much shorter.
    pub(crate) fn gains_of_row(&self, y: usize) -> Option<Vec<f32>> {
        let corrections = self.corrections.as_ref().filter(|c| !c.gains.is_empty())?;
        let per_pixel = self.layout.samples_per_pixel();
        let mut out = vec![1.0f32; self.width * per_pixel];
        let [left, top] = corrections.origin_px;
        for gain in &corrections.gains {
            let plane = |i: usize| match self.layout {
                SampleLayout::Rgb => i % 3,
                SampleLayout::Mosaic(cell) if gain.is_by_color => cell.color(i, y),
                SampleLayout::Mosaic(_) => 0,
            };
            gain.multiply_row(corrections.area_px, [left, y + top], per_pixel, plane, &mut out);
        }
        Some(out)
    }

    /// Returns the phase of sample `i` in row `y`: the row's first sample is `y * width *
    /// samples_per_pixel`.
    #[inline]
    pub(crate) fn phase(&self, i: usize, y: usize) -> usize {
        match self.layout {
            SampleLayout::Rgb => i % 3,
            SampleLayout::Mosaic(_) => (y % 2) * 2 + (i - y * self.width) % 2,
        }
    }

    /// Returns the signals of the green channel, `[H/2, W/2]`, each from a block of 2x2 pixels:
    /// alignment and motion are judged by them.
    pub(crate) fn half_green(&self) -> (usize, usize, Vec<f32>) {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut out = Vec::with_capacity(width * height);
        let phases = self.layout.samples_per_pixel();
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                let mut count = 0.0;
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (px, py) = (2 * x + dx, 2 * y + dy);
                    let channel = match self.layout {
                        SampleLayout::Rgb => 1,
                        SampleLayout::Mosaic(cell) if cell.color(px, py) == 1 => 0,
                        SampleLayout::Mosaic(_) => continue,
                    };
                    let i = (py * self.width + px) * phases + channel;
                    if let Some(transfer) = self.transfers.get(self.phase(i, py)) {
                        sum += transfer.signal(self.samples.code(i));
                        count += 1.0;
                    }
                }
                out.push(if count > 0.0 { sum / count } else { 0.0 });
            }
        }
        (width, height, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_bayer_cells_are_cells() {
        assert!(Cell::bayer([0, 1, 1, 2]).is_some() && Cell::bayer([1, 2, 0, 1]).is_some());
        assert!(Cell::bayer([0, 1, 2, 1]).is_none() && Cell::bayer([9; 4]).is_none());
    }

    #[test]
    fn codes_out_of_the_table_are_saturated_and_no_panic() {
        let transfer = CodeTransfer::new(vec![0.0, 0.5, 1.0], 0, 2, 0.29);
        assert_eq!(transfer.signal(70_000), 1.0);
        assert!(transfer.is_clipped(70_000) && transfer.is_dark(0) && !transfer.is_dark(1));
        assert_eq!(CodeTransfer::new(Vec::new(), 0, 1, 0.29).clip_signal(), 1.0);
    }

    #[test]
    fn a_frame_that_contradicts_itself_is_refused() {
        let good = crate::testing::linear_frame(2, 2, &[0.1; 12], 1.0);
        assert_eq!(good.validate(), Ok(()));
        assert!(CapturedFrame { width: 3, ..good.clone() }.validate().is_err());
        assert!(CapturedFrame { signal_per_radiance: 0.0, ..good }.validate().is_err());
    }
}

//! One or more frames of one view to radiance, each sample weighted by how little noise it has.
//!
//! In: [`CapturedFrame`]s of one size and layout with their exposures and noise. Out: [`Merged`],
//! radiance `[H*W*C]` in camera colours. The estimate is the maximum-likelihood one of a normal
//! noise whose variance is that of the expected signal and not of the noisy sample (Hasinoff et al.
//! 2010, Aguerrebere et al. 2014): a first estimate weights by exposure squared, a second by
//! exposure squared over variance. A mosaic is merged as it is, so that noise is known, and made to
//! an image afterwards.
//!
//! Both ends: a saturated sample has no weight, and weight fades out below saturation, so that no
//! edge shows where a frame leaves. A sample that is saturated in every frame has the shortest
//! frame's radiance, a lower bound, and is marked. A sample that is far beyond saturation by a
//! shorter exposure is saturated, whatever its code: compression leaves codes a little below white
//! beside edges there. Samples at black keep their weight (their signal is small, and so is the
//! error), and are counted where every frame is black. A gain that undoes a lens's vignette counts
//! as an exposure that is smaller by it, so that noise and saturation stay the sensor's.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use luxel_core::Image;
use luxel_core::photo::RawCorrections;
use rayon::prelude::*;

use crate::lens_correction::{CameraColors, corrected};
use crate::{CapturedFrame, FrameError, SampleLayout, demosaic};

/// Share of the saturation signal from which on a sample's weight fades.
const FADE_FROM: f32 = 0.85;
/// A frame disagrees with the estimate beyond this many standard deviations plus
/// [`MOTION_RELATIVE`].
const MOTION_SIGMAS: f32 = 5.0;
/// A sample is saturated if another frame expects this many times its saturation of it...
const CERTAINLY_SATURATED: f32 = 1.5;
/// ...by a signal of more than this share of saturation, which is more than noise.
const CERTAIN_SIGNAL: f32 = 0.1;
/// Relative disagreement that exposure times and response curves account for.
const MOTION_RELATIVE: f32 = 0.2;

/// Radiance of a view in camera colours.
#[derive(Clone, Debug)]
pub struct Merged {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Arrangement of the samples.
    pub layout: SampleLayout,
    /// `[H*W*C]`; noise may bring it below 0.
    pub radiance: Vec<f32>,
    /// Saturated in every frame, so that radiance is a lower bound. `[H*W*C]`.
    pub saturated: Vec<bool>,
    /// Samples that are black in every frame.
    pub dark: usize,
    /// Samples in which frames disagree beyond their noise.
    pub disagreeing: usize,
    /// Corrections of the first frame's lens, of which the gains of samples are applied.
    pub corrections: Option<Arc<RawCorrections>>,
}

/// The result of one row.
#[derive(Default)]
struct MergedRow {
    dark: usize,
    disagreeing: usize,
}

/// Merges the exposures of one view to radiance.
///
/// ```
/// use luxel_capture::prepare::{CurveTables, developed_frame};
/// use luxel_capture::{Codes, Exposure, ResponseCurve, merge};
///
/// // A pixel that the longer exposure saturates, and a neighbour that the shorter one barely sees.
/// let tables = CurveTables::new(&ResponseCurve::Linear);
/// let frame = |seconds: f64, codes: [u8; 2]| {
///     let exposure = Exposure { seconds, iso: Some(100.0), f_number: Some(8.0) };
///     let codes = Codes::U8(codes.iter().flat_map(|c| [*c; 3]).collect());
///     developed_frame([2, 1], codes, &tables, &exposure)
/// };
/// let merged = merge(&[frame(0.01, [200, 10]), frame(0.1, [255, 100])])?;
/// assert!(!merged.saturated[0]);
/// let ratio = merged.radiance[0] / merged.radiance[3];
/// assert!((ratio - 20.0).abs() < 0.5, "{ratio}");
/// # Ok::<(), luxel_capture::FrameError>(())
/// ```
///
/// # Errors
/// No frames, a frame that contradicts itself, or frames that differ in size or layout.
pub fn merge(frames: &[CapturedFrame]) -> Result<Merged, FrameError> {
    let first = frames.first().ok_or(FrameError::None)?;
    for frame in frames {
        frame.validate()?;
        if (frame.width, frame.height, frame.layout) != (first.width, first.height, first.layout) {
            return Err(FrameError::Mixed(frame.width, frame.height, first.width, first.height));
        }
    }
    let per_row = first.width * first.layout.samples_per_pixel();
    let mut radiance = vec![0.0f32; per_row * first.height];
    let mut saturated = vec![false; radiance.len()];
    let rows: Vec<MergedRow> = radiance
        .par_chunks_mut(per_row)
        .zip(saturated.par_chunks_mut(per_row))
        .enumerate()
        .map(|(y, (radiance, saturated))| merge_row(frames, y, y * per_row, radiance, saturated))
        .collect();
    Ok(Merged {
        width: first.width,
        height: first.height,
        layout: first.layout,
        radiance,
        saturated,
        dark: rows.iter().map(|r| r.dark).sum(),
        disagreeing: rows.iter().map(|r| r.disagreeing).sum(),
        corrections: first.corrections.clone(),
    })
}

/// A frame's measurement of a sample.
#[derive(Clone, Copy)]
struct Word {
    signal: f32,
    /// Signal per radiance.
    exposure: f32,
    /// 0 where saturated, 1 well below.
    trust: f32,
    rounding: f32,
    /// The smallest signal that is saturated.
    clip: f32,
}

fn merge_row(frames: &[CapturedFrame], y: usize, start: usize, radiance: &mut [f32], saturated: &mut [bool]) -> MergedRow {
    let mut row = MergedRow::default();
    let mut words = Vec::with_capacity(frames.len());
    let gains: Vec<Option<Vec<f32>>> = frames.iter().map(|frame| frame.gains_of_row(y)).collect();
    for (x, (radiance, saturated)) in radiance.iter_mut().zip(saturated).enumerate() {
        words.clear();
        let mut is_dark = true;
        for (frame, gains) in frames.iter().zip(&gains) {
            let i = start + x;
            let code = frame.samples.code(i);
            let Some(transfer) = frame.transfers.get(frame.phase(i, y)) else { continue };
            let signal = transfer.signal(code);
            let clip = transfer.clip_signal();
            let fade = ((clip - signal) / (clip * (1.0 - FADE_FROM))).clamp(0.0, 1.0);
            let trust = if transfer.is_clipped(code) { 0.0 } else { fade.max(1e-3) };
            is_dark &= transfer.is_dark(code);
            let exposure =
                gains.as_ref().and_then(|gains| gains.get(x)).map_or(frame.signal_per_radiance, |g| frame.signal_per_radiance / g);
            words.push(Word { signal, exposure, trust, rounding: transfer.rounding(code), clip });
        }
        let is_contradicted = silence_saturated(&mut words);
        row.dark += usize::from(is_dark);
        let (value, is_saturated) = estimate(&words, frames);
        (*radiance, *saturated) = (value, is_saturated);
        row.disagreeing += usize::from(is_contradicted || (!is_saturated && disagrees(&words, frames, value)));
    }
    row
}

/// Distrusts frames that must be saturated, according to a shorter exposure. Whether one
/// of them measures clearly that it is not: something moved.
fn silence_saturated(words: &mut [Word]) -> bool {
    let is_certain = |word: &&Word| word.signal > CERTAIN_SIGNAL * word.clip;
    let seen = words.iter().filter(is_certain).map(|word| word.signal / word.exposure).fold(0.0, f32::max);
    let mut is_contradicted = false;
    for word in words.iter_mut().filter(|word| seen * word.exposure > CERTAINLY_SATURATED * word.clip) {
        is_contradicted |= word.trust >= 1.0;
        word.trust = 0.0;
    }
    is_contradicted
}

/// Returns the radiance, and whether it is a lower bound.
fn estimate(words: &[Word], frames: &[CapturedFrame]) -> (f32, bool) {
    let (mut sum, mut weights) = (0.0f32, 0.0f32);
    for word in words {
        sum += word.trust * word.exposure * word.signal;
        weights += word.trust * word.exposure * word.exposure;
    }
    if weights <= 0.0 {
        // The shortest exposure bounds highest.
        let bound = words.iter().map(|w| w.signal / w.exposure).fold(f32::NEG_INFINITY, f32::max);
        return (if bound.is_finite() { bound } else { 0.0 }, true);
    }
    let first = sum / weights;
    if words.len() == 1 {
        return (first, false);
    }
    let (mut sum, mut weights) = (0.0f64, 0.0f64);
    for (word, frame) in words.iter().zip(frames) {
        let variance = frame.noise.variance(first * word.exposure) + word.rounding;
        let weight = f64::from(word.trust * word.exposure) / f64::from(variance.max(f32::MIN_POSITIVE));
        sum += weight * f64::from(word.signal);
        weights += weight * f64::from(word.exposure);
    }
    ((sum / weights) as f32, false)
}

/// Returns whether a frame that measures better contradicts the result.
fn disagrees(words: &[Word], frames: &[CapturedFrame], radiance: f32) -> bool {
    words.len() > 1
        && words.iter().zip(frames).any(|(word, frame)| {
            let expected = radiance * word.exposure;
            let sigma = (frame.noise.variance(expected) + word.rounding).sqrt();
            word.trust >= 1.0 && (word.signal - expected).abs() > MOTION_SIGMAS * sigma + MOTION_RELATIVE * expected.abs()
        })
}

/// Radiance of a view, and where it is a lower bound.
#[derive(Clone, Debug)]
pub struct Developed {
    /// In the scene's space, 0 and above.
    pub image: Image,
    /// Pixels of which a channel is saturated in every frame.
    pub saturated: Vec<bool>,
    /// Pixels of which a channel was below 0: noise at black, or a colour outside of the space.
    pub negative: usize,
}

impl Merged {
    /// Returns the image in another space: camera colours, moved and multiplied by the corrections
    /// of the lens, times `balance`, highlights mended, times `scene_from_balanced`.
    ///
    /// Where a channel is saturated the others go on rising, and balanced colours run to magenta: a
    /// saturated channel is set to the largest of the pixel's channels, if that is more, so that
    /// light beyond the sensor is neutral and no darker than its measured part.
    pub fn develop(self, balance: [f32; 3], scene_from_balanced: &DMat3) -> Developed {
        let (width, height) = (self.width, self.height);
        let (pixels, saturated) = match self.layout {
            SampleLayout::Rgb => {
                let marks: Vec<u8> = self.saturated.chunks_exact(3).map(|s| (0..3).map(|c| u8::from(s[c]) << c).sum()).collect();
                (self.radiance.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(), marks)
            }
            SampleLayout::Mosaic(cell) => {
                let marks = (0..width * height).into_par_iter().map(|i| self.saturated_around(cell, i)).collect();
                (demosaic(width, height, cell, &self.radiance), marks)
            }
        };
        let colors = CameraColors { width, height, pixels, saturated };
        let colors = self.corrections.iter().fold(colors, |colors, corrections| corrected(colors, corrections));
        let CameraColors { width, height, mut pixels, saturated: marks } = colors;
        let negative = pixels
            .par_iter_mut()
            .zip(&marks)
            .map(|(pixel, &marks): (&mut [f32; 3], &u8)| {
                let mut balanced = [0, 1, 2].map(|c| pixel[c] * balance[c]);
                let most = balanced[0].max(balanced[1]).max(balanced[2]);
                for (_, value) in balanced.iter_mut().enumerate().filter(|(c, _)| marks >> c & 1 == 1) {
                    *value = value.max(most);
                }
                let rgb = (*scene_from_balanced * DVec3::from_array(balanced.map(f64::from))).to_array();
                *pixel = rgb.map(|v| v.max(0.0) as f32);
                usize::from(rgb.iter().any(|v| *v < 0.0))
            })
            .sum();
        let saturated = marks.iter().map(|m| *m != 0).collect();
        Developed { image: Image { width, height, pixels }, saturated, negative }
    }

    /// Returns the bits of the colours that are saturated in the 3x3 samples around a mosaic's
    /// sample.
    fn saturated_around(&self, cell: crate::Cell, i: usize) -> u8 {
        let (x, y) = (i % self.width, i / self.width);
        let mut marks = 0;
        for row in y.saturating_sub(1)..(y + 2).min(self.height) {
            for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                if self.saturated.get(row * self.width + column).copied().unwrap_or(false) {
                    marks |= 1 << cell.color(column, row);
                }
            }
        }
        marks
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::testing::linear_frame;
    use crate::{Cell, Codes, SignalNoise};

    /// Returns a bracket of a ramp over decades, with photon and read noise.
    fn bracket(radiance: &[f32], exposures: &[f32], seed: u64) -> Vec<CapturedFrame> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let noise = SignalNoise::typical(100.0);
        let frame = |exposure: &f32| {
            let signals: Vec<f32> = radiance
                .iter()
                .map(|r| r * exposure)
                .map(|s| s + noise.variance(s).sqrt() * Normal::new(0.0f32, 1.0).unwrap().sample(&mut rng))
                .collect();
            linear_frame(radiance.len() / 3, 1, &signals, *exposure)
        };
        exposures.iter().map(frame).collect()
    }

    fn ramp(count: usize) -> Vec<f32> {
        (0..3 * count).map(|i| 10f32.powf(-3.0 + 5.0 * (i / 3) as f32 / count as f32)).collect()
    }

    #[test]
    fn five_exposures_give_five_decades_without_bias() {
        let truth = ramp(5000);
        let merged = merge(&bracket(&truth, &[0.005, 0.04, 0.32, 2.56, 20.0], 1)).unwrap();
        for decade in -3..2 {
            let range = 10f32.powi(decade)..10f32.powi(decade + 1);
            let errors: Vec<f64> =
                truth.iter().zip(&merged.radiance).filter(|(t, _)| range.contains(t)).map(|(t, m)| f64::from(m / t - 1.0)).collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
            assert!(mean.abs() < 4e-3 && rms < 0.06, "decade {decade}: mean {mean:.4} rms {rms:.4}");
        }
        assert_eq!(merged.saturated.iter().filter(|s| **s).count(), 0);
        assert!(merged.disagreeing < truth.len() / 500, "{}", merged.disagreeing);
    }

    #[test]
    fn merging_is_no_noisier_than_the_best_frame() {
        let truth = vec![0.02f32; 30_000];
        let frames = bracket(&truth, &[0.32, 2.56, 20.0], 2);
        let rms = |radiance: &[f32]| (radiance.iter().map(|r| f64::from(r / 0.02 - 1.0).powi(2)).sum::<f64>() / 30_000.0).sqrt();
        let merged = rms(&merge(&frames).unwrap().radiance);
        let best = frames.iter().map(|f| rms(&merge(std::slice::from_ref(f)).unwrap().radiance)).fold(f64::INFINITY, f64::min);
        assert!(merged < best, "{merged} {best}");
    }

    #[test]
    fn what_every_frame_clips_is_a_marked_lower_bound() {
        let frames = [linear_frame(1, 1, &[1.0, 0.5, 0.2], 0.1), linear_frame(1, 1, &[1.0, 1.0, 1.0], 10.0)];
        let merged = merge(&frames).unwrap();
        assert_eq!(merged.saturated, [true, false, false]);
        assert!((merged.radiance[0] - 10.0).abs() < 1e-3 && (merged.radiance[1] - 5.0).abs() < 2e-3);
    }

    #[test]
    fn a_code_below_white_where_a_shorter_exposure_is_saturated_has_no_say() {
        // As compression leaves them: 0.96 where the sensor got a hundred times its capacity.
        let frames = [linear_frame(1, 1, &[1.0, 0.5, 0.97], 0.1), linear_frame(1, 1, &[0.96, 0.96, 0.96], 10.0)];
        let merged = merge(&frames).unwrap();
        assert_eq!((merged.saturated.as_slice(), merged.disagreeing), (&[true, false, false][..], 0));
        for (found, expected) in merged.radiance.iter().zip([10.0, 5.0, 9.7]) {
            assert!((found / expected - 1.0).abs() < 2e-3, "{found} {expected}");
        }
        // Far below white it is no compression: somebody stood there.
        let frames = [linear_frame(1, 1, &[0.5; 3], 0.1), linear_frame(1, 1, &[0.2; 3], 10.0)];
        assert_eq!(merge(&frames).unwrap().disagreeing, 3);
    }

    #[test]
    fn clipped_highlights_are_neutral_and_not_magenta() {
        // Green clips first; red and blue would make it magenta after white balance.
        let merged = merge(&[linear_frame(1, 1, &[0.8, 1.0, 0.7], 1.0)]).unwrap();
        let developed = merged.develop([2.0, 1.0, 1.8], &DMat3::IDENTITY);
        let [r, g, b] = developed.image.at(0, 0);
        assert!(developed.saturated[0] && g >= r && g >= b, "{r} {g} {b}");
    }

    #[test]
    fn something_that_moved_is_noticed() {
        let mut frames = bracket(&vec![0.1; 3000], &[1.0, 4.0], 3);
        if let Codes::U16(codes) = &mut frames[1].samples {
            codes[..300].fill(1000);
        }
        let merged = merge(&frames).unwrap();
        assert!((290..320).contains(&merged.disagreeing), "{}", merged.disagreeing);
    }

    #[test]
    fn frames_that_do_not_go_together_are_refused() {
        let a = linear_frame(2, 1, &[0.1; 6], 1.0);
        let b = linear_frame(1, 2, &[0.1; 6], 1.0);
        assert_eq!(merge(&[a.clone(), b]).unwrap_err(), FrameError::Mixed(1, 2, 2, 1));
        assert_eq!(merge(&[]).unwrap_err(), FrameError::None);
        let cell = Cell::bayer([0, 1, 1, 2]).unwrap();
        assert!(merge(&[CapturedFrame { layout: SampleLayout::Mosaic(cell), ..a }]).is_err());
    }
}

//! Metrics of HDR view synthesis.
//!
//! In: prediction and target `[H,W,3]` in the scene's normalised units, and an optional mask. Out:
//! [`ViewMetrics`]. Images are compared under the mu-law T: a pixel p becomes
//! `T(clip(p / divisor, 0, 1))`. Three protocols differ in the divisors:
//!
//! | protocol | target | prediction | used by |
//! |---|---|---|---|
//! | `scene` | 1 | 1 | training: one scale per scene |
//! | `gtmax` | max(target) | max(target) | HDR-NeRF |
//! | `selfmax` | max(target) | max(prediction) | HDR-GS |
//!
//! PSNR has peak 1 and pools the channels; SSIM is the mean of [`ssim`] over the channels. Masked
//! pixels count for no mean and no maximum; SSIM sees the target there in both images. A black
//! image is divided by 1. Sums are f64.
//!
//! [`FieldMetrics`] holds the metrics that need no mu-law: PU21, HDR-FLIP, LPIPS, the error of the
//! logarithm, and relative errors by decade. [`LuminanceProfile`] is the error by luminance, and
//! [`evaluate()`] measures a scene on views.

mod captured;
pub mod colormap;
mod decades;
mod evaluate;
mod field;
mod flip;
mod gain;
mod lpips;
mod measures;
mod profile;
mod pu21;
mod ssim;

use serde::{Deserialize, Serialize};

use luxel_core::tone::MuLaw;
use luxel_core::{Image, Mask};

pub use captured::render_as_captured;
pub use decades::{DecadeError, LOG_FLOOR};
pub use evaluate::{EvaluationError, GainFit, NamedMetrics, SplitMetrics, evaluate, probe};
pub use field::{FieldMetrics, FieldOptions, FlipChoice, field_metrics};
pub use flip::{FLIP_PIXELS_PER_DEGREE, FlipExposures, FlipMap, MEDIAN_FLOOR, hdr_flip, ldr_flip};
pub use gain::{GainChannels, log_gain, log_gain_of_view};
pub use lpips::{Lpips, LpipsError, LpipsNetwork, Tensors};
pub use measures::Measures;
pub use profile::{LuminanceProfile, PROFILE_BINS_PER_DECADE, ProfileBin};
pub use pu21::{PU21_PEAK, PU21_RANGE_CD_M2, pu21_encode};
use ssim::ssim_of_rows;
pub use ssim::{ssim, ssim_interior, ssim_replicated};

/// PSNR of equal images, dB. It stands for infinity, which JSON cannot hold; f32
/// rounding alone would score even higher.
pub const MAX_PSNR_DB: f64 = 100.0;

/// The reasons for which images cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MetricsError {
    /// The images have different sizes.
    #[error("prediction is {}x{}, target {}x{}: metrics need equal sizes", prediction.0, prediction.1, target.0, target.1)]
    Size {
        /// Width and height of the prediction.
        prediction: (usize, usize),
        /// Width and height of the target.
        target: (usize, usize),
    },
    /// The length of a plane is not that of the image.
    #[error("planes hold {prediction} and {target} values, expected {width} x {height}")]
    Planes {
        /// Values of the prediction.
        prediction: usize,
        /// Values of the target.
        target: usize,
        /// Width of the image, pixels.
        width: usize,
        /// Height of the image, pixels.
        height: usize,
    },
    /// The length of a mask is not that of the image.
    #[error("mask holds {found} pixels, image {expected}")]
    Mask {
        /// Pixels of the mask.
        found: usize,
        /// Pixels of the image.
        expected: usize,
    },
    /// No pixel is left to compare.
    #[error("no valid pixel: the image is empty or masked entirely")]
    NoValidPixels,
    /// A valid pixel is NaN or infinite.
    #[error("{image} is not finite at column {x}, row {y}")]
    NotFinite {
        /// `prediction` or `target`.
        image: &'static str,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// The mu-law has no curve for this mu.
    #[error("mu is {0}, expected a finite number above 0")]
    Mu(f32),
    /// A display with this peak luminance shows nothing.
    #[error("peak luminance is {0} cd/m2, expected a finite number above 0")]
    PeakLuminance(f32),
}

/// Metrics of one view, or their means over several views. PSNR is in dB, at most [`MAX_PSNR_DB`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewMetrics {
    /// PSNR by `scene`: in the scene's scale, clipped at 1.
    pub psnr_scene: f64,
    /// SSIM by `scene`: in the scene's scale, clipped at 1.
    pub ssim_scene: f64,
    /// PSNR by `gtmax`: both divided by the target's maximum.
    pub psnr_gtmax: f64,
    /// SSIM by `gtmax`: both divided by the target's maximum.
    pub ssim_gtmax: f64,
    /// PSNR by `selfmax`: each divided by its own maximum.
    pub psnr_selfmax: f64,
    /// SSIM by `selfmax`: each divided by its own maximum.
    pub ssim_selfmax: f64,
    /// PSNR of a black image by `scene`: the baseline without any knowledge, and a check of the
    /// loader.
    pub psnr_black_scene: f64,
    /// PSNR of a black image by `gtmax`, which is also that by `selfmax`.
    pub psnr_black_gtmax: f64,
    /// Mean absolute difference under the mu-law by `scene`.
    pub l1_scene: f64,
    /// Mean absolute difference under the mu-law in the scene's scale, not clipped above: the L1
    /// term of the training loss.
    pub mean_abs_mu: f64,
}

impl ViewMetrics {
    /// Returns names and values, in the order of the fields.
    pub fn named(&self) -> [(&'static str, f64); 10] {
        [
            ("psnr_scene", self.psnr_scene),
            ("ssim_scene", self.ssim_scene),
            ("psnr_gtmax", self.psnr_gtmax),
            ("ssim_gtmax", self.ssim_gtmax),
            ("psnr_selfmax", self.psnr_selfmax),
            ("ssim_selfmax", self.ssim_selfmax),
            ("psnr_black_scene", self.psnr_black_scene),
            ("psnr_black_gtmax", self.psnr_black_gtmax),
            ("l1_scene", self.l1_scene),
            ("mean_abs_mu", self.mean_abs_mu),
        ]
    }

    /// Returns the mean of every metric, or `None` without any view. PSNR is averaged in dB, as is
    /// usual.
    pub fn mean(views: &[Self]) -> Option<Self> {
        if views.is_empty() {
            return None;
        }
        let mean = |of: fn(&Self) -> f64| views.iter().map(of).sum::<f64>() / views.len() as f64;
        Some(Self {
            psnr_scene: mean(|v| v.psnr_scene),
            ssim_scene: mean(|v| v.ssim_scene),
            psnr_gtmax: mean(|v| v.psnr_gtmax),
            ssim_gtmax: mean(|v| v.ssim_gtmax),
            psnr_selfmax: mean(|v| v.psnr_selfmax),
            ssim_selfmax: mean(|v| v.ssim_selfmax),
            psnr_black_scene: mean(|v| v.psnr_black_scene),
            psnr_black_gtmax: mean(|v| v.psnr_black_gtmax),
            l1_scene: mean(|v| v.l1_scene),
            mean_abs_mu: mean(|v| v.mean_abs_mu),
        })
    }
}

/// Computes every metric of a view: `prediction` against `target`, both in normalised units.
///
/// # Errors
/// [`MetricsError`]: sizes differ, no pixel is valid, a valid pixel is NaN or infinite, or mu is
/// not positive.
pub fn view_metrics(prediction: &Image, target: &Image, mask: Option<&Mask>, mu: f32) -> Result<ViewMetrics, MetricsError> {
    let curve = curve(mu)?;
    let pair = Pair::new(prediction, target, mask)?;
    let (prediction_max, target_max) = pair.maxima();
    let by = |divisors: [f32; 2]| pair.compare(divisors, curve);
    let by_target = || rayon::join(|| by([target_max; 2]), || by([prediction_max, target_max]));
    let (scene, (gtmax, selfmax)) = rayon::join(|| by([1.0; 2]), by_target);
    let mut abs_mu = 0.0;
    for (prediction, target) in pair.valid() {
        for c in 0..3 {
            abs_mu += f64::from((curve.apply(prediction[c].max(0.0)) - curve.apply(target[c].max(0.0))).abs());
        }
    }
    Ok(ViewMetrics {
        psnr_scene: psnr_of_mse(scene.mse),
        ssim_scene: scene.ssim,
        psnr_gtmax: psnr_of_mse(gtmax.mse),
        ssim_gtmax: gtmax.ssim,
        psnr_selfmax: psnr_of_mse(selfmax.mse),
        ssim_selfmax: selfmax.ssim,
        psnr_black_scene: psnr_of_mse(scene.mse_black),
        psnr_black_gtmax: psnr_of_mse(gtmax.mse_black),
        l1_scene: scene.l1,
        mean_abs_mu: abs_mu / (3.0 * pair.valid_count as f64),
    })
}

/// Computes [`ViewMetrics::psnr_scene`] alone, in a small part of the time of [`view_metrics`].
///
/// # Errors
/// The same as of [`view_metrics`].
pub fn psnr_scene(prediction: &Image, target: &Image, mask: Option<&Mask>, mu: f32) -> Result<f64, MetricsError> {
    let curve = curve(mu)?;
    let pair = Pair::new(prediction, target, mask)?;
    let tone = |value: f32| curve.apply(value.clamp(0.0, 1.0));
    let square = |p: f32, t: f32| f64::from(tone(p) - tone(t)).powi(2);
    let squares: f64 = pair.valid().map(|(p, t)| (0..3).map(|c| square(p[c], t[c])).sum::<f64>()).sum();
    Ok(psnr_of_mse(squares / (3.0 * pair.valid_count as f64)))
}

fn curve(mu: f32) -> Result<MuLaw, MetricsError> {
    if mu.is_finite() && mu > 0.0 { Ok(MuLaw::new(mu)) } else { Err(MetricsError::Mu(mu)) }
}

/// Returns the PSNR of a mean squared error, dB: -10 log10(`mse`) with peak 1, at most
/// [`MAX_PSNR_DB`].
pub fn psnr_of_mse(mse: f64) -> f64 {
    (-10.0 * mse.log10()).min(MAX_PSNR_DB)
}

/// A prediction, its target and the mask of the pixels that count.
struct Pair<'a> {
    prediction: &'a Image,
    target: &'a Image,
    mask: Option<&'a Mask>,
    valid_count: usize,
}

/// The comparison of a prediction with its target by one protocol.
struct Comparison {
    mse: f64,
    mse_black: f64,
    l1: f64,
    ssim: f64,
}

impl<'a> Pair<'a> {
    fn new(prediction: &'a Image, target: &'a Image, mask: Option<&'a Mask>) -> Result<Self, MetricsError> {
        let size = |image: &Image| (image.width, image.height);
        let expected = target.pixels.len();
        if size(prediction) != size(target) || prediction.pixels.len() != expected {
            return Err(MetricsError::Size { prediction: size(prediction), target: size(target) });
        }
        if let Some(found) = mask.map(|mask| mask.weights.len()).filter(|&found| found != expected) {
            return Err(MetricsError::Mask { found, expected });
        }
        let pair = Self { prediction, target, mask, valid_count: 0 };
        for i in (0..expected).filter(|&i| pair.is_valid(i)) {
            for (image, pixels) in [("prediction", &prediction.pixels), ("target", &target.pixels)] {
                if pixels[i].iter().any(|v| !v.is_finite()) {
                    let width = target.width.max(1);
                    return Err(MetricsError::NotFinite { image, x: i % width, y: i / width });
                }
            }
        }
        match pair.valid().count() {
            0 => Err(MetricsError::NoValidPixels),
            valid_count => Ok(Self { valid_count, ..pair }),
        }
    }

    fn is_valid(&self, i: usize) -> bool {
        self.mask.is_none_or(|mask| mask.is_valid(i))
    }

    fn valid(&self) -> impl Iterator<Item = ([f32; 3], [f32; 3])> {
        let pairs = self.prediction.pixels.iter().zip(&self.target.pixels).enumerate();
        pairs.filter(|&(i, _)| self.is_valid(i)).map(|(_, (&p, &t))| (p, t))
    }

    /// Returns the largest channel value of the prediction and of the target; 1 for a black image.
    fn maxima(&self) -> (f32, f32) {
        let largest = |rgb: [f32; 3]| rgb[0].max(rgb[1]).max(rgb[2]);
        let (prediction, target) = self.valid().fold((0f32, 0f32), |(a, b), (p, t)| (a.max(largest(p)), b.max(largest(t))));
        let or_one = |max: f32| if max > 0.0 { max } else { 1.0 };
        (or_one(prediction), or_one(target))
    }

    /// Compares the prediction with the target, each divided and under the mu-law. NaN and
    /// infinity, which masked pixels may hold, become 0.
    fn compare(&self, [divisor, target_divisor]: [f32; 2], curve: MuLaw) -> Comparison {
        let (mut squares, mut squares_black, mut absolute, mut similarity) = (0.0, 0.0, 0.0, 0.0);
        let [width, height] = [self.target.width, self.target.height];
        for channel in 0..3 {
            similarity += ssim_of_rows([width, height], |y, predictions: &mut [f32], targets: &mut [f32]| {
                for (x, (p, t)) in predictions.iter_mut().zip(targets).enumerate() {
                    let i = y * width + x;
                    let value = self.target.pixels[i][channel];
                    *t = if value.is_finite() { curve.apply((value / target_divisor).clamp(0.0, 1.0)) } else { 0.0 };
                    if !self.is_valid(i) {
                        *p = *t;
                        continue;
                    }
                    *p = curve.apply((self.prediction.pixels[i][channel] / divisor).clamp(0.0, 1.0));
                    let difference = f64::from(*p) - f64::from(*t);
                    squares += difference * difference;
                    squares_black += f64::from(*t) * f64::from(*t);
                    absolute += difference.abs();
                }
            });
        }
        let count = 3.0 * self.valid_count as f64;
        Comparison { mse: squares / count, mse_black: squares_black / count, l1: absolute / count, ssim: similarity / 3.0 }
    }
}

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;

#[cfg(test)]
mod tests;

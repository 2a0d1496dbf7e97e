//! The loss of an image under a curve, with its gradient by the values, for steps that compare more
//! than one image.
//!
//! In: predicted and expected values `[3][H*W]`, weights of pixels, [`LossWeights`]. Out: mean
//! absolute difference, mean SSIM, the loss, and its gradient. The formulas are those of the
//! engines' pass `loss`: 11 x 11 window with zero padding, weights that mix the prediction with the
//! target. Each channel is computed by one thread: the same bits for any number of threads.
//! Degenerate: if all weights are 0, loss and gradient are 0.

use fearless_simd::Level;
use luxel_core::{LossWeights, SQUARED_KNEE, SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_TAPS, ssim_window};
use rayon::prelude::*;

/// The values of an image by channel, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Planes {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) values: [Vec<f32>; 3],
}

/// A prediction compared with its target.
#[derive(Clone, Debug)]
pub(crate) struct Comparison {
    pub(crate) loss: f32,
    pub(crate) l1: f32,
    pub(crate) ssim: f32,
    /// Gradient of the loss by the predicted values.
    pub(crate) by_value: Planes,
}

impl Planes {
    /// Makes planes of interleaved pixels, each value mapped by `map(channel, value)`.
    pub(crate) fn from_pixels(width: usize, height: usize, pixels: &[[f32; 3]], map: impl Fn(usize, f32) -> f32 + Sync) -> Self {
        let plane = |c: usize| pixels.iter().map(|rgb| map(c, rgb[c])).collect();
        Self { width, height, values: [plane(0), plane(1), plane(2)] }
    }

    /// Returns the values of pixel `i`.
    pub(crate) fn pixel(&self, i: usize) -> [f32; 3] {
        [0, 1, 2].map(|c| self.values[c][i])
    }
}

/// A prediction compared with its target value by value.
#[derive(Clone, Debug)]
pub(crate) struct MappedComparison {
    pub(crate) comparison: Comparison,
    /// 1 - SSIM of the window around each value.
    pub(crate) dissimilarity: Planes,
}

/// Sums of one channel, and its gradient.
struct Channel {
    absolute: f64,
    squared: f64,
    /// Sum of SSIM times the weight of its value, and sum of these weights.
    ssim: f64,
    weight: f64,
    gradient: Vec<f32>,
    dissimilarity: Vec<f32>,
}

/// How much values count: by pixel, and in the losses of single values and windows.
#[derive(Clone, Copy)]
struct Weights<'a> {
    pixels: Option<&'a [f32]>,
    values: Option<&'a [f32]>,
}

/// Compares an image with its target.
pub(crate) fn compare(prediction: &Planes, target: &Planes, weights: Option<&[f32]>, loss: &LossWeights) -> Comparison {
    compare_mapped(prediction, target, None, weights, loss).comparison
}

/// Compares an image with its target, where the difference of each value and the SSIM of the window
/// around it count as much as `map` says; L1 and SSIM that are reported do so, too.
pub(crate) fn compare_mapped(
    prediction: &Planes,
    target: &Planes,
    map: Option<&Planes>,
    weights: Option<&[f32]>,
    loss: &LossWeights,
) -> MappedComparison {
    let (width, height) = (prediction.width, prediction.height);
    let total = 3.0 * weights.map_or((width * height) as f64, |weights| weights.iter().map(|w| f64::from(*w)).sum());
    let channels: Vec<Channel> = (0..3)
        .into_par_iter()
        .map(|c| {
            let planes = [&prediction.values[c][..], &target.values[c]];
            fearless_simd::dispatch!(Level::new(), _simd => channel([width, height], planes, Weights { pixels: weights, values: map.map(|map| &map.values[c][..]) }, loss, total))
        })
        .collect();
    let sum = |of: fn(&Channel) -> f64| channels.iter().map(of).sum::<f64>();
    let mean = |sum: f64| if total > 0.0 { (sum / total) as f32 } else { 0.0 };
    let (l1, l2) = (mean(sum(|c| c.absolute)), mean(sum(|c| c.squared)));
    let count = (3 * width * height).max(1) as f64;
    let (ssim, weight) = ((sum(|c| c.ssim) / count) as f32, (sum(|c| c.weight) / count) as f32);
    // Of a perfect image SSIM is 1 times the mean weight.
    let loss = loss.total(l1, l2, ssim) - loss.ssim_weight * (1.0 - weight);
    let (mut gradients, mut dissimilarities): (Vec<_>, Vec<_>) = channels.into_iter().map(|c| (c.gradient, c.dissimilarity)).unzip();
    let planes = |channels: &mut Vec<Vec<f32>>| {
        let mut channels = channels.drain(..);
        Planes { width, height, values: [(); 3].map(|()| channels.next().unwrap_or_default()) }
    };
    let comparison = Comparison { loss, l1, ssim, by_value: planes(&mut gradients) };
    MappedComparison { comparison, dissimilarity: planes(&mut dissimilarities) }
}

/// Compares a channel. The same operations on every instruction set: arithmetic is by elements.
#[inline(always)]
fn channel([width, height]: [usize; 2], [x, y]: [&[f32]; 2], weights: Weights<'_>, loss: &LossWeights, total: f64) -> Channel {
    let of_value = |i: usize| weights.values.map_or(1.0, |map| map[i]);
    let mixed: Vec<f32> = match weights.pixels {
        None => x.to_vec(),
        Some(weights) => x.iter().zip(y).zip(weights).map(|((x, y), w)| w * x + (1.0 - w) * y).collect(),
    };
    let x = &mixed[..];
    let mut gradient = vec![0.0; x.len()];
    let (mut absolute, mut squared) = (0.0f64, 0.0f64);
    let by_difference = if total > 0.0 { (1.0 - loss.ssim_weight) / total as f32 } else { 0.0 };
    let (l1, l2) = (by_difference * (1.0 - loss.squared_share), by_difference * loss.squared_share / SQUARED_KNEE);
    for (i, ((x, y), gradient)) in x.iter().zip(y).zip(&mut gradient).enumerate() {
        let (d, weight) = (x - y, of_value(i));
        absolute += f64::from(weight * d.abs());
        squared += f64::from(weight * d * d);
        let sign = if d > 0.0 {
            l1
        } else if d < 0.0 {
            -l1
        } else {
            0.0
        };
        *gradient = weight * (sign + l2 * d);
    }
    let mut window = Window::new(width, height);
    let both = || x.iter().zip(y);
    let (mx, my) = (window.convolve(x.to_vec()), window.convolve(y.to_vec()));
    let squares = window.convolve(both().map(|(x, y)| x * x + y * y).collect());
    let product = window.convolve(both().map(|(x, y)| x * y).collect());
    let mut by = [vec![0.0; x.len()], vec![0.0; x.len()], vec![0.0; x.len()]];
    let (mut ssim, mut total_weight) = (0.0f64, 0.0f64);
    let mut dissimilarity = vec![0.0; x.len()];
    for (i, dissimilarity) in dissimilarity.iter_mut().enumerate() {
        let (value, weight) = (similarity([mx[i], my[i], squares[i], product[i]]), of_value(i));
        ssim += f64::from(weight * value.ssim);
        total_weight += f64::from(weight);
        *dissimilarity = 1.0 - value.ssim;
        by.iter_mut().zip(value.by).for_each(|(plane, v)| plane[i] = weight * v);
    }
    let factor = -loss.ssim_weight / (3 * width * height) as f32;
    if factor != 0.0 {
        let [by_mean, by_square, by_product] = by.map(|plane| window.convolve(plane));
        for (i, gradient) in gradient.iter_mut().enumerate() {
            *gradient += factor * (by_mean[i] + 2.0 * x[i] * by_square[i] + y[i] * by_product[i]);
        }
    }
    if let Some(weights) = weights.pixels {
        gradient.iter_mut().zip(weights).for_each(|(gradient, weight)| *gradient *= weight);
    }
    Channel { absolute, squared, ssim, weight: total_weight, gradient, dissimilarity }
}

/// SSIM of a window, with its derivatives by the means of x, x^2 and xy.
struct Similarity {
    ssim: f32,
    by: [f32; 3],
}

#[inline(always)]
fn similarity([mx, my, squares, product]: [f32; 4]) -> Similarity {
    let (c1, c2) = (SSIM_C1 as f32, SSIM_C2 as f32);
    let (a, b) = (2.0 * mx * my + c1, 2.0 * (product - mx * my) + c2);
    let (c, d) = (mx * mx + my * my + c1, squares - mx * mx - my * my + c2);
    let ssim = a * b / (c * d);
    let by_mean = 2.0 * my * (b - a) / (c * d) - 2.0 * mx * ssim / c + 2.0 * mx * ssim / d;
    Similarity { ssim, by: [by_mean, -ssim / d, 2.0 * a / (c * d)] }
}

/// The window of SSIM over planes of one size.
struct Window {
    width: usize,
    height: usize,
    taps: [f32; SSIM_TAPS],
    row: Vec<f32>,
    down: Vec<f32>,
}

impl Window {
    fn new(width: usize, height: usize) -> Self {
        let taps = ssim_window().map(|v| v as f32);
        Self { width, height, taps, row: vec![0.0; width + 2 * SSIM_RADIUS], down: vec![0.0; width * height] }
    }

    /// Convolves a plane, down the columns and then along the rows. The window is symmetric, so
    /// this is its own adjoint.
    #[inline(always)]
    fn convolve(&mut self, mut plane: Vec<f32>) -> Vec<f32> {
        let Self { width, height, taps, row, down } = self;
        for y in 0..*height {
            let out = &mut down[y * *width..][..*width];
            out.fill(0.0);
            for (tap, weight) in taps.iter().enumerate() {
                let from = (y + tap).checked_sub(SSIM_RADIUS).filter(|from| from < height);
                if let Some(from) = from {
                    out.iter_mut().zip(&plane[from * *width..]).for_each(|(sum, v)| *sum += *weight * *v);
                }
            }
        }
        for (out, from) in plane.chunks_exact_mut((*width).max(1)).zip(down.chunks_exact((*width).max(1))) {
            row[SSIM_RADIUS..][..from.len()].copy_from_slice(from);
            out.fill(0.0);
            for (tap, weight) in taps.iter().enumerate() {
                out.iter_mut().zip(&row[tap..]).for_each(|(sum, v)| *sum += *weight * *v);
            }
        }
        plane
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    fn planes(seed: u64) -> Planes {
        let value = |c: u64, i: u64| 0.5 + 0.2 * (0.3 * i as f32).sin() + 0.1 * standard_normal(seed, 1000 * c + i)[0];
        let plane = |c: u64| (0..17 * 13).map(|i| value(c, i)).collect();
        Planes { width: 17, height: 13, values: [plane(0), plane(1), plane(2)] }
    }

    #[test]
    fn the_gradient_is_that_of_differences_with_and_without_weights() {
        let (x, y) = (planes(1), planes(2));
        let weights: Vec<f32> = (0..17 * 13).map(|i| [1.0, 0.0, 0.5, 1.0, 0.25][i % 5]).collect();
        let loss = LossWeights { ssim_weight: 0.4, squared_share: 0.3, ..LossWeights::default() };
        for weights in [None, Some(&weights[..])] {
            let exact = compare(&x, &y, weights, &loss).by_value;
            for (c, i) in [(0, 0), (1, 40), (2, 111), (0, 220), (1, 7), (2, 83)] {
                let moved = |h: f32| {
                    let mut x = x.clone();
                    x.values[c][i] += h;
                    f64::from(compare(&x, &y, weights, &loss).loss)
                };
                let numeric = (moved(4e-3) - moved(-4e-3)) / 8e-3;
                let found = f64::from(exact.values[c][i]);
                assert!((numeric - found).abs() < 2e-5 + 2e-2 * found.abs(), "{c}, {i}: {numeric:e} {found:e}");
            }
        }
    }

    #[test]
    fn the_gradient_under_a_map_is_that_of_differences_and_a_map_of_ones_changes_nothing() {
        let (x, y) = (planes(1), planes(2));
        let mut map = planes(5);
        map.values.iter_mut().flatten().for_each(|w| *w = w.abs());
        let loss = LossWeights { ssim_weight: 0.4, squared_share: 0.3, ..LossWeights::default() };
        let exact = compare_mapped(&x, &y, Some(&map), None, &loss).comparison.by_value;
        for (c, i) in [(0, 0), (1, 40), (2, 111), (0, 220)] {
            let moved = |h: f32| {
                let mut x = x.clone();
                x.values[c][i] += h;
                f64::from(compare_mapped(&x, &y, Some(&map), None, &loss).comparison.loss)
            };
            let (numeric, found) = ((moved(4e-3) - moved(-4e-3)) / 8e-3, f64::from(exact.values[c][i]));
            assert!((numeric - found).abs() < 2e-5 + 2e-2 * found.abs(), "{c}, {i}: {numeric:e} {found:e}");
        }
        map.values.iter_mut().flatten().for_each(|w| *w = 1.0);
        let (with, without) = (compare_mapped(&x, &y, Some(&map), None, &loss).comparison, compare(&x, &y, None, &loss));
        assert_eq!((with.loss, with.by_value), (without.loss, without.by_value));
    }

    #[test]
    fn equal_images_have_no_loss_and_pixels_without_weight_no_effect() {
        let (x, y) = (planes(3), planes(3));
        let same = compare(&x, &y, None, &LossWeights::default());
        assert!(same.loss.abs() < 1e-6 && (same.ssim - 1.0).abs() < 1e-6 && same.l1 == 0.0, "{same:?}");
        let mut other = x.clone();
        other.values[1][50] = 9.0;
        let mut weights = vec![1.0; 17 * 13];
        weights[50] = 0.0;
        let masked = |x: &Planes| compare(x, &planes(4), Some(&weights), &LossWeights::default());
        assert_eq!(masked(&x).loss, masked(&other).loss);
        assert_eq!(masked(&other).by_value.values[1][50], 0.0);
        assert_eq!(compare(&x, &planes(4), Some(&[0.0; 17 * 13]), &LossWeights { ssim_weight: 0.0, ..LossWeights::default() }).loss, 0.0);
    }
}

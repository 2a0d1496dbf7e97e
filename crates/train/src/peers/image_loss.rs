//! The loss of an image under a curve, with its gradient by the values, for steps that compare more
//! than one image.
//!
//! In: predicted and expected values `[3, H, W]`, weights of pixels, [`LossWeights`]. Out: mean
//! absolute difference, mean SSIM, the loss, and its gradient. The formulas are those of the
//! engines' pass `loss`: 11 x 11 window with zero padding, weights that mix the prediction with the
//! target. Each channel is computed by one thread, row by row: the same bits for any number of
//! threads. Degenerate: if all weights are 0, loss and gradient are 0.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x16};
use luxel_core::{LossWeights, SQUARED_KNEE, SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_TAPS, ssim_window};
use rayon::prelude::*;

use super::functions::LANES;

/// A prediction with its target, and how much pixels and values count.
#[derive(Clone, Copy)]
pub(super) struct Compared<'a> {
    /// Width and height.
    pub(super) size: [usize; 2],
    /// `[3, H, W]`.
    pub(super) prediction: &'a [f32],
    /// `[3, H, W]`.
    pub(super) target: &'a [f32],
    /// Weights of pixels, `[H, W]`.
    pub(super) pixels: Option<&'a [f32]>,
    /// Weights of the difference of each value and of the SSIM of the window around it, `[3, H,
    /// W]`; L1 and SSIM that are reported have them, too.
    pub(super) values: Option<&'a [f32]>,
    /// Factor of the gradient.
    pub(super) factor: f32,
}

/// Receives what a comparison finds value by value.
pub(super) struct ComparedOut<'a> {
    /// Gradient of the loss by the prediction, `[3, H, W]`.
    pub(super) by_value: &'a mut [f32],
    /// 1 - SSIM of the window around each value, `[3, H, W]`, if it is wanted.
    pub(super) dissimilarity: Option<&'a mut [f32]>,
}

/// The means of a comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Comparison {
    pub(super) loss: f32,
    pub(super) l1: f32,
    pub(super) ssim: f32,
}

/// Sums of one channel.
#[derive(Clone, Copy, Default)]
struct Sums {
    absolute: f64,
    squared: f64,
    /// Sum of SSIM times the weight of its value, and sum of these weights.
    ssim: f64,
    weight: f64,
}

/// Compares an image with its target.
pub(super) fn compare(of: &Compared<'_>, loss: &LossWeights, out: ComparedOut<'_>) -> Comparison {
    let pixels = of.size[0] * of.size[1];
    let total = 3.0 * of.pixels.map_or(pixels as f64, |weights| weights.iter().map(|w| f64::from(*w)).sum());
    let ComparedOut { by_value, dissimilarity } = out;
    let mut dissimilarity = dissimilarity.map(|planes| planes.chunks_mut(pixels.max(1)));
    let outs: Vec<ChannelOut<'_>> = by_value
        .chunks_mut(pixels.max(1))
        .map(|by_value| ChannelOut { by_value, dissimilarity: dissimilarity.as_mut().and_then(Iterator::next) })
        .collect();
    let sums: Vec<Sums> = outs
        .into_par_iter()
        .enumerate()
        .map(|(c, out)| {
            let plane = |planes: &'_ [f32]| c * pixels..((c + 1) * pixels).min(planes.len());
            let channel = Channel {
                size: of.size,
                x: &of.prediction[plane(of.prediction)],
                y: &of.target[plane(of.target)],
                pixels: of.pixels,
                values: of.values.map(|values| &values[plane(values)]),
                by_difference: if total > 0.0 { of.factor * (1.0 - loss.ssim_weight) / total as f32 } else { 0.0 },
                by_ssim: -of.factor * loss.ssim_weight / (3 * pixels).max(1) as f32,
                squared_share: loss.squared_share,
            };
            fearless_simd::dispatch!(Level::new(), simd => channel.compare(simd, out))
        })
        .collect();
    let sum = |of: fn(&Sums) -> f64| sums.iter().map(of).sum::<f64>();
    let mean = |sum: f64| if total > 0.0 { (sum / total) as f32 } else { 0.0 };
    let (l1, l2) = (mean(sum(|c| c.absolute)), mean(sum(|c| c.squared)));
    let count = (3 * pixels).max(1) as f64;
    let (ssim, weight) = ((sum(|c| c.ssim) / count) as f32, (sum(|c| c.weight) / count) as f32);
    // Of a perfect image SSIM is 1 times the mean weight.
    Comparison { loss: loss.total(l1, l2, ssim) - loss.ssim_weight * (1.0 - weight), l1, ssim }
}

/// A channel to be compared.
struct Channel<'a> {
    size: [usize; 2],
    x: &'a [f32],
    y: &'a [f32],
    pixels: Option<&'a [f32]>,
    values: Option<&'a [f32]>,
    /// Gradient by an absolute difference of weight 1, and by an SSIM.
    by_difference: f32,
    by_ssim: f32,
    squared_share: f32,
}

struct ChannelOut<'a> {
    by_value: &'a mut [f32],
    dissimilarity: Option<&'a mut [f32]>,
}

/// A plane whose rows are whole vectors, with zeros behind the last pixel.
struct Padded {
    /// Vectors of a row.
    stride: usize,
    vectors: Vec<[f32; LANES]>,
}

impl Padded {
    fn zeros([width, height]: [usize; 2]) -> Self {
        let stride = width.div_ceil(LANES);
        Self { stride, vectors: vec![[0.0; LANES]; stride * height] }
    }

    #[inline(always)]
    fn load<S: Simd>(&self, simd: S, row: usize, vector: usize) -> f32x16<S> {
        f32x16::load_array_ref(simd, &self.vectors[row * self.stride + vector])
    }

    #[inline(always)]
    fn store<S: Simd>(&mut self, row: usize, vector: usize, values: f32x16<S>) {
        values.store_array(&mut self.vectors[row * self.stride + vector]);
    }

    fn row_mut(&mut self, row: usize, width: usize) -> &mut [f32] {
        &mut self.vectors[row * self.stride..][..self.stride].as_flattened_mut()[..width]
    }
}

/// Numbers that the window reads for a vector of sums along a row.
const REACH: usize = LANES + 2 * SSIM_RADIUS;

/// A row with room for the window on both sides.
struct Margined(Vec<f32>);

impl Margined {
    fn zeros(stride: usize) -> Self {
        Self(vec![0.0; stride * LANES + 2 * SSIM_RADIUS])
    }

    #[inline(always)]
    fn store<S: Simd>(&mut self, vector: usize, values: f32x16<S>) {
        values.store_slice(&mut self.0[SSIM_RADIUS + vector * LANES..][..LANES]);
    }

    /// Removes what lies behind the last pixel.
    fn end(&mut self, width: usize) {
        self.0[SSIM_RADIUS + width..].fill(0.0);
    }

    /// Returns the numbers that the window reads for a vector.
    #[inline(always)]
    fn reach(&self, vector: usize) -> &[f32; REACH] {
        self.0[vector * LANES..].first_chunk().unwrap_or(&[0.0; REACH])
    }
}

/// Returns the window's sums along `N` rows.
#[inline(always)]
fn along<S: Simd, const N: usize>(simd: S, rows: &[Margined; N], taps: &[f32; SSIM_TAPS], vector: usize) -> [f32x16<S>; N] {
    let mut sums = [f32x16::splat(simd, 0.0); N];
    for (sum, row) in sums.iter_mut().zip(rows) {
        let reach = row.reach(vector);
        for (tap, weight) in taps.iter().enumerate() {
            *sum = f32x16::from_slice(simd, &reach[tap..tap + LANES]).mul_add(f32x16::splat(simd, *weight), *sum);
        }
    }
    sums
}

/// Returns the taps of the window around `row` that lie on the image; tap number n is on row
/// `row + n - SSIM_RADIUS`.
fn window_rows(row: usize, height: usize) -> std::ops::Range<usize> {
    SSIM_RADIUS.saturating_sub(row)..SSIM_TAPS.min(height + SSIM_RADIUS - row)
}

impl Channel<'_> {
    /// Returns the prediction, mixed with the target by the weights of pixels, and the target.
    fn padded(&self) -> [Padded; 2] {
        let [width, height] = self.size;
        let (mut x, mut y) = (Padded::zeros(self.size), Padded::zeros(self.size));
        for row in 0..height {
            let at = row * width..(row + 1) * width;
            y.row_mut(row, width).copy_from_slice(&self.y[at.clone()]);
            let (out, x, y) = (x.row_mut(row, width), &self.x[at.clone()], &self.y[at.clone()]);
            match self.pixels {
                None => out.copy_from_slice(x),
                Some(weights) => {
                    let values = out.iter_mut().zip(x).zip(y).zip(&weights[at]);
                    values.for_each(|(((out, x), y), w)| *out = w * x + (1.0 - w) * y);
                }
            }
        }
        [x, y]
    }

    #[inline(always)]
    fn compare<S: Simd>(&self, simd: S, out: ChannelOut<'_>) -> Sums {
        let ([width, height], taps) = (self.size, ssim_window().map(|v| v as f32));
        let ChannelOut { by_value, mut dissimilarity } = out;
        let [x, y] = self.padded();
        let mut sums = Sums::default();
        let mut by = [(); 3].map(|()| Padded::zeros(self.size));
        let mut rows = [(); 4].map(|()| Margined::zeros(x.stride));
        let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
        for row in 0..height {
            for vector in 0..x.stride {
                let mut down = [zero; 5];
                for tap in window_rows(row, height) {
                    let from = row + tap - SSIM_RADIUS;
                    let (x, y, weight) = (x.load(simd, from, vector), y.load(simd, from, vector), f32x16::splat(simd, taps[tap]));
                    let (wx, wy) = (weight * x, weight * y);
                    down[0] += wx;
                    down[1] += wy;
                    down[2] = wx.mul_add(x, down[2]);
                    down[3] = wx.mul_add(y, down[3]);
                    down[4] = wy.mul_add(y, down[4]);
                }
                rows[0].store(vector, down[0]);
                rows[1].store(vector, down[1]);
                rows[2].store(vector, down[2] + down[4]);
                rows[3].store(vector, down[3]);
            }
            rows.iter_mut().for_each(|row| row.end(width));
            let (mut ssim, mut weights) = (zero, zero);
            for vector in 0..x.stride {
                let first = vector * LANES;
                let len = LANES.min(width - first);
                let found = similarity(simd, along(simd, &rows, &taps, vector));
                let weight = f32x16::load_array_ref(simd, &self.weights_of_values(row * width + first, len));
                ssim = weight.mul_add(found.ssim, ssim);
                weights += weight;
                for (by, value) in by.iter_mut().zip(found.by) {
                    by.store(row, vector, weight * value);
                }
                if let Some(dissimilarity) = &mut dissimilarity {
                    let values = (one - found.ssim).to_array();
                    dissimilarity[row * width + first..][..len].copy_from_slice(&values[..len]);
                }
            }
            sums.ssim += f64::from(ssim.to_array().iter().sum::<f32>());
            sums.weight += f64::from(weights.to_array().iter().sum::<f32>());
        }
        let [first, second, third, _] = rows;
        let mut rows = [first, second, third];
        for row in 0..height {
            self.differentiate_row(simd, row, &x, &y, &by, &mut rows, &taps, &mut by_value[row * width..][..width], &mut sums);
        }
        sums
    }

    /// Returns the weights of `len` values from `first` on, and zeros behind them.
    #[inline(always)]
    fn weights_of_values(&self, first: usize, len: usize) -> [f32; LANES] {
        let mut weights = [0.0; LANES];
        match self.values {
            None => weights[..len].fill(1.0),
            Some(values) => weights[..len].copy_from_slice(&values[first..first + len]),
        }
        weights
    }

    /// Writes the gradient by a row of the prediction, and adds the sums of its differences.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "an inlined part of a loop")]
    fn differentiate_row<S: Simd>(
        &self,
        simd: S,
        row: usize,
        x: &Padded,
        y: &Padded,
        by: &[Padded; 3],
        rows: &mut [Margined; 3],
        taps: &[f32; SSIM_TAPS],
        out: &mut [f32],
        sums: &mut Sums,
    ) {
        let [width, height] = self.size;
        let c = |value: f32| f32x16::splat(simd, value);
        let zero = c(0.0);
        let (l1, l2) = (self.by_difference * (1.0 - self.squared_share), self.by_difference * self.squared_share / SQUARED_KNEE);
        for vector in 0..x.stride {
            let mut down = [zero; 3];
            for tap in window_rows(row, height) {
                let (from, weight) = (row + tap - SSIM_RADIUS, c(taps[tap]));
                for (down, by) in down.iter_mut().zip(by) {
                    *down = by.load(simd, from, vector).mul_add(weight, *down);
                }
            }
            for (row, down) in rows.iter_mut().zip(down) {
                row.store(vector, down);
            }
        }
        rows.iter_mut().for_each(|row| row.end(width));
        let (mut absolute, mut squared) = (zero, zero);
        for vector in 0..x.stride {
            let column = vector * LANES;
            let len = LANES.min(width - column);
            let (x, y) = (x.load(simd, row, vector), y.load(simd, row, vector));
            let weight = f32x16::load_array_ref(simd, &self.weights_of_values(row * width + column, len));
            let d = x - y;
            absolute = weight.mul_add(d.abs(), absolute);
            squared = (weight * d).mul_add(d, squared);
            let sign = d.simd_gt(zero).select(c(l1), d.simd_lt(zero).select(c(-l1), zero));
            let along = along(simd, rows, taps, vector);
            let by_window = y.mul_add(along[2], (x + x).mul_add(along[1], along[0]));
            let mut gradient = weight.mul_add(d.mul_add(c(l2), sign), c(self.by_ssim) * by_window).to_array();
            if let Some(weights) = self.pixels {
                gradient.iter_mut().zip(&weights[row * width + column..]).for_each(|(gradient, weight)| *gradient *= weight);
            }
            out[column..][..len].copy_from_slice(&gradient[..len]);
        }
        sums.absolute += f64::from(absolute.to_array().iter().sum::<f32>());
        sums.squared += f64::from(squared.to_array().iter().sum::<f32>());
    }
}

/// SSIM of windows, with its derivatives by the means of x, x^2 and xy.
struct Similarity<S: Simd> {
    ssim: f32x16<S>,
    by: [f32x16<S>; 3],
}

/// Compares windows by the means of x, y, x^2 + y^2 and xy.
#[inline(always)]
fn similarity<S: Simd>(simd: S, [mx, my, squares, product]: [f32x16<S>; 4]) -> Similarity<S> {
    let (c1, c2) = (f32x16::splat(simd, SSIM_C1 as f32), f32x16::splat(simd, SSIM_C2 as f32));
    let two = f32x16::splat(simd, 2.0);
    let (both, mean_squares) = (mx * my, mx * mx + my * my);
    let (a, b) = (two * both + c1, two * (product - both) + c2);
    let (c, d) = (mean_squares + c1, squares - mean_squares + c2);
    let (by_c, by_d) = (f32x16::splat(simd, 1.0) / c, f32x16::splat(simd, 1.0) / d);
    let ssim = a * by_c * (b * by_d);
    let by_mean = two * (my * (b - a) * by_c * by_d + mx * ssim * (by_d - by_c));
    Similarity { ssim, by: [by_mean, -ssim * by_d, two * a * by_c * by_d] }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    const SIZE: [usize; 2] = [17, 13];
    const PIXELS: usize = 17 * 13;

    fn planes(seed: u64) -> Vec<f32> {
        let value = |c: u64, i: u64| 0.5 + 0.2 * (0.3 * i as f32).sin() + 0.1 * standard_normal(seed, 1000 * c + i)[0];
        (0..3).flat_map(|c| (0..PIXELS as u64).map(move |i| value(c, i))).collect()
    }

    #[derive(Clone, Copy, Default)]
    struct Weights<'a> {
        pixels: Option<&'a [f32]>,
        values: Option<&'a [f32]>,
    }

    fn compared(x: &[f32], y: &[f32], Weights { pixels, values }: Weights<'_>, loss: &LossWeights) -> (Comparison, Vec<f32>) {
        let mut by_value = vec![f32::NAN; x.len()];
        let of = Compared { size: SIZE, prediction: x, target: y, pixels, values, factor: 1.0 };
        (compare(&of, loss, ComparedOut { by_value: &mut by_value, dissimilarity: None }), by_value)
    }

    fn check(x: &[f32], y: &[f32], weights: Weights<'_>, loss: &LossWeights) {
        let exact = compared(x, y, weights, loss).1;
        for i in [0, PIXELS + 40, 2 * PIXELS + 111, 220, PIXELS + 7, 2 * PIXELS + 83] {
            let moved = |h: f32| {
                let mut x = x.to_vec();
                x[i] += h;
                f64::from(compared(&x, y, weights, loss).0.loss)
            };
            let (numeric, found) = ((moved(4e-3) - moved(-4e-3)) / 8e-3, f64::from(exact[i]));
            assert!((numeric - found).abs() < 2e-5 + 2e-2 * found.abs(), "{i}: {numeric:e} {found:e}");
        }
    }

    #[test]
    fn the_gradient_is_that_of_differences_with_and_without_weights() {
        let (x, y) = (planes(1), planes(2));
        let pixels: Vec<f32> = (0..PIXELS).map(|i| [1.0, 0.0, 0.5, 1.0, 0.25][i % 5]).collect();
        let values: Vec<f32> = planes(5).iter().map(|w| w.abs()).collect();
        let loss = LossWeights { ssim_weight: 0.4, squared_share: 0.3, ..LossWeights::default() };
        for weights in
            [Weights::default(), Weights { pixels: Some(&pixels), values: None }, Weights { pixels: None, values: Some(&values) }]
        {
            check(&x, &y, weights, &loss);
        }
    }

    #[test]
    fn weights_of_one_change_nothing_and_a_factor_is_one_of_the_gradient() {
        let (x, y, loss, ones) = (planes(1), planes(2), LossWeights::default(), vec![1.0; 3 * PIXELS]);
        let plain = compared(&x, &y, Weights::default(), &loss);
        assert_eq!(compared(&x, &y, Weights { pixels: None, values: Some(&ones) }, &loss), plain);
        let mut twice = vec![0.0; x.len()];
        let of = Compared { size: SIZE, prediction: &x, target: &y, pixels: None, values: None, factor: 2.0 };
        compare(&of, &loss, ComparedOut { by_value: &mut twice, dissimilarity: None });
        assert!(twice.iter().zip(plain.1).all(|(twice, once)| (twice - 2.0 * once).abs() <= 1e-6 * once.abs()));
    }

    #[test]
    fn equal_images_have_no_loss_and_pixels_without_weight_no_effect() {
        let (x, y) = (planes(3), planes(3));
        let mut dissimilarity = vec![1.0; x.len()];
        let of = Compared { size: SIZE, prediction: &x, target: &y, pixels: None, values: None, factor: 1.0 };
        let out = ComparedOut { by_value: &mut vec![0.0; x.len()], dissimilarity: Some(&mut dissimilarity) };
        let same = compare(&of, &LossWeights::default(), out);
        assert!(same.loss.abs() < 1e-6 && (same.ssim - 1.0).abs() < 1e-6 && same.l1 == 0.0, "{same:?}");
        assert!(dissimilarity.iter().all(|d| d.abs() < 1e-5));
        let mut other = x.clone();
        other[PIXELS + 50] = 9.0;
        let mut pixels = vec![1.0; PIXELS];
        pixels[50] = 0.0;
        let masked = |x: &[f32]| compared(x, &planes(4), Weights { pixels: Some(&pixels), values: None }, &LossWeights::default());
        assert_eq!(masked(&x).0.loss, masked(&other).0.loss);
        assert_eq!(masked(&other).1[PIXELS + 50], 0.0);
        let nothing = Weights { pixels: Some(&[0.0; PIXELS]), values: None };
        assert_eq!(compared(&x, &planes(4), nothing, &LossWeights { ssim_weight: 0.0, ..LossWeights::default() }).0.loss, 0.0);
    }
}

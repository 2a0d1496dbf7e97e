//! The loss of an image under a curve, with its gradient by the values, for steps that compare more
//! than one image.
//!
//! In: predicted and expected values `[3, H, W]`, weights of pixels, [`LossWeights`]. Out: mean
//! absolute difference, mean SSIM, the loss, and its gradient. The formulas are those of the
//! engines' pass `loss`: 11 x 11 window with zero padding, weights that mix the prediction with the
//! target. Work is divided into [`band`]s of rows of a channel, whose sums are added in order: the
//! same bits for any number of threads. Degenerate: if all weights are 0, loss and gradient are 0.
//!
//! The code is not the engine's: the CPU pass has its rows in strips, adds the weights of a window
//! in another order and divides by an estimate. The last bits differ, and with them what methods
//! learn.

mod band;
mod similarity;
mod window;

use luxel_core::LossWeights;
use luxel_lanes::Level;
use rayon::prelude::*;

use self::band::{BAND, BandOut, Channel, Scratch, Sums};

/// A prediction with its target, and how much pixels and values count.
#[derive(Clone, Copy)]
pub(crate) struct Compared<'a> {
    /// Width and height.
    pub(crate) size: [usize; 2],
    /// `[3, H, W]`.
    pub(crate) prediction: &'a [f32],
    /// `[3, H, W]`.
    pub(crate) target: &'a [f32],
    /// Weights of pixels, `[H, W]`.
    pub(crate) pixels: Option<&'a [f32]>,
    /// Weights of the difference of each value and of the SSIM of the window around it, `[3, H,
    /// W]`; L1 and SSIM that are reported have them, too.
    pub(crate) values: Option<&'a [f32]>,
    /// Factor of the gradient.
    pub(crate) factor: f32,
}

/// Receives what a comparison finds value by value.
pub(crate) struct ComparedOut<'a> {
    /// Gradient of the loss by the prediction, `[3, H, W]`.
    pub(crate) by_value: &'a mut [f32],
    /// 1 - SSIM of the window around each value, `[3, H, W]`, if it is wanted.
    pub(crate) dissimilarity: Option<&'a mut [f32]>,
}

/// The means of a comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Comparison {
    pub(crate) loss: f32,
    pub(crate) l1: f32,
    pub(crate) ssim: f32,
}

/// Compares an image with its target.
pub(crate) fn compare(of: &Compared<'_>, loss: &LossWeights, out: ComparedOut<'_>) -> Comparison {
    let [width, height] = of.size;
    let pixels = width * height;
    if pixels == 0 {
        return Comparison::default();
    }
    let total = 3.0 * of.pixels.map_or(pixels as f64, |weights| weights.iter().map(|w| f64::from(*w)).sum());
    let channels: Vec<Channel<'_>> = (0..3)
        .map(|c| {
            let plane = c * pixels..(c + 1) * pixels;
            Channel {
                size: of.size,
                x: &of.prediction[plane.clone()],
                y: &of.target[plane.clone()],
                pixels: of.pixels,
                values: of.values.map(|values| &values[plane]),
                by_difference: if total > 0.0 { of.factor * (1.0 - loss.ssim_weight) / total as f32 } else { 0.0 },
                by_ssim: -of.factor * loss.ssim_weight / (3 * pixels) as f32,
                squared_share: loss.squared_share,
            }
        })
        .collect();
    let ComparedOut { by_value, dissimilarity } = out;
    let mut dissimilarity = dissimilarity.map(|planes| bands(planes, of.size));
    let mut outs: Vec<BandOut<'_>> = bands(by_value, of.size)
        .map(|by_value| BandOut { by_value, dissimilarity: dissimilarity.as_mut().and_then(Iterator::next) })
        .collect();
    let per_channel = height.div_ceil(BAND);
    let level = Level::best();
    let sums: Vec<Sums> = outs
        .par_iter_mut()
        .enumerate()
        .map_init(Scratch::default, |scratch, (i, out)| {
            let (channel, first_row) = (&channels[i / per_channel], i % per_channel * BAND);
            luxel_lanes::dispatch!(level, simd => channel.compare(simd, first_row, scratch, out))
        })
        .collect();
    let sum = |of: fn(&Sums) -> f64| sums.iter().map(of).sum::<f64>();
    let mean = |sum: f64| if total > 0.0 { (sum / total) as f32 } else { 0.0 };
    let (l1, l2) = (mean(sum(|c| c.absolute)), mean(sum(|c| c.squared)));
    let count = (3 * pixels) as f64;
    let (ssim, weight) = ((sum(|c| c.ssim) / count) as f32, (sum(|c| c.weight) / count) as f32);
    // Of a perfect image SSIM is 1 times the mean weight.
    Comparison { loss: loss.total(l1, l2, ssim) - loss.ssim_weight * (1.0 - weight), l1, ssim }
}

/// Divides planes into the bands of each.
fn bands(planes: &mut [f32], [width, height]: [usize; 2]) -> impl Iterator<Item = &mut [f32]> {
    planes.chunks_mut(width * height).flat_map(move |plane| plane.chunks_mut(BAND * width))
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

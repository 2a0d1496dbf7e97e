//! Mono-HDR-GS's network from radiance under the mu-law back to captured values, pixel by pixel.
//!
//! In: pixels p [3] of radiance under the mu-law. Out: c = sigmoid(max(A h, 0) + tanh(B h)), both
//! with biases, where h = max(W p + b, 0) has [`UNITS`] units; and the gradient by the pixels and
//! by all numbers. Sixteen pixels are computed together on every instruction set. Pixels are taken
//! in chunks of constant size, and their sums are added in order: the same bits for any number of
//! threads.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x16};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use crate::TrainError;

/// Hidden units.
const UNITS: usize = 128;
/// Rows of outgoing weights: those of the ReLU of each channel, then those of the tanh.
const HEADS: usize = 6;
/// Places of the numbers: weights by input channel and unit, biases of the units, outgoing weights
/// by head and unit, biases of the heads.
const BIASES: usize = 3 * UNITS;
const OUTGOING: usize = BIASES + UNITS;
const HEAD_BIASES: usize = OUTGOING + HEADS * UNITS;
const NUMBERS: usize = HEAD_BIASES + HEADS;
/// Pixels of a chunk.
const CHUNK: usize = 2048;
/// Pixels that are computed together.
const LANES: usize = 16;
/// Constant that separates the random stream of the network from others of the same seed.
const STREAM: u64 = 0x6c75_7865_6c06;

/// The network, with the state of its optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Cycle {
    numbers: Vec<f32>,
    adam: Adam,
}

/// The captured values of an image, and what their gradient needs.
pub(crate) struct CycleImage {
    pub(crate) values: Vec<[f32; 3]>,
    /// Derivatives of the captured values by the outputs of the two heads of their channel.
    slopes: Vec<[f32; HEADS]>,
}

/// The gradients of an image.
pub(crate) struct CycleGradient {
    pub(crate) by_pixel: Vec<[f32; 3]>,
    by_numbers: Vec<f64>,
}

/// Values of the hidden units for pixels that are computed together.
type Hidden = [[f32; LANES]; UNITS];

/// Loads the channels of at most [`LANES`] pixels; the others are black.
#[inline(always)]
fn rows<const N: usize, S: Simd>(simd: S, pixels: &[[f32; N]]) -> [f32x16<S>; N] {
    let mut rows = [[0.0; LANES]; N];
    for (lane, pixel) in pixels.iter().enumerate() {
        (0..N).for_each(|c| rows[c][lane] = pixel[c]);
    }
    rows.map(|row| f32x16::load_array_ref(simd, &row))
}

/// Adds to sixteen sums.
#[inline(always)]
fn add<S: Simd>(simd: S, sum: &mut [f32; LANES], a: f32x16<S>, b: f32x16<S>) {
    a.mul_add(b, f32x16::load_array_ref(simd, sum)).store_array(sum);
}

impl Cycle {
    /// Makes the network at the start of a run.
    pub(crate) fn new(seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ STREAM);
        let bounds = [(OUTGOING, 3.0f32), (NUMBERS - OUTGOING, UNITS as f32)];
        let bounds = bounds.into_iter().flat_map(|(count, inputs)| std::iter::repeat_n(inputs.sqrt().recip(), count));
        let numbers = bounds.map(|bound| rng.random_range(-bound..bound)).collect();
        Self { numbers, adam: Adam::new(NUMBERS) }
    }

    /// Checks a network read from a file.
    pub(crate) fn validate(&self) -> Result<(), TrainError> {
        if self.numbers.len() != NUMBERS || !self.numbers.iter().all(|v| v.is_finite()) {
            return Err(TrainError::State(format!("a network of pixels has other numbers than its {NUMBERS}")));
        }
        self.adam.validate(NUMBERS)
    }

    /// Computes the hidden units, and returns the outputs of the heads.
    #[inline(always)]
    fn forward<S: Simd>(&self, simd: S, pixels: [f32x16<S>; 3], hidden: &mut Hidden) -> [f32x16<S>; HEADS] {
        let n = &self.numbers[..];
        let c = |at: usize| f32x16::splat(simd, n[at]);
        let mut heads = [f32x16::splat(simd, 0.0); HEADS];
        for (k, head) in heads.iter_mut().enumerate() {
            *head = c(HEAD_BIASES + k);
        }
        for (unit, hidden) in hidden.iter_mut().enumerate() {
            let mut z = c(BIASES + unit);
            for (channel, pixels) in pixels.iter().enumerate() {
                z = pixels.mul_add(c(channel * UNITS + unit), z);
            }
            let h = z.max(f32x16::splat(simd, 0.0));
            h.store_array(hidden);
            for (k, head) in heads.iter_mut().enumerate() {
                *head = h.mul_add(c(OUTGOING + k * UNITS + unit), *head);
            }
        }
        heads
    }

    #[inline(always)]
    fn apply_chunk<S: Simd>(&self, simd: S, pixels: &[[f32; 3]], values: &mut [[f32; 3]], slopes: &mut [[f32; HEADS]]) {
        let mut hidden = [[0.0; LANES]; UNITS];
        for (pixels, (values, slopes)) in pixels.chunks(LANES).zip(values.chunks_mut(LANES).zip(slopes.chunks_mut(LANES))) {
            let heads = self.forward(simd, rows(simd, pixels), &mut hidden).map(|head| {
                let mut row = [0.0; LANES];
                head.store_array(&mut row);
                row
            });
            for (lane, (values, slopes)) in values.iter_mut().zip(slopes).enumerate() {
                for c in 0..3 {
                    let (relu, tanh) = (heads[c][lane], heads[3 + c][lane].tanh());
                    let value = 1.0 / (1.0 + (-(relu.max(0.0) + tanh)).exp());
                    let by_sum = value * (1.0 - value);
                    values[c] = value;
                    (slopes[c], slopes[3 + c]) = (if relu > 0.0 { by_sum } else { 0.0 }, by_sum * (1.0 - tanh * tanh));
                }
            }
        }
    }

    /// Returns the captured values of pixels.
    pub(crate) fn apply(&self, pixels: &[[f32; 3]]) -> CycleImage {
        let (mut values, mut slopes) = (vec![[0.0; 3]; pixels.len()], vec![[0.0; HEADS]; pixels.len()]);
        let outs = values.par_chunks_mut(CHUNK).zip(slopes.par_chunks_mut(CHUNK));
        outs.zip(pixels.par_chunks(CHUNK)).for_each(|((values, slopes), pixels)| {
            fearless_simd::dispatch!(Level::new(), simd => self.apply_chunk(simd, pixels, values, slopes));
        });
        CycleImage { values, slopes }
    }

    /// Returns the gradients by the pixels and by the numbers, from that by the captured values.
    pub(crate) fn backward(&self, pixels: &[[f32; 3]], image: &CycleImage, by_value: &[[f32; 3]]) -> CycleGradient {
        let mut by_pixel = vec![[0.0; 3]; pixels.len()];
        let inputs = pixels.par_chunks(CHUNK).zip(image.slopes.par_chunks(CHUNK)).zip(by_value.par_chunks(CHUNK));
        let parts: Vec<Vec<[f32; LANES]>> = by_pixel
            .par_chunks_mut(CHUNK)
            .zip(inputs)
            .map(|(out, ((pixels, slopes), by_value))| {
                let mut sums = vec![[0.0; LANES]; NUMBERS];
                let given = Given { pixels, slopes, by_value };
                fearless_simd::dispatch!(Level::new(), simd => self.backward_chunk(simd, given, out, &mut sums));
                sums
            })
            .collect();
        let mut by_numbers = vec![0.0; NUMBERS];
        for part in &parts {
            for (sum, lanes) in by_numbers.iter_mut().zip(part) {
                *sum += lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
            }
        }
        CycleGradient { by_pixel, by_numbers }
    }

    #[inline(always)]
    fn backward_chunk<S: Simd>(&self, simd: S, given: Given<'_>, out: &mut [[f32; 3]], sums: &mut [[f32; LANES]]) {
        let n = &self.numbers[..];
        let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
        let mut hidden = [[0.0; LANES]; UNITS];
        let blocks = given.pixels.chunks(LANES).zip(given.slopes.chunks(LANES)).zip(given.by_value.chunks(LANES));
        for (((pixels, slopes), by_value), out) in blocks.zip(out.chunks_mut(LANES)) {
            let (pixels, slopes, by_value) = (rows(simd, pixels), rows(simd, slopes), rows(simd, by_value));
            self.forward(simd, pixels, &mut hidden);
            let mut by_heads = [f32x16::splat(simd, 0.0); HEADS];
            for (k, by) in by_heads.iter_mut().enumerate() {
                *by = by_value[k % 3] * slopes[k];
            }
            let mut by_pixels = [zero; 3];
            for (unit, hidden) in hidden.iter().enumerate() {
                let h = f32x16::load_array_ref(simd, hidden);
                let mut by_hidden = zero;
                for (k, by_head) in by_heads.iter().enumerate() {
                    let at = OUTGOING + k * UNITS + unit;
                    add(simd, &mut sums[at], *by_head, h);
                    by_hidden = by_head.mul_add(f32x16::splat(simd, n[at]), by_hidden);
                }
                let by_z = h.simd_gt(zero).select(by_hidden, zero);
                add(simd, &mut sums[BIASES + unit], by_z, one);
                for (c, (pixels, by_pixels)) in pixels.iter().zip(&mut by_pixels).enumerate() {
                    let at = c * UNITS + unit;
                    add(simd, &mut sums[at], by_z, *pixels);
                    *by_pixels = by_z.mul_add(f32x16::splat(simd, n[at]), *by_pixels);
                }
            }
            for (k, by_head) in by_heads.iter().enumerate() {
                add(simd, &mut sums[HEAD_BIASES + k], *by_head, one);
            }
            for (c, by_pixels) in by_pixels.iter().enumerate() {
                let mut row = [0.0; LANES];
                by_pixels.store_array(&mut row);
                out.iter_mut().zip(row).for_each(|(out, value)| out[c] = value);
            }
        }
    }

    /// Updates the network.
    pub(crate) fn update(&mut self, gradient: &CycleGradient, rate: f64) {
        self.adam.step(&mut self.numbers, &gradient.by_numbers, rate);
    }
}

/// A chunk of pixels, the derivatives of their captured values, and the gradient by those.
#[derive(Clone, Copy)]
struct Given<'a> {
    pixels: &'a [[f32; 3]],
    slopes: &'a [[f32; HEADS]],
    by_value: &'a [[f32; 3]],
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    #[test]
    fn gradients_are_those_of_differences() {
        let pixels: Vec<[f32; 3]> = (0..30).map(|i| standard_normal(3, i).map(|v: f32| v.abs())).collect();
        let weight = |i: usize| f64::from(0.7 * i as f32).sin();
        let loss = |cycle: &Cycle, pixels: &[[f32; 3]]| -> f64 {
            cycle.apply(pixels).values.as_flattened().iter().enumerate().map(|(i, v)| f64::from(*v) * weight(i)).sum()
        };
        let cycle = Cycle::new(4);
        let by: Vec<[f32; 3]> = (0..30).map(|i| [0, 1, 2].map(|c| weight(3 * i + c) as f32)).collect();
        let exact = cycle.backward(&pixels, &cycle.apply(&pixels), &by);
        for (i, c) in [(0, 0), (7, 1), (29, 2)] {
            let moved = |h: f32| {
                let mut pixels = pixels.clone();
                pixels[i][c] += h;
                loss(&cycle, &pixels)
            };
            let (numeric, found) = ((moved(2e-3) - moved(-2e-3)) / 4e-3, f64::from(exact.by_pixel[i][c]));
            assert!((numeric - found).abs() < 1e-3 + 2e-2 * found.abs(), "{i}, {c}: {numeric} {found}");
        }
        for at in (0..NUMBERS).step_by(41).chain([NUMBERS - 1]) {
            let moved = |h: f32| {
                let mut cycle = cycle.clone();
                cycle.numbers[at] += h;
                loss(&cycle, &pixels)
            };
            let (numeric, found) = ((moved(5e-3) - moved(-5e-3)) / 1e-2, exact.by_numbers[at]);
            assert!((numeric - found).abs() < 3e-3 + 2e-2 * found.abs(), "{at}: {numeric} {found}");
        }
        assert_eq!(NUMBERS, 1286);
    }
}

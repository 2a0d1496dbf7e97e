//! Mono-HDR-GS's network from radiance under the mu-law back to captured values, pixel by pixel.
//!
//! In: pixels p of radiance under the mu-law, `[3, H, W]`. Out: c = sigmoid(max(A h, 0) + tanh(B
//! h)), both with biases, where h = max(W p + b, 0) has [`UNITS`] units; and the gradient by the
//! pixels and by all numbers. Sixteen pixels are computed together on every instruction set. Pixels
//! are taken in chunks of constant size, and their sums are added in order: the same bits for any
//! number of threads.
//!
//! The way back goes over the pixels of a chunk once for every [`TILE`] units, whose sums then stay
//! in the core's first cache, and takes two blocks of pixels at a time.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_lanes::functions::{sigmoid, tanh};
use luxel_lanes::sums;
use luxel_lanes::{LANES, Level};
use luxel_train::TrainError;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::captured::arithmetic::adam::Adam;
use crate::captured::arithmetic::blocks::{Block, CHUNK, from_planes, to_planes};

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
/// Units whose sums are kept together on the way back.
const TILE: usize = 16;
/// Sums of a unit: outgoing weights, bias, incoming weights.
const UNIT_SUMS: usize = HEADS + 4;
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
    /// `[3, H, W]`.
    pub(crate) values: Vec<f32>,
    pixels: Vec<Block<3>>,
    /// Derivatives of the captured values by the outputs of the two heads of their channel.
    slopes: Vec<Block<HEADS>>,
}

/// The gradients of an image.
pub(crate) struct CycleGradient {
    /// `[3, H, W]`.
    pub(crate) by_pixel: Vec<f32>,
    pub(crate) by_numbers: Vec<f64>,
}

/// Loads rows of a block.
#[inline(always)]
fn load<const R: usize, S: Simd>(simd: S, block: &Block<R>) -> [f32x16<S>; R] {
    let mut rows = [f32x16::splat(simd, 0.0); R];
    for (row, numbers) in rows.iter_mut().zip(block) {
        *row = f32x16::load_array_ref(simd, numbers);
    }
    rows
}

/// Adds to sixteen sums.
#[inline(always)]
fn add<S: Simd>(simd: S, sum: &mut [f32; LANES], part: f32x16<S>) {
    (f32x16::load_array_ref(simd, sum) + part).store_array(sum);
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

    /// Returns a hidden unit of pixels.
    #[inline(always)]
    fn hidden<S: Simd>(&self, simd: S, unit: usize, pixels: &[f32x16<S>; 3]) -> f32x16<S> {
        let n = &self.numbers[..];
        let mut z = f32x16::splat(simd, n[BIASES + unit]);
        for (channel, pixels) in pixels.iter().enumerate() {
            z = pixels.mul_add(f32x16::splat(simd, n[channel * UNITS + unit]), z);
        }
        z.max(f32x16::splat(simd, 0.0))
    }

    /// Computes the values and slopes of blocks of pixels, two at a time.
    #[inline(always)]
    fn apply_chunk<S: Simd>(&self, simd: S, pixels: &[Block<3>], values: &mut [Block<3>], slopes: &mut [Block<HEADS>]) {
        for ((pixels, values), slopes) in pixels.chunks(2).zip(values.chunks_mut(2)).zip(slopes.chunks_mut(2)) {
            let last = pixels.len() - 1;
            let inputs = [load(simd, &pixels[0]), load(simd, &pixels[last])];
            let mut heads = [[f32x16::splat(simd, 0.0); HEADS]; 2];
            for (k, bias) in self.numbers[HEAD_BIASES..].iter().enumerate() {
                let bias = f32x16::splat(simd, *bias);
                (heads[0][k], heads[1][k]) = (bias, bias);
            }
            let [first, second] = &mut heads;
            for unit in 0..UNITS {
                let h = [self.hidden(simd, unit, &inputs[0]), self.hidden(simd, unit, &inputs[1])];
                for (k, (first, second)) in first.iter_mut().zip(&mut *second).enumerate() {
                    let weight = f32x16::splat(simd, self.numbers[OUTGOING + k * UNITS + unit]);
                    *first = h[0].mul_add(weight, *first);
                    *second = h[1].mul_add(weight, *second);
                }
            }
            for (heads, (values, slopes)) in heads.into_iter().zip(values.iter_mut().zip(slopes)) {
                finish(simd, heads, values, slopes);
            }
        }
    }

    /// Returns the captured values of pixels, `[3, H, W]`.
    pub(crate) fn apply(&self, pixels: &[f32]) -> CycleImage {
        let len = pixels.len() / 3;
        let pixels: Vec<Block<3>> = from_planes(pixels);
        let (mut blocks, mut slopes) = (vec![[[0.0; LANES]; 3]; pixels.len()], vec![[[0.0; LANES]; HEADS]; pixels.len()]);
        let outs = blocks.par_chunks_mut(CHUNK).zip(slopes.par_chunks_mut(CHUNK));
        outs.zip(pixels.par_chunks(CHUNK)).for_each(|((values, slopes), pixels)| {
            luxel_lanes::dispatch!(Level::best(), simd => self.apply_chunk(simd, pixels, values, slopes));
        });
        let mut values = vec![0.0; 3 * len];
        to_planes(&blocks, 0, len, &mut values);
        CycleImage { values, pixels, slopes }
    }

    /// Returns the gradients by the pixels and by the numbers, from that by the captured values,
    /// `[3, H, W]`.
    pub(crate) fn backward(&self, image: &CycleImage, by_value: &[f32]) -> CycleGradient {
        let len = by_value.len() / 3;
        let by_value: Vec<Block<3>> = from_planes(by_value);
        let mut by_pixel = vec![[[0.0; LANES]; 3]; by_value.len()];
        let inputs = image.pixels.par_chunks(CHUNK).zip(image.slopes.par_chunks(CHUNK)).zip(by_value.par_chunks(CHUNK));
        let parts: Vec<Vec<f32>> = by_pixel
            .par_chunks_mut(CHUNK)
            .zip(inputs)
            .map(|(out, ((pixels, slopes), by_value))| {
                let given = Given { pixels, slopes, by_value };
                luxel_lanes::dispatch!(Level::best(), simd => self.backward_chunk(simd, given, out))
            })
            .collect();
        let mut by_numbers = vec![0.0; NUMBERS];
        for part in &parts {
            by_numbers.iter_mut().zip(part).for_each(|(sum, part)| *sum += f64::from(*part));
        }
        let mut planes = vec![0.0; 3 * len];
        to_planes(&by_pixel, 0, len, &mut planes);
        CycleGradient { by_pixel: planes, by_numbers }
    }

    /// Writes the gradient by a chunk of pixels, and returns that by the numbers.
    #[inline(always)]
    fn backward_chunk<S: Simd>(&self, simd: S, given: Given<'_>, out: &mut [Block<3>]) -> Vec<f32> {
        let mut by_numbers = vec![0.0; NUMBERS];
        let mut by_heads = vec![[[0.0; LANES]; HEADS]; out.len()];
        let mut of_heads = [f32x16::splat(simd, 0.0); HEADS];
        for ((by_heads, slopes), by_value) in by_heads.iter_mut().zip(given.slopes).zip(given.by_value) {
            let (slopes, by_value) = (load(simd, slopes), load(simd, by_value));
            for (k, by) in by_heads.iter_mut().enumerate() {
                let by_head = by_value[k % 3] * slopes[k];
                of_heads[k] += by_head;
                by_head.store_array(by);
            }
        }
        for (k, sum) in of_heads.into_iter().enumerate() {
            by_numbers[HEAD_BIASES + k] = sums::sum(sum.to_array());
        }
        for first in (0..UNITS).step_by(TILE) {
            let mut sums = [[[0.0; LANES]; UNIT_SUMS]; TILE];
            for ((pixels, by_heads), out) in given.pixels.chunks(2).zip(by_heads.chunks(2)).zip(out.chunks_mut(2)) {
                self.backward_pair(simd, first, pixels, by_heads, out, &mut sums);
            }
            for (unit, sums) in (first..).zip(&sums) {
                for (k, sum) in sums.iter().enumerate() {
                    let place = match k {
                        0..HEADS => OUTGOING + k * UNITS + unit,
                        HEADS => BIASES + unit,
                        _ => (k - HEADS - 1) * UNITS + unit,
                    };
                    by_numbers[place] = sums::sum(*sum);
                }
            }
        }
        by_numbers
    }

    /// Differentiates [`TILE`] units from `first` on for one or two blocks of pixels.
    #[inline(always)]
    fn backward_pair<S: Simd>(
        &self,
        simd: S,
        first: usize,
        pixels: &[Block<3>],
        by_heads: &[Block<HEADS>],
        out: &mut [Block<3>],
        sums: &mut [Block<UNIT_SUMS>; TILE],
    ) {
        let (n, zero, last) = (&self.numbers[..], f32x16::splat(simd, 0.0), pixels.len() - 1);
        let inputs = [load(simd, &pixels[0]), load(simd, &pixels[last])];
        let mut by = [load(simd, &by_heads[0]), load(simd, &by_heads[last])];
        if last == 0 {
            by[1] = [zero; HEADS];
        }
        let mut by_pixels = [[zero; 3]; 2];
        for (unit, sums) in (first..).zip(sums) {
            let h = [self.hidden(simd, unit, &inputs[0]), self.hidden(simd, unit, &inputs[1])];
            let mut by_hidden = [zero; 2];
            for (k, sum) in sums.iter_mut().enumerate().take(HEADS) {
                let weight = f32x16::splat(simd, n[OUTGOING + k * UNITS + unit]);
                by_hidden[0] = by[0][k].mul_add(weight, by_hidden[0]);
                by_hidden[1] = by[1][k].mul_add(weight, by_hidden[1]);
                add(simd, sum, by[0][k].mul_add(h[0], by[1][k] * h[1]));
            }
            let by_z = [h[0].simd_gt(zero).select(by_hidden[0], zero), h[1].simd_gt(zero).select(by_hidden[1], zero)];
            add(simd, &mut sums[HEADS], by_z[0] + by_z[1]);
            for c in 0..3 {
                add(simd, &mut sums[HEADS + 1 + c], by_z[0].mul_add(inputs[0][c], by_z[1] * inputs[1][c]));
                let weight = f32x16::splat(simd, n[c * UNITS + unit]);
                by_pixels[0][c] = by_z[0].mul_add(weight, by_pixels[0][c]);
                by_pixels[1][c] = by_z[1].mul_add(weight, by_pixels[1][c]);
            }
        }
        for (out, by_pixels) in out.iter_mut().zip(by_pixels) {
            for (sum, part) in out.iter_mut().zip(by_pixels) {
                add(simd, sum, part);
            }
        }
    }

    /// Returns the numbers of the network.
    #[cfg(test)]
    pub(crate) fn numbers(&self) -> &[f32] {
        &self.numbers
    }

    /// Updates the network.
    pub(crate) fn update(&mut self, gradient: &CycleGradient, rate: f64) {
        self.adam.step(&mut self.numbers, &gradient.by_numbers, rate);
    }
}

/// Writes captured values and their derivatives by the heads.
#[inline(always)]
fn finish<S: Simd>(simd: S, heads: [f32x16<S>; HEADS], values: &mut Block<3>, slopes: &mut Block<HEADS>) {
    let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
    for (c, out) in values.iter_mut().enumerate() {
        let (relu, tanh) = (heads[c], tanh(heads[3 + c]));
        let value = sigmoid(relu.max(zero) + tanh);
        let by_sum = value * (one - value);
        value.store_array(out);
        relu.simd_gt(zero).select(by_sum, zero).store_array(&mut slopes[c]);
        (by_sum * (one - tanh * tanh)).store_array(&mut slopes[3 + c]);
    }
}

/// A chunk of pixels, the derivatives of their captured values, and the gradient by those.
#[derive(Clone, Copy)]
struct Given<'a> {
    pixels: &'a [Block<3>],
    slopes: &'a [Block<HEADS>],
    by_value: &'a [Block<3>],
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    #[test]
    fn gradients_are_those_of_differences() {
        // Number c of pixel i is number 30 c + i.
        let pixels: Vec<f32> = (0..90).map(|at| standard_normal(3, at % 30).map(|v: f32| v.abs())[at as usize / 30]).collect();
        let weight = |at: usize| f64::from(0.7 * (3 * (at % 30) + at / 30) as f32).sin();
        let loss = |cycle: &Cycle, pixels: &[f32]| -> f64 {
            cycle.apply(pixels).values.iter().enumerate().map(|(i, v)| f64::from(*v) * weight(i)).sum()
        };
        let cycle = Cycle::new(4);
        let by: Vec<f32> = (0..90).map(|i| weight(i) as f32).collect();
        let exact = cycle.backward(&cycle.apply(&pixels), &by);
        for i in [0, 37, 89] {
            let moved = |h: f32| {
                let mut pixels = pixels.clone();
                pixels[i] += h;
                loss(&cycle, &pixels)
            };
            let (numeric, found) = ((moved(2e-3) - moved(-2e-3)) / 4e-3, f64::from(exact.by_pixel[i]));
            assert!((numeric - found).abs() < 1e-3 + 2e-2 * found.abs(), "{i}: {numeric} {found}");
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

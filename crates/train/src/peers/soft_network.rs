//! Small dense networks of one hidden layer of smooth units and one output, for sixteen inputs at a
//! time.
//!
//! In: N numbers for each of sixteen items. Out: u = c + sum over units j of v_j h(w_j . x + b_j),
//! and the gradient by the inputs and by all numbers. h(z) = (z + sqrt(z^2 + 4 ln^2 2)) / 2 has the
//! value of softplus at 0, its slope there and its asymptotes, and needs no exponential
//! (squareplus, Barron 2021).

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use rand::Rng;
use serde::{Deserialize, Serialize};

use crate::TrainError;

/// Items that are computed together.
pub(super) const LANES: usize = 16;
/// Hidden units.
pub(super) const UNITS: usize = 64;
/// 4 ln^2 2.
const BEND: f32 = 4.0 * std::f32::consts::LN_2 * std::f32::consts::LN_2;

/// Sums over items by lane.
pub(super) type LaneSums = [[f32; LANES]];

/// A network: its numbers are, unit by unit, N weights, a bias and an outgoing weight, and last the
/// bias of the output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct SoftNetwork<const N: usize> {
    numbers: Vec<f32>,
}

/// Adds to sixteen sums.
#[inline(always)]
fn add<S: Simd>(simd: S, sum: &mut [f32; LANES], a: f32x16<S>, b: f32x16<S>) {
    a.mul_add(b, f32x16::load_array_ref(simd, sum)).store_array(sum);
}

impl<const N: usize> SoftNetwork<N> {
    /// Number of numbers.
    pub(super) const NUMBERS: usize = UNITS * (N + 2) + 1;

    /// Makes a network whose numbers are uniform within 1 / sqrt(inputs of their layer), as
    /// PyTorch's linear layers begin.
    pub(super) fn random(rng: &mut impl Rng) -> Self {
        let bound = |at: usize| if at % (N + 2) == N + 1 || at + 1 == Self::NUMBERS { UNITS as f32 } else { N as f32 }.sqrt().recip();
        let numbers = (0..Self::NUMBERS).map(bound).map(|bound| rng.random_range(-bound..bound)).collect();
        Self { numbers }
    }

    /// Returns the numbers, to be changed.
    pub(super) fn numbers_mut(&mut self) -> &mut [f32] {
        &mut self.numbers
    }

    /// Checks a network read from a file.
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        match self.numbers.len() == Self::NUMBERS && self.numbers.iter().all(|v| v.is_finite()) {
            true => Ok(()),
            false => Err(TrainError::State(format!("a network of {N} inputs has other numbers than its {}", Self::NUMBERS))),
        }
    }

    /// Returns the outputs of sixteen items.
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, simd: S, inputs: &[f32x16<S>; N]) -> f32x16<S> {
        let c = |value: f32| f32x16::splat(simd, value);
        let mut sum = c(self.numbers[Self::NUMBERS - 1]);
        for unit in self.numbers.chunks_exact(N + 2) {
            let mut z = c(unit[N]);
            for (input, weight) in inputs.iter().zip(unit) {
                z = input.mul_add(c(*weight), z);
            }
            let root = z.mul_add(z, c(BEND)).sqrt();
            sum = (z + root).mul_add(c(0.5 * unit[N + 1]), sum);
        }
        sum
    }

    /// Adds the gradient by the numbers to sums, and returns that by the inputs, from that by the
    /// outputs of sixteen items.
    #[inline(always)]
    pub(super) fn backward<S: Simd>(&self, simd: S, inputs: &[f32x16<S>; N], by: f32x16<S>, sums: &mut LaneSums) -> [f32x16<S>; N] {
        let c = |value: f32| f32x16::splat(simd, value);
        let (zero, one, half) = (c(0.0), c(1.0), c(0.5));
        let mut by_inputs = [zero; N];
        for (unit, sums) in self.numbers.chunks_exact(N + 2).zip(sums.chunks_exact_mut(N + 2)) {
            let mut z = c(unit[N]);
            for (input, weight) in inputs.iter().zip(unit) {
                z = input.mul_add(c(*weight), z);
            }
            let root = z.mul_add(z, c(BEND)).sqrt();
            let hidden = (z + root) * half;
            add(simd, &mut sums[N + 1], by, hidden);
            // h'(z) = h / sqrt(z^2 + 4 ln^2 2).
            let by_z = by * c(unit[N + 1]) * (hidden / root);
            add(simd, &mut sums[N], by_z, one);
            for (k, (input, weight)) in inputs.iter().zip(unit).enumerate() {
                add(simd, &mut sums[k], by_z, *input);
                by_inputs[k] = by_z.mul_add(c(*weight), by_inputs[k]);
            }
        }
        add(simd, &mut sums[Self::NUMBERS - 1], by, one);
        by_inputs
    }
}

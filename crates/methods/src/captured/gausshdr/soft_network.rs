//! Small dense networks of one hidden layer of smooth units and one output, for two blocks of
//! sixteen items at a time.
//!
//! In: N numbers for each item. Out: u = c + sum over units j of v_j h(w_j . x + b_j),
//! and the gradient by the inputs and by all numbers. h(z) = (z + sqrt(z^2 + 4 ln^2 2)) / 2 has the
//! value of softplus at 0, its slope there and its asymptotes, and needs no exponential
//! (squareplus, Barron 2021).

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::each;
use luxel_lanes::LANES;
use luxel_train::TrainError;
use rand::Rng;
use serde::{Deserialize, Serialize};

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
pub(super) fn add<S: Simd>(simd: S, sum: &mut [f32; LANES], part: f32x16<S>) {
    (f32x16::load_array_ref(simd, sum) + part).store_array(sum);
}

/// Inputs of two blocks of items.
pub(super) type Pair<S, const N: usize> = [[f32x16<S>; N]; 2];

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

    /// Returns the numbers.
    #[cfg(test)]
    pub(super) fn numbers(&self) -> &[f32] {
        &self.numbers
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

    /// Returns the part of a hidden unit's arguments that all inputs but the first make up.
    #[inline(always)]
    fn rest_of_arguments<S: Simd>(simd: S, unit: &[f32], inputs: &Pair<S, N>) -> [f32x16<S>; 2] {
        let bias = f32x16::splat(simd, unit[N]);
        let mut z = [bias; 2];
        for k in 1..N {
            let weight = f32x16::splat(simd, unit[k]);
            z[0] = inputs[0][k].mul_add(weight, z[0]);
            z[1] = inputs[1][k].mul_add(weight, z[1]);
        }
        z
    }

    /// Returns the arguments of a hidden unit.
    #[inline(always)]
    fn arguments<S: Simd>(simd: S, unit: &[f32], inputs: &Pair<S, N>) -> [f32x16<S>; 2] {
        let (rest, weight) = (Self::rest_of_arguments(simd, unit, inputs), f32x16::splat(simd, unit[0]));
        each!([0, 1] b => inputs[b][0].mul_add(weight, rest[b]))
    }

    /// Returns the outputs of two blocks of items.
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, simd: S, inputs: &Pair<S, N>) -> [f32x16<S>; 2] {
        let c = |value: f32| f32x16::splat(simd, value);
        let bend = c(BEND);
        let mut sums = [c(self.numbers[Self::NUMBERS - 1]); 2];
        for unit in 0..UNITS {
            let unit = &self.numbers[unit * (N + 2)..][..N + 2];
            let (z, outgoing) = (Self::arguments(simd, unit, inputs), c(0.5 * unit[N + 1]));
            sums = each!([0, 1] b => (z[b] + z[b].mul_add(z[b], bend).sqrt()).mul_add(outgoing, sums[b]));
        }
        sums
    }

    /// Adds the gradient by the numbers to sums, and returns that by the inputs, from that by the
    /// outputs of two blocks of items.
    #[inline(always)]
    pub(super) fn backward<S: Simd>(&self, simd: S, inputs: &Pair<S, N>, by: [f32x16<S>; 2], sums: &mut LaneSums) -> Pair<S, N> {
        let c = |value: f32| f32x16::splat(simd, value);
        let (bend, half) = (c(BEND), c(0.5));
        let mut by_inputs = [[c(0.0); N]; 2];
        for unit in 0..UNITS {
            let numbers = unit * (N + 2)..(unit + 1) * (N + 2);
            let (unit, sums) = (&self.numbers[numbers.clone()], &mut sums[numbers]);
            let (z, outgoing) = (Self::arguments(simd, unit, inputs), c(unit[N + 1]));
            let root = each!([0, 1] b => z[b].mul_add(z[b], bend).sqrt());
            let hidden = each!([0, 1] b => (z[b] + root[b]) * half);
            // h'(z) = h / sqrt(z^2 + 4 ln^2 2).
            let by_z = each!([0, 1] b => by[b] * outgoing * (hidden[b] / root[b]));
            add(simd, &mut sums[N + 1], by[0].mul_add(hidden[0], by[1] * hidden[1]));
            add(simd, &mut sums[N], by_z[0] + by_z[1]);
            for k in 0..N {
                add(simd, &mut sums[k], by_z[0].mul_add(inputs[0][k], by_z[1] * inputs[1][k]));
                let weight = c(unit[k]);
                by_inputs[0][k] = by_z[0].mul_add(weight, by_inputs[0][k]);
                by_inputs[1][k] = by_z[1].mul_add(weight, by_inputs[1][k]);
            }
        }
        add(simd, &mut sums[Self::NUMBERS - 1], by[0] + by[1]);
        by_inputs
    }

    /// Returns the outputs of two blocks of items for each of `C` numbers in place of the first
    /// input.
    #[inline(always)]
    pub(super) fn apply_each<const C: usize, S: Simd>(&self, simd: S, first: &Pair<S, C>, inputs: &Pair<S, N>) -> Pair<S, C> {
        let c = |value: f32| f32x16::splat(simd, value);
        let bend = c(BEND);
        let mut sums = [[c(self.numbers[Self::NUMBERS - 1]); C]; 2];
        for unit in 0..UNITS {
            let unit = &self.numbers[unit * (N + 2)..][..N + 2];
            let (rest, weight, outgoing) = (Self::rest_of_arguments(simd, unit, inputs), c(unit[0]), c(0.5 * unit[N + 1]));
            for k in 0..C {
                let z = each!([0, 1] b => first[b][k].mul_add(weight, rest[b]));
                sums[0][k] = (z[0] + z[0].mul_add(z[0], bend).sqrt()).mul_add(outgoing, sums[0][k]);
                sums[1][k] = (z[1] + z[1].mul_add(z[1], bend).sqrt()).mul_add(outgoing, sums[1][k]);
            }
        }
        sums
    }

    /// Adds the gradient by the numbers to sums, from that by the outputs of [`Self::apply_each`].
    #[inline(always)]
    pub(super) fn add_gradient_of_each<const C: usize, S: Simd>(
        &self,
        simd: S,
        first: &Pair<S, C>,
        inputs: &Pair<S, N>,
        by: &Pair<S, C>,
        sums: &mut LaneSums,
    ) {
        let c = |value: f32| f32x16::splat(simd, value);
        let (bend, half, zero) = (c(BEND), c(0.5), c(0.0));
        for unit in 0..UNITS {
            let numbers = unit * (N + 2)..(unit + 1) * (N + 2);
            let (unit, sums) = (&self.numbers[numbers.clone()], &mut sums[numbers]);
            let (rest, weight, outgoing) = (Self::rest_of_arguments(simd, unit, inputs), c(unit[0]), c(unit[N + 1]));
            let (mut by_outgoing, mut by_weight, mut by_z) = (zero, zero, [zero; 2]);
            for k in 0..C {
                let z = each!([0, 1] b => first[b][k].mul_add(weight, rest[b]));
                let root = each!([0, 1] b => z[b].mul_add(z[b], bend).sqrt());
                let hidden = each!([0, 1] b => (z[b] + root[b]) * half);
                let part = each!([0, 1] b => by[b][k] * outgoing * (hidden[b] / root[b]));
                by_outgoing = by[0][k].mul_add(hidden[0], by[1][k].mul_add(hidden[1], by_outgoing));
                by_weight = part[0].mul_add(first[0][k], part[1].mul_add(first[1][k], by_weight));
                by_z = each!([0, 1] b => by_z[b] + part[b]);
            }
            add(simd, &mut sums[N + 1], by_outgoing);
            add(simd, &mut sums[N], by_z[0] + by_z[1]);
            add(simd, &mut sums[0], by_weight);
            for k in 1..N {
                add(simd, &mut sums[k], by_z[0].mul_add(inputs[0][k], by_z[1] * inputs[1][k]));
            }
        }
        for (first, second) in by[0].iter().zip(&by[1]) {
            add(simd, &mut sums[Self::NUMBERS - 1], *first + *second);
        }
    }
}

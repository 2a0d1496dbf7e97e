//! The window of SSIM along one axis, several results at a time.

use fearless_simd::Simd;
use luxel_core::metrics::{SSIM_RADIUS, ssim_window};
use luxel_core::{Real, each};

use crate::lanes::{Lanes, V};

/// Vectors on either side of a result.
pub(super) const RADIUS: usize = SSIM_RADIUS;
/// Results at a time: they share their inputs in registers.
pub(super) const GROUP: usize = 5;
/// Inputs of a group.
const GROUP_INPUTS: usize = GROUP + 2 * RADIUS;
/// Inputs of a single result.
const TAPS: usize = 2 * RADIUS + 1;

/// The vectors of as many rows as a group has, one below the other.
pub(super) type Stack = [Lanes; GROUP];

/// Weights of the window from its centre outwards.
pub(super) type Weights = [f32; RADIUS + 1];

/// The window's weights.
pub(super) fn weights() -> Weights {
    let window = ssim_window();
    std::array::from_fn(|k| window[RADIUS + k] as f32)
}

/// The weights in all lanes.
#[derive(Clone, Copy)]
pub(super) struct Window<S: Simd>([V<S>; RADIUS + 1]);

impl<S: Simd> Window<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, weights: &Weights) -> Self {
        Self(each!([0, 1, 2, 3, 4, 5] k => V::splat(simd, weights[k])))
    }

    /// The window is symmetric: adding what has the same weight first takes 5 additions and 6 multiplications, on separate units, in place
    /// of 11 of the latter.
    #[inline(always)]
    fn at(&self, inputs: &[V<S>], center: usize) -> V<S> {
        let mut sum = inputs[center] * self.0[0];
        for k in 1..=RADIUS {
            sum = (inputs[center - k] + inputs[center + k]).mul_add(self.0[k], sum);
        }
        sum
    }

    /// Convolves a group, its results side by side: a sum waits for its last term, the next result's does not.
    #[inline(always)]
    fn group(&self, inputs: &[V<S>; GROUP_INPUTS]) -> [V<S>; GROUP] {
        let mut sums = each!([0, 1, 2, 3, 4] i => inputs[i + RADIUS] * self.0[0]);
        for k in 1..=RADIUS {
            let pairs = each!([0, 1, 2, 3, 4] i => inputs[i + RADIUS - k] + inputs[i + RADIUS + k]);
            sums = each!([0, 1, 2, 3, 4] i => pairs[i].mul_add(self.0[k], sums[i]));
        }
        sums
    }

    /// Convolves a row's group of vectors `step` apart in memory, whose inputs are the first of `row`.
    #[inline(always)]
    pub(super) fn row_group(&self, simd: S, row: &[Lanes], step: usize) -> [V<S>; GROUP] {
        let row = &row[..(GROUP_INPUTS - 1) * step + 1];
        self.group(&each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14] i => V::load(simd, &row[i * step])))
    }

    /// As [`Self::row_group`], a single result.
    #[inline(always)]
    pub(super) fn row_single(&self, simd: S, row: &[Lanes], step: usize) -> V<S> {
        let row = &row[..(TAPS - 1) * step + 1];
        self.at(&each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10] i => V::load(simd, &row[i * step])), RADIUS)
    }

    /// Convolves the group of a column whose inputs are three stacks of rows.
    #[inline(always)]
    pub(super) fn column_group(&self, simd: S, [above, at, below]: [&Stack; 3]) -> [V<S>; GROUP] {
        let mut inputs = [V::splat(simd, 0.0); GROUP_INPUTS];
        for i in 0..GROUP {
            inputs[i] = V::load(simd, &above[i]);
            inputs[GROUP + i] = V::load(simd, &at[i]);
            inputs[2 * GROUP + i] = V::load(simd, &below[i]);
        }
        self.group(&inputs)
    }
}

// A group's inputs are three stacks.
const _: () = assert!(GROUP_INPUTS == 3 * GROUP);

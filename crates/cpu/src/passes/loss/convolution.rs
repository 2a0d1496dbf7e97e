//! Convolution with the window of SSIM along one axis, several results at a time.
//!
//! In: fifteen vectors, a pixel apart. Out: the five results in their middle.

use fearless_simd::Simd;
use luxel_core::{Real, each};
use luxel_core::{SSIM_RADIUS, ssim_window};

use crate::lanes::{Half, Lanes, V, is_one_register};

/// Vectors on either side of a result.
pub(super) const RADIUS: usize = SSIM_RADIUS;
/// Results that are computed together: they share their inputs in registers.
pub(super) const GROUP: usize = 5;
/// Inputs of a group of results.
const GROUP_INPUTS: usize = GROUP + 2 * RADIUS;
/// Inputs of one result.
const TAPS: usize = 2 * RADIUS + 1;

/// The vectors of a group of rows, one below the other.
pub(super) type RowStack = [Lanes; GROUP];

/// The weights of the window, from its centre outwards.
pub(super) type Weights = [f32; RADIUS + 1];

/// Returns the window's weights.
pub(super) fn weights() -> Weights {
    let window = ssim_window();
    std::array::from_fn(|k| window[RADIUS + k] as f32)
}

/// The weights in all lanes.
#[derive(Clone, Copy)]
pub(super) struct Window<S: Simd> {
    whole: [V<S>; RADIUS + 1],
    half: [Half<S>; RADIUS + 1],
}

/// The inputs of a group of results: vectors, a pixel apart.
pub(super) trait Inputs<S: Simd>: Copy {
    /// Returns input `j`.
    fn whole(self, simd: S, j: usize) -> V<S>;
    /// Returns half number `half` of input `j`.
    fn half(self, simd: S, j: usize, half: usize) -> Half<S>;
}

/// The vectors of three stacks, one below the other.
#[derive(Clone, Copy)]
pub(super) struct Column<'a>(pub(super) [&'a RowStack; 3]);

/// The vectors of a row.
#[derive(Clone, Copy)]
pub(super) struct Row<'a>(&'a [Lanes; GROUP_INPUTS]);

/// The values x^2 + y^2.
#[derive(Clone, Copy)]
pub(super) struct Squares<'a>(pub(super) Column<'a>, pub(super) Column<'a>);

/// The products x y.
#[derive(Clone, Copy)]
pub(super) struct Products<'a>(pub(super) Column<'a>, pub(super) Column<'a>);

// A group's inputs are three stacks.
const _: () = assert!(GROUP_INPUTS == 3 * GROUP);

impl Column<'_> {
    #[inline(always)]
    fn at(&self, j: usize) -> &Lanes {
        &self.0[j / GROUP][j % GROUP]
    }
}

impl<'a> Row<'a> {
    /// Returns the inputs at the start of `row`.
    #[inline(always)]
    pub(super) fn at(row: &'a [Lanes]) -> Self {
        Self(row[..GROUP_INPUTS].try_into().expect("as long as that"))
    }
}

impl<S: Simd> Inputs<S> for Column<'_> {
    #[inline(always)]
    fn whole(self, simd: S, j: usize) -> V<S> {
        V::load(simd, self.at(j))
    }
    #[inline(always)]
    fn half(self, simd: S, j: usize, half: usize) -> Half<S> {
        Half::load(simd, self.at(j), half)
    }
}

impl<S: Simd> Inputs<S> for Row<'_> {
    #[inline(always)]
    fn whole(self, simd: S, j: usize) -> V<S> {
        V::load(simd, &self.0[j])
    }
    #[inline(always)]
    fn half(self, simd: S, j: usize, half: usize) -> Half<S> {
        Half::load(simd, &self.0[j], half)
    }
}

impl<S: Simd> Inputs<S> for Squares<'_> {
    #[inline(always)]
    fn whole(self, simd: S, j: usize) -> V<S> {
        let (x, y) = (self.0.whole(simd, j), self.1.whole(simd, j));
        x.mul_add(x, y * y)
    }
    #[inline(always)]
    fn half(self, simd: S, j: usize, half: usize) -> Half<S> {
        let (x, y) = (self.0.half(simd, j, half), self.1.half(simd, j, half));
        x.mul_add(x, y * y)
    }
}

impl<S: Simd> Inputs<S> for Products<'_> {
    #[inline(always)]
    fn whole(self, simd: S, j: usize) -> V<S> {
        self.0.whole(simd, j) * self.1.whole(simd, j)
    }
    #[inline(always)]
    fn half(self, simd: S, j: usize, half: usize) -> Half<S> {
        self.0.half(simd, j, half) * self.1.half(simd, j, half)
    }
}

impl<S: Simd> Window<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, weights: &Weights) -> Self {
        Self {
            whole: each!([0, 1, 2, 3, 4, 5] k => V::splat(simd, weights[k])),
            half: each!([0, 1, 2, 3, 4, 5] k => Half::splat(simd, weights[k])),
        }
    }

    /// Convolves a group. The sums of its results are interleaved, because each sum waits for its
    /// last term while the others do not. Terms are added from the window's ends inwards, small
    /// ones first, which rounds less.
    #[inline(always)]
    pub(super) fn convolve(&self, simd: S, inputs: impl Inputs<S>) -> [V<S>; GROUP] {
        if is_one_register::<S>() { self.whole(simd, inputs) } else { self.halves(simd, inputs) }
    }

    /// Convolves with all inputs in registers, of which there are 32. The window is symmetric:
    /// adding the two inputs of equal weight first takes 5 additions and 6 multiplications, on
    /// separate units, in place of 11 multiplications.
    #[inline(always)]
    fn whole(&self, simd: S, inputs: impl Inputs<S>) -> [V<S>; GROUP] {
        let inputs = each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14] j => inputs.whole(simd, j));
        let mut sums = [V::splat(simd, 0.0); GROUP];
        for k in (1..=RADIUS).rev() {
            let pairs = each!([0, 1, 2, 3, 4] i => inputs[i + RADIUS - k] + inputs[i + RADIUS + k]);
            sums = each!([0, 1, 2, 3, 4] i => pairs[i].mul_add(self.whole[k], sums[i]));
        }
        each!([0, 1, 2, 3, 4] i => inputs[i + RADIUS].mul_add(self.whole[0], sums[i]))
    }

    /// Convolves the two halves of the vectors one after the other.
    #[inline(always)]
    fn halves(&self, simd: S, inputs: impl Inputs<S>) -> [V<S>; GROUP] {
        let halves = each!([0, 1] half => self.half(simd, inputs, half));
        each!([0, 1, 2, 3, 4] i => V::from_halves(halves[0][i], halves[1][i]))
    }

    /// Convolves one half, one input after the other: 16 registers hold no more than the weights
    /// and the sums.
    #[inline(always)]
    fn half(&self, simd: S, inputs: impl Inputs<S>, half: usize) -> [Half<S>; GROUP] {
        let mut sums = [Half::splat(simd, 0.0); GROUP];
        each!([0, 14, 1, 13, 2, 12, 3, 11, 4, 10, 5, 9, 6, 8, 7] j => {
            let input = inputs.half(simd, j, half);
            each!([0, 1, 2, 3, 4] i => {
                if (i..i + TAPS).contains(&j) {
                    sums[i] = input.mul_add(self.half[j.abs_diff(i + RADIUS)], sums[i]);
                }
            });
        });
        sums
    }
}

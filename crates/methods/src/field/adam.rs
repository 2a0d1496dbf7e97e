//! Adam (Kingma and Ba 2015) over a slice of parameters.
//!
//! In: gradient, learning rate, number of the step. In, out: parameters and moments. A parameter
//! whose gradient is exactly 0 stays as it is, and so do its moments: most entries of a hash table
//! are not touched by a step. With beta_2 = 0.99, the correction of the bias by the step's number
//! is right for those, too: the first update of an entry is 1, a tenth over the root of a
//! hundredth. The order of the operations is not that of the CPU engine's pass `adam`, and neither
//! are the last bits.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::engine::AdamBetas;
use luxel_lanes::LANES;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.99;
const EPSILON: f32 = 1e-15;

/// Parameters and their moments.
pub(crate) struct Moving<'a> {
    pub(crate) parameters: &'a mut [f32],
    pub(crate) first: &'a mut [f32],
    pub(crate) second: &'a mut [f32],
}

/// The factors of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rate {
    /// Learning rate over 1 - beta_1^t, times the root of 1 - beta_2^t.
    rate: f32,
}

impl Rate {
    pub(crate) fn new(learning_rate: f32, step: u32) -> Self {
        let [first, second] = AdamBetas { first: BETA1, second: BETA2 }.corrections(step);
        Self { rate: (f64::from(learning_rate) * second.sqrt() / first) as f32 }
    }

    /// Moves the parameters against the gradient.
    #[inline(always)]
    pub(crate) fn update<S: Simd>(self, simd: S, moving: Moving<'_>, gradient: &[f32]) {
        let Moving { parameters, first, second } = moving;
        let c = |value: f32| f32x16::splat(simd, value);
        let rows = parameters.chunks_exact_mut(LANES).zip(first.chunks_exact_mut(LANES)).zip(second.chunks_exact_mut(LANES));
        for (((parameters, first), second), gradient) in rows.zip(gradient.chunks_exact(LANES)) {
            let g = f32x16::from_slice(simd, gradient);
            let untouched = g.simd_eq(c(0.0));
            if untouched.all_true() {
                continue;
            }
            let (p, m, v) = (f32x16::from_slice(simd, parameters), f32x16::from_slice(simd, first), f32x16::from_slice(simd, second));
            let new_m = m.mul_add(c(BETA1), g * c(1.0 - BETA1));
            let new_v = v.mul_add(c(BETA2), g * g * c(1.0 - BETA2));
            let new_p = p - c(self.rate) * new_m / (new_v.sqrt() + c(EPSILON));
            untouched.select(p, new_p).store_slice(parameters);
            untouched.select(m, new_m).store_slice(first);
            untouched.select(v, new_v).store_slice(second);
        }
        let done = gradient.len() / LANES * LANES;
        for i in done..gradient.len() {
            if gradient[i] != 0.0 {
                first[i] = BETA1 * first[i] + (1.0 - BETA1) * gradient[i];
                second[i] = BETA2 * second[i] + (1.0 - BETA2) * gradient[i] * gradient[i];
                parameters[i] -= self.rate * first[i] / (second[i].sqrt() + EPSILON);
            }
        }
    }
}

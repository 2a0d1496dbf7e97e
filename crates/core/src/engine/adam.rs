//! Adam (Kingma and Ba 2015): its constants, the correction of its moments, and the update of
//! single numbers in double precision.
//!
//! In: moments and a gradient. Out: the new moments, and the move. Engines update the parameters of
//! splats in single precision, a vector at a time, and a radiance field updates its table by the
//! same operations in another order. They have code of their own: the last bits differ, and trained
//! results depend on them. What they share is the correction.

/// Adam's beta_1.
pub const ADAM_BETA1: f32 = 0.9;
/// Adam's beta_2.
pub const ADAM_BETA2: f32 = 0.999;
/// Adam's epsilon.
pub const ADAM_EPSILON: f32 = 1e-15;

/// Adam's decay rates of the moments at one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamBetas {
    /// Decay rate of the first moments.
    pub first: f32,
    /// Decay rate of the second moments.
    pub second: f32,
}

impl Default for AdamBetas {
    fn default() -> Self {
        Self { first: ADAM_BETA1, second: ADAM_BETA2 }
    }
}

impl AdamBetas {
    /// Returns 1 - beta^t of both moments in step t, which is 1 for the first: by what moments that
    /// began at zero are divided.
    pub fn corrections(self, step: u32) -> [f64; 2] {
        [self.first, self.second].map(|beta| 1.0 - f64::from(beta).powi(step.clamp(1, i32::MAX as u32) as i32))
    }
}

/// The constants of a step of single numbers, in double precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberAdam {
    betas: [f64; 2],
    corrections: [f64; 2],
    epsilon: f64,
}

/// The update of a number: it moves by `mean / deviation` times the learning rate, against the
/// gradient. Callers divide and multiply in their own order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamMove {
    /// The corrected first moment.
    pub mean: f64,
    /// The root of the corrected second moment, plus epsilon.
    pub deviation: f64,
}

impl NumberAdam {
    /// Returns the constants after so many updates of the first and of the second moments, this one
    /// included.
    pub fn new(betas: [f64; 2], updates: [u32; 2], epsilon: f64) -> Self {
        let correction = |i: usize| 1.0 - betas[i].powf(f64::from(updates[i]));
        Self { betas, corrections: [correction(0), correction(1)], epsilon }
    }

    /// Updates the moments by a gradient.
    #[inline(always)]
    pub fn update(&self, first: &mut f64, second: &mut f64, gradient: f64) -> AdamMove {
        let [beta1, beta2] = self.betas;
        *first = beta1 * *first + (1.0 - beta1) * gradient;
        *second = beta2 * *second + (1.0 - beta2) * gradient * gradient;
        AdamMove { mean: *first / self.corrections[0], deviation: (*second / self.corrections[1]).sqrt() + self.epsilon }
    }

    /// Updates moments that are stored in single precision. The move is that of the moments before
    /// they are rounded.
    #[inline(always)]
    pub fn update_f32(&self, first: &mut f32, second: &mut f32, gradient: f64) -> AdamMove {
        let (mut m, mut v) = (f64::from(*first), f64::from(*second));
        let moved = self.update(&mut m, &mut v, gradient);
        (*first, *second) = (m as f32, v as f32);
        moved
    }
}

impl AdamMove {
    /// Returns the step at learning rate 1.
    #[inline(always)]
    pub fn at_rate_1(self) -> f64 {
        self.mean / self.deviation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_rate() {
        for gradient in [3.0, -1e-4] {
            let (mut first, mut second) = (0.0, 0.0);
            let adam = NumberAdam::new([0.9, 0.999], [1, 1], 1e-15);
            let moved = adam.update(&mut first, &mut second, gradient).at_rate_1();
            assert!((moved - gradient.signum()).abs() < 1e-9, "{moved}");
            assert!((first - 0.1 * gradient).abs() < 1e-12 && (second - 1e-3 * gradient * gradient).abs() < 1e-12);
        }
    }

    #[test]
    fn corrections_begin_with_the_rest_of_a_beta_and_end_at_1() {
        let [first, second] = AdamBetas::default().corrections(1);
        assert!((first - 0.1).abs() < 1e-7 && (second - 1e-3).abs() < 1e-7);
        assert_eq!(AdamBetas::default().corrections(0), AdamBetas::default().corrections(1));
        assert_eq!(AdamBetas::default().corrections(u32::MAX), [1.0; 2]);
    }
}

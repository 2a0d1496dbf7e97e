//! Splats that are long and thin: needles.
//!
//! A splat's aspect is its largest standard deviation over the second largest, so that flat splats,
//! which surfaces are made of, have an aspect of about 1. A limit shortens needles and leaves their
//! width, thickness, place and colour. Degenerate: a limit below 1 counts as 1.

use crate::Splats;

impl Splats {
    /// Returns the natural logarithm of the aspect of splat `i`, 0 or more.
    pub fn log_aspect(&self, i: usize) -> f32 {
        let [largest, second, _] = sorted(self.log_scale[i]);
        largest - second
    }

    /// Shortens splats whose aspect is above `most`. Returns how many there were.
    ///
    /// ```
    /// use luxel_core::synthetic;
    ///
    /// let mut splats = synthetic::room(1, 1);
    /// splats.log_scale[0] = [0.0, 3.0, 1.0];
    /// assert_eq!(splats.limit_aspect(1.0f32.exp()), 1);
    /// assert_eq!(splats.log_scale[0], [0.0, 2.0, 1.0]);
    /// assert_eq!(splats.limit_aspect(1.0f32.exp()), 0);
    /// ```
    pub fn limit_aspect(&mut self, most: f32) -> usize {
        let log_most = most.max(1.0).ln();
        let mut count = 0;
        for log_scale in &mut self.log_scale {
            let longest = sorted(*log_scale)[1] + log_most;
            // Only one can be above it: the second largest is not.
            if let Some(value) = log_scale.iter_mut().find(|value| **value > longest) {
                *value = longest;
                count += 1;
            }
        }
        count
    }
}

/// Returns the values, largest first.
fn sorted(mut values: [f32; 3]) -> [f32; 3] {
    values.sort_unstable_by(|a, b| b.total_cmp(a));
    values
}

#[cfg(test)]
mod tests {
    use crate::synthetic;

    #[test]
    fn flat_splats_stay_and_needles_get_the_limit() {
        let mut splats = synthetic::room(3, 1);
        splats.log_scale = vec![[-1.0, -1.0, -9.0], [5.0, -2.0, -3.0], [0.5, 0.0, 0.4]];
        let before = splats.clone();
        assert_eq!(splats.limit_aspect(10.0), 1);
        assert_eq!([splats.log_scale[0], splats.log_scale[2]], [before.log_scale[0], before.log_scale[2]]);
        assert!((splats.log_aspect(1) - 10f32.ln()).abs() < 1e-6 && splats.log_scale[1][1..] == [-2.0, -3.0]);
        assert_eq!(splats.limit_aspect(10.0), 0, "once is enough");
        // Everything is as wide as it is long, at most.
        splats.limit_aspect(0.0);
        assert!((0..3).all(|i| splats.log_aspect(i) == 0.0));
    }
}

//! Splats that a step leaves out, so that none is relied on alone (DropGaussian, Park et al. 2025).

use crate::random;

/// A random choice of splats that a training step leaves out.
///
/// The others are drawn with their opacities divided by 1 - `rate`, so that images keep their
/// coverage on average. A splat that is left out has a gradient of zero. What is left out depends
/// on the seed and the splat's number alone, and is the same on every engine.
///
/// ```
/// use luxel_core::engine::Dropout;
///
/// let dropout = Dropout { rate: 0.25, seed: 7 };
/// let kept = (0..10_000).filter(|splat| dropout.keeps(*splat)).count();
/// assert!((7_350..7_650).contains(&kept));
/// assert_eq!(dropout.opacity_factor(), 1.0 / 0.75);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Probability of each splat to be left out, at least 0 and below 1.
    pub rate: f32,
    /// Seed of the choice; another for each step.
    pub seed: u32,
}

impl Dropout {
    /// Returns whether the step draws splat number `splat`.
    #[inline]
    pub fn keeps(self, splat: u32) -> bool {
        random::uniform_32(self.seed, splat) >= self.rate
    }

    /// Returns the factor of the opacities of the splats that are drawn.
    #[inline]
    pub fn opacity_factor(self) -> f32 {
        1.0 / (1.0 - self.rate)
    }
}

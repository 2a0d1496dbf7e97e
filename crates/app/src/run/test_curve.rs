//! When a run looks at test views between its evaluations, and at which: the test curve of the
//! report.
//!
//! In: the number of steps and of test views. Out: about [`LOOKS`] looks at a few views each, at
//! lines of the log. A look renders and leaves training as it is. All looks together render at most
//! one view for every hundred steps, and one more at the last; a step takes longer than a render.

use super::log::LOG_EVERY;

/// Looks over a run of many steps.
const LOOKS: u32 = 10;

/// Steps for which a look has one more view.
const STEPS_A_VIEW: u32 = 1000;

/// Views of a look at most.
const MOST_VIEWS: u32 = 4;

/// The schedule.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TestCurve {
    iterations: u32,
    test_views: usize,
}

impl TestCurve {
    /// Returns the schedule of a run.
    pub(crate) fn new(iterations: u32, test_views: usize) -> Self {
        Self { iterations, test_views }
    }

    /// Returns whether the run looks after this step.
    pub(crate) fn is_due(self, iteration: u32) -> bool {
        let every = self.iterations.div_ceil(LOOKS).next_multiple_of(LOG_EVERY).max(LOG_EVERY);
        iteration == self.iterations || (iteration > 0 && iteration.is_multiple_of(every))
    }

    /// Returns the indices of the test views to look at, spread evenly.
    pub(crate) fn views(self) -> impl Iterator<Item = usize> {
        let most = (self.iterations / STEPS_A_VIEW).clamp(1, MOST_VIEWS) as usize;
        let (count, chosen) = (self.test_views, most.min(self.test_views));
        (0..chosen).map(move |i| (2 * i + 1) * count / (2 * chosen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_are_few_and_spread() {
        for (iterations, looks, views) in [(40, 1, 1), (100, 1, 1), (1000, 10, 1), (3000, 10, 3), (9000, 10, 4), (30_000, 10, 4)] {
            let curve = TestCurve::new(iterations, 17);
            assert_eq!((1..=iterations).filter(|i| curve.is_due(*i)).count(), looks, "{iterations}");
            assert_eq!(curve.views().count(), views, "{iterations}");
            assert!((looks * views) as u32 <= iterations / 100 + 1);
        }
        assert_eq!(TestCurve::new(9000, 17).views().collect::<Vec<_>>(), [2, 6, 10, 14]);
        assert_eq!((TestCurve::new(9000, 2).views().collect::<Vec<_>>(), TestCurve::new(9000, 0).views().count()), (vec![0, 1], 0));
    }
}

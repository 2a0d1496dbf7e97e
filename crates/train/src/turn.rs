//! The captured image that a step sees of those of its view.
//!
//! In: the view, the step. Out: the index of one of its captured images. Each pose takes its
//! captured images in turn, and poses begin at different ones, so over as many epochs as there are
//! exposures every pair of a pose and an exposure comes once.

/// Returns the index of the captured image of a view that `step` sees, of `views` views.
pub(crate) fn turn(step: u32, index: usize, views: usize, recordings: usize) -> usize {
    let epoch = (step.saturating_sub(1) as usize) / views.max(1);
    (epoch + index) % recordings.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_comes_once_in_as_many_epochs_as_there_are_exposures() {
        let mut seen = [[0; 3]; 7];
        for step in 1..=21 {
            // Within an epoch the order of views is any.
            let index = (step as usize * 3) % 7;
            seen[index][turn(step, index, 7, 3)] += 1;
        }
        assert_eq!(seen, [[1; 3]; 7]);
        assert_eq!([0, 1, 2].map(|index| turn(1, index, 7, 3)), [0, 1, 2]);
    }
}

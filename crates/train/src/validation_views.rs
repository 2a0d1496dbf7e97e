//! Training views that validate: they are not trained on while splats are added, and tell growth
//! that helps from overfitting.
//!
//! In: the cameras of the training views, the fraction that validates. Out: the validation views,
//! spread evenly over the order of the set, and for each the two trained views that look at the
//! most similar part of the scene. Degenerate: of fewer than [`LEAST_VIEWS`] views none validates,
//! because few views cannot do without one.

use luxel_core::{Camera, View};
use serde::{Deserialize, Serialize};

/// Largest number of validation views: enough for a steady mean.
const MOST: usize = 8;

/// Smallest number of training views of which some validate.
const LEAST_VIEWS: usize = 12;

/// Number of trained views that a validation view is compared with.
const NEIGHBOURS: usize = 2;

/// How well views that are not trained on are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Fit {
    /// Largest number of splats now.
    pub(crate) room: u32,
    /// By how much views that are trained on are better than validation views, dB; the mean of the
    /// latest rounds.
    pub(crate) lead_db: f64,
}

/// A validation view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ValidationView {
    /// Its index.
    pub(crate) index: usize,
    /// Indices of the trained views that it is compared with.
    pub(crate) neighbours: Vec<usize>,
}

/// Returns the indices of the validation views of `count` views, in order.
pub(crate) fn validation_indices(count: usize, fraction: f32) -> Vec<usize> {
    if count < LEAST_VIEWS || fraction <= 0.0 {
        return Vec::new();
    }
    let kept = ((count as f32 * fraction).round() as usize).clamp(1, MOST).min(count / 2);
    (0..kept).map(|i| (2 * i + 1) * count / (2 * kept)).collect()
}

/// Returns the validation views, with their neighbours; `extent` is the radius of the cameras'
/// places, world units.
pub(crate) fn validation_views(train: &[View], fraction: f32, extent: f32) -> Vec<ValidationView> {
    let indices = validation_indices(train.len(), fraction);
    let validation = |index: &usize| {
        let camera = &train.get(*index)?.camera;
        let others = train.iter().enumerate().filter(|(other, _)| !indices.contains(other));
        let mut others: Vec<(f64, usize)> = others.map(|(other, view)| (difference(camera, &view.camera, extent), other)).collect();
        others.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Some(ValidationView { index: *index, neighbours: others.into_iter().take(NEIGHBOURS).map(|(_, other)| other).collect() })
    };
    indices.iter().filter_map(validation).collect()
}

/// Returns how differently two cameras look at a scene: the distance between their places in
/// extents, plus the distance between their unit directions.
fn difference(a: &Camera, b: &Camera, extent: f32) -> f64 {
    a.eye().distance(b.eye()) / f64::from(extent) + a.forward().distance(b.forward())
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;

    use super::*;
    use crate::testing::{camera_at, view_of};

    #[test]
    fn a_part_of_the_views_validates_and_none_of_few() {
        assert_eq!(validation_indices(11, 0.1), Vec::<usize>::new());
        assert_eq!(validation_indices(100, 0.0), Vec::<usize>::new());
        assert_eq!(validation_indices(12, 0.1), [6]);
        assert_eq!(validation_indices(18, 0.1), [4, 13]);
        let many = validation_indices(1000, 0.1);
        assert_eq!(many.len(), MOST);
        assert!(many.is_sorted() && many.iter().all(|index| *index < 1000));
    }

    #[test]
    fn neighbours_are_near_and_trained_on() {
        // Two rows of cameras whose order jumps between the rows.
        let eye = |i: usize| [0.1 * (i / 2) as f64, (i % 2) as f64, 0.0];
        let train: Vec<View> =
            (0..24).map(|i| view_of(&format!("{i:02}"), camera_at(eye(i), [8, 8]), Image::filled(8, 8, [0.2; 3]))).collect();
        let views = validation_views(&train, 0.1, 2.0);
        assert_eq!(views.iter().map(|view| view.index).collect::<Vec<_>>(), [6, 18]);
        let neighbours = |i: usize| std::collections::BTreeSet::from_iter(views[i].neighbours.clone());
        assert_eq!([neighbours(0), neighbours(1)], [[4, 8].into(), [16, 20].into()]);
    }
}

//! Spacing of points, which determines the initial scale of splats.
//!
//! In: positions [N,3], finite. Out: root of the mean squared distance to the 3 nearest others (or
//! to all others, if there are fewer), world units, at least `MIN_DISTANCE`. Points in the same
//! place have the minimum. A single point has 1.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Smallest distance: the root of 3DGS's floor of 1e-7 on the squared distance.
const MIN_DISTANCE: f32 = 3.162_277_7e-4;

/// Number of neighbours that are averaged.
const NEIGHBOURS: usize = 3;

/// Returns the spacing at each of `positions`.
pub fn distances(positions: &[[f32; 3]]) -> Vec<f32> {
    if positions.len() < 2 {
        return vec![1.0; positions.len()];
    }
    let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(positions) else {
        // The tree only refuses more points than it can number; then all points get a common
        // spacing.
        return vec![common_spacing(positions); positions.len()];
    };
    let count = NonZero::<usize>::MIN.saturating_add(NEIGHBOURS);
    positions
        .par_iter()
        .map(|position| {
            let found = tree.query(position).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            // The nearest result is the point itself, or one in the same place: either way its
            // distance is 0.
            let others = found.iter().skip(1).map(|item| f64::from(item.distance));
            let mean = others.clone().sum::<f64>() / others.len().max(1) as f64;
            (mean.sqrt() as f32).max(MIN_DISTANCE)
        })
        .collect()
}

/// Returns the spacing of the same number of points on a grid in the bounding box.
fn common_spacing(positions: &[[f32; 3]]) -> f32 {
    let extent = |axis: usize| {
        let values = positions.iter().map(|p| p[axis]);
        values.clone().fold(f32::NEG_INFINITY, f32::max) - values.fold(f32::INFINITY, f32::min)
    };
    let side = extent(0).max(extent(1)).max(extent(2));
    (side / (positions.len() as f32).cbrt()).max(MIN_DISTANCE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_points_are_one_step_apart() {
        let grid: Vec<[f32; 3]> = (0..1000).map(|i| [(i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32]).collect();
        for distance in distances(&grid) {
            assert!((distance - 1.0).abs() < 1e-6, "{distance}");
        }
    }

    #[test]
    fn spacing_is_the_root_mean_square_to_three_neighbours() {
        let line = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [6.0, 0.0, 0.0]];
        let expected = ((1.0 + 9.0 + 36.0) / 3f32).sqrt();
        assert!((distances(&line)[0] - expected).abs() < 1e-5);
        assert_eq!(distances(&line[..2]), [1.0, 1.0]);
    }

    #[test]
    fn points_in_the_same_place_and_plane_are_no_trouble() {
        assert_eq!(distances(&[[1.0, 2.0, 3.0]; 500]), [MIN_DISTANCE; 500]);
        let plane: Vec<[f32; 3]> = (0..5000).map(|i| [(i % 70) as f32, (i / 70) as f32, 0.0]).collect();
        assert!(distances(&plane).iter().all(|d| (0.9..2.0).contains(d)));
        assert_eq!(distances(&[[5.0; 3]]), [1.0]);
        assert_eq!(distances(&[]), [0.0; 0]);
    }
}

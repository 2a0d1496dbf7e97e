//! Distances of points to their neighbours, for finding those that are far from all others.
//!
//! In: positions [N,3], finite. Out: the distance of each to its n-th nearest other, and how many
//! times as far that is as its neighbours' own. Degenerate: with at most n points nothing is
//! isolated; points in one place have a distance of 0 and no isolation.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Points and the distances to their neighbours.
#[derive(Clone, Debug)]
pub struct Neighbourhood {
    /// Indices of the nearest others of each point, `[N]`.
    neighbours: Vec<Vec<u32>>,
    /// Distance to the farthest of them, `[N]`.
    distances: Vec<f32>,
}

impl Neighbourhood {
    /// Finds the `count` nearest others of each point.
    pub fn new(positions: &[[f32; 3]], count: usize) -> Self {
        let empty = || Self { neighbours: vec![Vec::new(); positions.len()], distances: vec![0.0; positions.len()] };
        if positions.len() <= count {
            return empty();
        }
        // The tree only refuses more points than it can number.
        let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(positions) else { return empty() };
        let with_itself = NonZero::<usize>::MIN.saturating_add(count);
        let of_point = |position: &[f32; 3]| {
            let found = tree.query(position).nearest_n::<SquaredEuclidean<f32>>(with_itself).execute();
            // The nearest result is the point itself, or one in the same place.
            let others: Vec<u32> = found.iter().skip(1).map(|item| item.item).collect();
            (others, found.last().map_or(0.0, |item| item.distance.sqrt()))
        };
        let (neighbours, distances) = positions.par_iter().map(of_point).unzip();
        Self { neighbours, distances }
    }

    /// Returns the distance of point `i` to the farthest of its neighbours.
    pub fn distance(&self, i: usize) -> f32 {
        self.distances.get(i).copied().unwrap_or(0.0)
    }

    /// Returns for each point its distance over the median of its neighbours' distances: about 1
    /// for points among others, whatever the density.
    pub fn isolation(&self) -> Vec<f32> {
        let of_point = |(neighbours, distance): (&Vec<u32>, &f32)| {
            let mut theirs: Vec<f32> = neighbours.iter().map(|i| self.distance(*i as usize)).collect();
            theirs.sort_unstable_by(f32::total_cmp);
            match theirs.get(theirs.len() / 2) {
                Some(median) if *median > 0.0 => distance / median,
                _ => 0.0,
            }
        };
        self.neighbours.par_iter().zip(&self.distances).map(of_point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_apart_is_isolated_and_a_sparse_region_is_not() {
        let grid = |side: usize, step: f32, x: f32| {
            (0..side * side).map(move |i| [x + step * (i % side) as f32, step * (i / side) as f32, 0.0]).collect::<Vec<_>>()
        };
        // A dense and a sparse grid, and a point between them.
        let points = [grid(20, 0.1, 0.0), grid(10, 2.0, 50.0), vec![[10.0, 0.0, 0.0]]].concat();
        let isolation = Neighbourhood::new(&points, 8).isolation();
        assert!(isolation[..500].iter().all(|v| *v < 3.0) && isolation[500] > 20.0, "{isolation:?}");
    }

    #[test]
    fn few_points_and_points_in_one_place_are_not_isolated() {
        for points in [vec![], vec![[1.0; 3]; 3], vec![[2.0; 3]; 100]] {
            let found = Neighbourhood::new(&points, 8);
            assert_eq!(found.isolation(), vec![0.0; points.len()]);
        }
    }
}

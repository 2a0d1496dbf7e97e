//! Marching: the intervals of a ray that lie in occupied cells.
//!
//! In: a [`Ray`], the [`Occupancy`]. Out: intervals front to back. Their length is the cube's
//! diagonal / 1024 near the camera and grows with the distance, as the footprint of a pixel does.
//! Degenerate: a ray past the cube has none.

use crate::occupancy::Occupancy;
use crate::space::{MIN_LENGTH, Ray};

/// Length of an interval over its distance from the camera.
const CONE: f32 = 1.0 / 256.0;
/// Greatest number of intervals of a ray.
const MAX_INTERVALS: usize = 1024;

/// A part of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interval {
    /// Distance of its middle from the ray's origin.
    pub(crate) middle: f32,
    pub(crate) length: f32,
    pub(crate) position: [f32; 3],
}

/// A ray under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct March {
    ray: Ray,
    inverse: [f32; 3],
    at: f32,
    end: f32,
    left: usize,
}

impl March {
    /// Starts at distance `near`, or where the ray enters the cube; `shift` in [0, 1) moves all
    /// intervals by a part of the first one's length.
    pub(crate) fn new(ray: Ray, near: f32, shift: f32) -> Self {
        let inverse = ray.direction.map(|d| if d.abs() > 1e-9 { d.recip() } else { 1e9f32.copysign(d) });
        let (mut at, mut end) = (near, f32::INFINITY);
        for (origin, inverse) in ray.origin.into_iter().zip(inverse) {
            let (a, b) = (-origin * inverse, (1.0 - origin) * inverse);
            at = at.max(a.min(b));
            end = end.min(a.max(b));
        }
        at += shift * length_at(at);
        Self { ray, inverse, at, end, left: MAX_INTERVALS }
    }

    /// Returns the next occupied interval.
    pub(crate) fn next(&mut self, occupancy: &Occupancy) -> Option<Interval> {
        let Ray { origin, direction } = self.ray;
        while self.at < self.end && self.left > 0 {
            let length = length_at(self.at);
            let middle = self.at + 0.5 * length;
            let mut position = [0.0; 3];
            for axis in 0..3 {
                position[axis] = origin[axis] + middle * direction[axis];
            }
            let cell = occupancy.cell(position);
            if occupancy.is_occupied(cell) {
                self.at += length;
                self.left -= 1;
                return Some(Interval { middle, length, position });
            }
            // To the end of the cell, by whole intervals.
            let mut skip = f32::INFINITY;
            for axis in 0..3 {
                let border = (cell[axis] as f32 + if direction[axis] > 0.0 { 1.0 } else { 0.0 }) / occupancy.side() as f32;
                skip = skip.min((border - position[axis]) * self.inverse[axis]);
            }
            self.at += length * (skip.max(0.0) / length).ceil().max(1.0);
        }
        None
    }
}

fn length_at(distance: f32) -> f32 {
    (CONE * distance).max(MIN_LENGTH)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(mut march: March, occupancy: &Occupancy) -> Vec<Interval> {
        std::iter::from_fn(|| march.next(occupancy)).collect()
    }

    #[test]
    fn intervals_follow_each_other_and_fill_the_ray() {
        let ray = Ray { origin: [-0.5, 0.5, 0.5], direction: [1.0, 0.0, 0.0] };
        let found = all(March::new(ray, 0.0, 0.0), &Occupancy::full(16));
        for pair in found.windows(2) {
            let ends = [pair[0].middle + 0.5 * pair[0].length, pair[1].middle - 0.5 * pair[1].length];
            assert!((ends[0] - ends[1]).abs() < 1e-5, "{ends:?}");
        }
        let covered: f32 = found.iter().map(|interval| interval.length).sum();
        assert!((covered - 1.0).abs() < 0.01, "{covered}");
    }

    #[test]
    fn empty_cells_have_no_intervals_and_occupied_ones_all() {
        let mut occupancy = Occupancy::full(16);
        occupancy.keep(|cell| cell[0] == 9);
        let direction = [0.8, 0.36, 0.48];
        let found = all(March::new(Ray { origin: [0.05, 0.1, 0.1], direction }, 0.01, 0.3), &occupancy);
        assert!(!found.is_empty() && found.iter().all(|interval| (9.0..10.0).contains(&(16.0 * interval.position[0]))));
        let covered: f32 = found.iter().map(|interval| interval.length * direction[0]).sum();
        assert!((covered - 1.0 / 16.0).abs() < 0.006, "{covered}");
    }

    #[test]
    fn a_ray_past_the_cube_has_no_intervals() {
        let ray = Ray { origin: [0.5, 2.0, 0.5], direction: [0.0, 1.0, 0.0] };
        assert_eq!(all(March::new(ray, 0.0, 0.0), &Occupancy::full(16)), []);
    }
}

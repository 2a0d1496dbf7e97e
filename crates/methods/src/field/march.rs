//! Marching: the intervals of a ray that lie in occupied cells.
//!
//! In: a [`Ray`], the [`Occupancy`]. Out: intervals front to back. Their length is the cube's
//! diagonal / 1024 near the camera and grows with the distance, as the footprint of a pixel does.
//! Images of a field that is fog still have one interval in place of several where those together
//! dim light by no more than one in an occupied cell of a solid field does ([`Spacing`]).
//! Degenerate: a ray past the cube has none.

use crate::field::occupancy::Occupancy;
use crate::field::space::{MIN_LENGTH, Ray};

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

/// The lengths of intervals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Spacing {
    /// By the distance alone.
    Even,
    /// In thin cells several times that, at most to the cell's end.
    ByDensity,
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
    #[inline]
    pub(crate) fn next(&mut self, occupancy: &Occupancy, spacing: Spacing) -> Option<Interval> {
        while self.at < self.end && self.left > 0 {
            let length = length_at(self.at);
            let mut interval = self.interval(length);
            let cell = occupancy.cell(interval.position);
            let stretch = occupancy.stretch(cell);
            if stretch > 0 {
                if stretch > 1 && spacing == Spacing::ByDensity {
                    interval = self.interval(length * f32::from(stretch).min(self.rest_of_cell(&interval, cell, occupancy)));
                }
                self.at += interval.length;
                self.left -= 1;
                return Some(interval);
            }
            self.at += length * self.rest_of_cell(&interval, cell, occupancy);
        }
        None
    }

    /// Returns the interval of a length that begins here.
    #[inline]
    fn interval(&self, length: f32) -> Interval {
        let middle = self.at + 0.5 * length;
        let position = std::array::from_fn(|axis| self.ray.origin[axis] + middle * self.ray.direction[axis]);
        Interval { middle, length, position }
    }

    /// Returns the number of whole intervals from one, whose middle is in a cell, to the end of
    /// the cell.
    #[inline]
    fn rest_of_cell(&self, interval: &Interval, cell: [usize; 3], occupancy: &Occupancy) -> f32 {
        let to_border = |axis: usize| {
            let border = (cell[axis] as f32 + if self.ray.direction[axis] > 0.0 { 1.0 } else { 0.0 }) / occupancy.side() as f32;
            (border - interval.position[axis]) * self.inverse[axis]
        };
        let rest = (0..3).map(to_border).fold(f32::INFINITY, f32::min);
        (rest.max(0.0) / interval.length).ceil().max(1.0)
    }
}

fn length_at(distance: f32) -> f32 {
    (CONE * distance).max(MIN_LENGTH)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::occupancy::SIDE;

    fn all(mut march: March, occupancy: &Occupancy) -> Vec<Interval> {
        std::iter::from_fn(|| march.next(occupancy, Spacing::Even)).collect()
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
    fn intervals_are_longer_in_thin_cells_and_nowhere_else() {
        let stretched = |occupancy: &Occupancy, mut march: March| -> Vec<Interval> {
            std::iter::from_fn(|| march.next(occupancy, Spacing::ByDensity)).collect()
        };
        let march = || March::new(Ray { origin: [-0.1, 0.2, 0.3], direction: [0.8, 0.36, 0.48] }, 0.01, 0.5);
        let of_density = |density: f32| Occupancy::from_densities(vec![density; SIDE.pow(3)]).unwrap();
        // A shortest interval dims light by 0.0025, a quarter of the threshold, and by twice it.
        let (thin, solid) = (of_density(0.002_5 / MIN_LENGTH), of_density(0.02 / MIN_LENGTH));
        let (even, long) = (all(march(), &thin), stretched(&thin, march()));
        assert!(2 * long.len() < even.len() && even.len() < 4 * long.len(), "{} {}", long.len(), even.len());
        for pair in long.windows(2) {
            let ends = [pair[0].middle + 0.5 * pair[0].length, pair[1].middle - 0.5 * pair[1].length];
            assert!((ends[0] - ends[1]).abs() < 1e-5, "{ends:?}");
        }
        assert_eq!(stretched(&solid, march()), all(march(), &solid));
    }

    #[test]
    fn a_ray_past_the_cube_has_no_intervals() {
        let ray = Ray { origin: [0.5, 2.0, 0.5], direction: [0.0, 1.0, 0.0] };
        assert_eq!(all(March::new(ray, 0.0, 0.0), &Occupancy::full(16)), []);
    }
}

//! The depths of points to a fraction of a pixel, in larger images than those of the sweep.
//!
//! In: points that views agree on, with the pixels at which these views see them; panels of the
//! same views with more pixels. Out: each point at the depth along its first view's ray at which
//! the other views resemble a window around it best, by the mean of 1 - ZNCC. Degenerate: a point
//! is left out if no view resembles it, or if the best depth is more than a pixel of the sweep
//! away.

use glam::{DVec2, DVec3};
use luxel_core::Point;
use rayon::prelude::*;

use super::panel::Panel;
use super::sweep::{LEAST_CONTRAST, MOST_COST, RADIUS, SIDE, vertex};

/// Number of pixels of a window.
const WINDOW: usize = SIDE * SIDE;

/// Distance between two depths on the screen of the view where it is largest, pixels.
const STEP_PX: f64 = 0.5;

/// Largest number of views that a window is compared with.
const MOST_OTHERS: usize = 6;

/// Returns the points whose depths could be refined. `ratio` is the number of pixels of these
/// panels per pixel of the sweep.
pub(super) fn refined(panels: &[Panel], points: Vec<Point>, ratio: f64) -> Vec<Point> {
    // In the order of the views, of which not all have a panel.
    let panel_of = |view: u32| panels.binary_search_by_key(&(view as usize), |panel| panel.view).ok().map(|i| &panels[i]);
    let steps = ((ratio + 0.5) / STEP_PX).ceil() as usize;
    let refine = |mut point: Point| {
        let (first, others) = point.observations.split_first()?;
        let others: Vec<&Panel> = others.iter().take(MOST_OTHERS).filter_map(|seen| panel_of(seen.view)).collect();
        let panel = panel_of(first.view)?;
        let at_px = DVec2::from_array(first.pixel_px.map(f64::from)) / panel.factor;
        let place = DVec3::from_array(point.position.map(f64::from));
        let at = Window::new(panel, at_px)?.best_place(panel, &others, place, steps)?;
        point.position = at.as_vec3().to_array();
        Some(point)
    };
    points.into_par_iter().filter_map(refine).collect()
}

/// The pixels around a place in its first view.
struct Window {
    /// Column and row of the first pixel.
    corner: [usize; 2],
    /// Log radiance less its mean, and the root of the sum of its squares.
    values: [f32; WINDOW],
    norm: f32,
}

impl Window {
    /// Returns the window around a pixel, if it is inside, valid and not bare.
    fn new(panel: &Panel, at_px: DVec2) -> Option<Self> {
        let corner = [at_px.x as usize, at_px.y as usize].map(|middle| middle.checked_sub(RADIUS));
        let [Some(x), Some(y)] = corner else { return None };
        if x + SIDE > panel.width || y + SIDE > panel.height {
            return None;
        }
        let at = |i: usize| (y + i / SIDE) * panel.width + x + i % SIDE;
        if !(0..WINDOW).all(|i| panel.is_valid[at(i)]) {
            return None;
        }
        let (values, norm) = centered(std::array::from_fn(|i| panel.log_radiance[at(i)]))?;
        Some(Self { corner: [x, y], values, norm })
    }

    /// Returns the place on the ray through the middle of the window that the other views resemble
    /// best, among `steps` depths on either side of `start`.
    fn best_place(&self, panel: &Panel, others: &[&Panel], start: DVec3, steps: usize) -> Option<DVec3> {
        let middle_px = DVec2::new((self.corner[0] + RADIUS) as f64, (self.corner[1] + RADIUS) as f64) + 0.5;
        let depth = panel.camera.camera_from_world.transform_point3(start).z;
        let inverse = 1.0 / depth;
        // Depths that are equidistant in their inverse are so on the screens of the other views.
        let moved = |other: &&Panel| {
            let at = |inverse: f64| other.camera.project(panel.place(middle_px, 1.0 / inverse)).map(|(px, _)| px);
            Some((at(inverse)? - at(1.01 * inverse)?).length())
        };
        let px_per_percent = others.iter().filter_map(moved).fold(0.0, f64::max);
        let step = 0.01 * inverse * STEP_PX / px_per_percent;
        if !(step.is_finite() && step * (steps as f64) < 0.5 * inverse) {
            return None;
        }
        let depth_of = |at: f64| 1.0 / (inverse + step * (at - steps as f64));
        let costs: Vec<f32> = (0..=2 * steps).map(|at| self.cost(panel, others, depth_of(at as f64))).collect::<Option<_>>()?;
        let (best, least) = costs.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
        if least > MOST_COST || best == 0 || best == 2 * steps {
            return None;
        }
        let shift = vertex([costs[best - 1], least, costs[best + 1]]);
        Some(panel.place(middle_px, depth_of(best as f64 + shift)))
    }

    /// Returns the mean of 1 - ZNCC of the views that see the whole window at a depth, if any does.
    fn cost(&self, panel: &Panel, others: &[&Panel], depth: f64) -> Option<f32> {
        let seen: Vec<f32> = others.iter().filter_map(|other| self.cost_in(panel, other, depth)).collect();
        (!seen.is_empty()).then(|| seen.iter().sum::<f32>() / seen.len() as f32)
    }

    fn cost_in(&self, panel: &Panel, other: &Panel, depth: f64) -> Option<f32> {
        // Places on the plane at this depth are linear in the pixel.
        let corner = DVec2::from_array(self.corner.map(|at| at as f64 + 0.5));
        let to_other = |at_px: DVec2| other.camera.camera_from_world.transform_point3(panel.place(at_px, depth));
        let origin = to_other(corner);
        let (dx, dy) = (to_other(corner + DVec2::X) - origin, to_other(corner + DVec2::Y) - origin);
        let mut values = [0.0; WINDOW];
        for (i, value) in values.iter_mut().enumerate() {
            let p = origin + dx * (i % SIDE) as f64 + dy * (i / SIDE) as f64;
            if p.z <= 0.0 {
                return None;
            }
            *value = other.log_radiance_at(p.truncate() / p.z * other.camera.focal_px + other.camera.center_px)?;
        }
        let (values, norm) = centered(values)?;
        let product: f32 = values.iter().zip(&self.values).map(|(a, b)| a * b).sum();
        Some(1.0 - product / (norm * self.norm))
    }
}

/// Returns values less their mean, and the root of the sum of their squares, unless they are all
/// about the same.
fn centered(mut values: [f32; WINDOW]) -> Option<([f32; WINDOW], f32)> {
    let mean = values.iter().sum::<f32>() / WINDOW as f32;
    values.iter_mut().for_each(|value| *value -= mean);
    let squares: f32 = values.iter().map(|value| value * value).sum();
    (squares >= WINDOW as f32 * LEAST_CONTRAST * LEAST_CONTRAST).then(|| (values, squares.sqrt()))
}

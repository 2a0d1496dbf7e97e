//! The depth of each pixel of a view by plane sweep.
//!
//! In: a panel and its neighbours. Out: depths along the axis `[H*W]`, world units, 0 where the
//! images do not tell. Planes are parallel to the image and equidistant in inverse depth, about a
//! pixel of the neighbours apart. The cost of a pixel at a plane is 1 - ZNCC over a window, the
//! mean of the two best neighbours, so that a neighbour from which the place is hidden does not
//! count. Sums over windows run along rows and columns.

use glam::DVec3;
use rayon::prelude::*;

use super::panel::Panel;

/// Half the side of a window, its side, and the number of its pixels: 7 x 7.
pub(super) const RADIUS: usize = 3;
pub(super) const SIDE: usize = 2 * RADIUS + 1;
const WINDOW: f32 = (SIDE * SIDE) as f32;

/// Smallest and largest number of planes.
const PLANES: [usize; 2] = [32, 192];

/// Bytes of a pixel: its depth, and its cost at every plane.
pub(super) const DEPTH_BYTES: u64 = 4;
pub(super) const MOST_COST_BYTES: u64 = 4 * PLANES[1] as u64;

/// Largest cost of an accepted depth: a correlation of 0.7.
pub(super) const MOST_COST: f32 = 0.3;

/// Least difference between the best cost and the best elsewhere.
const LEAST_LEAD: f32 = 0.06;

/// Smallest standard deviation of log radiance in a window that is compared.
pub(super) const LEAST_CONTRAST: f32 = 0.02;

/// Cost of what cannot be compared.
const UNKNOWN: f32 = 2.0;

/// The depths of a view.
pub(super) struct DepthMap {
    /// Depth along the axis of each pixel, world units; 0 where the images do not tell.
    pub(super) depth: Vec<f32>,
}

/// Returns the depths of a panel from its neighbours, given by index.
pub(super) fn depth_map(panel: &Panel, near: &[usize], panels: &[Panel]) -> DepthMap {
    let count = panel.len();
    let Some([nearest, farthest]) = panel.depths.filter(|_| !near.is_empty()) else { return DepthMap { depth: vec![0.0; count] } };
    let others: Vec<&Panel> = near.iter().map(|i| &panels[*i]).collect();
    let planes = planes(panel, &others, [nearest, farthest]);
    let inverse = |plane: f64| 1.0 / farthest + (1.0 / nearest - 1.0 / farthest) * plane / (planes - 1) as f64;
    let own = Windows::of_panel(panel);
    let costs: Vec<Vec<f32>> = (0..planes).into_par_iter().map(|plane| cost(panel, &own, &others, 1.0 / inverse(plane as f64))).collect();
    let depth = (0..count).into_par_iter().map(|i| best(&costs, i).map_or(0.0, |plane| (1.0 / inverse(plane)) as f32)).collect();
    DepthMap { depth }
}

/// Returns the number of planes that are a pixel of the neighbours apart.
fn planes(panel: &Panel, others: &[&Panel], [near, far]: [f64; 2]) -> usize {
    let middle = glam::DVec2::new(panel.width as f64, panel.height as f64) / 2.0;
    let across = |other: &&Panel| {
        let at = |depth: f64| other.camera.camera_from_world.transform_point3(panel.place(middle, depth));
        let (a, b) = (at(near), at(far));
        let flat = |p: DVec3| glam::DVec2::new(p.x, p.y) / p.z.max(1e-3 * near) * other.camera.focal_px;
        (flat(a) - flat(b)).length()
    };
    let longest = others.iter().map(across).filter(|px| px.is_finite()).fold(0.0, f64::max);
    (longest as usize).clamp(PLANES[0], PLANES[1])
}

/// Returns the plane of pixel `i`, between planes, if it is unambiguous.
fn best(costs: &[Vec<f32>], i: usize) -> Option<f64> {
    let cost = |plane: usize| costs[plane][i];
    let (mut at, mut least) = (0, f32::INFINITY);
    for plane in 0..costs.len() {
        if cost(plane) < least {
            (at, least) = (plane, cost(plane));
        }
    }
    if least > MOST_COST || at == 0 || at + 1 >= costs.len() {
        return None;
    }
    let elsewhere = (0..costs.len()).filter(|plane| plane.abs_diff(at) > 2).map(cost).fold(f32::INFINITY, f32::min);
    if elsewhere - least < LEAST_LEAD {
        return None;
    }
    Some(at as f64 + vertex([cost(at - 1), least, cost(at + 1)]))
}

/// Returns where the parabola through three costs is least, from the middle one, -1/2 to 1/2.
pub(super) fn vertex(costs: [f32; 3]) -> f64 {
    let [before, least, after] = costs.map(f64::from);
    let curvature = before - 2.0 * least + after;
    let shift = if curvature > 1e-9 { 0.5 * (before - after) / curvature } else { 0.0 };
    shift.clamp(-0.5, 0.5)
}

/// The mean and the variance of the window around each pixel.
struct Windows {
    mean: Vec<f32>,
    variance: Vec<f32>,
}

impl Windows {
    fn new(width: usize, height: usize, values: &[f32]) -> Self {
        let squares: Vec<f32> = values.iter().map(|v| v * v).collect();
        let mut mean = window_sums(width, height, values);
        mean.iter_mut().for_each(|sum| *sum /= WINDOW);
        let mut variance = window_sums(width, height, &squares);
        variance.iter_mut().zip(&mean).for_each(|(sum, mean)| *sum = *sum / WINDOW - mean * mean);
        Self { mean, variance }
    }

    /// Returns the windows of a panel, without a variance where they reach beyond its border.
    fn of_panel(panel: &Panel) -> Self {
        let mut own = Self::new(panel.width, panel.height, &panel.log_radiance);
        for (row, variance) in own.variance.chunks_mut(panel.width).enumerate() {
            let is_inside = row >= RADIUS && row + RADIUS < panel.height;
            for (column, variance) in variance.iter_mut().enumerate() {
                if !(is_inside && column >= RADIUS && column + RADIUS < panel.width) {
                    *variance = 0.0;
                }
            }
        }
        own
    }
}

/// Returns the cost of each pixel at a depth.
fn cost(panel: &Panel, own: &Windows, others: &[&Panel], depth: f64) -> Vec<f32> {
    let (mut least, mut second) = (vec![UNKNOWN; panel.len()], vec![UNKNOWN; panel.len()]);
    for other in others {
        let warped = warp(panel, other, depth);
        let theirs = Windows::new(panel.width, panel.height, &warped);
        let product: Vec<f32> = warped.iter().zip(&panel.log_radiance).map(|(a, b)| a * b).collect();
        let product = window_sums(panel.width, panel.height, &product);
        let floor = LEAST_CONTRAST * LEAST_CONTRAST;
        for i in 0..panel.len() {
            let covariance = product[i] / WINDOW - own.mean[i] * theirs.mean[i];
            let cost = 1.0 - covariance / (own.variance[i] * theirs.variance[i]).sqrt();
            // A window with a missing pixel has no number for its variance.
            let is_compared = own.variance[i] >= floor && theirs.variance[i] >= floor;
            let cost = if is_compared { cost } else { UNKNOWN };
            let larger = if cost > least[i] { cost } else { least[i] };
            least[i] = if cost < least[i] { cost } else { least[i] };
            second[i] = if larger < second[i] { larger } else { second[i] };
        }
    }
    if others.len() > 1 {
        least.iter_mut().zip(&second).for_each(|(least, second)| *least = (*least + second) / 2.0);
    }
    least
}

/// Returns the log radiance that `other` has where the pixels of `panel` are at `depth`; not a
/// number where it has none.
fn warp(panel: &Panel, other: &Panel, depth: f64) -> Vec<f32> {
    // Places on the plane, and their coordinates in the other camera, are linear in the pixel.
    let to_other = |at: glam::DVec2| other.camera.camera_from_world.transform_point3(panel.place(at, depth));
    let origin = to_other(glam::DVec2::splat(0.5));
    let (dx, dy) = (to_other(glam::DVec2::new(1.5, 0.5)) - origin, to_other(glam::DVec2::new(0.5, 1.5)) - origin);
    let focal = other.camera.focal_px.as_vec2();
    let center = other.camera.center_px.as_vec2() - 0.5;
    let mut out = Vec::with_capacity(panel.len());
    let (last_x, last_y) = ((other.width - 1) as f32, (other.height - 1) as f32);
    for row in 0..panel.height {
        let (start, step) = ((origin + dy * row as f64).as_vec3(), dx.as_vec3());
        for column in 0..panel.width {
            let p = start + step * column as f32;
            let (x, y) = (p.x / p.z * focal.x + center.x, p.y / p.z * focal.y + center.y);
            let is_inside = p.z > 0.0 && x >= 0.0 && y >= 0.0 && x < last_x && y < last_y;
            if !is_inside || !panel.is_valid[row * panel.width + column] {
                out.push(f32::NAN);
                continue;
            }
            let (i, j) = (x as usize, y as usize);
            let (u, v) = (x - i as f32, y - j as f32);
            let at = j * other.width + i;
            let value = |k: usize| other.log_radiance[k];
            let above = value(at) * (1.0 - u) + value(at + 1) * u;
            let below = value(at + other.width) * (1.0 - u) + value(at + other.width + 1) * u;
            out.push(if other.is_valid[at] { above * (1.0 - v) + below * v } else { f32::NAN });
        }
    }
    out
}

/// Returns the sum over the window around each pixel, as far as it is inside.
fn window_sums(width: usize, height: usize, values: &[f32]) -> Vec<f32> {
    let mut sums = vec![0.0f32; values.len()];
    let mut padded = vec![0.0f32; width + 2 * RADIUS];
    for (values, out) in values.chunks(width).zip(sums.chunks_mut(width)) {
        padded[RADIUS..RADIUS + width].copy_from_slice(values);
        sum_of(out, std::array::from_fn(|shift| &padded[shift..shift + width]));
    }
    let (rows, none) = (sums.clone(), vec![0.0f32; width]);
    for (y, out) in sums.chunks_mut(width).enumerate() {
        let row = |shift: usize| match (y + shift).checked_sub(RADIUS) {
            Some(row) if row < height => &rows[row * width..(row + 1) * width],
            _ => &none,
        };
        sum_of(out, std::array::from_fn(row));
    }
    sums
}

/// Writes the sums of the rows.
fn sum_of(out: &mut [f32], rows: [&[f32]; SIDE]) {
    let [a, b, c, d, e, f, g] = rows.map(|row| &row[..out.len()]);
    for i in 0..out.len() {
        out[i] = a[i] + b[i] + c[i] + d[i] + e[i] + f[i] + g[i];
    }
}

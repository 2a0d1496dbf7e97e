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

/// Half the side of a window, pixels: 7 x 7.
pub(super) const RADIUS: usize = 3;

/// Smallest and largest number of planes.
const PLANES: [usize; 2] = [32, 192];

/// Number of best neighbours that a cost is the mean of.
const BEST: usize = 2;

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
    let own = Moments::new(panel.width, panel.height, &panel.log_radiance);
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

/// Sums over windows.
struct Moments {
    sum: Vec<f32>,
    squares: Vec<f32>,
}

impl Moments {
    fn new(width: usize, height: usize, values: &[f32]) -> Self {
        let squares: Vec<f32> = values.iter().map(|v| v * v).collect();
        Self { sum: window_sums(width, height, values), squares: window_sums(width, height, &squares) }
    }
}

/// Returns the cost of each pixel at a depth.
fn cost(panel: &Panel, own: &Moments, others: &[&Panel], depth: f64) -> Vec<f32> {
    let count = panel.len();
    let mut least = vec![[UNKNOWN; BEST]; count];
    for other in others {
        let (warped, is_missing) = warp(panel, other, depth);
        let theirs = Moments::new(panel.width, panel.height, &warped);
        let product: Vec<f32> = warped.iter().zip(&panel.log_radiance).map(|(a, b)| a * b).collect();
        let product = window_sums(panel.width, panel.height, &product);
        let missing = window_sums(panel.width, panel.height, &is_missing);
        let n = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
        for i in 0..count {
            let (x, y) = (i % panel.width, i / panel.width);
            let is_cut = x.min(y) < RADIUS || x + RADIUS >= panel.width || y + RADIUS >= panel.height;
            if is_cut || missing[i] > 0.5 {
                continue;
            }
            let own_variance = own.squares[i] / n - (own.sum[i] / n).powi(2);
            let variance = theirs.squares[i] / n - (theirs.sum[i] / n).powi(2);
            let floor = LEAST_CONTRAST * LEAST_CONTRAST;
            if own_variance < floor || variance < floor {
                continue;
            }
            let covariance = product[i] / n - own.sum[i] / n * (theirs.sum[i] / n);
            let cost = 1.0 - covariance / (own_variance * variance).sqrt();
            let [first, second] = &mut least[i];
            if cost < *first {
                (*first, *second) = (cost, *first);
            } else if cost < *second {
                *second = cost;
            }
        }
    }
    let used = others.len().min(BEST);
    least.into_iter().map(|least| least[..used].iter().sum::<f32>() / used as f32).collect()
}

/// Returns the log radiance that `other` has where the pixels of `panel` are at `depth`, and 1
/// where it has none.
fn warp(panel: &Panel, other: &Panel, depth: f64) -> (Vec<f32>, Vec<f32>) {
    // Places on the plane, and their coordinates in the other camera, are linear in the pixel.
    let to_other = |at: glam::DVec2| other.camera.camera_from_world.transform_point3(panel.place(at, depth));
    let origin = to_other(glam::DVec2::splat(0.5));
    let (dx, dy) = (to_other(glam::DVec2::new(1.5, 0.5)) - origin, to_other(glam::DVec2::new(0.5, 1.5)) - origin);
    let focal = other.camera.focal_px.as_vec2();
    let center = other.camera.center_px.as_vec2() - 0.5;
    let (mut out, mut is_missing) = (Vec::with_capacity(panel.len()), Vec::with_capacity(panel.len()));
    let (last_x, last_y) = ((other.width - 1) as f32, (other.height - 1) as f32);
    for row in 0..panel.height {
        let (start, step) = ((origin + dy * row as f64).as_vec3(), dx.as_vec3());
        for column in 0..panel.width {
            let p = start + step * column as f32;
            let (x, y) = (p.x / p.z * focal.x + center.x, p.y / p.z * focal.y + center.y);
            let i = row * panel.width + column;
            let is_seen = p.z > 0.0 && x >= 0.0 && y >= 0.0 && x < last_x && y < last_y && panel.is_valid[i];
            if !is_seen {
                out.push(0.0);
                is_missing.push(1.0);
                continue;
            }
            let (i, j) = (x as usize, y as usize);
            let (u, v) = (x - i as f32, y - j as f32);
            let at = j * other.width + i;
            let value = |k: usize| other.log_radiance[k];
            let above = value(at) * (1.0 - u) + value(at + 1) * u;
            let below = value(at + other.width) * (1.0 - u) + value(at + other.width + 1) * u;
            out.push(above * (1.0 - v) + below * v);
            is_missing.push(if other.is_valid[at] { 0.0 } else { 1.0 });
        }
    }
    (out, is_missing)
}

/// Returns the sum over the window around each pixel, as far as it is inside.
fn window_sums(width: usize, height: usize, values: &[f32]) -> Vec<f32> {
    let mut rows = vec![0.0f32; values.len()];
    let add = |out: &mut [f32], values: &[f32]| out.iter_mut().zip(values).for_each(|(out, value)| *out += value);
    for (row, out) in values.chunks(width).zip(rows.chunks_mut(width)) {
        add(out, row);
        for shift in 1..=RADIUS.min(width) {
            add(out, &row[shift..]);
            add(&mut out[shift..], row);
        }
    }
    let mut sums = vec![0.0f32; values.len()];
    for y in 0..height {
        let out = &mut sums[y * width..(y + 1) * width];
        for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
            add(out, &rows[row * width..(row + 1) * width]);
        }
    }
    sums
}

//! A view as stereo sees it: reduced, in log radiance, with the range of depths to search.
//!
//! In: a view, the points. Out: log radiance `[H*W]`, the reduced camera, the range of depths.
//! Degenerate: black pixels have the floor, and no window with a masked pixel is compared.

use glam::{DVec2, DVec3};
use luxel_core::{Camera, Point, View, luminance_sum};

/// Longest side of a panel that is swept, pixels: time grows with its third power.
pub(super) const SWEPT_PX: u32 = 200;

/// Longest side of a panel in which depths are refined, pixels: the first splats are no finer.
pub(super) const REFINED_PX: u32 = 400;

/// Bytes of a pixel of a panel: log radiance, and whether it is valid.
pub(super) const BYTES: u64 = 5;

/// Floor of radiance as a fraction of the median, below which noise is all there is.
const FLOOR: f32 = 1e-2;

/// Share of a view's points that may be nearer or farther than the range of depths.
const OUTLIERS: f64 = 0.02;

/// Factor by which the range reaches beyond the points on either side.
const MARGIN: f64 = 1.5;

/// Least number of points in a view from which its range is taken.
const LEAST_POINTS: usize = 20;

/// A reduced view.
pub(super) struct Panel {
    /// Index of the view among the training views.
    pub(super) view: usize,
    pub(super) camera: Camera,
    /// Pixels of the view per pixel of the panel.
    pub(super) factor: f64,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) log_radiance: Vec<f32>,
    pub(super) is_valid: Vec<bool>,
    /// Nearest and farthest depth along the axis, world units; `None` if neither points nor
    /// cameras tell.
    pub(super) depths: Option<[f64; 2]>,
    /// Median depth of what the view sees.
    pub(super) typical: f64,
}

impl Panel {
    /// Reduces training view `index` to at most `side_px` pixels a side.
    pub(super) fn new(view: &View, index: usize, points: &[Point], range: Option<[f64; 2]>, side_px: u32) -> Self {
        let side = view.camera.size_px[0].max(view.camera.size_px[1]);
        let factor = side.div_ceil(side_px).max(1);
        let view = view.downscaled(factor, 0.5);
        let luminance: Vec<f32> = view.image.pixels.iter().map(|pixel| luminance_sum(*pixel)).collect();
        let is_valid: Vec<bool> = (0..luminance.len()).map(|i| view.is_valid(i) && luminance[i].is_finite()).collect();
        let mut lit: Vec<f32> = luminance.iter().copied().filter(|value| *value > 0.0 && value.is_finite()).collect();
        let at = lit.len() / 2;
        let median = if lit.is_empty() { 1.0 } else { *lit.select_nth_unstable_by(at, f32::total_cmp).1 };
        let floor = (FLOOR * median).max(f32::MIN_POSITIVE);
        let log_radiance =
            luminance.into_iter().map(|value| if value.is_finite() { (value.max(0.0) + floor).ln() } else { floor.ln() }).collect();
        let mut seen: Vec<f64> = points.iter().filter_map(|point| depth_of(&view.camera, point)).collect();
        seen.sort_unstable_by(f64::total_cmp);
        let quantile = |part: f64| seen[((seen.len() - 1) as f64 * part) as usize];
        let (depths, typical) = if seen.len() >= LEAST_POINTS {
            (Some([quantile(OUTLIERS) / MARGIN, quantile(1.0 - OUTLIERS) * MARGIN]), quantile(0.5))
        } else {
            (range, range.map_or(1.0, |[near, far]| (near * far).sqrt()))
        };
        let [width, height] = view.camera.size_px.map(|side| side as usize);
        Self { view: index, camera: view.camera, factor: factor.into(), width, height, log_radiance, is_valid, depths, typical }
    }

    pub(super) fn len(&self) -> usize {
        self.width * self.height
    }

    /// Returns the place in the world that pixel coordinates show at a depth.
    pub(super) fn place(&self, at_px: DVec2, depth: f64) -> DVec3 {
        let flat = (at_px - self.camera.center_px) / self.camera.focal_px;
        let local = DVec3::new(flat.x, flat.y, 1.0) * depth;
        self.camera.camera_from_world.matrix3.transpose() * local + self.camera.eye()
    }

    /// Returns the log radiance between the centres of four valid pixels, if there are four.
    pub(super) fn log_radiance_at(&self, at_px: DVec2) -> Option<f32> {
        let at = at_px - 0.5;
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < (self.width - 1) as f64 && at.y < (self.height - 1) as f64) {
            return None;
        }
        let (column, row) = (at.x as usize, at.y as usize);
        let (u, v) = ((at.x - column as f64) as f32, (at.y - row as f64) as f32);
        let places = [0, 1, self.width, self.width + 1].map(|to| row * self.width + column + to);
        if !places.iter().all(|i| self.is_valid[*i]) {
            return None;
        }
        let [a, b, c, d] = places.map(|i| self.log_radiance[i]);
        Some((a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v)
    }

    /// Returns the pixel (column, row), its coordinates and the depth of a place, if it is seen.
    pub(super) fn find(&self, place: DVec3) -> Option<([usize; 2], DVec2, f64)> {
        let (at_px, depth) = self.camera.project(place)?;
        let is_inside = at_px.x >= 0.0 && at_px.y >= 0.0 && at_px.x < self.width as f64 && at_px.y < self.height as f64;
        (is_inside && depth > 0.0).then_some(([at_px.x as usize, at_px.y as usize], at_px, depth))
    }
}

fn depth_of(camera: &Camera, point: &Point) -> Option<f64> {
    let (at_px, depth) = camera.project(DVec3::from_array(point.position.map(f64::from)))?;
    let [width, height] = camera.size_px.map(f64::from);
    (depth > 0.0 && (0.0..width).contains(&at_px.x) && (0.0..height).contains(&at_px.y)).then_some(depth)
}

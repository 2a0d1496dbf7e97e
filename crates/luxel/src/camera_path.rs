//! Camera paths around a captured scene, from the cameras of its data set alone; through keyframes
//! in [`keyframes`].
//!
//! In: the views of a data set, a kind of path and a number of frames. Out: cameras named
//! `frame_00000`, world of the data set, with the lens and image size of the first view and the
//! principal point in the middle. Up is the mean up direction of the cameras; what they look at is
//! the point nearest to all viewing rays.
//!
//! - Orbit: around that point at the cameras' mean distance and height. Where the cameras leave a
//!   gap of more than [`WIDEST_GAP_DEG`] around it, the path goes there and back over the arc that
//!   they cover, since nothing is known of the scene's other side. The end joins the beginning.
//! - Spiral: two turns about the mean camera, within the cameras' spread, looking at the point. The
//!   end joins the beginning.
//! - Between views: through all views, at even speed. The views are visited in the order of their
//!   names, unless going from each to its nearest neighbour is less than half as far.
//!
//! Degenerate: cameras that look in parallel, or away from one another, look at a point ahead of
//! them as far as the data set's points; a single view has no path between views; cameras that look
//! all ways have no spiral.

pub mod keyframes;

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Dataset, Distortion, View};
use luxel_io::PathCamera;

use crate::Result;
use crate::error::bail;

/// Widest gap between neighbouring cameras, seen from what they look at, that an orbit crosses.
pub const WIDEST_GAP_DEG: f64 = 120.0;

/// Turns of a spiral.
const TURNS: f64 = 2.0;

/// Share of the cameras that lie within a spiral's radii.
const SPIRAL_PERCENTILE: f64 = 0.5;

/// Length of a mean of unit vectors below which they have no common direction.
const NO_DIRECTION: f64 = 0.5;

/// A kind of camera path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathKind {
    /// Around what the cameras look at.
    Orbit,
    /// Turns about the mean camera.
    Spiral,
    /// From view to view.
    BetweenViews,
}

/// A camera path, and how it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    /// Its cameras, in order.
    pub cameras: Vec<PathCamera>,
    /// The path in words.
    pub description: String,
}

/// Returns a path of `frames` cameras.
///
/// ```
/// use luxel::camera_path::{PathKind, camera_path};
/// use luxel::{Dataset, synthetic};
///
/// # fn main() -> luxel::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let my_images = folder.path().join("data");
/// synthetic::write_dataset(&my_images, synthetic::BallsOptions { side_px: 16, views: 9 })?;
/// let dataset = Dataset::open(&my_images)?;
/// let path = camera_path(&dataset, PathKind::Orbit, 24)?;
/// assert_eq!(path.cameras.len(), 24);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// A data set with too few views, or whose cameras look all ways where the path needs one
/// direction.
pub fn camera_path(dataset: &Dataset, kind: PathKind, frames: usize) -> Result<CameraPath> {
    let mut views: Vec<&View> = dataset.train.iter().chain(&dataset.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let Some(first) = views.first() else { bail!("the data set has no views, and a camera path needs their cameras") };
    let rig = Rig::new(&views, dataset);
    let (poses, description) = match kind {
        PathKind::Orbit => rig.orbit(frames),
        PathKind::Spiral => rig.spiral(frames)?,
        PathKind::BetweenViews => rig.between_views(frames)?,
    };
    let lens = &first.camera;
    let camera = |(i, pose): (usize, DAffine3)| {
        let camera = Camera {
            camera_from_world: pose,
            focal_px: pinhole_focal_px(lens),
            center_px: 0.5 * DVec2::from_array(lens.size_px.map(f64::from)),
            size_px: lens.size_px,
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        };
        PathCamera::new(format!("frame_{i:05}"), camera)
    };
    Ok(CameraPath { cameras: poses.into_iter().enumerate().map(camera).collect(), description })
}

/// Returns the focal length of a path's cameras: that of the lens, or a field of 90 degrees where
/// the data set was taken with another projection.
fn pinhole_focal_px(lens: &Camera) -> DVec2 {
    if lens.projection.is_pinhole() { lens.focal_px } else { DVec2::splat(0.5 * f64::from(lens.size_px[0].max(lens.size_px[1]))) }
}

/// The cameras of a data set together.
struct Rig {
    eyes: Vec<DVec3>,
    rotations: Vec<DQuat>,
    /// Mean up direction, a unit vector.
    up: DVec3,
    /// Mean viewing direction; shorter than 1 where the cameras look different ways.
    forward: DVec3,
    /// Mean of the eyes.
    middle: DVec3,
    /// The point that the cameras look at.
    focus: DVec3,
}

impl Rig {
    fn new(views: &[&View], dataset: &Dataset) -> Self {
        let mean = |vectors: &mut dyn Iterator<Item = DVec3>| vectors.sum::<DVec3>() / views.len().max(1) as f64;
        let rows = |row: usize| views.iter().map(move |view| view.camera.camera_from_world.matrix3.row(row));
        let eyes: Vec<DVec3> = views.iter().map(|view| view.camera.eye()).collect();
        let up = (-mean(&mut rows(1))).try_normalize().unwrap_or(DVec3::NEG_Y);
        let (forward, middle) = (mean(&mut rows(2)), mean(&mut eyes.iter().copied()));
        let rotations = views.iter().map(|view| DQuat::from_mat3(&view.camera.camera_from_world.matrix3.transpose())).collect();
        let directions: Vec<DVec3> = rows(2).collect();
        let focus = nearest_to_rays(&eyes, &directions);
        let distance = || distance_of_points(views, dataset).unwrap_or_else(|| 2.0 * spread(&eyes, middle).max(0.5));
        let focus = focus.unwrap_or_else(|| middle + forward.try_normalize().unwrap_or(DVec3::Z) * distance());
        Self { eyes, rotations, up, forward, middle, focus }
    }

    /// Returns the poses around the focus.
    fn orbit(&self, frames: usize) -> (Vec<DAffine3>, String) {
        let axis = self.up;
        let (east, north) = axis.any_orthonormal_pair();
        let offsets: Vec<DVec3> = self.eyes.iter().map(|eye| *eye - self.focus).collect();
        let height = offsets.iter().map(|offset| offset.dot(axis)).sum::<f64>() / offsets.len() as f64;
        let flat: Vec<[f64; 2]> = offsets.iter().map(|offset| [offset.dot(east), offset.dot(north)]).collect();
        let radius = (flat.iter().map(|[x, y]| x.hypot(*y)).sum::<f64>() / flat.len() as f64).max(1e-9);
        let arc = Arc::covering(flat.iter().map(|[x, y]| y.atan2(*x)).collect());
        let poses = (0..frames).map(|i| {
            let turn = TAU * i as f64 / frames as f64;
            let angle = if arc.is_closed { arc.middle + turn } else { arc.middle + arc.half * turn.sin() };
            let eye = self.focus + radius * (angle.cos() * east + angle.sin() * north) + height * axis;
            looking_at(eye, self.focus, axis)
        });
        let kind = match arc.is_closed {
            true => "a full circle".to_owned(),
            false => format!("there and back over the {:.0} degrees from which the views see it", 2.0 * arc.half.to_degrees()),
        };
        (poses.collect(), format!("orbit around {}: {kind}", at(self.focus)))
    }

    /// Returns the poses about the mean camera.
    fn spiral(&self, frames: usize) -> Result<(Vec<DAffine3>, String)> {
        if self.forward.length() < NO_DIRECTION {
            bail!("the cameras look all ways, and a spiral needs one direction: choose orbit or between-views");
        }
        let pose = looking_at(self.middle, self.focus, self.up);
        let [right, down, ahead] = [0, 1, 2].map(|row| pose.matrix3.row(row));
        let radius = |axis: DVec3| percentile(self.eyes.iter().map(|eye| (*eye - self.middle).dot(axis).abs()).collect());
        let [x, y, z] = [right, down, ahead].map(radius);
        let poses = (0..frames).map(|i| {
            let turn = TAU * i as f64 / frames as f64;
            let eye = self.middle + x * (TURNS * turn).cos() * right + y * (TURNS * turn).sin() * down + z * turn.sin() * ahead;
            looking_at(eye, self.focus, self.up)
        });
        Ok((poses.collect(), format!("spiral about {}, looking at {}", at(self.middle), at(self.focus))))
    }

    /// Returns the poses through all views.
    fn between_views(&self, frames: usize) -> Result<(Vec<DAffine3>, String)> {
        if self.eyes.len() < 2 {
            bail!("the data set has one view, and a path between views needs two");
        }
        let by_name: Vec<usize> = (0..self.eyes.len()).collect();
        let nearest = nearest_neighbours(&self.eyes);
        let length = |order: &[usize]| order.windows(2).map(|pair| (self.eyes[pair[1]] - self.eyes[pair[0]]).length()).sum::<f64>();
        let is_jumping = 2.0 * length(&nearest) < length(&by_name);
        let order = if is_jumping { nearest } else { by_name };
        // A turn of the camera counts as the way of its focus.
        let reach = (self.focus - self.middle).length();
        let mut rotations: Vec<DQuat> = order.iter().map(|i| self.rotations[*i]).collect();
        let mut times = vec![0.0];
        for i in 1..order.len() {
            if rotations[i].dot(rotations[i - 1]) < 0.0 {
                rotations[i] = -rotations[i];
            }
            let way = (self.eyes[order[i]] - self.eyes[order[i - 1]]).length() + reach * rotations[i].angle_between(rotations[i - 1]);
            times.push(times[i - 1] + way.max(1e-12));
        }
        let eyes: Vec<[f64; 3]> = order.iter().map(|i| self.eyes[*i].to_array()).collect();
        let turns: Vec<[f64; 4]> = rotations.iter().map(|rotation| rotation.to_array()).collect();
        let last = times[times.len() - 1];
        let poses = (0..frames).map(|i| {
            let time = last * i as f64 / frames.saturating_sub(1).max(1) as f64;
            let eye = DVec3::from_array(spline(&times, &eyes, time));
            let rotation = DQuat::from_array(spline(&times, &turns, time)).normalize();
            let camera_from_world = DMat3::from_quat(rotation).transpose();
            DAffine3 { matrix3: camera_from_world, translation: -(camera_from_world * eye) }
        });
        let order = if is_jumping { "each to its nearest neighbour" } else { "in the order of their names" };
        Ok((poses.collect(), format!("between {} views, {order}", self.eyes.len())))
    }
}

/// The angles that cameras cover around a point.
struct Arc {
    middle: f64,
    half: f64,
    is_closed: bool,
}

impl Arc {
    /// Returns the arc that has all angles and leaves the widest gap out.
    fn covering(mut angles: Vec<f64>) -> Self {
        angles.sort_by(f64::total_cmp);
        let next = |i: usize| if i + 1 < angles.len() { angles[i + 1] } else { angles[0] + TAU };
        let widest = (0..angles.len()).max_by(|a, b| (next(*a) - angles[*a]).total_cmp(&(next(*b) - angles[*b]))).unwrap_or(0);
        let gap = next(widest) - angles[widest];
        // The arc begins behind the gap.
        let (start, half) = (next(widest), 0.5 * (TAU - gap));
        Self { middle: start + half, half, is_closed: gap <= WIDEST_GAP_DEG.to_radians() }
    }
}

/// Returns the pose at `eye` that looks at `target`, with `up` as far up as it can be.
fn looking_at(eye: DVec3, target: DVec3, up: DVec3) -> DAffine3 {
    let forward = (target - eye).try_normalize().unwrap_or(DVec3::Z);
    let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
    let down = forward.cross(right);
    let matrix3 = DMat3::from_cols(right, down, forward).transpose();
    DAffine3 { matrix3, translation: -(matrix3 * eye) }
}

/// Returns the point nearest to all rays; `None` where it is not ahead of most of them, or rays are
/// nearly parallel.
fn nearest_to_rays(eyes: &[DVec3], directions: &[DVec3]) -> Option<DVec3> {
    let (mut sum, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for (eye, direction) in eyes.iter().zip(directions) {
        let across = DMat3::IDENTITY - DMat3::from_cols(*direction * direction.x, *direction * direction.y, *direction * direction.z);
        sum += across;
        right += across * *eye;
    }
    // 2/3 of the identity per ray where rays come from everywhere, singular where they are
    // parallel.
    let part = sum.determinant() / (eyes.len() as f64).powi(3);
    let point = (part > 1e-4).then(|| sum.inverse() * right).filter(|point| point.is_finite())?;
    let ahead = eyes.iter().zip(directions).filter(|(eye, direction)| (point - **eye).dot(**direction) > 0.0).count();
    (2 * ahead > eyes.len()).then_some(point)
}

/// Returns the median depth of the data set's points in the views; `None` without any.
fn distance_of_points(views: &[&View], dataset: &Dataset) -> Option<f64> {
    let stride = (dataset.points.len() * views.len() / 100_000).max(1);
    let points = dataset.points.iter().step_by(stride).map(|point| DVec3::from(point.position.map(f64::from)));
    let depths: Vec<f64> = points.flat_map(|p| views.iter().filter_map(move |view| Some(view.camera.project(p)?.1))).collect();
    (!depths.is_empty()).then(|| percentile(depths))
}

/// Returns the largest distance of eyes from their mean.
fn spread(eyes: &[DVec3], middle: DVec3) -> f64 {
    eyes.iter().map(|eye| (*eye - middle).length()).fold(0.0, f64::max)
}

/// Returns the value that [`SPIRAL_PERCENTILE`] of the values do not exceed.
fn percentile(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get((SPIRAL_PERCENTILE * values.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or(0.0)
}

/// Returns the order that goes from the first point always to the nearest that is left.
fn nearest_neighbours(points: &[DVec3]) -> Vec<usize> {
    let mut left: Vec<usize> = (1..points.len()).collect();
    let mut order = vec![0];
    while !left.is_empty() {
        let here = points[order[order.len() - 1]];
        let distance = |i: &usize| (points[left[*i]] - here).length_squared();
        let nearest = (0..left.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
        order.push(left.remove(nearest));
    }
    order
}

/// Returns a cubic spline through `values` at `times` (ascending), with the slopes of finite
/// differences.
fn spline<const N: usize>(times: &[f64], values: &[[f64; N]], time: f64) -> [f64; N] {
    let last = times.len() - 1;
    let i = times.partition_point(|t| *t <= time).clamp(1, last) - 1;
    let step = times[i + 1] - times[i];
    let t = ((time - times[i]) / step).clamp(0.0, 1.0);
    let slope = |at: usize, c: usize| {
        let (a, b) = (at.saturating_sub(1), (at + 1).min(last));
        (values[b][c] - values[a][c]) / (times[b] - times[a])
    };
    std::array::from_fn(|c| {
        let (from, to) = (values[i][c], values[i + 1][c]);
        hermite([from, to], [slope(i, c) * step, slope(i + 1, c) * step], t)
    })
}

/// Returns a cubic between two values at `t` in `[0, 1]`, with the slopes at its ends.
fn hermite([from, to]: [f64; 2], [m, n]: [f64; 2], t: f64) -> f64 {
    let (t2, t3) = (t * t, t * t * t);
    (2.0 * t3 - 3.0 * t2 + 1.0) * from + (t3 - 2.0 * t2 + t) * m + (3.0 * t2 - 2.0 * t3) * to + (t3 - t2) * n
}

/// Returns a point in words.
fn at(point: DVec3) -> String {
    format!("({:.3}, {:.3}, {:.3})", point.x, point.y, point.z)
}

/// A camera with another image size, and what of its image is lost.
#[derive(Clone, Debug, PartialEq)]
pub struct Resized {
    /// The camera.
    pub camera: Camera,
    /// Parts of the width and the height that are cropped, 0 to 1; one of them is 0.
    pub cropped: [f64; 2],
}

/// Returns the camera of an image of another size that shows as much as fits: the field of view is
/// that of the old image in one direction, and cropped evenly on both sides in the other. Pixels
/// keep their shape.
///
/// ```
/// use luxel::camera_path::resized;
/// use luxel::synthetic;
///
/// let wide = resized(&synthetic::room_camera([64, 48]), [128, 72]);
/// assert_eq!((wide.camera.size_px, wide.cropped), ([128, 72], [0.0, 0.25]));
/// ```
pub fn resized(camera: &Camera, size_px: [u32; 2]) -> Resized {
    let ([w, h], [width, height]) = (camera.size_px.map(f64::from), size_px.map(f64::from));
    let scale = (width / w).max(height / h);
    let center = camera.center_px * scale - 0.5 * DVec2::new(scale * w - width, scale * h - height);
    let cropped = [1.0 - width / (scale * w), 1.0 - height / (scale * h)].map(|part| part.max(0.0));
    Resized { camera: Camera { focal_px: camera.focal_px * scale, center_px: center, size_px, ..camera.clone() }, cropped }
}

/// Returns a camera reduced by a whole factor, so that it has at most this many pixels.
pub(crate) fn with_at_most(camera: &Camera, pixels: u64) -> Camera {
    let reduced = |factor: u32| camera.size_px.map(|side| u64::from(side / factor)).iter().product::<u64>();
    camera.downscaled((1..).find(|factor| reduced(*factor) <= pixels).unwrap_or(1))
}

#[cfg(test)]
mod tests;

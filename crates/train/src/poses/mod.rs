//! Corrections of the training images' camera poses, and of the focal lengths, which are optimised
//! with the scene.
//!
//! In: the gradient of a step's loss by its camera ([`luxel_core::engine::CameraGradient`]). Out:
//! the corrected cameras of all views. A correction is a [`CameraMotion`] from the pose that the
//! data set has; a focal length has one factor for all views with the same intrinsics.
//!
//! Units: everything is measured by how far it moves the image. A step of one pixel turns a camera
//! by 1 / focal length, moves it by extent / focal length, and changes a focal length so that the
//! image's edge moves by a pixel. Adam's first moments are a view's own. Second moments are shared
//! by all views: gradients of all views have the same scale, and a view whose pose is right already
//! then moves less than one whose pose is not.
//!
//! Schedule: the poses are fixed while the scene forms, and again at the end, while it converges
//! ([`crate::Schedule::pose_progress`]); in between the rate falls to 0 along a cosine.
//!
//! Gauge: the scene and all cameras together can move, turn and grow without a change of the
//! images. After every update the similarity that all corrections have in common is removed from
//! them ([`gauge`]), so that the scene keeps its place and scale. A single view keeps its pose.

mod align;
mod gauge;

pub use align::{ALIGNMENT_STEPS, AlignmentScene, align_camera};

use glam::DVec3;
use luxel_core::engine::{CameraGradient, NumberAdam};
use luxel_core::{Camera, CameraMotion, Dataset};
use serde::{Deserialize, Serialize};

use self::gauge::Gauge;
use crate::TrainError;
use crate::lenses::groups_by_lens;

/// Decay rates of the moments.
const BETAS: [f64; 2] = [0.9, 0.999];
/// Epsilon of Adam, far below typical gradients per pixel.
const EPSILON: f64 = 1e-12;
/// Distance that the default rate can move an image in the course of a run, pixels.
const REACH_PX: f64 = 4.0;
/// Limits of the default rate, pixels per step.
const RATES_PX: [f64; 2] = [0.02, 0.4];
/// Mean of the rate over its decay, as a fraction of the first.
const MEAN_RATE: f64 = 0.5;
/// Rate of a focal length relative to a pose's, for each of its views: it moves at every step that
/// sees one of them.
const FOCAL_SHARE: f64 = 0.5;
/// Largest |ln factor| of a focal length: twice or half as long.
const MAX_LOG_FOCAL: f64 = 0.7;
/// Degrees of freedom of a pose.
const DOF: usize = 6;

/// The corrections and the state of their optimiser; the cameras they apply to are not part of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Corrections {
    /// Motion of each view from its pose in the data set.
    motions: Vec<CameraMotion>,
    /// First moments of each view, rotation and translation.
    first: Vec<[f64; DOF]>,
    /// Number of updates of each view.
    visits: Vec<u32>,
    /// Second moments, shared by all views.
    second: [f64; DOF],
    /// Number of updates in all.
    updates: u32,
    /// Factors of the focal lengths; none if they are fixed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    focals: Vec<Focal>,
}

/// The factor of the focal lengths of views with the same intrinsics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Focal {
    log_factor: f64,
    first: f64,
    second: f64,
    updates: u32,
}

/// Corrections with the cameras that they apply to.
pub(crate) struct Poses {
    /// Cameras of the data set.
    given: Vec<Camera>,
    /// The group of views with the same intrinsics that each view belongs to.
    groups: Vec<usize>,
    gauge: Gauge,
    /// Distance of the scene from the cameras, world units.
    extent: f64,
}

/// The size of a correction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseChange {
    /// Root mean square of the motion of points as far away as the scene's extent, over the image,
    /// pixels of the full resolution.
    pub px: f64,
    /// Angle of the rotation, degrees.
    pub degrees: f64,
    /// Displacement of the camera's centre, scene units.
    pub scene_units: f64,
}

/// The corrections of all views in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseReport {
    /// Means over the views.
    pub mean: PoseChange,
    /// Largest values, each of its own view.
    pub largest: PoseChange,
    /// Factors of the focal lengths, one for each set of intrinsics; none if they are fixed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub focal_factors: Vec<f64>,
}

impl Corrections {
    /// Returns no corrections for the views of `poses`.
    pub(crate) fn none(poses: &Poses, refines_focal: bool) -> Self {
        let views = poses.given.len();
        let groups = poses.groups.iter().max().map_or(0, |last| last + 1);
        Self {
            motions: vec![CameraMotion::IDENTITY; views],
            first: vec![[0.0; DOF]; views],
            visits: vec![0; views],
            second: [0.0; DOF],
            updates: 0,
            focals: if refines_focal { vec![Focal::default(); groups] } else { Vec::new() },
        }
    }

    /// Checks corrections from a file.
    pub(crate) fn validate(&self, poses: &Poses, refines_focal: bool) -> Result<(), TrainError> {
        let groups = Self::none(poses, refines_focal).focals.len();
        let views = poses.given.len();
        let lengths = [self.motions.len(), self.first.len(), self.visits.len()];
        if lengths != [views; 3] || self.focals.len() != groups {
            return Err(TrainError::State(format!(
                "poses of {lengths:?} views and {} cameras, expected {views} and {groups}",
                self.focals.len()
            )));
        }
        let moments = self.first.as_flattened().iter().chain(&self.second);
        let focals = self.focals.iter().flat_map(|focal| [focal.log_factor, focal.first, focal.second]);
        if !(self.motions.iter().all(CameraMotion::is_valid) && moments.copied().chain(focals).all(f64::is_finite)) {
            return Err(TrainError::State("the corrections of poses hold numbers that make no pose".to_owned()));
        }
        Ok(())
    }

    /// Moves view `index` by the gradient of a step at a rate in pixels, and removes what all
    /// corrections have in common. A gradient that is not finite moves nothing.
    pub(crate) fn update(&mut self, poses: &Poses, index: usize, gradient: &CameraGradient, rate_px: f64) {
        let (Some(camera), Some(group)) = (poses.given.get(index), poses.groups.get(index)) else { return };
        if !gradient.is_finite() {
            return;
        }
        self.updates = self.updates.saturating_add(1);
        let units = poses.units(camera);
        let by_px: [f64; DOF] = std::array::from_fn(|i| units[i] * if i < 3 { gradient.rotation[i] } else { gradient.translation[i - 3] });
        let (Some(first), Some(visits)) = (self.first.get_mut(index), self.visits.get_mut(index)) else { return };
        *visits = visits.saturating_add(1);
        let adam = NumberAdam::new(BETAS, [*visits, self.updates], EPSILON);
        let step: [f64; DOF] =
            std::array::from_fn(|i| -rate_px * units[i] * adam.update(&mut first[i], &mut self.second[i], by_px[i]).at_rate_1());
        if let Some(motion) = self.motions.get_mut(index) {
            let [rx, ry, rz, tx, ty, tz] = step;
            *motion = motion.then(DVec3::new(rx, ry, rz), DVec3::new(tx, ty, tz));
        }
        if let Some(focal) = self.focals.get_mut(*group) {
            let views = poses.groups.iter().filter(|other| *other == group).count();
            focal.update(camera, gradient, FOCAL_SHARE * rate_px / views.max(1) as f64);
        }
        poses.gauge.remove_common(&poses.given, &mut self.motions);
    }

    /// Returns the corrected cameras of all views.
    pub(crate) fn cameras(&self, poses: &Poses) -> Vec<Camera> {
        let views = poses.given.iter().zip(&poses.groups).zip(&self.motions);
        let corrected = |((camera, group), motion): ((&Camera, &usize), &CameraMotion)| {
            let factor = self.focals.get(*group).map_or(1.0, |focal| focal.log_factor.exp());
            let moved = motion.apply(camera);
            Camera { focal_px: moved.focal_px * factor, ..moved }
        };
        views.map(corrected).collect()
    }

    /// Returns the corrections in numbers.
    pub(crate) fn report(&self, poses: &Poses) -> PoseReport {
        let changes: Vec<PoseChange> = poses
            .given
            .iter()
            .zip(&self.motions)
            .map(|(camera, motion)| pose_change(camera, &motion.apply(camera), poses.extent))
            .collect();
        PoseReport { focal_factors: self.focals.iter().map(|focal| focal.log_factor.exp()).collect(), ..PoseReport::of_changes(&changes) }
    }
}

impl PoseReport {
    /// Returns mean and largest of some changes; zeros without any.
    pub fn of_changes(changes: &[PoseChange]) -> Self {
        let count = changes.len().max(1) as f64;
        let mean = |of: fn(&PoseChange) -> f64| changes.iter().map(of).sum::<f64>() / count;
        let largest = |of: fn(&PoseChange) -> f64| changes.iter().map(of).fold(0.0, f64::max);
        let each = |number: &dyn Fn(fn(&PoseChange) -> f64) -> f64| PoseChange {
            px: number(|change| change.px),
            degrees: number(|change| change.degrees),
            scene_units: number(|change| change.scene_units),
        };
        Self { mean: each(&mean), largest: each(&largest), focal_factors: Vec::new() }
    }
}

impl Focal {
    /// Moves the factor by the gradient of a step, so that an edge of the image moves by the rate.
    fn update(&mut self, camera: &Camera, gradient: &CameraGradient, rate_px: f64) {
        self.updates = self.updates.saturating_add(1);
        let by_log = (0..2).map(|i| camera.focal_px[i] * self.log_factor.exp() * gradient.focal_px[i]).sum::<f64>();
        let unit = 2.0 / f64::from(camera.size_px[0].max(camera.size_px[1]).max(1));
        let adam = NumberAdam::new(BETAS, [self.updates; 2], EPSILON);
        let moved = adam.update(&mut self.first, &mut self.second, unit * by_log).at_rate_1();
        self.log_factor = (self.log_factor - rate_px * unit * moved).clamp(-MAX_LOG_FOCAL, MAX_LOG_FOCAL);
    }
}

impl Poses {
    /// Returns the poses of a data set's training views, around a scene of this extent.
    pub(crate) fn of_views(dataset: &Dataset, extent: f32) -> Self {
        Self::new(dataset.train.iter().map(|view| view.camera.clone()).collect(), extent)
    }

    /// Returns the poses of cameras at full resolution, around a scene of this extent.
    pub(crate) fn new(given: Vec<Camera>, extent: f32) -> Self {
        let groups = groups_by_lens(&given);
        let extent = f64::from(extent);
        Self { gauge: Gauge::new(&given, extent), given, groups, extent }
    }

    /// Returns the rotations (radians) and translations (world units) that move the image of
    /// `camera` by a pixel.
    fn units(&self, camera: &Camera) -> [f64; DOF] {
        let angle = angle_of_pixel(camera);
        let shift = angle * self.extent;
        [angle, angle, angle, shift, shift, shift]
    }
}

/// Returns the default rate for `views` views over `steps` steps, pixels.
pub(crate) fn default_rate_px(steps: u32, views: usize) -> f64 {
    let visits = f64::from(steps) / views.max(1) as f64;
    (REACH_PX / (MEAN_RATE * visits.max(1.0))).clamp(RATES_PX[0], RATES_PX[1])
}

/// Returns the factor of the rate when the fraction `progress` of the steps is done: it falls from
/// 1 to 0 along a cosine.
pub(crate) fn decay(progress: f64) -> f64 {
    0.5 + 0.5 * (std::f64::consts::PI * progress.clamp(0.0, 1.0)).cos()
}

fn angle_of_pixel(camera: &Camera) -> f64 {
    1.0 / (0.5 * (camera.focal_px.x + camera.focal_px.y)).max(1e-9)
}

/// Returns the change from one pose of a camera to another; `depth` is how far away the points are
/// whose motion is measured, world units.
pub fn pose_change(from: &Camera, to: &Camera, depth: f64) -> PoseChange {
    let motion = CameraMotion::between(&from.camera_from_world, &to.camera_from_world);
    let world_from_camera = from.camera_from_world.inverse();
    let to = Camera { focal_px: from.focal_px, center_px: from.center_px, ..to.clone() };
    let [width, height] = from.size_px.map(f64::from);
    let places = [0.1, 0.5, 0.9].into_iter().flat_map(|y| [0.1, 0.5, 0.9].map(|x| glam::DVec2::new(x * width, y * height)));
    let squares: Vec<f64> = places
        .filter_map(|px| {
            let point = world_from_camera.transform_point3(from.unproject(px)? * depth);
            Some((to.project(point)?.0 - px).length_squared())
        })
        .collect();
    PoseChange {
        px: (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt(),
        degrees: motion.rotation.to_scaled_axis().length().to_degrees(),
        scene_units: motion.translation.length(),
    }
}

#[cfg(test)]
mod tests;

//! The cube that a field fills, and the rays through it.
//!
//! In: a data set's cameras and points. Out: a [`Space`], in whose coordinates the cube is [0,
//! 1]^3, and rays in them. Degenerate: without points the cube follows from the cameras alone.

use glam::{DVec2, DVec3};
use luxel_core::{Camera, Dataset};
use serde::{Deserialize, Serialize};

/// Part of the points, at each end of an axis, that may lie outside of the cube.
const STRAYS: f64 = 0.01;
/// Ratio of the cube to what it must hold.
const MARGIN: f64 = 1.2;
/// Side of the cube without points, in distances of the outermost camera from the centre.
const SIDE_WITHOUT_POINTS: f64 = 8.0;
/// Largest distance from a camera at which its rays begin, in sides of the cube.
const MAX_NEAR: f64 = 0.05;
/// Part of a view's distances to its points that may be shorter than twice the near distance.
const NEAREST: f64 = 0.005;

/// Shortest interval of a ray, sides of the cube: the diagonal / 1024.
pub(crate) const MIN_LENGTH: f32 = 1.732_050_8 / 1024.0;

/// The place of a field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Space {
    /// Centre of the cube, in the coordinates of the data set (local).
    pub center: [f64; 3],
    /// Side of the cube, local units.
    pub side: f64,
    /// Distance from the camera at which rays begin, sides of the cube.
    pub near: f32,
}

/// A ray in the coordinates of the cube.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Ray {
    pub(crate) origin: [f32; 3],
    /// Unit vector.
    pub(crate) direction: [f32; 3],
}

impl Space {
    /// Chooses the cube around a data set.
    pub(crate) fn around(dataset: &Dataset) -> Self {
        let eyes: Vec<DVec3> = dataset.train.iter().map(|view| view.camera.eye()).collect();
        let points: Vec<DVec3> = dataset.points.iter().map(|point| DVec3::from_array(point.position.map(f64::from))).collect();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for eye in &eyes {
            (low, high) = (low.min(*eye), high.max(*eye));
        }
        if points.is_empty() {
            let center = 0.5 * (low + high);
            let reach = eyes.iter().map(|eye| eye.distance(center)).fold(0.0, f64::max);
            let side = if reach > 0.0 { SIDE_WITHOUT_POINTS * reach } else { 1.0 };
            return Self { center: center.to_array(), side, near: 0.5 * MAX_NEAR as f32 };
        }
        for axis in 0..3 {
            let mut along: Vec<f64> = points.iter().map(|point| point[axis]).collect();
            along.sort_unstable_by(f64::total_cmp);
            let strays = ((along.len() - 1) as f64 * STRAYS) as usize;
            low[axis] = low[axis].min(along[strays]);
            high[axis] = high[axis].max(along[along.len() - 1 - strays]);
        }
        let side = (MARGIN * (high - low).max_element()).max(f64::MIN_POSITIVE);
        let mut depths: Vec<f64> = Vec::new();
        for view in &dataset.train {
            let ([width, height], eye) = (view.camera.size_px.map(f64::from), view.camera.eye());
            let is_seen = |at: DVec2| at.x >= 0.0 && at.y >= 0.0 && at.x < width && at.y < height;
            let seen = points.iter().filter(|point| view.camera.project(**point).is_some_and(|(at, _)| is_seen(at)));
            depths.extend(seen.map(|point| point.distance(eye)));
        }
        depths.sort_unstable_by(f64::total_cmp);
        let nearest = depths.get((depths.len() as f64 * NEAREST) as usize).map_or(MAX_NEAR, |depth| 0.5 * depth / side);
        Self { center: (0.5 * (low + high)).to_array(), side, near: nearest.min(MAX_NEAR) as f32 }
    }

    /// Returns the point at `position` of the cube in local coordinates.
    pub(crate) fn local(&self, position: DVec3) -> DVec3 {
        DVec3::from_array(self.center) + self.side * (position - 0.5)
    }

    /// Returns the ray of a camera through a place of its image; `None` where it shows nothing.
    pub(crate) fn ray(&self, camera: &Camera, at_px: DVec2) -> Option<Ray> {
        let toward = camera.unproject(at_px)?;
        let direction = (camera.camera_from_world.matrix3.transpose() * toward).normalize();
        let origin = (camera.eye() - DVec3::from_array(self.center)) / self.side + 0.5;
        Some(Ray { origin: origin.as_vec3().to_array(), direction: direction.as_vec3().to_array() })
    }
}

//! Pinholes to look at a scene's surfaces from.
//!
//! In: cameras of any projection, and the longest side of an image. Out: [`SurfaceView`]s, of a
//! pinhole one, of other lenses those of a cube around the camera that look where it does. Of more
//! cameras than wanted, evenly spread ones are taken. Degenerate: directions that the camera does
//! not show are known ([`SurfaceView::is_shown`]), so that nothing counts as seen that was not.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Distortion};

use crate::camera_path::resized;

/// A pinhole, and the camera whose view it is a part of.
pub(super) struct SurfaceView {
    pub(super) camera: Camera,
    /// The camera with another lens; `None` for a pinhole itself.
    lens: Option<Camera>,
}

/// Returns the pinholes to render.
pub(super) fn views(cameras: &[Camera], side_px: u32, most: usize) -> Vec<SurfaceView> {
    let chosen = cameras.len().min(most);
    (0..chosen).map(|n| &cameras[n * cameras.len() / chosen]).flat_map(|camera| pinholes(camera, side_px)).collect()
}

fn pinholes(camera: &Camera, side_px: u32) -> Vec<SurfaceView> {
    if camera.projection.is_pinhole() {
        let [width, height] = camera.size_px.map(f64::from);
        let scale = f64::from(side_px) / width.max(height);
        let size_px = [width, height].map(|side| ((side * scale).round() as u32).max(1));
        let camera = Camera { distortion: Distortion::default(), ..camera.clone() };
        return vec![SurfaceView { camera: resized(&camera, size_px).camera, lens: None }];
    }
    let face = |forward: DVec3| {
        let right = if forward.y == 0.0 { DVec3::Y.cross(forward) } else { DVec3::X };
        let face_from_camera = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let pose = DAffine3 { matrix3: face_from_camera, translation: DVec3::ZERO } * camera.camera_from_world;
        let size = f64::from(side_px);
        let pinhole = Camera {
            camera_from_world: pose,
            focal_px: DVec2::splat(0.5 * size),
            center_px: DVec2::splat(0.5 * size),
            size_px: [side_px; 2],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        };
        SurfaceView { camera: pinhole, lens: Some(camera.clone()) }
    };
    let axes = [DVec3::Z, DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::NEG_Z];
    axes.map(face).into_iter().filter(SurfaceView::shows_anything).collect()
}

/// Places along the side of an image that are looked at.
const PROBES: u32 = 17;

impl SurfaceView {
    /// Returns whether the camera shows what a place of the pinhole's image does.
    pub(super) fn is_shown(&self, at_px: DVec2) -> bool {
        let Some(lens) = &self.lens else { return true };
        let pose = self.camera.camera_from_world;
        let ray = ((at_px - self.camera.center_px) / self.camera.focal_px).extend(1.0);
        let point = self.camera.eye() + pose.matrix3.transpose() * ray;
        let [width, height] = lens.size_px.map(f64::from);
        let is_inside = |px: DVec2| (0.0..width).contains(&px.x) && (0.0..height).contains(&px.y);
        lens.project(point).is_some_and(|(px, _)| is_inside(px) && lens.shows(px))
    }

    fn shows_anything(&self) -> bool {
        let at = |n: u32| f64::from(self.camera.size_px[0]) * f64::from(n) / f64::from(PROBES - 1);
        (0..PROBES * PROBES).any(|n| self.is_shown(DVec2::new(at(n % PROBES), at(n / PROBES))))
    }
}

//! Small scenes for tests.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, ColorSpace, Dataset, Distortion, Image, View};

/// A camera at `eye` that looks along +z, with a focal length of the image's width.
pub(crate) fn camera_at(eye: [f64; 3], size_px: [u32; 2]) -> Camera {
    camera_looking_at(DVec3::from_array(eye), DVec3::from_array(eye) + DVec3::Z, size_px)
}

/// A camera at `eye` with its axis through `target`; y is down.
pub(crate) fn camera_looking_at(eye: DVec3, target: DVec3, size_px: [u32; 2]) -> Camera {
    let forward = (target - eye).normalize();
    let right = DVec3::Y.cross(forward).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Camera {
        camera_from_world: DAffine3 { matrix3: rotation, translation: -(rotation * eye) },
        focal_px: DVec2::splat(f64::from(size_px[0])),
        center_px: DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])) / 2.0,
        size_px,
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

pub(crate) fn view_of(name: &str, camera: Camera, image: Image) -> View {
    View::of_radiance(name, camera, image)
}

/// A data set with the training views `train` and without points.
pub(crate) fn dataset_of(train: Vec<View>) -> Dataset {
    Dataset {
        format: "test".to_owned(),
        train,
        test: Vec::new(),
        points: Vec::new(),
        color_space: ColorSpace::default(),
        bad_pixels: Vec::new(),
        fingerprint: "0123".to_owned(),
        warnings: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
        is_developed: false,
        readers: 2,
    }
}

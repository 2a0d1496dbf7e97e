//! COLMAP's cameras: those of its models that a camera of the library can have as they are.

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Distortion, Fisheye};
use pyo3::prelude::*;
use serde::Serialize;

use crate::errors::invalid;

/// Models with the number of their parameters.
const MODELS: [(&str, usize); 8] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
];

/// Returns the camera of COLMAP's numbers.
pub(crate) fn from_colmap(model: &str, params: &[f64], size_px: [u32; 2], qvec: [f64; 4], tvec: [f64; 3]) -> PyResult<Camera> {
    let known = MODELS.iter().find(|(name, _)| *name == model);
    let Some((_, count)) = known else {
        let names = MODELS.map(|(name, _)| name).join(", ");
        return Err(invalid(format!("model: found {model:?}, expected one of {names}; Dataset.open removes the distortion of the others")));
    };
    if params.len() != *count {
        return Err(invalid(format!("params: {} numbers, expected the {count} of {model}", params.len())));
    }
    let has_two_focals = matches!(model, "PINHOLE" | "OPENCV" | "OPENCV_FISHEYE");
    let (focal_px, rest) =
        if has_two_focals { (DVec2::new(params[0], params[1]), &params[2..]) } else { (DVec2::splat(params[0]), &params[1..]) };
    let (center_px, k) = (DVec2::new(rest[0], rest[1]), &rest[2..]);
    let at = |i: usize| k.get(i).copied().unwrap_or(0.0);
    let is_fisheye = model.ends_with("FISHEYE");
    let projection = if is_fisheye { CameraProjection::Fisheye(Fisheye::new([0, 1, 2, 3].map(at))) } else { CameraProjection::Pinhole };
    let distortion = if is_fisheye { Distortion::default() } else { Distortion { k1: at(0), k2: at(1), p1: at(2), p2: at(3) } };
    let [w, x, y, z] = qvec;
    let turn = DQuat::from_xyzw(x, y, z, w);
    if !(turn.is_finite() && turn.length() > 0.0) {
        return Err(invalid(format!("qvec: found {qvec:?}, expected a quaternion w, x, y, z that is not zero")));
    }
    let camera_from_world = DAffine3 { matrix3: DMat3::from_quat(turn.normalize()), translation: DVec3::from_array(tvec) };
    Ok(Camera { camera_from_world, focal_px, center_px, size_px, distortion, projection })
}

/// COLMAP's numbers of a camera.
#[derive(Serialize)]
pub(crate) struct ColmapCamera {
    model: &'static str,
    params: Vec<f64>,
    width: u32,
    height: u32,
    qvec: [f64; 4],
    tvec: [f64; 3],
}

/// Returns COLMAP's numbers of a camera.
pub(crate) fn to_colmap(camera: &Camera) -> PyResult<ColmapCamera> {
    let Camera { focal_px: f, center_px: c, size_px: [width, height], distortion: d, .. } = *camera;
    let mut params = vec![f.x, f.y, c.x, c.y];
    let model = match camera.projection {
        CameraProjection::Equirectangular => {
            return Err(invalid("a panorama has no model of COLMAP that other programs read; use to_nerfstudio"));
        }
        CameraProjection::Fisheye(lens) => {
            params.extend(lens.coefficients);
            "OPENCV_FISHEYE"
        }
        CameraProjection::Pinhole if d.is_none() => "PINHOLE",
        CameraProjection::Pinhole => {
            params.extend([d.k1, d.k2, d.p1, d.p2]);
            "OPENCV"
        }
    };
    let DQuat { x, y, z, w } = DQuat::from_mat3(&camera.camera_from_world.matrix3);
    Ok(ColmapCamera { model, params, width, height, qvec: [w, x, y, z], tvec: camera.camera_from_world.translation.to_array() })
}

//! Normals of splats, for images of them.
//!
//! In: the parameters, and footprints of a view. Out: each splat's normal in place of its radiance:
//! the world direction of its shortest axis, on the side that faces the camera. Degenerate: where
//! axes are equally short, the first of them counts.

use luxel_core::engine::ParameterRows;
use rayon::prelude::*;

use super::project::Footprint;
use crate::store::Store;
use crate::view::ScreenCamera;

/// Writes the normals of the splats to their footprints, `[N]` rounded up to whole blocks.
pub(crate) fn set_normals(parameters: &Store, camera: &ScreenCamera, footprints: &mut [Footprint]) {
    footprints.par_iter_mut().take(parameters.count).enumerate().for_each(|(i, footprint)| {
        footprint.radiance = normal(parameters, camera, i);
    });
}

/// Returns the normal of splat `i`.
fn normal(parameters: &Store, camera: &ScreenCamera, i: usize) -> [f32; 3] {
    let row = |row: usize, c: usize| parameters.at(row + c, i);
    let log_scale: [f32; 3] = std::array::from_fn(|c| row(ParameterRows::LOG_SCALE, c));
    let shortest = (1..3).fold(0, |shortest, c| if log_scale[c] < log_scale[shortest] { c } else { shortest });
    let [w, x, y, z] = std::array::from_fn(|c| f64::from(row(ParameterRows::ROTATION, c)));
    let turn = glam::DQuat::from_xyzw(x, y, z, w);
    // A quaternion of length 0 turns nothing in any pass.
    let turn = if turn.length_squared() > 0.0 { turn.normalize() } else { glam::DQuat::IDENTITY };
    let axis = turn * glam::DVec3::AXES[shortest];
    let towards: [f32; 3] = std::array::from_fn(|c| camera.eye[c] - row(ParameterRows::POSITION, c));
    let side = axis.dot(glam::Vec3::from(towards).as_dvec3());
    (if side < 0.0 { -axis } else { axis }).as_vec3().to_array()
}

/// Scales a sum of normals to length 1; normals that cancel out, and none at all, give 0.
pub(crate) fn unit_or_zero(sum: [f32; 3]) -> [f32; 3] {
    glam::Vec3::from(sum).normalize_or_zero().to_array()
}

//! Pass `project_backward` for cameras whose pixels are rays: see [`super::project_rays`].
//!
//! In: the gradient by the Jacobian `[2,3]` (basis of the plane in the world's axes, divided by the
//! distance), by the centre on the plane, and by the covariance. Out: the gradient by the point in
//! camera space. A basis that follows the splat without turning about it changes by -(e . dm) m
//! when its direction changes by dm: so the plane tilts with the direction and nothing else.

use fearless_simd::Simd;
use luxel_core::{Real, each};

use super::project::Projection;
use super::project_rays::Facing;
use crate::lanes::{V, dot};
use crate::view::ScreenCamera;

/// The gradients that reach a splat's point.
pub(crate) struct PlaneGradient<S: Simd> {
    /// By the Jacobian.
    pub(crate) d_jacobian: [[V<S>; 3]; 2],
    /// By the centre, in radians of the plane.
    pub(crate) d_mean: [V<S>; 2],
    /// By the dilation of the covariance.
    pub(crate) d_dilation: V<S>,
}

/// Returns the gradient by the point in camera space.
#[inline(always)]
pub(crate) fn point_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    facing: &Facing<S>,
    PlaneGradient { d_jacobian, d_mean, d_dilation }: PlaneGradient<S>,
) -> [V<S>; 3] {
    let c = |value: f32| V::splat(simd, value);
    let Facing { unit, basis, inverse_distance, .. } = facing;
    // jacobian = basis rotation / distance.
    let by_basis = each!([0, 1] i => {
        let row = d_jacobian[i];
        each!([0, 1, 2] k => dot(row, each!([0, 1, 2] j => c(camera.rotation[k][j]))))
    });
    let by_inverse_distance = dot(by_basis[0], basis[0]) + dot(by_basis[1], basis[1]);
    // By the direction within the plane, per radian.
    let tilt = each!([0, 1] i => d_mean[i] - *inverse_distance * dot(by_basis[i], *unit));
    // The size of a pixel follows the cosine to the axis, which is the direction's z.
    let by_cosine = d_dilation * facing.pixel_angle[1] * camera.filter.dilation_px2;
    each!([0, 1, 2] k => {
        let along = tilt[0].mul_add(basis[0][k], tilt[1] * basis[1][k]);
        let axis = if k == 2 { c(1.0) } else { c(0.0) };
        let across = along + by_cosine * (axis - unit[2] * unit[k]);
        *inverse_distance * (across - *inverse_distance * by_inverse_distance * unit[k])
    })
}

/// Returns the gradient by the dilation, from that by the dilated covariance without opacity
/// compensation, and the gradient by ln(opacity).
#[inline(always)]
pub(crate) fn dilation_backward<S: Simd>(camera: &ScreenCamera, p: &Projection<S>, d_trace: V<S>, d_log_alpha: V<S>) -> V<S> {
    if !camera.filter.compensates_opacity {
        return d_trace;
    }
    // compensation = sqrt(before / after), and only the area after dilation depends on it.
    let inverse = p.determinant.lift(1.0) / p.determinant;
    let ratio = p.determinant_before * inverse;
    let is_free = (ratio - luxel_core::engine::MIN_AREA_RATIO).if_positive(d_log_alpha * 0.5, d_log_alpha.lift(0.0));
    d_trace - is_free * inverse * (p.covariance[0] + p.covariance[2])
}

//! The parts of `project_backward` that do not depend on the meaning of parameters: from sums over
//! pixels to ellipses, and from ellipses to shapes.
//!
//! With M^T M the inverse covariance and S the second moments of the offsets whitened by M,
//! dE/dcovariance = M^T S M / 2. The covariance before dilation is root root^T with root = jacobian
//! axes diag(sigma).

use fearless_simd::Simd;
use luxel_core::engine::MIN_AREA_RATIO;
use luxel_core::{Real, each};

use super::project::{Projection, SQRT_HALF_LOG2_E};
use crate::lanes::{LANES, V, dot};

/// The gradient by the ellipses of 16 splats.
pub(crate) struct EllipseGradient<S: Simd> {
    /// Gradient by the centre.
    pub(crate) d_mean: [V<S>; 2],
    /// Gradient by the dilated covariance, without opacity compensation: xx, xy, yy. The
    /// off-diagonal number stands for both entries.
    pub(crate) d_covariance: [V<S>; 3],
}

/// Computes the gradient by the ellipses from the sums over pixels. `root` is
/// [`Projection::inverse_root`].
#[inline(always)]
pub(crate) fn moments_backward<S: Simd>(root: [V<S>; 3], [_, gu, gv, guu, guv, gvv, ..]: &[V<S>; LANES]) -> EllipseGradient<S> {
    // covariance^-1 = M^T M. With offsets whitened by M, the gradient by the centre is M^T times
    // the first moments, and the gradient by the covariance is half of M^T times the second moments
    // times M. The rasteriser's (u, v) are M's times a constant.
    let unit = 1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E);
    let d_mean = mean_backward(root, [*gu, *gv]);
    let moments = [*guu * unit, *guv * unit, *gvv * unit];
    let half = guu.lift(0.5);
    let by_root =
        [moments[0] * root[0], moments[0].mul_add(root[1], moments[1] * root[2]), moments[1].mul_add(root[1], moments[2] * root[2])];
    let d_xx = half * by_root[0] * root[0];
    let d_xy = root[0] * by_root[1];
    let d_yy = half * root[1].mul_add(by_root[1], root[2] * by_root[2]);
    EllipseGradient { d_mean, d_covariance: [d_xx, d_xy, d_yy] }
}

/// Returns the gradient by the centre from the sums over pixels of g u and g v.
#[inline(always)]
pub(crate) fn mean_backward<S: Simd>(root: [V<S>; 3], [gu, gv]: [V<S>; 2]) -> [V<S>; 2] {
    let (gu, gv) = (gu * (1.0 / SQRT_HALF_LOG2_E), gv * (1.0 / SQRT_HALF_LOG2_E));
    [root[0] * gu, root[1].mul_add(gu, root[2] * gv)]
}

/// Adds the gradient through the opacity compensation to that by the dilated covariance.
#[inline(always)]
pub(crate) fn compensation_backward<S: Simd>(p: &Projection<S>, d_log_alpha: V<S>, [d_xx, d_xy, d_yy]: &mut [V<S>; 3]) {
    let c = |value: f32| d_log_alpha.lift(value);
    // compensation = sqrt(before / after): d ln(compensation) = (d ln before - d ln after) / 2.
    let inverse_det = c(1.0) / p.determinant;
    let ratio = p.determinant_before * inverse_det;
    let d_ratio = (ratio - MIN_AREA_RATIO).if_positive(c(0.5) * d_log_alpha, c(0.0));
    let by_before = d_ratio / p.determinant_before.max(c(1e-30));
    let by_after = d_ratio * inverse_det;
    *d_xx = *d_xx + by_before * (p.covariance[2] - p.dilation) - by_after * p.covariance[2];
    *d_yy = *d_yy + by_before * (p.covariance[0] - p.dilation) - by_after * p.covariance[0];
    *d_xy = *d_xy - (by_before - by_after) * (p.covariance[1] + p.covariance[1]);
}

/// The gradient by what a covariance is made of.
pub(crate) struct ShapeGradient<S: Simd> {
    /// By the standard deviations.
    pub(crate) d_sigma: [V<S>; 3],
    /// By the raw quaternion.
    pub(crate) d_rotation: [V<S>; 4],
    /// By [`Projection::jacobian`].
    pub(crate) d_jacobian: [[V<S>; 3]; 2],
}

/// Differentiates the covariance.
#[inline(always)]
pub(crate) fn shape_backward<S: Simd>(p: &Projection<S>, [d_xx, d_xy, d_yy]: [V<S>; 3]) -> ShapeGradient<S> {
    // covariance = root root^T.
    let d_root = [
        each!([0, 1, 2] k => (d_xx + d_xx).mul_add(p.root[0][k], d_xy * p.root[1][k])),
        each!([0, 1, 2] k => (d_yy + d_yy).mul_add(p.root[1][k], d_xy * p.root[0][k])),
    ];
    // root = screen_axes diag(sigma).
    let d_sigma = each!([0, 1, 2] k => d_root[0][k].mul_add(p.screen_axes[0][k], d_root[1][k] * p.screen_axes[1][k]));
    let d_screen_axes = each!([0, 1] i => { let row = d_root[i]; each!([0, 1, 2] k => row[k] * p.sigma[k]) });
    // screen_axes = jacobian axes.
    let d_axes: [[V<S>; 3]; 3] = each!([0, 1, 2] j => {
        each!([0, 1, 2] k => p.jacobian[0][j].mul_add(d_screen_axes[0][k], p.jacobian[1][j] * d_screen_axes[1][k]))
    });
    let d_jacobian = each!([0, 1] i => { let row = d_screen_axes[i]; each!([0, 1, 2] j => dot(row, p.axes[j])) });
    ShapeGradient { d_sigma, d_rotation: rotation_backward(p, &d_axes), d_jacobian }
}

/// Returns the gradient by the raw quaternion.
#[inline(always)]
fn rotation_backward<S: Simd>(p: &Projection<S>, d: &[[V<S>; 3]; 3]) -> [V<S>; 4] {
    let [w, x, y, z] = p.quaternion;
    let twice = |v: V<S>| v + v;
    // Derivatives of the entries of `rotation_matrix`.
    let d_w = twice(x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
    let d_x = twice(y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[2][1] - d[1][2]) - twice(x * (d[1][1] + d[2][2])));
    let d_y = twice(x * (d[0][1] + d[1][0]) + z * (d[1][2] + d[2][1]) + w * (d[0][2] - d[2][0]) - twice(y * (d[0][0] + d[2][2])));
    let d_z = twice(x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]) + w * (d[1][0] - d[0][1]) - twice(z * (d[0][0] + d[1][1])));
    // Normalisation: only the part orthogonal to the quaternion has an effect.
    let along = w * d_w + x * d_x + y * d_y + z * d_z;
    let unit = [d_w, d_x, d_y, d_z];
    each!([0, 1, 2, 3] i => (unit[i] - along * p.quaternion[i]) * p.inverse_length)
}

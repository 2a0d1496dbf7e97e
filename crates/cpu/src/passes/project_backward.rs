//! Pass `project_backward`: computes the gradient by position, rotation, scale and opacity, and
//! calls pass `color_backward` for the rest.
//!
//! In: a block's parameters, per-entry gradients of `rasterize_backward`, bins. Out: the block's
//! gradient rows `[rows, 16]`, if one of its splats is visible (or there are regularisers),
//! densification statistics. A splat's entries are summed in the order of its tiles: the same bits
//! for any number of threads. Derivation: reverse mode through `project`; with M^T M the inverse
//! covariance and S the second moments of the offsets whitened by M, dE/dcovariance = M^T S M / 2.
//! [`super::update`] iterates over the blocks. Degenerate: gradients that overflow become zero.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4};
use luxel_core::engine::{MIN_AREA_RATIO, ParameterRows};
use luxel_core::{LossWeights, Real, each};

use super::bin::Bins;
use super::color_backward::color_backward;
use super::project::{Projection, SQRT_HALF_LOG2_E};
use super::project_backward_rays::{self, PlaneGradient, dilation_backward};
use super::project_rays::{Facing, project_to_plane};
use super::sums::{ENTRY_LEN, EntryGradient};
use crate::lanes::{LANES, Lanes, V, dot};
use crate::store::{Block, Store, StoreShape};
use crate::view::ScreenCamera;

/// The data that the pass reads.
pub(crate) struct Inputs<'a> {
    pub(crate) shape: StoreShape,
    pub(crate) smoothing: &'a [Lanes],
    pub(crate) bins: &'a Bins,
    /// Gradients of the entries of all tiles, in the order of the bins.
    pub(crate) entries: &'a [EntryGradient],
    pub(crate) loss: &'a LossWeights,
}

impl<'a> Inputs<'a> {
    /// Collects the inputs for the splats of `store`, which is not borrowed and can be updated.
    pub(crate) fn new(store: &Store, smoothing: &'a [Lanes], bins: &'a Bins, entries: &'a [EntryGradient], loss: &'a LossWeights) -> Self {
        Self { shape: store.shape(), smoothing, bins, entries, loss }
    }

    /// Reports whether every splat has a gradient, visible or not.
    pub(crate) fn is_regularised(&self) -> bool {
        self.loss.opacity_weight != 0.0 || self.loss.scale_weight != 0.0
    }
}

/// The statistics of a block's splats, to which a step is added.
pub(crate) struct BlockStats<'a> {
    pub(crate) norm: &'a mut [f32],
    pub(crate) absolute: &'a mut [f32],
    pub(crate) views: &'a mut [u32],
}

/// Differentiates a block of parameters, given the sums of its splats. Returns false, with
/// `gradient` unchanged, if the block has no gradient.
#[inline(always)]
pub(crate) fn project_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    block: Block<'_>,
    sums: &BlockSums,
    gradient: &mut [Lanes],
    stats: Option<BlockStats<'_>>,
) -> bool {
    let written = sums.is_visible() || inputs.is_regularised();
    if written {
        // Otherwise every row is written.
        if camera.active_degree < inputs.shape.layout.color_model.max_degree() {
            gradient.fill(Lanes::ZERO);
        }
        let BlockBackward { norms: statistics, .. } = block_backward(simd, camera, inputs, block, &sums.by_field(simd), gradient);
        if let Some(stats) = stats {
            for lane in (0..stats.views.len()).filter(|lane| sums.visible[*lane]) {
                stats.norm[lane] += statistics[0][lane];
                stats.absolute[lane] += statistics[1][lane];
                stats.views[lane] += 1;
            }
        }
    }
    written
}

/// The parts of a block's gradient that a motion of the camera needs besides its rows.
pub(crate) struct CameraParts<S: Simd> {
    /// Gradient by the position through the projection alone, world axes.
    pub(crate) by_projection: [V<S>; 3],
    /// Gradient by the focal lengths.
    pub(crate) by_focal_px: [V<S>; 2],
}

/// Differentiates a block as [`project_backward`] does, without statistics, and returns the parts
/// for a motion of the camera; `None`, with `gradient` unchanged, if no splat is visible.
#[inline(always)]
pub(crate) fn camera_parts<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    block: Block<'_>,
    sums: &BlockSums,
    gradient: &mut [Lanes],
) -> Option<CameraParts<S>> {
    if !sums.is_visible() {
        return None;
    }
    Some(block_backward(simd, camera, inputs, block, &sums.by_field(simd), gradient).camera)
}

/// The result of differentiating a block, besides the rows of its gradient.
struct BlockBackward<S: Simd> {
    /// For each splat the norms of two gradients by the centre: of the summed gradient, and of the
    /// sums of absolute values.
    norms: [[f32; LANES]; 2],
    camera: CameraParts<S>,
}

/// The sums of a block's splats over their tiles: for each splat the fields of an
/// [`EntryGradient`], then zeros.
pub(crate) struct BlockSums {
    rows: [Lanes; LANES],
    /// Which splats have any entry.
    visible: [bool; LANES],
}

impl BlockSums {
    pub(crate) const ZERO: Self = Self { rows: [Lanes::ZERO; LANES], visible: [false; LANES] };

    /// Returns whether any splat has an entry.
    fn is_visible(&self) -> bool {
        self.visible.contains(&true)
    }

    /// Returns the sums by field, a splat in each lane.
    #[inline(always)]
    fn by_field<S: Simd>(&self, simd: S) -> [V<S>; LANES] {
        V::transpose(
            each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] lane => { let row = &self.rows[lane]; V::load(simd, row) }),
        )
    }

    /// Gathers the sums of block number `block`.
    #[inline(always)]
    pub(crate) fn gather<S: Simd>(&mut self, simd: S, inputs: &Inputs<'_>, block: usize) {
        let alive = LANES.min(inputs.shape.count - block * LANES);
        let splats = self.rows.iter_mut().zip(&mut self.visible).zip(inputs.bins.entries(block * LANES, alive));
        for ((row, visible), entries) in splats {
            *visible = !entries.is_empty();
            let mut sum = [f32x4::splat(simd, 0.0); ENTRY_LEN / 4];
            for entry in entries {
                let entry: &[[f32; 4]; ENTRY_LEN / 4] = bytemuck::cast_ref(&inputs.entries[*entry as usize]);
                for (sum, part) in sum.iter_mut().zip(entry) {
                    *sum += f32x4::load_array_ref(simd, part);
                }
            }
            for (sum, part) in sum.iter().zip(row.0.as_chunks_mut().0) {
                sum.store_array(part);
            }
        }
    }
}

/// The gradient by the ellipses of 16 splats.
struct EllipseGradient<S: Simd> {
    /// Gradient by the centre.
    d_mean: [V<S>; 2],
    /// Gradient by the dilated covariance: xx, xy, yy. The off-diagonal number stands for both
    /// entries.
    d_covariance: [V<S>; 3],
    /// Gradient by the trace of the dilated covariance, without opacity compensation.
    d_trace: V<S>,
}

/// Computes the gradient by the ellipses from the sums over pixels. `root` is
/// [`Projection::inverse_root`].
#[inline(always)]
fn ellipse_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    p: &Projection<S>,
    root: [V<S>; 3],
    [d_log_alpha, gu, gv, guu, guv, gvv, ..]: &[V<S>; LANES],
) -> EllipseGradient<S> {
    let c = |value: f32| V::splat(simd, value);
    // covariance^-1 = M^T M. With offsets whitened by M, the gradient by the centre is M^T times
    // the first moments, and the gradient by the covariance is half of M^T times the second moments
    // times M. The rasteriser's (u, v) are M's times a constant.
    let unit = 1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E);
    let (gu, gv) = (*gu * (1.0 / SQRT_HALF_LOG2_E), *gv * (1.0 / SQRT_HALF_LOG2_E));
    let d_mean = [root[0] * gu, root[1].mul_add(gu, root[2] * gv)];
    let moments = [*guu * unit, *guv * unit, *gvv * unit];
    let half = c(0.5);
    let by_root =
        [moments[0] * root[0], moments[0].mul_add(root[1], moments[1] * root[2]), moments[1].mul_add(root[1], moments[2] * root[2])];
    let mut d_xx = half * by_root[0] * root[0];
    let mut d_xy = root[0] * by_root[1];
    let mut d_yy = half * root[1].mul_add(by_root[1], root[2] * by_root[2]);
    let inverse_det = c(1.0) / p.determinant;
    let d_trace = d_xx + d_yy;

    if camera.antialias.compensates_opacity() {
        // compensation = sqrt(before / after): d ln(compensation) = (d ln before - d ln after) / 2.
        let ratio = p.determinant_before * inverse_det;
        let d_ratio = (ratio - MIN_AREA_RATIO).if_positive(half * *d_log_alpha, c(0.0));
        let by_before = d_ratio / p.determinant_before.max(c(1e-30));
        let by_after = d_ratio * inverse_det;
        d_xx = d_xx + by_before * (p.covariance[2] - p.dilation) - by_after * p.covariance[2];
        d_yy = d_yy + by_before * (p.covariance[0] - p.dilation) - by_after * p.covariance[0];
        d_xy = d_xy - (by_before - by_after) * (p.covariance[1] + p.covariance[1]);
    }
    EllipseGradient { d_mean, d_covariance: [d_xx, d_xy, d_yy], d_trace }
}

/// Projects a block as the forward pass did; with the plane of each splat if pixels are rays.
#[inline(always)]
fn project_again<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    Block { index, rows }: Block<'_>,
) -> (Projection<S>, Option<Facing<S>>) {
    let smoothing = inputs.smoothing.get(index);
    match &camera.rays {
        None => (Projection::new(simd, camera, rows, smoothing), None),
        Some(rays) => {
            let (p, facing) = project_to_plane(simd, camera, rays, rows, smoothing);
            (p, Some(facing))
        }
    }
}

/// Computes the gradient of a block.
#[inline(always)]
fn block_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    inputs: &Inputs<'_>,
    Block { index, rows }: Block<'_>,
    sums: &[V<S>; LANES],
    out: &mut [Lanes],
) -> BlockBackward<S> {
    let c = |value: f32| V::splat(simd, value);
    let [d_log_alpha, _, _, _, _, _, dr, dg, db, abs_u, abs_y, ..] = *sums;
    let (p, facing) = project_again(simd, camera, inputs, Block { index, rows });
    let mut d_position = color_backward(simd, camera, inputs.shape.layout, rows, [dr, dg, db], out);

    let root = p.inverse_root();
    let EllipseGradient { d_mean, d_covariance: [d_xx, d_xy, d_yy], d_trace } = ellipse_backward(simd, camera, &p, root, sums);

    // covariance = root root^T.
    let d_root = [
        each!([0, 1, 2] k => (d_xx + d_xx).mul_add(p.root[0][k], d_xy * p.root[1][k])),
        each!([0, 1, 2] k => (d_yy + d_yy).mul_add(p.root[1][k], d_xy * p.root[0][k])),
    ];
    // root = screen_axes diag(sigma).
    for k in 0..3 {
        let d_sigma = d_root[0][k].mul_add(p.screen_axes[0][k], d_root[1][k] * p.screen_axes[1][k]);
        // Without a filter sigma = raw, and this is d_sigma sigma; with it sigma^2 = raw^2 + f^2,
        // and the opacity's factor prod raw / sigma. Squares of the tiniest deviations vanish in
        // f32, their ratio does not.
        let ratio = p.raw_sigma[k] / p.sigma[k];
        let share = ratio * ratio;
        let mut d_log_scale = finite((d_sigma * p.sigma[k]).mul_add(share, d_log_alpha * (c(1.0) - share)));
        d_log_scale = p.raw_sigma[k].mul_add(c(inputs.loss.scale_weight / (3 * inputs.shape.count) as f32), d_log_scale);
        d_log_scale.store(&mut out[ParameterRows::LOG_SCALE + k]);
    }
    let d_opacity_logit = (c(1.0) - p.opacity) * p.opacity.mul_add(c(inputs.loss.opacity_weight / inputs.shape.count as f32), d_log_alpha);
    d_opacity_logit.store(&mut out[ParameterRows::OPACITY]);
    let d_screen_axes = each!([0, 1] i => { let row = d_root[i]; each!([0, 1, 2] k => row[k] * p.sigma[k]) });
    // screen_axes = jacobian axes.
    let d_axes: [[V<S>; 3]; 3] = each!([0, 1, 2] j => {
        each!([0, 1, 2] k => p.jacobian[0][j].mul_add(d_screen_axes[0][k], p.jacobian[1][j] * d_screen_axes[1][k]))
    });
    for (i, d) in rotation_backward(&p, &d_axes).into_iter().enumerate() {
        finite(d).store(&mut out[ParameterRows::ROTATION + i]);
    }
    let d_jacobian = each!([0, 1] i => { let row = d_screen_axes[i]; each!([0, 1, 2] j => dot(row, p.axes[j])) });
    let PointGradient { d_point, d_focal_px } = match &facing {
        None => point_backward(simd, camera, &p, d_jacobian, d_mean),
        Some(facing) => {
            let d_dilation = dilation_backward(camera, &p, d_trace, d_log_alpha);
            let d_point = project_backward_rays::point_backward(simd, camera, facing, PlaneGradient { d_jacobian, d_mean, d_dilation });
            PointGradient { d_point, d_focal_px: [c(0.0); 2] }
        }
    };
    let by_projection = each!([0, 1, 2] i => {
        let column = each!([0, 1, 2] row => c(camera.rotation[row][i]));
        dot(column, d_point)
    });
    for (i, d) in d_position.iter_mut().enumerate() {
        *d = *d + by_projection[i];
        finite(*d).store(&mut out[ParameterRows::POSITION + i]);
    }

    // NDC spans 2 over the image's side. Absolute sums carry the rasteriser's constant twice: in u
    // and v, and in its root.
    let ndc = match &facing {
        None => each!([0, 1] i => c(0.5 * camera.size_px[i] as f32)),
        Some(facing) => [facing.ndc_radian(camera.size_px); 2],
    };
    let by_center = [d_mean, [root[0] * abs_u * (1.0 / SQRT_HALF_LOG2_E), abs_y * (1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E))]];
    let norms = each!([0, 1] i => {
        let (x, y) = (by_center[i][0] * ndc[0], by_center[i][1] * ndc[1]);
        (x * x + y * y).sqrt().lanes()
    });
    BlockBackward {
        norms,
        camera: CameraParts {
            by_projection: each!([0, 1, 2] i => { let d = by_projection[i]; finite(d) }),
            by_focal_px: each!([0, 1] i => { let d = d_focal_px[i]; finite(d) }),
        },
    }
}

/// Replaces numbers that are not finite by zero: a splat that is culled for overflow has zero
/// incoming gradients, but zero times infinity is NaN.
#[inline(always)]
fn finite<S: Simd>(v: V<S>) -> V<S> {
    V::select(v.abs().lt(v.lift(f32::INFINITY)), v, v.lift(0.0))
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

/// The gradients that pass through the centre and the Jacobian.
struct PointGradient<S: Simd> {
    /// By the point in camera space.
    d_point: [V<S>; 3],
    /// By the focal lengths of a pinhole; zero for other projections.
    d_focal_px: [V<S>; 2],
}

/// Differentiates the projection of a pinhole.
#[inline(always)]
fn point_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    p: &Projection<S>,
    d_jacobian: [[V<S>; 3]; 2],
    d_mean: [V<S>; 2],
) -> PointGradient<S> {
    let c = |value: f32| V::splat(simd, value);
    let inverse_z = c(1.0) / p.point[2];
    let (mut d_point, mut d_focal_px) = ([c(0.0); 3], [c(0.0); 2]);
    for i in 0..2 {
        let scale = inverse_z * camera.focal_px[i];
        // jacobian[i] = scale (rotation[i] - slope rotation[2]); mean = scale point + centre.
        let by_direct = dot(d_jacobian[i], each!([0, 1, 2] j => c(camera.rotation[i][j])));
        let by_depth = dot(d_jacobian[i], each!([0, 1, 2] i => c(camera.rotation[2][i])));
        let d_slope = -(scale * by_depth);
        let true_slope = p.point[i] * inverse_z;
        // Where the slope is clamped it is constant.
        let free = (true_slope - p.slope[i]).abs();
        let d_slope = free.if_positive(c(0.0), d_slope);
        d_point[i] = d_mean[i].mul_add(scale, d_slope * inverse_z);
        let by_scale = by_direct - p.slope[i] * by_depth + d_mean[i] * p.point[i];
        d_point[2] = d_point[2] - inverse_z * (by_scale * scale + d_slope * true_slope);
        // The limits of the slope are a length on the image over the focal length: scale times a
        // clamped slope does not depend on it.
        d_focal_px[i] = inverse_z * (by_scale + free.if_positive(p.slope[i] * by_depth, c(0.0)));
    }
    PointGradient { d_point, d_focal_px }
}

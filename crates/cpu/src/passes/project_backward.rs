//! Pass `project_backward`: computes the gradient by position, rotation, scale and opacity, and
//! calls pass `color_backward` for the rest.
//!
//! In: a block's parameters, gradients by the screen of `rasterize_backward`, bins. Out: the
//! block's gradient rows `[rows, 16]`, if one of its splats is visible (or there are regularisers),
//! densification statistics. A splat's entries are summed in the order of its tiles: the same bits
//! for any number of threads. Derivation: reverse mode through `project`; with M^T M the inverse
//! covariance and S the second moments of the offsets whitened by M, dE/dcovariance = M^T S M / 2.
//! [`super::update`] iterates over the blocks. Degenerate: gradients that overflow become zero.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4};
use luxel_core::engine::{MeasuredChannels, ParameterRows};
use luxel_core::{LossWeights, Real, each};

use super::bin::Bins;
use super::color_backward::color_backward;
use super::ellipse_backward::{EllipseGradient, ShapeGradient, compensation_backward, mean_backward, moments_backward, shape_backward};
use super::encoding::Logarithmic;
use super::project::{Projection, SQRT_HALF_LOG2_E};
use super::project_backward_rays::{self, PlaneGradient, dilation_backward};
use super::project_rays::{Facing, project_to_plane};
use super::screen_gradients::ByScreen;
use super::sums::{ENTRY_LEN, EntryGradient};
use crate::lanes::{LANES, Lanes, V, dot, fill_rows, outlined};
use crate::store::{Block, Store, StoreShape};
use crate::view::ScreenCamera;

/// The data that the pass reads.
pub(crate) struct Inputs<'a> {
    pub(crate) shape: StoreShape,
    pub(crate) smoothing: &'a [Lanes],
    pub(crate) bins: &'a Bins,
    /// Gradients by the screen.
    pub(crate) by_screen: ByScreen<'a>,
    pub(crate) loss: &'a LossWeights,
    /// Gradients by the splats' radiance, `[N]`, where channels were blended in its place.
    pub(crate) by_radiance: Option<&'a [[f32; 3]]>,
    /// Channels that statistics are of.
    pub(crate) measured: MeasuredChannels,
}

impl<'a> Inputs<'a> {
    /// Collects the inputs for the splats of `store`, which is not borrowed and can be updated.
    pub(crate) fn new(store: &Store, smoothing: &'a [Lanes], bins: &'a Bins, by_screen: ByScreen<'a>, loss: &'a LossWeights) -> Self {
        Self { shape: store.shape(), smoothing, bins, by_screen, loss, by_radiance: None, measured: MeasuredChannels::All }
    }

    /// Takes the gradient by radiance from `by_radiance`, `[N]`, in place of the entries.
    pub(crate) fn with_radiance(self, by_radiance: &'a [[f32; 3]], measured: MeasuredChannels) -> Self {
        Self { by_radiance: Some(by_radiance), measured, ..self }
    }

    /// Returns the gradients by radiance of a block's splats, if they are not those of the entries.
    #[inline(always)]
    fn radiance_rows(&self, block: usize) -> Option<[Lanes; 3]> {
        let by_radiance = self.by_radiance?;
        let mut rows = [Lanes::ZERO; 3];
        fill_rows(&mut rows, &by_radiance[block * LANES..by_radiance.len().min((block + 1) * LANES)]);
        Some(rows)
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
    pub(crate) visible: [bool; LANES],
}

impl BlockSums {
    pub(crate) const ZERO: Self = Self { rows: [Lanes::ZERO; LANES], visible: [false; LANES] };

    /// Returns whether any splat has an entry.
    pub(crate) fn is_visible(&self) -> bool {
        self.visible.contains(&true)
    }

    /// Returns the sums by field, a splat in each lane.
    #[inline(always)]
    pub(crate) fn by_field<S: Simd>(&self, simd: S) -> [V<S>; LANES] {
        V::transpose(
            each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] lane => { let row = &self.rows[lane]; V::load(simd, row) }),
        )
    }

    /// Gathers the sums of block number `block`.
    #[inline(always)]
    pub(crate) fn gather<S: Simd>(&mut self, simd: S, inputs: &Inputs<'_>, block: usize) {
        let range = block * LANES..inputs.shape.count.min((block + 1) * LANES);
        match inputs.by_screen {
            ByScreen::Entries(entries) => self.gather_entries(simd, inputs.bins, entries, range),
            ByScreen::Splats(sums) => self.take(inputs.bins, sums, range),
        }
    }

    /// Takes the sums of the splats of a range, all within one block.
    fn take(&mut self, bins: &Bins, sums: &[EntryGradient], range: Range<usize>) {
        let lists = bins.entries(range.start, range.len());
        for (((row, visible), entries), sum) in self.rows.iter_mut().zip(&mut self.visible).zip(lists).zip(&sums[range]) {
            *visible = !entries.is_empty();
            row.0[..ENTRY_LEN].copy_from_slice(bytemuck::cast_ref::<_, [f32; ENTRY_LEN]>(sum));
        }
    }

    /// Gathers the sums of the splats of a range, all within one block.
    #[inline(always)]
    pub(crate) fn gather_entries<S: Simd>(&mut self, simd: S, bins: &Bins, gradients: &[EntryGradient], range: Range<usize>) {
        let splats = self.rows.iter_mut().zip(&mut self.visible).zip(bins.entries(range.start, range.len()));
        for ((row, visible), entries) in splats {
            *visible = !entries.is_empty();
            let mut sum = [f32x4::splat(simd, 0.0); ENTRY_LEN / 4];
            for entry in entries {
                let entry: &[[f32; 4]; ENTRY_LEN / 4] = bytemuck::cast_ref(&gradients[*entry as usize]);
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
        None => (Projection::new::<Logarithmic>(simd, camera, rows, smoothing), None),
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
    outlined!(simd => {
        let c = |value: f32| V::splat(simd, value);
        let [d_log_alpha, _, _, _, _, _, dr, dg, db, abs_u, abs_y, ..] = *sums;
        let (p, facing) = project_again(simd, camera, inputs, Block { index, rows });
        let d_radiance = match inputs.radiance_rows(index) {
            None => [dr, dg, db],
            Some(rows) => each!([0, 1, 2] c => { let row = &rows[c]; V::load(simd, row) }),
        };
        let mut d_position = color_backward(simd, camera, inputs.shape.layout, rows, d_radiance, out);

        let root = p.inverse_root();
        let EllipseGradient { d_mean, mut d_covariance } = moments_backward(root, sums);
        let d_trace = d_covariance[0] + d_covariance[2];
        if camera.filter.compensates_opacity {
            compensation_backward(&p, d_log_alpha, &mut d_covariance);
        }
        let ShapeGradient { d_sigma, d_rotation, d_jacobian } = shape_backward(&p, d_covariance);
        store_log_scales(simd, inputs, &p, d_sigma, d_log_alpha, out);
        let d_opacity_logit = (c(1.0) - p.opacity) * p.opacity.mul_add(c(inputs.loss.opacity_weight / inputs.shape.count as f32), d_log_alpha);
        d_opacity_logit.store(&mut out[ParameterRows::OPACITY]);
        for (i, d) in d_rotation.into_iter().enumerate() {
            finite(d).store(&mut out[ParameterRows::ROTATION + i]);
        }
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

        // NDC spans 2 over the image's side. Absolute sums carry the rasteriser's constant twice:
        // in u and v, and in its root.
        let ndc = match &facing {
            None => each!([0, 1] i => c(0.5 * camera.size_px[i] as f32)),
            Some(facing) => [facing.ndc_radian(camera.size_px); 2],
        };
        let by_center = match inputs.measured {
            MeasuredChannels::All => {
                [d_mean, [root[0] * abs_u * (1.0 / SQRT_HALF_LOG2_E), abs_y * (1.0 / (SQRT_HALF_LOG2_E * SQRT_HALF_LOG2_E))]]
            }
            MeasuredChannels::FirstThree => [mean_backward(root, [abs_u, abs_y]), [c(0.0); 2]],
        };
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
    })
}

/// Stores the gradient by the logarithms of the standard deviations.
#[inline(always)]
fn store_log_scales<S: Simd>(simd: S, inputs: &Inputs<'_>, p: &Projection<S>, d_sigma: [V<S>; 3], d_log_alpha: V<S>, out: &mut [Lanes]) {
    let c = |value: f32| V::splat(simd, value);
    for (k, d_sigma) in d_sigma.into_iter().enumerate() {
        // Without a filter sigma = raw, and this is d_sigma sigma; with it sigma^2 = raw^2 + f^2,
        // and the opacity's factor prod raw / sigma. Squares of the tiniest deviations vanish in
        // f32, their ratio does not.
        let ratio = p.raw_sigma[k] / p.sigma[k];
        let share = ratio * ratio;
        let mut d_log_scale = finite((d_sigma * p.sigma[k]).mul_add(share, d_log_alpha * (c(1.0) - share)));
        d_log_scale = p.raw_sigma[k].mul_add(c(inputs.loss.scale_weight / (3 * inputs.shape.count) as f32), d_log_scale);
        d_log_scale.store(&mut out[ParameterRows::LOG_SCALE + k]);
    }
}

/// Replaces numbers that are not finite by zero: a splat that is culled for overflow has zero
/// incoming gradients, but zero times infinity is NaN.
#[inline(always)]
pub(crate) fn finite<S: Simd>(v: V<S>) -> V<S> {
    V::select(v.abs().lt(v.lift(f32::INFINITY)), v, v.lift(0.0))
}

/// The gradients that pass through the centre and the Jacobian.
pub(crate) struct PointGradient<S: Simd> {
    /// By the point in camera space.
    pub(crate) d_point: [V<S>; 3],
    /// By the focal lengths of a pinhole; zero for other projections.
    d_focal_px: [V<S>; 2],
}

/// Differentiates the projection of a pinhole.
#[inline(always)]
pub(crate) fn point_backward<S: Simd>(
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

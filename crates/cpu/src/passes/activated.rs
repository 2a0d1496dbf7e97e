//! Passes `project` and `project_backward` for splats with activated parameters, and cameras that
//! are matrices.
//!
//! In: [`ActivatedStore`], camera. Out: one [`Footprint`] per splat and its numbers on the screen;
//! backward, gradients by the parameters and by the twelve numbers of the camera's map. The
//! projection and its gradient are those of training; only scales and opacities are read as they
//! are. Degenerate: splats that are culled are zero on the screen, and have zero gradients.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::engine::{ActivatedSplats, BlendOptions, CameraMatrices, ParameterRows, ScreenEllipses, ShapeParameters};
use luxel_core::{Real, each};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::color::BlockColor;
use super::ellipse_backward::{ShapeGradient, compensation_backward, shape_backward};
use super::encoding::Linear;
use super::project::{Centered, Footprint, Projection, store_footprints};
use super::project_backward::{finite, point_backward};
use crate::lanes::{LANES, Lanes, V, dot, fill_rows, with_simd};
use crate::view::ScreenCamera;

/// Rows of a splat: position 3, rotation 4, scale 3, opacity 1.
pub(crate) const ROWS: usize = ParameterRows::SH;

/// Largest number of standard deviations of a radius, as in gsplat.
const MOST_DEVIATIONS: f32 = 3.33;

/// Splats in blocks: `[blocks, 11, 16]`.
pub(crate) struct ActivatedStore {
    pub(crate) count: usize,
    pub(crate) blocks: Vec<[Lanes; ROWS]>,
}

impl ActivatedStore {
    /// Copies splats into blocks.
    pub(crate) fn new(level: Level, splats: &ActivatedSplats<'_>) -> Self {
        let count = splats.len();
        let block = |block: usize| {
            let mut rows = [Lanes::ZERO; ROWS];
            let splat = block * LANES..count.min((block + 1) * LANES);
            with_simd!(level, _simd => {
                fill_rows(&mut rows[ParameterRows::POSITION..], &splats.position[splat.clone()]);
                fill_rows(&mut rows[ParameterRows::ROTATION..], &splats.rotation[splat.clone()]);
                fill_rows(&mut rows[ParameterRows::LOG_SCALE..], &splats.scale[splat.clone()]);
            });
            rows[ParameterRows::OPACITY].0[..splat.len()].copy_from_slice(&splats.opacity[splat]);
            rows
        };
        Self { count, blocks: (0..count.div_ceil(LANES)).into_par_iter().with_min_len(64).map(block).collect() }
    }
}

/// A block's part of [`ScreenEllipses`].
pub(crate) struct EllipseRows<'a> {
    mean_px: &'a mut [[f32; 2]],
    covariance_px2: &'a mut [[f32; 3]],
    conic: &'a mut [[f32; 3]],
    depth: &'a mut [f32],
    opacity: &'a mut [f32],
    radius_px: &'a mut [[i32; 2]],
}

impl EllipseRows<'_> {
    /// Writes the zeros of a splat that is culled.
    fn clear_splat(&mut self, lane: usize) {
        self.mean_px[lane] = [0.0; 2];
        self.covariance_px2[lane] = [0.0; 3];
        self.conic[lane] = [0.0; 3];
        self.depth[lane] = 0.0;
        self.opacity[lane] = 0.0;
        self.radius_px[lane] = [0; 2];
    }

    /// Writes the zeros of a block that is culled.
    fn clear(&mut self) {
        (0..self.depth.len()).for_each(|lane| self.clear_splat(lane));
    }

    /// Divides a camera's part of the ellipses into blocks.
    pub(crate) fn blocks(
        ellipses: &mut ScreenEllipses,
        range: std::ops::Range<usize>,
    ) -> impl IndexedParallelIterator<Item = EllipseRows<'_>> {
        let ScreenEllipses { mean_px, covariance_px2, conic, depth, opacity, radius_px } = ellipses;
        (
            mean_px[range.clone()].par_chunks_mut(LANES),
            covariance_px2[range.clone()].par_chunks_mut(LANES),
            conic[range.clone()].par_chunks_mut(LANES),
            depth[range.clone()].par_chunks_mut(LANES),
            opacity[range.clone()].par_chunks_mut(LANES),
            radius_px[range].par_chunks_mut(LANES),
        )
            .into_par_iter()
            .map(|(mean_px, covariance_px2, conic, depth, opacity, radius_px)| EllipseRows {
                mean_px,
                covariance_px2,
                conic,
                depth,
                opacity,
                radius_px,
            })
    }
}

/// Projects a block. Writes the numbers of its splats to `out`, zeros for those that are culled,
/// and returns a bit for each of the others.
#[inline(always)]
pub(crate) fn project_activated<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    options: &BlendOptions,
    rows: &[Lanes; ROWS],
    mut out: EllipseRows<'_>,
    footprints: &mut [Footprint],
) -> u16 {
    let c = |value: f32| V::splat(simd, value);
    let p = Projection::new::<Linear>(simd, camera, rows, None);
    let mut centered = Centered::new(simd, camera, rows, &p, out.depth.len());
    let Centered { mean, depth, opacity, .. } = centered;
    // gsplat's radii, which densification counts: whole pixels around the alpha threshold.
    let threshold = c(camera.cutoffs.min_alpha);
    let deviations = ((opacity / threshold).max(c(1.0)).ln() * 2.0).sqrt().min(c(MOST_DEVIATIONS));
    let radius = each!([0, 2] i => -((-(deviations * p.covariance[i].sqrt())).floor()));
    let exists = V::lane_numbers(simd).lt(c(out.depth.len() as f32));
    let is_large = radius[0].gt(c(options.min_radius_px)) | radius[1].gt(c(options.min_radius_px));
    let mut visible = exists & depth.ge(c(camera.cutoffs.near)) & c(options.far).ge(depth) & opacity.ge(threshold) & is_large;
    for i in 0..2 {
        visible = visible & (mean[i] + radius[i]).gt(c(0.0)) & (mean[i] - radius[i]).lt(c(camera.size_px[i] as f32));
    }
    let root = p.inverse_root();
    // Comparisons with NaN are false.
    visible = visible
        & root[0].abs().lt(c(f32::MAX))
        & root[1].abs().lt(c(f32::MAX))
        & root[2].lt(c(f32::MAX))
        & (radius[0] + radius[1]).lt(c(1e9));
    let bits = visible.to_bitmask() as u16;
    if bits == 0 {
        footprints.fill(Footprint::default());
        out.clear();
        return 0;
    }
    centered.mask &= visible;
    store_footprints(simd, camera, &p, &centered, BlockColor { brightest: c(0.0), radiance: [c(0.0); 3] }, footprints);
    let conic = [root[0] * root[0], root[0] * root[1], root[1].mul_add(root[1], root[2] * root[2])];
    let (mean, radius) = (each!([0, 1] i => mean[i].lanes()), each!([0, 1] i => radius[i].lanes()));
    let (covariance, conic) = (each!([0, 1, 2] i => p.covariance[i].lanes()), each!([0, 1, 2] i => conic[i].lanes()));
    let (depth, opacity) = (depth.lanes(), opacity.lanes());
    for lane in 0..out.depth.len() {
        if bits >> lane & 1 == 0 {
            out.clear_splat(lane);
            continue;
        }
        out.mean_px[lane] = each!([0, 1] i => mean[i][lane]);
        out.covariance_px2[lane] = each!([0, 1, 2] i => covariance[i][lane]);
        out.conic[lane] = each!([0, 1, 2] i => conic[i][lane]);
        out.depth[lane] = depth[lane];
        out.opacity[lane] = opacity[lane];
        out.radius_px[lane] = each!([0, 1] i => radius[i][lane] as i32);
    }
    bits
}

/// The gradient by a block's ellipses of one camera: mean 2, covariance 3, conic 3, depth 1,
/// opacity 1.
#[derive(Clone, Copy)]
pub(crate) struct EllipseLanes {
    pub(crate) mean: [Lanes; 2],
    pub(crate) covariance: [Lanes; 3],
    /// If there is one.
    pub(crate) conic: Option<[Lanes; 3]>,
    pub(crate) depth: Lanes,
    pub(crate) opacity: Lanes,
}

/// The parts of a gradient that are computed only where they are wanted.
#[derive(Clone, Copy)]
pub(crate) struct WantedParts {
    pub(crate) shape: ShapeParameters,
    pub(crate) cameras: CameraMatrices,
}

/// The gradient by a block's splats.
pub(crate) struct SplatLanes<S: Simd> {
    /// In the order of the rows.
    pub(crate) rows: [V<S>; ROWS],
    /// By the covariance in the world, if it is wanted: xx, xy, xz, yy, yz, zz.
    pub(crate) covariance: Option<[V<S>; 6]>,
    /// By each number of the camera's map, row by row, if it is wanted.
    pub(crate) camera: Option<[V<S>; 12]>,
}

/// Differentiates a block for a camera, in which the splats of `visible` are not culled.
#[inline(always)]
pub(crate) fn project_activated_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    rows: &[Lanes; ROWS],
    visible: u16,
    gradient: &EllipseLanes,
    wanted: WantedParts,
) -> SplatLanes<S> {
    let c = |value: f32| V::splat(simd, value);
    let zero = c(0.0);
    let load = |lanes: &Lanes| V::load(simd, lanes);
    let mask = crate::lanes::M::from_bitmask(simd, visible.into());
    let p = Projection::new::<Linear>(simd, camera, rows, None);
    let d_mean = each!([0, 1] i => load(&gradient.mean[i]));
    let mut d_covariance = each!([0, 1, 2] i => load(&gradient.covariance[i]));
    if let Some(d_conic) = &gradient.conic {
        let by_conic = conic_backward(&p, each!([0, 1, 2] i => load(&d_conic[i])));
        d_covariance = each!([0, 1, 2] i => d_covariance[i] + by_conic[i]);
    }
    let d_opacity = load(&gradient.opacity);
    if camera.filter.compensates_opacity {
        compensation_backward(&p, d_opacity * p.opacity * p.compensation, &mut d_covariance);
    }
    let ShapeGradient { d_sigma, d_rotation, d_jacobian } = shape_backward(&p, d_covariance);
    // Closures would not be inlined.
    let covariance = match wanted.shape {
        ShapeParameters::Covariance => {
            let by_world = world_covariance_backward(&p, d_covariance);
            Some(each!([0, 1, 2, 3, 4, 5] i => { let v = by_world[i]; V::select(mask, finite(v), zero) }))
        }
        _ => None,
    };
    let mut d_point = point_backward(simd, camera, &p, d_jacobian, d_mean).d_point;
    d_point[2] = d_point[2] + load(&gradient.depth);
    let d_position = each!([0, 1, 2] i => {
        let column = each!([0, 1, 2] row => c(camera.rotation[row][i]));
        dot(column, d_point)
    });
    let camera = match wanted.cameras {
        CameraMatrices::Differentiate => {
            let by_map = camera_backward(simd, camera, rows, &p, d_point, d_jacobian);
            Some(each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11] i => { let v = by_map[i / 4][i % 4]; V::select(mask, finite(v), zero) }))
        }
        _ => None,
    };
    let [d0, d1, d2] = d_position;
    let [s0, s1, s2] = d_sigma;
    let [w, x, y, z] = d_rotation;
    let d_rows = [d0, d1, d2, w, x, y, z, s0, s1, s2, d_opacity * p.compensation];
    let rows = each!([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10] i => { let v = d_rows[i]; V::select(mask, finite(v), zero) });
    SplatLanes { rows, covariance, camera }
}

/// Returns the gradient by the camera's map, of which point = rotation position + translation, and
/// jacobian[i] = scale (rotation[i] - slope rotation[2]).
#[inline(always)]
fn camera_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    rows: &[Lanes; ROWS],
    p: &Projection<S>,
    d_point: [V<S>; 3],
    d_jacobian: [[V<S>; 3]; 2],
) -> [[V<S>; 4]; 3] {
    let inverse_z = V::splat(simd, 1.0) / p.point[2];
    let position = each!([0, 1, 2] i => V::load(simd, &rows[ParameterRows::POSITION + i]));
    let mut d_camera = each!([0, 1, 2] row => {
        let d = d_point[row];
        [d * position[0], d * position[1], d * position[2], d]
    });
    for i in 0..2 {
        let scale = inverse_z * camera.focal_px[i];
        for k in 0..3 {
            let by_row = scale * d_jacobian[i][k];
            d_camera[i][k] = d_camera[i][k] + by_row;
            d_camera[2][k] = d_camera[2][k] - by_row * p.slope[i];
        }
    }
    d_camera
}

/// Returns the gradient by the covariance in the world from that by the one on the screen G: with
/// the Jacobian J it is J^T G J. Off-diagonal numbers stand for both entries.
#[inline(always)]
fn world_covariance_backward<S: Simd>(p: &Projection<S>, [d_xx, d_xy, d_yy]: [V<S>; 3]) -> [V<S>; 6] {
    let [first, second] = &p.jacobian;
    let half = d_xy * 0.5;
    // G J.
    let gj = [each!([0, 1, 2] k => d_xx * first[k] + half * second[k]), each!([0, 1, 2] k => half * first[k] + d_yy * second[k])];
    // Entries (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2); a closure would not be inlined.
    let diagonal = each!([0, 1, 2] k => first[k] * gj[0][k] + second[k] * gj[1][k]);
    let off_diagonal = each!([0, 1, 2] k => { let (r, c) = (k / 2, 1 + k.div_ceil(2)); first[r] * gj[0][c] + second[r] * gj[1][c] });
    let [xy, xz, yz] = each!([0, 1, 2] k => off_diagonal[k] + off_diagonal[k]);
    [diagonal[0], xy, xz, diagonal[1], yz, diagonal[2]]
}

/// Returns the gradient by the covariance from that by its inverse C: -C G C. Off-diagonal numbers
/// stand for both entries.
#[inline(always)]
fn conic_backward<S: Simd>(p: &Projection<S>, [d_xx, d_xy, d_yy]: [V<S>; 3]) -> [V<S>; 3] {
    let root = p.inverse_root();
    let (a, b, c) = (root[0] * root[0], root[0] * root[1], root[1].mul_add(root[1], root[2] * root[2]));
    let half = d_xy * 0.5;
    // G C, then C (G C).
    let gc = [[d_xx * a + half * b, d_xx * b + half * c], [half * a + d_yy * b, half * b + d_yy * c]];
    let xx = a * gc[0][0] + b * gc[1][0];
    let xy = a * gc[0][1] + b * gc[1][1];
    let yy = b * gc[0][1] + c * gc[1][1];
    [-xx, -(xy + xy), -yy]
}

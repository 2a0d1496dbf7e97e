//! Pass `project`: projects splats to ellipses on the screen, and calls pass `color` for visible
//! blocks.
//!
//! In: parameters `[blocks, rows, 16]`, camera. Out: one [`Footprint`] per splat (N rounded up to
//! whole blocks). Source: EWA splatting (Zwicker et al. 2001) as in 3DGS (Kerbl et al. 2023), the
//! Jacobian's clamp as in gsplat; opacity compensation and 3D filter from Mip-splatting (Yu et al.
//! 2024). Degenerate: a splat is culled (its threshold is above its opacity) if it is nearer than
//! `near`, nowhere above its alpha threshold, off the image, or not finite.

use bytemuck::{Pod, Zeroable};
use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::engine::{MIN_AREA_RATIO, ParameterRows};
use luxel_core::{Real, each};

use super::color::{BlockColor, color};
use super::dropout::drawn;
use super::encoding::{Encoding, Logarithmic};
use crate::lanes::{LANES, Lanes, M, V, dot};
use crate::rays::Touch;
use crate::store::{Block, Store, StoreShape};
use crate::view::{ScreenCamera, TILE_PX};

/// sqrt(log2(e) / 2): scales a root of the inverse covariance for exponents of base 2.
pub(crate) const SQRT_HALF_LOG2_E: f32 = 0.849_321_8;

/// Enlarges footprints against rounding, pixels.
pub(crate) const MARGIN_PX: f32 = 0.01;

/// A splat on the screen; one cache line.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Footprint {
    /// Centre.
    pub(crate) mean_px: [f32; 2],
    /// Triangular root of the inverse covariance, times sqrt(log2(e) / 2): alpha = 2^(log2_opacity
    /// - u^2 - v^2) at u = root[0] dx + root[1] dy and v = root[2] dy. Written as a sum of squares,
    ///   the exponent suffers no cancellation for thin ellipses.
    pub(crate) root: [f32; 3],
    /// log2 of the opacity (after compensation).
    pub(crate) log2_opacity: f32,
    /// Radiance towards the camera.
    pub(crate) radiance: [f32; 3],
    /// log2 of the alpha below which the splat is skipped; above `log2_opacity` if culled.
    pub(crate) log2_threshold: f32,
    /// Half the ellipse's extent along y at the threshold.
    pub(crate) extent_y_px: f32,
    /// Distance along the viewing axis.
    pub(crate) depth: f32,
    /// dy at the ellipse's rightmost point.
    pub(crate) right_dy_px: f32,
    /// Tiles with a pixel centre in the ellipse's bounding box, columns and rows: first, and one
    /// beyond the last. None if culled.
    pub(crate) tiles: [[u16; 2]; 2],
    /// For cameras whose pixels are rays, the last number of [`Self::rows`]; else unused.
    pub(crate) last: f32,
}

impl Footprint {
    /// Returns the rows of the matrix that gives (u, v) at a ray in camera space, where the
    /// camera's pixels are rays: `mean_px`, `root` and `last` hold them.
    #[inline(always)]
    pub(crate) fn rows(&self) -> [[f32; 3]; 2] {
        let ([a, b], [c, d, e]) = (self.mean_px, self.root);
        [[a, b, c], [d, e, self.last]]
    }

    /// Returns what decides which rays touch the splat; `None` if it is culled.
    #[inline(always)]
    pub(crate) fn touch(&self) -> Option<Touch> {
        Touch::new(self.rows(), self.log2_opacity - self.log2_threshold)
    }
}

/// The geometry of 16 splats up to the screen, with the intermediate values that the backward pass
/// needs.
pub(crate) struct Projection<S: Simd> {
    /// Position in camera space.
    pub(crate) point: [V<S>; 3],
    /// x/z and y/z as used by the pinhole's Jacobian.
    pub(crate) slope: [V<S>; 2],
    /// The variance that the pixel adds.
    pub(crate) dilation: V<S>,
    /// Unit quaternion and the reciprocal of the raw one's length.
    pub(crate) quaternion: [V<S>; 4],
    pub(crate) inverse_length: V<S>,
    /// Rotation matrix of the splat.
    pub(crate) axes: [[V<S>; 3]; 3],
    /// Standard deviations from the parameters, and with the 3D filter.
    pub(crate) raw_sigma: [V<S>; 3],
    pub(crate) sigma: [V<S>; 3],
    /// J R_camera: `[2,3]`.
    pub(crate) jacobian: [[V<S>; 3]; 2],
    /// Jacobian times axes: `[2,3]`.
    pub(crate) screen_axes: [[V<S>; 3]; 2],
    /// `screen_axes` scaled by sigma; the covariance before dilation is its product with its
    /// transpose.
    pub(crate) root: [[V<S>; 3]; 2],
    /// Dilated covariance xx, xy, yy and its determinant; determinant before dilation.
    pub(crate) covariance: [V<S>; 3],
    pub(crate) determinant: V<S>,
    pub(crate) determinant_before: V<S>,
    /// Opacity from the parameters, and factors from the 2D compensation and the 3D filter.
    pub(crate) opacity: V<S>,
    pub(crate) compensation: V<S>,
    pub(crate) filter_factor: V<S>,
}

/// The projection linearised at 16 splats.
pub(crate) struct Linearised<S: Simd> {
    pub(crate) point: [V<S>; 3],
    pub(crate) slope: [V<S>; 2],
    pub(crate) jacobian: [[V<S>; 3]; 2],
    pub(crate) dilation: V<S>,
}

impl<S: Simd> Projection<S> {
    /// Projects a block of parameters. `smoothing` is the 3D filter of the block, if the scene has
    /// one.
    #[inline(always)]
    pub(crate) fn new<E: Encoding>(simd: S, camera: &ScreenCamera, rows: &[Lanes], smoothing: Option<&Lanes>) -> Self {
        let load = |row: usize| V::load(simd, &rows[row]);
        let c = |value: f32| V::splat(simd, value);
        let one = c(1.0);
        let position: [V<S>; 3] = each!([0, 1, 2] i => load(ParameterRows::POSITION + i));
        let rotation = each!([0, 1, 2] i => { let row = camera.rotation[i]; each!([0, 1, 2] i => c(row[i])) });
        let point = each!([0, 1, 2] i => dot(rotation[i], position) + camera.translation[i]);
        // Depth zero would divide by zero; such splats are culled, so any finite value will do.
        let z = V::select(point[2].gt(c(camera.cutoffs.near * 0.5)), point[2], one);
        let inverse_z = one / z;
        let slope = each!([0, 1] i => (point[i] * inverse_z).max(c(camera.slope_min[i])).min(c(camera.slope_max[i])));
        let scale = each!([0, 1] i => inverse_z * camera.focal_px[i]);
        let jacobian = each!([0, 1] i => {
            let shear = -(scale[i] * slope[i]);
            each!([0, 1, 2] j => scale[i].mul_add(rotation[i][j], shear * rotation[2][j]))
        });
        let (point, dilation) = ([point[0], point[1], z], c(camera.filter.dilation_px2));
        Self::linearised::<E>(simd, camera, rows, smoothing, Linearised { point, slope, jacobian, dilation })
    }

    /// Projects a block of parameters by a Jacobian.
    #[inline(always)]
    pub(crate) fn linearised<E: Encoding>(
        simd: S,
        camera: &ScreenCamera,
        rows: &[Lanes],
        smoothing: Option<&Lanes>,
        Linearised { point, slope, jacobian, dilation }: Linearised<S>,
    ) -> Self {
        let load = |row: usize| V::load(simd, &rows[row]);
        let c = |value: f32| V::splat(simd, value);
        let one = c(1.0);
        let raw: [V<S>; 4] = each!([0, 1, 2, 3] i => load(ParameterRows::ROTATION + i));
        let length2 = raw[0].mul_add(raw[0], raw[1].mul_add(raw[1], raw[2].mul_add(raw[2], raw[3] * raw[3])));
        let inverse_length = one / length2.max(c(1e-30)).sqrt();
        let quaternion = each!([0, 1, 2, 3] i => { let v = raw[i]; v * inverse_length });
        let axes = rotation_matrix(quaternion);

        let raw_sigma: [V<S>; 3] = each!([0, 1, 2] i => E::sigma(load(ParameterRows::LOG_SCALE + i)));
        let (sigma, filter_factor) = match smoothing.filter(|_| camera.filter.smooths) {
            None => (raw_sigma, one),
            Some(lanes) => {
                let f = V::load(simd, lanes);
                let sigma = each!([0, 1, 2] i => { let s = raw_sigma[i]; s.mul_add(s, f * f).sqrt() });
                let ratio = each!([0, 1, 2] i => raw_sigma[i] / sigma[i]);
                (sigma, ratio[0] * ratio[1] * ratio[2])
            }
        };

        let screen_axes =
            each!([0, 1] i => { let row = jacobian[i]; each!([0, 1, 2] k => dot(row, [axes[0][k], axes[1][k], axes[2][k]])) });
        let root = each!([0, 1] i => { let row = screen_axes[i]; each!([0, 1, 2] k => row[k] * sigma[k]) });

        let before = [dot(root[0], root[0]), dot(root[0], root[1]), dot(root[1], root[1])];
        // |a|^2 |b|^2 - (a.b)^2 = |a x b|^2 (Lagrange): no cancellation for thin ellipses.
        let cross = each!([0, 1, 2] k => {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            root[0][i] * root[1][j] - root[0][j] * root[1][i]
        });
        let determinant_before = dot(cross, cross);
        let determinant = (before[0] + before[2]).mul_add(dilation, determinant_before + dilation * dilation);
        let covariance = [before[0] + dilation, before[1], before[2] + dilation];
        let compensation = match camera.filter.compensates_opacity {
            false => one,
            true => (determinant_before / determinant).max(c(MIN_AREA_RATIO)).sqrt(),
        };
        let opacity = E::opacity(load(ParameterRows::OPACITY));
        Self {
            point,
            slope,
            dilation,
            quaternion,
            inverse_length,
            axes,
            raw_sigma,
            sigma,
            jacobian,
            screen_axes,
            root,
            covariance,
            determinant,
            determinant_before,
            opacity,
            compensation,
            filter_factor,
        }
    }

    /// Returns the triangular root M of the inverse covariance: M = [[m0, m1], [0, m2]], M^T M =
    /// covariance^-1.
    #[inline(always)]
    pub(crate) fn inverse_root(&self) -> [V<S>; 3] {
        let [_, xy, yy] = self.covariance;
        let one = yy.lift(1.0);
        let m0 = (yy / self.determinant).sqrt();
        [m0, -(m0 * xy / yy), one / yy.sqrt()]
    }
}

/// Returns the rows of the rotation matrix of unit quaternions (w, x, y, z).
#[inline(always)]
pub(crate) fn rotation_matrix<S: Simd>([w, x, y, z]: [V<S>; 4]) -> [[V<S>; 3]; 3] {
    let one = w.lift(1.0);
    let twice = |v: V<S>| v + v;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, xz, yz, wx, wy, wz) = (x * y, x * z, y * z, w * x, w * y, w * z);
    [
        [one - twice(yy + zz), twice(xy - wz), twice(xz + wy)],
        [twice(xy + wz), one - twice(xx + zz), twice(yz - wx)],
        [twice(xz - wy), twice(yz + wx), one - twice(xx + yy)],
    ]
}

/// Resizes `footprints` to the splats of a store, rounded up to whole blocks.
pub(crate) fn resize_for(store: &Store, footprints: &mut Vec<Footprint>) {
    footprints.resize(store.lanes.len() / store.layout.count() * LANES, Footprint::zeroed());
}

/// Splats on their way to the screen of a pinhole.
pub(crate) struct Centered<S: Simd> {
    pub(crate) mean: [V<S>; 2],
    pub(crate) depth: V<S>,
    /// With all factors.
    pub(crate) opacity: V<S>,
    /// Splats that may touch the image.
    pub(crate) mask: M<S>,
}

impl<S: Simd> Centered<S> {
    /// Finds the centres of a block's splats, of which `alive` exist.
    #[inline(always)]
    pub(crate) fn new(simd: S, camera: &ScreenCamera, rows: &[Lanes], p: &Projection<S>, alive: usize) -> Self {
        let c = |value: f32| V::splat(simd, value);
        let one = c(1.0);
        let opacity = p.opacity * p.compensation * p.filter_factor;
        let inverse_z = one / p.point[2];
        let mean = each!([0, 1] i => (p.point[i] * inverse_z).mul_add(c(camera.focal_px[i]), c(camera.center_px[i])));

        // Blocks whose largest possible footprints all miss the image skip colour and the rest.
        let depth = V::load(simd, &rows[ParameterRows::POSITION]) * camera.rotation[2][0]
            + V::load(simd, &rows[ParameterRows::POSITION + 1]) * camera.rotation[2][1]
            + V::load(simd, &rows[ParameterRows::POSITION + 2]) * camera.rotation[2][2]
            + camera.translation[2];
        let floor = c(camera.cutoffs.alpha_floor.min(camera.cutoffs.min_alpha));
        let widest = (opacity / floor).max(one).ln() * 2.0;
        let reach = each!([0, 2] i => (p.covariance[i] * widest).sqrt());
        let exists = V::lane_numbers(simd).lt(c(alive as f32));
        let mut mask = exists & depth.ge(c(camera.cutoffs.near)) & opacity.ge(floor);
        for i in 0..2 {
            mask = mask & (mean[i] + reach[i]).gt(c(0.0)) & (mean[i] - reach[i]).lt(c(camera.size_px[i] as f32));
        }
        Self { mean, depth, opacity, mask }
    }
}

/// Projects a block of a store of the given shape, for a pinhole. `smoothing` holds the 3D filter
/// of all blocks, or is empty.
#[inline(always)]
pub(crate) fn project_block<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    StoreShape { layout, count }: StoreShape,
    Block { index, rows }: Block<'_>,
    smoothing: &[Lanes],
    out: &mut [Footprint],
) {
    let alive = count - (index * LANES).min(count);
    let mut p = Projection::new::<Logarithmic>(simd, camera, rows, smoothing.get(index));
    p.opacity = drawn(simd, camera, index, p.opacity);
    let centered = Centered::new(simd, camera, rows, &p, alive);
    if !centered.mask.any_true() {
        out.fill(Footprint::zeroed());
        return;
    }
    let color = color(simd, camera, layout, rows);
    store_footprints(simd, camera, &p, &centered, color, out);
}

/// Writes the footprints of a block's splats, as they look from the camera.
#[inline(always)]
pub(crate) fn store_footprints<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    p: &Projection<S>,
    &Centered { mean, depth, opacity, mut mask }: &Centered<S>,
    BlockColor { brightest, radiance }: BlockColor<S>,
    out: &mut [Footprint],
) {
    let c = |value: f32| V::splat(simd, value);
    let [log2_opacity, log2_threshold] = thresholds(simd, camera, opacity, brightest);
    let radius2 = (log2_opacity - log2_threshold) * (2.0 * std::f32::consts::LN_2);
    let extent = each!([0, 2] i => (p.covariance[i] * radius2.max(c(0.0))).sqrt());
    mask &= radius2.gt(c(0.0));
    for i in 0..2 {
        // Pixel centres lie between 1/2 and size - 1/2.
        mask = mask & (mean[i] + extent[i]).gt(c(0.5)) & (mean[i] - extent[i]).lt(c(camera.size_px[i] as f32 - 0.5));
    }
    let root = p.inverse_root();
    let root = each!([0, 1, 2] i => root[i] * SQRT_HALF_LOG2_E);
    // Comparisons with NaN are false, so of the values used above only the root can still be
    // infinite or NaN.
    let finite = root[0].lt(c(f32::MAX)) & root[1].abs().lt(c(f32::MAX)) & root[2].lt(c(f32::MAX));
    mask = mask
        & finite
        & root[0].gt(c(0.0))
        & root[2].gt(c(0.0))
        & (extent[0] + extent[1]).lt(c(1e9))
        & finite_color(simd, brightest, radiance);
    let right_dy = extent[0] * p.covariance[1] / p.covariance[0];
    let tiles = each!([0, 1] i => tile_range(camera, i, Interval { center: mean[i], half_length: extent[i] }, mask));

    let fields = [
        mean[0],
        mean[1],
        root[0],
        root[1],
        root[2],
        log2_opacity,
        radiance[0],
        radiance[1],
        radiance[2],
        log2_threshold,
        extent[1],
        depth,
        right_dy,
        tiles[0],
        tiles[1],
        c(0.0),
    ];
    for (footprint, fields) in bytemuck::cast_slice_mut(out).iter_mut().zip(V::transpose(fields)) {
        fields.store(footprint);
    }
}

/// Returns where a colour is finite, with and without the gain.
#[inline(always)]
pub(crate) fn finite_color<S: Simd>(simd: S, brightest: V<S>, radiance: [V<S>; 3]) -> M<S> {
    let limit = V::splat(simd, f32::MAX);
    brightest.lt(limit) & radiance[0].max(radiance[1]).max(radiance[2]).lt(limit)
}

/// Returns log2 of the opacity, and of the alpha below which a splat of this brightness is skipped.
#[inline(always)]
pub(crate) fn thresholds<S: Simd>(simd: S, camera: &ScreenCamera, opacity: V<S>, brightest: V<S>) -> [V<S>; 2] {
    let c = |value: f32| V::splat(simd, value);
    let threshold =
        (c(camera.cutoffs.min_contribution) / brightest.max(c(1e-30))).min(c(camera.cutoffs.min_alpha)).max(c(camera.cutoffs.alpha_floor));
    [opacity.max(c(1e-30)).ln() * std::f32::consts::LOG2_E, threshold.ln() * std::f32::consts::LOG2_E]
}

/// An interval along one axis of the screen, pixels.
struct Interval<S: Simd> {
    center: V<S>,
    half_length: V<S>,
}

/// Returns the range of tiles along one axis with pixel centres within the interval and a margin:
/// first tile and one beyond the last, packed into the bits of one number. It is empty where there
/// are no such pixels, and outside `mask`.
#[inline(always)]
fn tile_range<S: Simd>(
    camera: &ScreenCamera,
    axis: usize,
    Interval { center: mean, half_length: extent }: Interval<S>,
    mask: M<S>,
) -> V<S> {
    let zero = mean.lift(0.0);
    let reach = extent + MARGIN_PX;
    // Pixel centres between low and high: from floor(low + 1/2) to floor(high - 1/2). A centre
    // exactly at low is left out; the margin compensates for that.
    let (first, last) = ((mean - reach + 0.5).max(zero).floor(), (mean + reach - 0.5).floor());
    let count = mean.lift(camera.tiles()[axis] as f32);
    let tile = |pixel: V<S>| (pixel * (1.0 / TILE_PX as f32)).floor();
    let end = (tile(last) + 1.0).min(count);
    let some = mask & last.ge(first);
    V::select(some, V::pack(tile(first), end), zero)
}

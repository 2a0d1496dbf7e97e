//! Pass `project` for cameras whose pixels are rays: projects splats to the plane that touches the
//! sphere of directions at their centre.
//!
//! In: parameters, camera with its [`RayTable`]. Out: one [`Footprint`] per splat, with the rows of
//! a matrix of `[2,3]`: at a ray d in camera space, (u, v) = rows d. That is EWA splatting with a
//! virtual camera that looks at each splat, so no splat is far from an axis: the error is that of
//! Huang et al. 2024 ("On the Error Analysis of 3D Gaussian Splatting and an Optimal Projection
//! Strategy"), and it is the same wherever in the image a splat lies. Offsets are measured across
//! the ray of the centre (sine of the angle), which for round splats is what the integral along the
//! pixel's ray gives. The screen's filter is that of a pixel of [`RayTable::pixel_angle`].
//! Degenerate: as for the pinhole; `near` is compared with the distance.

use fearless_simd::Simd;
use fearless_simd::prelude::*;
use luxel_core::engine::ParameterRows;
use luxel_core::{Real, each};

use super::color::{BlockColor, color};
use super::dropout::drawn;
use super::encoding::Logarithmic;
use super::project::{Footprint, Linearised, Projection, SQRT_HALF_LOG2_E, finite_color, thresholds};
use crate::lanes::{LANES, Lanes, V, dot};
use crate::rays::RayTable;
use crate::store::{Block, StoreShape};
use crate::view::ScreenCamera;

/// The plane on which a splat is projected.
pub(crate) struct Facing<S: Simd> {
    /// Direction of the splat in camera space.
    pub(crate) unit: [V<S>; 3],
    /// Two directions of the plane, camera space.
    pub(crate) basis: [[V<S>; 3]; 2],
    pub(crate) distance: V<S>,
    pub(crate) inverse_distance: V<S>,
    /// Squared side of a pixel in radians, and its derivative by the cosine to the axis.
    pub(crate) pixel_angle: [V<S>; 2],
}

impl<S: Simd> Facing<S> {
    #[inline(always)]
    fn new(simd: S, rays: &RayTable, point: [V<S>; 3]) -> Self {
        let c = |value: f32| V::splat(simd, value);
        let one = c(1.0);
        let distance = dot(point, point).max(c(1e-30)).sqrt();
        let inverse_distance = one / distance;
        let unit = each!([0, 1, 2] i => point[i] * inverse_distance);
        // Duff et al. 2017: an orthonormal basis without singularities.
        let [x, y, z] = unit;
        let sign = V::select(z.ge(c(0.0)), one, c(-1.0));
        let a = -(one / (sign + z));
        let b = x * y * a;
        let basis = [[(sign * x * x).mul_add(a, one), sign * b, -(sign * x)], [b, (y * y).mul_add(a, sign), -y]];
        Self { unit, basis, distance, inverse_distance, pixel_angle: rays.pixel_angle(z) }
    }
}

impl<S: Simd> Facing<S> {
    /// Returns the factor from gradients by pixels' angles on the plane, in no direction of the
    /// image, to those by half the image's side.
    #[inline(always)]
    pub(crate) fn ndc_radian(&self, size_px: [usize; 2]) -> V<S> {
        let [width, height] = size_px.map(|side| side as f32);
        self.pixel_angle[0].sqrt() * (0.5 * (width * height).sqrt())
    }
}

/// Projects a block of parameters.
#[inline(always)]
pub(crate) fn project_to_plane<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    rays: &RayTable,
    rows: &[Lanes],
    smoothing: Option<&Lanes>,
) -> (Projection<S>, Facing<S>) {
    let c = |value: f32| V::splat(simd, value);
    let rotation = each!([0, 1, 2] i => { let row = camera.rotation[i]; each!([0, 1, 2] k => c(row[k])) });
    let position = each!([0, 1, 2] i => V::load(simd, &rows[ParameterRows::POSITION + i]));
    let point = each!([0, 1, 2] i => dot(rotation[i], position) + camera.translation[i]);
    let facing = Facing::new(simd, rays, point);
    let jacobian = each!([0, 1] i => {
        let e = facing.basis[i];
        each!([0, 1, 2] j => dot(e, [rotation[0][j], rotation[1][j], rotation[2][j]]) * facing.inverse_distance)
    });
    let dilation = facing.pixel_angle[0] * camera.filter.dilation_px2;
    let linearised = Linearised { point, slope: [c(0.0); 2], jacobian, dilation };
    (Projection::linearised::<Logarithmic>(simd, camera, rows, smoothing, linearised), facing)
}

/// Returns the rows of the footprint's matrix.
#[inline(always)]
fn footprint_rows<S: Simd>(p: &Projection<S>, facing: &Facing<S>) -> [[V<S>; 3]; 2] {
    let root = p.inverse_root();
    let root = each!([0, 1, 2] i => root[i] * SQRT_HALF_LOG2_E);
    let [e, f] = facing.basis;
    [each!([0, 1, 2] i => root[0].mul_add(e[i], root[1] * f[i])), each!([0, 1, 2] i => root[2] * f[i])]
}

/// Projects a block of a store of the given shape, as [`super::project::project_block`] does.
#[inline(always)]
pub(crate) fn project_block<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    rays: &RayTable,
    StoreShape { layout, count }: StoreShape,
    Block { index, rows }: Block<'_>,
    smoothing: &[Lanes],
    out: &mut [Footprint],
) {
    let c = |value: f32| V::splat(simd, value);
    let alive = count - (index * LANES).min(count);
    let (mut p, facing) = project_to_plane(simd, camera, rays, rows, smoothing.get(index));
    p.opacity = drawn(simd, camera, index, p.opacity);
    let opacity = p.opacity * p.compensation * p.filter_factor;
    let floor = c(camera.cutoffs.alpha_floor.min(camera.cutoffs.min_alpha));
    let widest = (opacity / floor).max(c(1.0)).ln() * 2.0;
    let reach = ((p.covariance[0] + p.covariance[2]) * widest).sqrt();
    let exists = V::lane_numbers(simd).lt(c(alive as f32));
    let mut mask = exists & facing.distance.ge(c(camera.cutoffs.near)) & opacity.ge(floor);
    mask &= (facing.unit[2] + reach).ge(c(rays.least_cosine));
    if !mask.any_true() {
        out.fill(Footprint::default());
        return;
    }

    let BlockColor { brightest, radiance } = color(simd, camera, layout, rows);
    let [log2_opacity, log2_threshold] = thresholds(simd, camera, opacity, brightest);
    let matrix = footprint_rows(&p, &facing);
    mask = mask & (log2_opacity - log2_threshold).gt(c(0.0)) & finite_color(simd, brightest, radiance);
    // Comparisons with NaN are false.
    for row in matrix {
        mask = mask & dot(row, row).lt(c(f32::MAX)) & dot(row, row).gt(c(0.0));
    }
    // A culled splat's threshold is above its opacity.
    let log2_threshold = V::select(mask, log2_threshold, c(1.0));
    let log2_opacity = V::select(mask, log2_opacity, c(0.0));
    let zero = c(0.0);
    let [[a, b, d], [e, f, last]] = each!([0, 1] i => { let row = matrix[i]; each!([0, 1, 2] k => V::select(mask, row[k], zero)) });
    let [red, green, blue] = radiance;
    let fields = [a, b, d, e, f, log2_opacity, red, green, blue, log2_threshold, zero, facing.distance, zero, zero, zero, last];
    for (footprint, fields) in bytemuck::cast_slice_mut(out).iter_mut().zip(V::transpose(fields)) {
        fields.store(footprint);
    }
}

#[cfg(test)]
mod tests {
    use luxel_lanes::Level;

    use super::*;
    use crate::lanes::with_simd;

    #[test]
    fn the_plane_touches_the_sphere_at_the_splat() {
        let camera = luxel_core::Camera::panorama(glam::DAffine3::IDENTITY, 64);
        let rays = RayTable::new(&camera);
        let noise = |n: u32| ((n.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 23) as f32) - 1.0;
        let points = [0, 1, 2].map(|axis| Lanes(std::array::from_fn(|i| 3.0 * noise(7 + 3 * i as u32 + axis))));
        for level in [Level::best(), Level::baseline()] {
            let [e, f, unit] = with_simd!(level, simd => {
                let facing = Facing::new(simd, &rays, each!([0, 1, 2] i => V::load(simd, &points[i])));
                let lanes = |v: [V<_>; 3]| v.map(|row| row.lanes());
                [lanes(facing.basis[0]), lanes(facing.basis[1]), lanes(facing.unit)]
            });
            for lane in 0..LANES {
                let [e, f, unit] = [e, f, unit].map(|v| glam::Vec3::from_array(v.map(|row| row[lane])));
                assert!((e.cross(f) - unit).length() < 1e-5 && e.dot(f).abs() < 1e-6, "{e} {f} {unit}");
            }
        }
    }
}

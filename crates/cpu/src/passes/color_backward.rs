//! Pass `color_backward`: computes the gradient by the colour model's coefficients and by the
//! viewing direction.
//!
//! In: rows of a block, gradient by its radiance `[3]` x 16. Out: gradient rows of harmonics and
//! raw luminance (up to the active degree; the rest is unchanged), and the gradient by the position
//! through the direction: (I - v v^T) dE/dv / |position - eye|. The formula is core's
//! [`luxel_core::Light::backward`].

use fearless_simd::Simd;
use luxel_core::engine::ParameterRows;
use luxel_core::{ColorBasis, each};

use crate::lanes::{Lanes, V, outlined};
use crate::view::{ScreenCamera, ViewDirection};

/// Differentiates a block's colours, and returns the gradient by the position.
#[inline(always)]
pub(crate) fn color_backward<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    layout: ParameterRows,
    rows: &[Lanes],
    d_radiance: [V<S>; 3],
    out: &mut [Lanes],
) -> [V<S>; 3] {
    outlined!(simd => {
        let ViewDirection { unit: direction, inverse_distance } = ViewDirection::new(simd, camera, rows);
        // Only models of one light are trained.
        let light = layout.color_model.component(0).light;
        let basis = ColorBasis::new(camera.active_degree.min(light.max_degree()), direction);
        let luminance = layout.luminance();
        let (sh_rows, luminance_rows) = out.split_at_mut(luminance);
        let d_direction = light.backward(
            &basis,
            |m, c| V::load(simd, &rows[ParameterRows::SH + 3 * m + c]),
            |m| V::load(simd, &rows[luminance + m]),
            d_radiance,
            |m, c, gradient| gradient.store(&mut sh_rows[ParameterRows::SH + 3 * m + c]),
            |m, gradient| gradient.store(&mut luminance_rows[m]),
        );
        each!([0, 1, 2] i => { let d = d_direction[i]; d * inverse_distance })
    })
}

//! Pass `color`: computes the radiance of each splat towards the camera, of one light. It runs
//! within `project`, for visible blocks.
//!
//! In: harmonics and raw luminance rows of a block, world positions, eye. Out: linear RGB radiance
//! `[3]` x 16, >= 0, and the largest channel before the gain of the light. The formula is core's
//! [`luxel_core::Light::radiance`], on sixteen splats at once. Cut-offs follow the radiance before
//! the gain, so that a light of a mix is cut off as in the scene that it comes from.

use fearless_simd::Simd;
use luxel_core::engine::ParameterRows;
use luxel_core::{ColorBasis, Real, each};

use crate::lanes::{Lanes, V, outlined};
use crate::view::{ScreenCamera, ViewDirection};

/// The radiance of a block's splats, of one light.
pub(crate) struct BlockColor<S: Simd> {
    /// The largest channel, before the gain.
    pub(crate) brightest: V<S>,
    /// Radiance with the gain.
    pub(crate) radiance: [V<S>; 3],
}

/// Computes the radiance of a block's splats.
#[inline(always)]
pub(crate) fn color<S: Simd>(simd: S, camera: &ScreenCamera, layout: ParameterRows, rows: &[Lanes]) -> BlockColor<S> {
    outlined!(simd => {
        let direction = ViewDirection::new(simd, camera, rows).unit;
        let model = layout.color_model;
        let component = model.component(camera.light);
        let basis = ColorBasis::new(camera.active_degree.min(component.light.max_degree()), direction);
        let luminance = layout.luminance();
        let raw_luminance = |m: usize| V::load(simd, &rows[luminance + m]);
        let radiance = component.radiance(&basis, |m, c| V::load(simd, &rows[ParameterRows::SH + 3 * m + c]), raw_luminance);
        let brightest = radiance[0].max(radiance[1]).max(radiance[2]);
        match component.gain(raw_luminance) {
            None => BlockColor { brightest, radiance },
            Some(gain) => BlockColor { brightest, radiance: each!([0, 1, 2] i => { let c = radiance[i]; c * gain }) },
        }
    })
}

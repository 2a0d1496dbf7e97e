//! Pass `color`: computes the radiance of each splat towards the camera. It runs within `project`,
//! for visible blocks.
//!
//! In: harmonics and raw luminance rows of a block, world positions, eye. Out: linear RGB radiance
//! `[3]` x 16, >= 0. The formula is core's [`luxel_core::ColorModel::radiance`], on sixteen splats
//! at once.

use fearless_simd::Simd;
use luxel_core::ColorBasis;
use luxel_core::engine::ParameterRows;

use crate::lanes::{Lanes, V};
use crate::view::{ScreenCamera, ViewDirection};

/// Returns the radiance of a block's splats.
#[inline(always)]
pub(crate) fn color<S: Simd>(simd: S, camera: &ScreenCamera, layout: ParameterRows, rows: &[Lanes]) -> [V<S>; 3] {
    let direction = ViewDirection::new(simd, camera, rows).unit;
    let model = layout.color_model;
    let basis = ColorBasis::new(camera.active_degree.min(model.max_degree()), direction);
    let luminance = layout.luminance();
    model.radiance(&basis, |m, c| V::load(simd, &rows[ParameterRows::SH + 3 * m + c]), |m| V::load(simd, &rows[luminance + m]))
}

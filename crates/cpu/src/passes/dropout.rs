//! The splats that a training step leaves out ([`Dropout`]), in passes `project` of all
//! projections.
//!
//! In: opacities of a block of splats. Out: the opacities to draw them with: zero, which culls, for
//! those that are left out. The backward pass differentiates by the opacity's logarithm, which the
//! factor does not change.
//!
//! [`Dropout`]: luxel_core::engine::Dropout

use fearless_simd::Simd;

use crate::lanes::{LANES, Lanes, V};
use crate::view::ScreenCamera;

/// Returns the opacities with which the splats of block `index` are drawn.
#[inline(always)]
pub(crate) fn drawn<S: Simd>(simd: S, camera: &ScreenCamera, index: usize, opacity: V<S>) -> V<S> {
    match camera.dropout {
        None => opacity,
        Some(dropout) => {
            let (first, factor) = ((index * LANES) as u32, dropout.opacity_factor());
            let factors = std::array::from_fn(|lane| if dropout.keeps(first.wrapping_add(lane as u32)) { factor } else { 0.0 });
            opacity * V::load(simd, &Lanes(factors))
        }
    }
}

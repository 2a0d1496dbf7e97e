//! The gradient by a view's vignetting: the sum over workgroups on the host.
//!
//! In: the view of the last step. Out: the gradient by the coefficients of ln gain, with the same
//! bits every time on one adapter. Degenerate: a view without vignetting has none.

use luxel_core::{EngineError, VIGNETTING_TERMS, View};

use super::GpuEngine;
use crate::screen::tiles;

impl GpuEngine {
    /// Reads the sums of the last step and returns the gradient by its view's vignetting.
    pub(super) fn read_vignetting_gradient(&self, view: &View) -> Result<Option<[f32; VIGNETTING_TERMS]>, EngineError> {
        if view.target.vignetting.is_none() {
            return Ok(None);
        }
        let groups = tiles(view.camera.size_px).map(|side| side as usize).into_iter().product();
        let sums: Vec<[f32; VIGNETTING_TERMS]> = self.gpu.read(&self.frame.pixels.group_sums, groups)?;
        let total = |k: usize| sums.iter().map(|group| f64::from(group[k])).sum::<f64>() as f32;
        Ok(Some(std::array::from_fn(total)))
    }
}

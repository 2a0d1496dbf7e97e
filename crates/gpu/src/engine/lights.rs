//! One light of a scene ([`luxel_core::Mix`]): its image, and its contributions.

use luxel_core::edit::Contributions;
use luxel_core::{Camera, EngineError, Image, RenderOptions};

use super::{GpuEngine, Submission};
use crate::device::Buffer;
use crate::screen::supersampled;

/// Returns the options for the image of one light of so many, whose images add to the image: each
/// has its part of the background.
pub(super) fn of_one_light(options: &RenderOptions, lights: usize) -> RenderOptions {
    RenderOptions { background: options.background.map(|c| c / lights as f32), ..*options }
}

impl GpuEngine {
    /// Renders the image of a light into an image of any size.
    pub(super) fn render_light(
        &mut self,
        camera: &Camera,
        options: &RenderOptions,
        light: usize,
        image: &mut Image,
    ) -> Result<(), EngineError> {
        self.run(&Submission::Render { camera, options, light })?;
        let (sampled, samples) = supersampled(camera, options);
        self.image_copy.read_into(&self.gpu, sampled.size_px, samples as usize, image)
    }

    /// Computes each splat's contributions to the image of a light.
    pub(super) fn contributions_of_light(
        &mut self,
        camera: &Camera,
        options: &RenderOptions,
        light: usize,
        mask: &Buffer,
    ) -> Result<Contributions, EngineError> {
        let out = self.gpu.storage("contributions", 16 * self.scene.count as u64)?;
        self.run(&Submission::Contributions { camera, options, light, mask, out: &out })?;
        // Cached bindings would keep the buffers alive.
        self.commands.forget();
        let sums: Vec<[f32; 4]> = self.gpu.read(&out, self.scene.count)?;
        let row = |k: usize| sums.iter().map(|sums| sums[k]).collect();
        Ok(Contributions { masked: row(0), blended: row(1), unoccluded: row(2), light: row(3) })
    }
}

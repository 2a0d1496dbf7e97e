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
    /// Renders the image of a light.
    pub(super) fn render_light(&mut self, camera: &Camera, options: &RenderOptions, light: usize) -> Result<Image, EngineError> {
        self.run(&Submission::Render { camera, options, light })?;
        let (sampled, samples) = supersampled(camera, options);
        let [width, height] = sampled.size_px.map(|side| side as usize);
        let bytes = self.gpu.read(&self.frame.pixels.image, 12 * (width * height) as u64)?;
        let image = Image { width, height, pixels: bytemuck::pod_collect_to_vec(&bytes) };
        Ok(if samples == 1 { image } else { image.block_means(samples as usize) })
    }

    /// Computes each splat's contributions to the image of a light.
    pub(super) fn contributions_of_light(
        &mut self,
        camera: &Camera,
        options: &RenderOptions,
        light: usize,
        mask: &Buffer,
    ) -> Result<Contributions, EngineError> {
        let bytes = 16 * self.scene.count as u64;
        let out = self.gpu.storage("contributions", bytes)?;
        self.run(&Submission::Contributions { camera, options, light, mask, out: &out })?;
        // Cached bindings would keep the buffers alive.
        self.commands.forget();
        let sums: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&self.gpu.read(&out, bytes)?);
        let row = |k: usize| sums.iter().map(|sums| sums[k]).collect();
        Ok(Contributions { masked: row(0), blended: row(1), unoccluded: row(2), light: row(3) })
    }
}

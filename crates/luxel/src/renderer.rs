//! Rendering of a scene: always with the scene's own raster settings, always into the units of the
//! data set.

use luxel_core::{Camera, ColorSpace, Engine, RadianceScale, RenderOptions, Similarity};

use crate::device::SelectedEngine;
use crate::error::{Context, ensure};
use crate::{DeviceOptions, Radiance, Result, Scene};

/// Renders one scene from any camera.
///
/// ```
/// use luxel::{Device, Renderer, synthetic};
///
/// # fn main() -> luxel::Result<()> {
/// let scene = synthetic::room(200, 1);
/// let mut renderer = Renderer::new(&scene, Device::Cpu)?;
/// let image = renderer.render(&synthetic::room_camera([32, 24]))?;
/// assert_eq!((image.width(), image.height()), (32, 24));
/// # Ok(())
/// # }
/// ```
pub struct Renderer {
    engine: Box<dyn Engine>,
    radiance_scale: RadianceScale,
    color_space: ColorSpace,
    options: RenderOptions,
    world_from_local: Similarity,
}

impl Renderer {
    /// Opens a device and loads the scene.
    ///
    /// # Errors
    /// A device that is not there; a scene that is not valid or does not fit into the device's
    /// memory.
    pub fn new(scene: &Scene, device: impl Into<DeviceOptions>) -> Result<Self> {
        let mut engine = SelectedEngine::open(&device.into())?.engine;
        engine.load(&scene.splats, None).context("cannot load the scene")?;
        let options = scene.render_options();
        Ok(Self {
            engine,
            radiance_scale: scene.radiance_scale,
            color_space: scene.color_space,
            options,
            world_from_local: scene.world_from_local,
        })
    }

    /// Sets the radiance behind everything, in the units of the data set. It is black at first.
    pub fn set_background(&mut self, radiance: [f32; 3]) {
        self.options.background = self.radiance_scale.normalised(radiance);
    }

    /// Sets the samples along a pixel's side, 1 to 4: a pixel is the mean of their square.
    ///
    /// # Errors
    /// A number outside of that range.
    pub fn set_samples(&mut self, samples: u8) -> Result<()> {
        ensure!((1..=luxel_core::MAX_SAMPLES).contains(&samples), "{samples} samples, expected 1 to {}", luxel_core::MAX_SAMPLES);
        self.options.raster.samples = samples;
        Ok(())
    }

    /// Renders the scene as `camera` sees it, which is in the scene's local coordinates:
    /// [`luxel_core::Scene::local_camera`] takes one of the world there, and
    /// [`luxel_core::Dataset::in_frame`] those of a data set.
    ///
    /// # Errors
    /// A camera that cannot be rendered; a device that gave up.
    pub fn render(&mut self, camera: &Camera) -> Result<Radiance> {
        crate::memory::check_render(camera.size_px, self.options.raster.samples)?;
        let image = self.engine.render(camera, &self.options).context("cannot render")?;
        let mut world_camera = camera.clone();
        self.world_from_local.apply_to_camera(&mut world_camera);
        Ok(Radiance::new(image, self.radiance_scale, self.color_space, &world_camera))
    }
}

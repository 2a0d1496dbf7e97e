//! Rendering of a scene: always with the scene's own raster settings, always into the units of the
//! data set.

use luxel_core::{Camera, ColorSpace, Engine, Image, RadianceScale, RasterConfig, RenderOptions, Similarity};

use crate::device::SelectedEngine;
use crate::error::{Context, ensure};
use crate::photograph::{Photograph, Quality, Sampling, Taken};
use crate::radiance::RadianceLayers;
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
        Self::with_engine(scene, SelectedEngine::open(&device.into())?.engine)
    }

    /// Loads the scene into an engine that is open already.
    ///
    /// # Errors
    /// A scene that is not valid or does not fit into the device's memory.
    pub fn with_engine(scene: &Scene, mut engine: Box<dyn Engine>) -> Result<Self> {
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

    /// Replaces the scene, and keeps background and samples. After an error the scene is as it was.
    ///
    /// # Errors
    /// A scene that is not valid or does not fit into the device's memory.
    pub fn replace_scene(&mut self, scene: &Scene) -> Result<()> {
        self.engine.load(&scene.splats, None).context("cannot load the scene")?;
        let RenderOptions { mut background, .. } = self.options;
        if scene.radiance_scale != self.radiance_scale {
            background = scene.radiance_scale.normalised(self.radiance_scale.restored(background));
        }
        let raster = RasterConfig { samples: self.options.raster.samples, ..scene.raster };
        self.options = RenderOptions { raster, background, ..scene.render_options() };
        (self.radiance_scale, self.color_space) = (scene.radiance_scale, scene.color_space);
        self.world_from_local = scene.world_from_local;
        Ok(())
    }

    /// Sets the radiance behind everything, in the units of the data set. It is black at first.
    pub fn set_background(&mut self, radiance: [f32; 3]) {
        self.options.background = self.radiance_scale.normalised(radiance);
    }

    /// Returns the options that the scene is rendered with; the background is in normalised units.
    pub fn options(&self) -> &RenderOptions {
        &self.options
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
        let image = self.render_normalised(camera)?;
        Ok(Radiance::new(image, self.radiance_scale, self.color_space, &self.world_camera(camera)))
    }

    /// Renders the scene through an aperture, or while the shutter is open; lengths and cameras of
    /// the photograph are in the scene's local coordinates, as those of [`Self::render`]. Also
    /// returns the number of samples and the estimate of their error.
    ///
    /// ```
    /// use luxel::photograph::{Aperture, Photograph, Sampling};
    /// use luxel::{Device, Renderer, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let mut renderer = Renderer::new(&synthetic::room(200, 1), Device::Cpu)?;
    /// let camera = synthetic::room_camera([32, 24]);
    /// let aperture = Some(Aperture { diameter: 0.1, focus_distance: 2.0, blades: Some(7) });
    /// let photograph = Photograph { camera, aperture, motion: None };
    /// let sampling = Sampling { count: Some(32), ..Sampling::default() };
    /// let (image, quality) = renderer.photograph(&photograph, sampling)?;
    /// assert_eq!((image.width(), quality.samples), (32, 32));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Those of [`Self::render`]; a camera without an axis; numbers that are no lens or shutter.
    pub fn photograph(&mut self, photograph: &Photograph, sampling: Sampling) -> Result<(Radiance, Quality)> {
        let Taken { image, quality, .. } = photograph.take(self.engine.as_mut(), &self.options, sampling, false)?;
        let camera = self.world_camera(&photograph.camera);
        Ok((Radiance::new(image, self.radiance_scale, self.color_space, &camera), quality))
    }

    /// Renders a part of the samples of a photograph, see [`Photograph::take_part`].
    ///
    /// # Errors
    /// Those of [`Self::photograph`]; a part without samples.
    pub fn photograph_part(&mut self, photograph: &Photograph, count: u32, part: [u32; 2]) -> Result<Radiance> {
        let image = photograph.take_part(self.engine.as_mut(), &self.options, count, part)?;
        Ok(Radiance::new(image, self.radiance_scale, self.color_space, &self.world_camera(&photograph.camera)))
    }

    /// Renders in normalised units.
    pub(crate) fn render_normalised(&mut self, camera: &Camera) -> Result<Image> {
        crate::memory::check_render(camera.size_px, self.options.raster.samples)?;
        self.engine.render(camera, &self.options).context("cannot render")
    }

    fn world_camera(&self, camera: &Camera) -> Camera {
        let mut world_camera = camera.clone();
        self.world_from_local.apply_to_camera(&mut world_camera);
        world_camera
    }

    /// Renders the scene with each pixel's coverage and depth.
    ///
    /// ```
    /// use luxel::{Device, Renderer, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let mut renderer = Renderer::new(&synthetic::room(200, 1), Device::Cpu)?;
    /// let camera = synthetic::room_camera([32, 24]);
    /// let layers = renderer.render_layers(&camera)?;
    /// assert_eq!(layers.radiance, renderer.render(&camera)?);
    /// assert_eq!((layers.alpha.len(), layers.depth.len()), (32 * 24, 32 * 24));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Those of [`Self::render`]; an engine without depth, such as the GPU's.
    pub fn render_layers(&mut self, camera: &Camera) -> Result<RadianceLayers> {
        crate::memory::check_render(camera.size_px, self.options.raster.samples)?;
        let mut layers = self.engine.render_layers(camera, &self.options).context("cannot render")?;
        let unit = self.world_from_local.scale() as f32;
        layers.depth.iter_mut().for_each(|z| *z *= unit);
        Ok(RadianceLayers::from_normalised(layers, self.radiance_scale, self.color_space, &self.world_camera(camera)))
    }

    /// Renders normals, `[H*W]`, row by row from the top: unit vectors of the world, towards the
    /// camera; 0 where there are no splats. The normal of a splat is its shortest axis; a pixel has
    /// the mean by the weights with which radiance is blended, scaled to length 1.
    ///
    /// ```
    /// use luxel::{Device, Renderer, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let mut renderer = Renderer::new(&synthetic::room(200, 1), Device::Cpu)?;
    /// let normals = renderer.render_normals(&synthetic::room_camera([32, 24]))?;
    /// assert_eq!(normals.len(), 32 * 24);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Those of [`Self::render`]; an engine without normals: the GPU's, that of a radiance field.
    pub fn render_normals(&mut self, camera: &Camera) -> Result<Vec<[f32; 3]>> {
        crate::memory::check_render(camera.size_px, self.options.raster.samples)?;
        let normals = self.engine.render_normals(camera, &self.options).context("cannot render")?;
        Ok(self.world_from_local.turned(&normals))
    }
}

//! A run between two steps, as a visitor sees it.
//!
//! In: the trainer and the data set; out: pictures and the scene as they stand, in the units of the
//! data set. Nothing that a visitor can do changes what the run learns.

use std::borrow::Cow;
use std::collections::BTreeMap;

use luxel_core::{Camera, Dataset};
use luxel_train::Trainer;

use crate::error::Context;
use crate::refined_views::{cameras_in_world, test_views_of, train_views_of};
use crate::{Radiance, RadianceLayers, Result, Scene, memory};

/// A run between two steps. [`crate::Observer::visit`] receives it.
pub struct LiveRun<'a> {
    trainer: &'a mut Trainer,
    dataset: &'a Dataset,
}

impl<'a> LiveRun<'a> {
    /// Returns the run of a trainer.
    pub fn new(trainer: &'a mut Trainer, dataset: &'a Dataset) -> Self {
        Self { trainer, dataset }
    }

    /// Returns the number of steps made so far.
    pub fn steps_made(&self) -> u32 {
        self.trainer.iteration()
    }

    /// Returns the number of steps in all.
    pub fn steps(&self) -> u32 {
        self.trainer.config().iterations
    }

    /// Returns the number of splats.
    pub fn splats_len(&self) -> usize {
        self.trainer.splats_len()
    }

    /// Returns the views.
    pub fn dataset(&self) -> &Dataset {
        self.dataset
    }

    /// Returns the cameras through which the run sees its views by now, by the names of the views,
    /// world coordinates. Test views keep their poses and get the lenses; `None` if poses are not
    /// refined.
    pub fn refined_cameras(&self) -> Option<BTreeMap<String, Camera>> {
        let train = train_views_of(self.trainer, self.dataset);
        let test = test_views_of(self.trainer, self.dataset);
        let is_refined = matches!(train, Cow::Owned(_));
        is_refined.then(|| cameras_in_world(self.dataset, train.iter().chain(&*test)))
    }

    /// Returns the scene as it stands.
    ///
    /// # Errors
    /// A device that gave up.
    pub fn scene(&mut self) -> Result<Scene> {
        Ok(self.trainer.scene()?.into())
    }

    /// Renders the scene as it stands from a camera in the data set's local coordinates.
    ///
    /// # Errors
    /// A camera that cannot be rendered; a device that gave up.
    pub fn render(&mut self, camera: &Camera) -> Result<Radiance> {
        let options = self.trainer.render_options();
        memory::check_render(camera.size_px, options.raster.samples)?;
        let image = self.trainer.engine().render(camera, &options).context("cannot render")?;
        Ok(Radiance::new(image, self.trainer.radiance_scale(), self.dataset.color_space, &self.world_camera(camera)))
    }

    /// Returns a camera of the data set's local coordinates in the world.
    fn world_camera(&self, camera: &Camera) -> Camera {
        let mut camera = camera.clone();
        self.dataset.world_from_local.apply_to_camera(&mut camera);
        camera
    }

    /// Renders the scene as it stands, with coverage and depth in world units.
    ///
    /// # Errors
    /// Those of [`Self::render`]; an engine without depth.
    pub fn render_layers(&mut self, camera: &Camera) -> Result<RadianceLayers> {
        let options = self.trainer.render_options();
        memory::check_render(camera.size_px, options.raster.samples)?;
        let mut layers = self.trainer.engine().render_layers(camera, &options).context("cannot render")?;
        let unit = self.dataset.world_from_local.scale() as f32;
        layers.depth.iter_mut().for_each(|z| *z *= unit);
        Ok(RadianceLayers::from_normalised(layers, self.trainer.radiance_scale(), self.dataset.color_space, &self.world_camera(camera)))
    }
}

//! The trait that every engine implements, and its error.
//!
//! In: splats, cameras, views and densification plans. Out: images, reports and splats. Images and
//! radiance are in normalised units.

use std::ops::Range;

use super::{
    ChannelSource, ChannelStep, DeepImage, DensifyPlan, DensifyStats, Differentiable, Evaluations, Geometry, Layers, MomentFormat,
    PassTime, RenderOptions, SavedPart, SparseGradients, SplatArray, StepConfig, StepReport, SurfaceImage,
};
use crate::edit::Contributions;
use crate::{Camera, Image, Moments, Remedy, Splats, View};

/// Explains why an engine cannot do something.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The camera cannot be rendered.
    #[error("camera: {0}")]
    Camera(#[from] crate::CameraError),
    /// The arrays do not make up a scene.
    #[error("splats: {0}")]
    Splats(#[from] crate::SplatsError),
    /// The input is outside of the contract.
    #[error("{message}")]
    Invalid {
        /// Place, expected and found.
        message: String,
        /// Advice, if anything but correcting the input helps.
        remedy: Option<Remedy>,
    },
    /// The device failed: it ran out of memory, was lost or hung.
    #[error("{message}")]
    Device {
        /// Pass, resource and limit.
        message: String,
        /// Advice on the failure.
        remedy: Option<Remedy>,
    },
}

impl EngineError {
    /// Returns the error of input outside of the contract.
    pub fn invalid(message: impl Into<String>) -> Self {
        Self::Invalid { message: message.into(), remedy: None }
    }

    /// Returns the error of a device that failed.
    pub fn device(message: impl Into<String>) -> Self {
        Self::Device { message: message.into(), remedy: None }
    }

    /// Returns this error with advice. Errors of cameras and splats stay without, since only a
    /// correct input helps.
    #[must_use]
    pub fn with_remedy(mut self, new: Remedy) -> Self {
        if let Self::Invalid { remedy, .. } | Self::Device { remedy, .. } = &mut self {
            *remedy = Some(new);
        }
        self
    }

    /// Returns the advice on the error, if there is any.
    ///
    /// ```
    /// use luxel_core::{EngineError, Remedy};
    ///
    /// let lower = Remedy::lower("max_splats");
    /// let error = EngineError::device("gpu: out of memory").with_remedy(lower);
    /// assert_eq!(error.remedy().map(Remedy::to_string).as_deref(), Some("lower max_splats"));
    /// ```
    pub fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Invalid { remedy, .. } | Self::Device { remedy, .. } => remedy.as_ref(),
            Self::Camera(_) | Self::Splats(_) => None,
        }
    }
}

/// Returns how much an engine may keep about the tiles of an image from pass to pass where images
/// may take `image_bytes`: a quarter of that, and at least 256 MiB.
pub fn tile_memory(image_bytes: u64) -> u64 {
    (image_bytes / 4).max(256 << 20)
}

fn no_channels() -> EngineError {
    EngineError::invalid("this engine blends no channels but radiance").with_remedy(Remedy::set("device", "cpu"))
}

/// A renderer and trainer of splats: blocking, object-safe, coarse.
pub trait Engine: Send {
    /// Replaces the scene; absent moments start at zero. Statistics restart.
    ///
    /// # Errors
    /// [`EngineError::Splats`] for invalid arrays, of moments too; [`EngineError::Invalid`] for
    /// moments of other splats. The engine then keeps its current scene. [`EngineError::Device`] if
    /// the device fails.
    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError>;

    /// Returns the current scene and moments.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn save(&mut self) -> Result<(Splats, Moments), EngineError>;

    /// Returns an array of some of the splats, `[splats, width]`, so that a state can be saved
    /// without a copy of it. Empty for the smoothing filter where there is none, and that of
    /// moments.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for a range beyond the last splat; [`EngineError::Device`].
    fn save_array(&mut self, part: SavedPart, array: SplatArray, splats: Range<usize>) -> Result<Vec<f32>, EngineError>;

    /// Replaces the parameters of all splats; moments and statistics stay.
    ///
    /// # Errors
    /// Those of [`Self::load`], of which splats of another number or colour model are one.
    fn replace_parameters(&mut self, splats: &Splats) -> Result<(), EngineError> {
        let (_, moments) = self.save()?;
        moments.validate_for(splats)?;
        // Loading starts statistics anew.
        let stats = self.densify_stats()?;
        self.load(splats, Some(&moments))?;
        self.set_densify_stats(&stats)
    }

    /// Renders radiance in normalised units as seen by `camera`, of any projection, which must be
    /// undistorted.
    ///
    /// # Errors
    /// [`EngineError::Camera`], [`EngineError::Device`].
    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError>;

    /// Renders like [`Engine::render`] into an image of any size, whose memory an engine may use
    /// again. After an error the image holds anything.
    ///
    /// # Errors
    /// Those of [`Engine::render`].
    fn render_into(&mut self, camera: &Camera, options: &RenderOptions, image: &mut Image) -> Result<(), EngineError> {
        *image = self.render(camera, options)?;
        Ok(())
    }

    /// Renders like [`Engine::render`], with each pixel's coverage and depth.
    ///
    /// # Errors
    /// Those of [`Engine::render`]; [`EngineError::Invalid`] from an engine without depth.
    fn render_layers(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Layers, EngineError> {
        Err(EngineError::invalid("this engine renders no depth and alpha").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Renders normals: unit vectors of the world, `[H*W]`, row-major, towards the camera; 0 where
    /// there are no splats. The normal of a splat is its shortest axis. A pixel has the mean by the
    /// weights with which [`Engine::render`] blends radiance, scaled to length 1.
    ///
    /// # Errors
    /// Those of [`Engine::render`]; [`EngineError::Invalid`] from an engine without normals.
    fn render_normals(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Vec<[f32; 3]>, EngineError> {
        Err(EngineError::invalid("this engine renders no normals").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Lists what each pixel of the image that [`Engine::render`] makes is blended from, with at
    /// most `most_samples` samples a pixel, at least 1. Radiance is in normalised units.
    ///
    /// # Errors
    /// Those of [`Engine::render`]; [`EngineError::Invalid`] for several samples along a pixel's
    /// side, for a mix of lights, and from an engine without deep images.
    fn render_deep(&mut self, _camera: &Camera, _options: &RenderOptions, _most_samples: usize) -> Result<DeepImage, EngineError> {
        Err(EngineError::invalid("this engine renders no deep images").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Renders the distribution of depths of each pixel, by the weights with which
    /// [`Engine::render`] blends radiance; of a mix of lights, that of the first.
    ///
    /// # Errors
    /// Those of [`Engine::render`]; [`EngineError::Invalid`] for a camera that is no pinhole,
    /// several samples along a pixel's side, and from an engine without surface images.
    fn render_surface(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<SurfaceImage, EngineError> {
        Err(EngineError::invalid("this engine renders no surface images").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Returns the contributions of each splat to the image that [`Engine::render`] makes, in total
    /// and within `mask` (`[H*W]`, row-major, 0 to 1), for selecting splats by a painted mask.
    ///
    /// # Errors
    /// [`EngineError::Camera`], [`EngineError::Invalid`] if the mask is not of the camera's size,
    /// [`EngineError::Device`].
    fn contributions(&mut self, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Result<Contributions, EngineError>;

    /// Counts how often blending evaluates a splat at a pixel for the image that [`Engine::render`]
    /// makes; `None` from an engine that does not count.
    ///
    /// # Errors
    /// Those of [`Engine::render`].
    fn evaluations(&mut self, _camera: &Camera, _options: &RenderOptions) -> Result<Option<Evaluations>, EngineError> {
        Ok(None)
    }

    /// Runs one training step towards `view`.
    ///
    /// The view's image times its [`Target::scale`] is in normalised units, or holds captured LDR
    /// values if the target's curve is a response. Views that share an image's
    /// allocation have the same image, so an engine may cache what it derives from it.
    ///
    /// An engine may work ahead. Its report is then about an earlier step, the newest known one,
    /// and every other call waits for the steps in flight. If a loss is not finite, such an engine
    /// changes nothing from that step on, reports the loss at one of the next calls, and refuses to
    /// return the scene.
    ///
    /// # Errors
    /// [`EngineError::Camera`]; [`EngineError::Invalid`] if the image or its mask is not of the
    /// camera's size, or the engine does not support the curve; [`EngineError::Device`].
    ///
    /// [`Target::scale`]: crate::Target::scale
    fn train_step(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError>;

    /// Runs one training step of a method that owns channels and loss, seen by a pinhole with one
    /// sample a pixel. If the loss is not finite, nothing is updated.
    ///
    /// # Errors
    /// [`EngineError::Camera`]; [`EngineError::Invalid`] for other cameras, cut-offs that depend on
    /// radiance, too few channels, and from an engine without such steps.
    fn train_channels(&mut self, _camera: &Camera, _method: &mut dyn ChannelStep, _step: &StepConfig) -> Result<StepReport, EngineError> {
        Err(no_channels())
    }

    /// Computes the gradients of [`Engine::train_channels`] without its update. The scene and its
    /// statistics stay as they are: the statistics that the step collects are in the result.
    ///
    /// # Errors
    /// Those of [`Engine::train_channels`].
    fn channel_gradients(
        &mut self,
        _camera: &Camera,
        _method: &mut dyn ChannelStep,
        _step: &StepConfig,
    ) -> Result<(StepReport, SparseGradients), EngineError> {
        Err(no_channels())
    }

    /// Renders channels instead of radiance, `[K, H, W]`, over `options.background` in the first
    /// three and over 0 in the others.
    ///
    /// # Errors
    /// Those of [`Engine::train_channels`].
    fn render_channels(
        &mut self,
        _camera: &Camera,
        _channels: &mut dyn ChannelSource,
        _options: &RenderOptions,
    ) -> Result<Vec<f32>, EngineError> {
        Err(no_channels())
    }

    /// Runs one step's forward and backward passes without its update, and reports the gradient by
    /// the camera in [`StepReport::camera`], whatever the step asks for. The scene and its
    /// statistics stay as they are.
    ///
    /// # Errors
    /// Those of [`Engine::train_step`]; [`EngineError::Invalid`] from an engine without gradients
    /// by the camera.
    fn camera_gradient(&mut self, _view: &View, _step: &StepConfig) -> Result<StepReport, EngineError> {
        Err(EngineError::invalid("this engine has no gradients by the camera").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Computes the gradients of one view of a batch, without an update. The scene and its
    /// statistics stay as they are: the statistics that the step collects are in the result.
    ///
    /// # Errors
    /// Those of [`Engine::train_step`]; [`EngineError::Invalid`] from an engine without gradients.
    fn view_gradients(&mut self, _view: &View, _step: &StepConfig) -> Result<(StepReport, SparseGradients), EngineError> {
        Err(EngineError::invalid("this engine has no gradients of single views").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Makes the update of a step from the gradients of its batch, and adds their statistics. With
    /// the gradients of one view, it is the update of [`Engine::train_step`].
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for gradients of other splats, or from an engine without gradients;
    /// [`EngineError::Device`].
    fn apply_gradients(&mut self, _gradients: &SparseGradients, _step: &StepConfig) -> Result<(), EngineError> {
        Err(EngineError::invalid("this engine takes no gradients").with_remedy(Remedy::set("device", "cpu")))
    }

    /// Takes gradients back that nobody needs, whose memory the next ones may have.
    fn reuse_gradients(&mut self, _gradients: SparseGradients) {}

    /// Returns the current scene without its moments.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn splats(&mut self) -> Result<Splats, EngineError> {
        Ok(self.save()?.0)
    }

    /// Sets how the moments of the next scene to be loaded are held. [`MomentFormat::F32`] unless
    /// set.
    ///
    /// # Errors
    /// [`EngineError::Device`] from an engine without that format.
    fn set_moment_format(&mut self, format: MomentFormat) -> Result<(), EngineError> {
        match format {
            MomentFormat::F32 => Ok(()),
            MomentFormat::Bf16 => Err(EngineError::device("this engine holds moments in single precision alone")
                .with_remedy(Remedy::set("device", "cpu").or(Remedy::set("moments", "f32")))),
        }
    }

    /// Returns the engine's rasteriser with gradients, for steps whose loss the caller owns; `None`
    /// from an engine without one. It does not see the engine's scene.
    fn differentiable(&self) -> Option<&dyn Differentiable> {
        None
    }

    /// Checks that all parameters are finite, as far as the engine can do so at little cost. A
    /// splat of which one is not is culled, so that the loss may stay finite.
    ///
    /// # Errors
    /// [`EngineError::Splats`] names the first splat and parameter that is not finite;
    /// [`EngineError::Device`].
    fn check_finite(&mut self) -> Result<(), EngineError> {
        Ok(self.geometry()?.check_finite()?)
    }

    /// Sets how much memory images may take, bytes: the engine keeps no more of them in memory of
    /// its own, and no more about the tiles of one than [`tile_memory`]. No result depends on it.
    fn limit_images(&mut self, _bytes: u64) {}

    /// Waits for all steps in flight: to measure, or before a pause.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn finish(&mut self) -> Result<(), EngineError> {
        Ok(())
    }

    /// Returns the statistics since the last [`Engine::densify`], [`Engine::load`] or
    /// [`Engine::set_densify_stats`].
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError>;

    /// Restores statistics when a run is resumed.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if lengths differ from the scene's.
    fn set_densify_stats(&mut self, stats: &DensifyStats) -> Result<(), EngineError>;

    /// Returns position, log scale and opacity, which densification policies look at.
    ///
    /// # Errors
    /// [`EngineError::Device`].
    fn geometry(&mut self) -> Result<Geometry, EngineError>;

    /// Applies a plan.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] if a source does not exist or lengths differ.
    fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError>;

    /// Returns the number of splats.
    fn len(&self) -> usize;

    /// Returns whether there are no splats.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the time spent in each pass since the engine was created, in the order of
    /// [`Pass::ALL`](super::Pass::ALL).
    fn timings(&self) -> &[PassTime];
}

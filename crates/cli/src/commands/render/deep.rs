//! Deep images beside the images of `luxel render`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use luxel_app::output::{self, FrameState, Recipe};
use luxel_core::engine::DeepImage;
use luxel_core::{Camera, ColorSpace, Conversion, Engine, Scene};
use luxel_io::{ExrOptions, ExrSample};

use super::making::Making;
use crate::args::values::ExrTypeArg;

/// A deep image to render.
pub(super) struct DeepJob {
    pub(super) path: PathBuf,
    pub(super) most_samples: u16,
    /// Digest of what decides it; its record is in the image.
    pub(super) made_by: String,
}

/// Returns the deep image of an image, which is in a folder of its own.
pub(super) fn path_beside(exr: &Path) -> PathBuf {
    exr.with_file_name("deep").join(exr.file_name().unwrap_or_default())
}

impl DeepJob {
    /// Returns the deep image of an image.
    pub(super) fn new(most_samples: u16, exr: &Path, of_frame: &Recipe) -> Self {
        Self { path: path_beside(exr), most_samples, made_by: of_frame.clone().with("deep", most_samples).digest() }
    }

    /// Returns whether the file is there, made by this recipe; `exr` is the image.
    pub(super) fn state(&self, exr: &Path, image: FrameState) -> FrameState {
        match image {
            _ if !self.path.exists() => FrameState::Missing,
            FrameState::Missing => FrameState::Other,
            _ => output::frame_state(exr, output::DEEP_MADE_BY, &self.made_by),
        }
    }

    /// Renders and writes the image; returns whether half floats could not hold it.
    pub(super) fn write(&self, making: &Making<'_>, camera: &Camera, engine: &mut dyn Engine) -> Result<bool> {
        let Making { images, scene, options, form } = making;
        let image = engine.render_deep(camera, options, usize::from(self.most_samples)).context("cannot render a deep image")?;
        let image = in_units_of_the_data(scene, form.color_space, image);
        let options = ExrOptions {
            sample: match images.exr_type {
                ExrTypeArg::Auto => ExrSample::smallest_for_deep(&image),
                ExrTypeArg::Half => ExrSample::Half,
                ExrTypeArg::Float => ExrSample::Float,
            },
            color_space: form.color_space,
            camera: Some(scene.world_camera(camera)),
            frames_per_second: images.frames_per_second,
            ..ExrOptions::default()
        };
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))?;
        }
        Ok(luxel_io::write_deep_exr(&self.path, &image, &options).context("cannot write a deep image")? > 0)
    }
}

/// Converts samples to radiance of the output's colour space, and depths to the world's unit.
fn in_units_of_the_data(scene: &Scene, to: ColorSpace, mut image: DeepImage) -> DeepImage {
    let conversion = Conversion::between(scene.color_space, to);
    let unit = scene.world_from_local.scale() as f32;
    for sample in image.pixels.iter_mut().flatten() {
        sample.radiance = conversion.apply(scene.color_space.towards(to, scene.radiance_scale.restored(sample.radiance)));
        sample.depth = sample.depth.map(|z| z * unit);
    }
    image
}

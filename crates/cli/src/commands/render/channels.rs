//! Channels of `luxel render` beside radiance.

use anyhow::{Context, Result, bail};
use luxel::aov::{Cryptomatte, Matte, MatteRenderer, Motion, motion, splat_ids};
use luxel_app::output::Recipe;
use luxel_core::{Edit, Engine, Layers};
use luxel_io::ExrPlane;

use super::jobs::Job;
use super::making::Making;
use super::neighbours::Neighbours;
use super::photograph::Photographer;
use super::plan::RenderPlan;
use crate::args::channels::{ChannelArg, ChannelArgs, MatteArg};
use crate::inputs::scene_source::SceneSource;
use crate::inputs::{engine, masks};
use crate::output::console::Console;

/// A rendered image with what is asked for beside it, in the scene's local coordinates.
pub(super) struct Picture {
    pub(super) layers: Layers,
    pub(super) normals: Option<Vec<[f32; 3]>>,
    pub(super) planes: Vec<ExrPlane>,
    /// Attributes of the file that say what the planes are.
    pub(super) attributes: Vec<(String, String)>,
}

/// Adds the channels to the recipe of all images; those without keep the recipe that they had
/// before there were any.
pub(super) fn in_recipe(channels: &ChannelArgs, recipe: Recipe) -> Recipe {
    let recipe = if channels.has(ChannelArg::Id) { recipe.with("id", true) } else { recipe };
    let named = |recipe: Recipe, matte: &MatteArg| recipe.with("matte", format_args!("{}={}", matte.name, matte.selection));
    channels.matte.iter().fold(recipe, named)
}

/// Renders images with their channels.
#[derive(Default)]
pub(super) struct ChannelRenderer {
    mattes: Option<(Cryptomatte, MatteRenderer)>,
}

impl ChannelRenderer {
    /// Selects and loads the mattes.
    ///
    /// # Errors
    /// Names that are given twice; selections of nothing; a scene without splats.
    pub(super) fn new(plan: &RenderPlan<'_>, source: &SceneSource, console: &Console) -> Result<Self> {
        let asked = &plan.images.channels.matte;
        if asked.is_empty() {
            return Ok(Self::default());
        }
        if let Some(twice) = asked.iter().enumerate().find(|(n, matte)| asked[..*n].iter().any(|before| before.name == matte.name)) {
            bail!("--matte {}: the name is given twice", twice.1.name);
        }
        let selecting: Vec<Edit> = asked.iter().map(|matte| Edit { selection: matte.selection.clone(), maps: Vec::new() }).collect();
        let mut helper = engine::engine(&plan.device)?.engine;
        let masks = masks::mask_shares(&selecting, source, plan.data, helper.as_mut(), console)?;
        drop(helper);
        let scene = &source.scene;
        let mattes: Vec<Matte> =
            asked.iter().map(|matte| Matte::of(&matte.name, &matte.selection, scene, &masks)).collect::<luxel::Result<_>>()?;
        let options = plan.device.options();
        let renderer = MatteRenderer::new(scene, &mattes, || Ok(luxel::SelectedEngine::open(&options)?.engine))?;
        Ok(Self { mattes: Some((Cryptomatte::new(mattes.into_iter().map(|matte| matte.name)), renderer)) })
    }

    /// Renders an image, with the channels that are asked for.
    pub(super) fn render(
        &mut self,
        making: &Making<'_>,
        job: &Job,
        engine: &mut dyn Engine,
        photographer: &mut Photographer,
    ) -> Result<Picture> {
        let Making { images, scene, options, .. } = making;
        let camera = &job.camera;
        luxel::memory::check_render(camera.size_px, options.raster.samples)?;
        images.deep.map_or(Ok(()), |most_samples| luxel::memory::check_deep(camera.size_px, most_samples))?;
        let has = |kind| images.channels.has(kind);
        let needs_depth = has(ChannelArg::Depth) || has(ChannelArg::Motion);
        let layers = match (&job.photograph, has(ChannelArg::Alpha) || needs_depth) {
            (Some(photograph), _) => {
                let taken = photographer.take(photograph, scene, engine, options, has(ChannelArg::Alpha))?;
                // Depths that are a mean over the aperture are those of nothing.
                let depth = if needs_depth { engine.render_layers(camera, options)?.depth } else { Vec::new() };
                Layers { depth, ..taken }
            }
            (None, true) => engine.render_layers(camera, options)?,
            (None, false) => Layers { image: engine.render(camera, options)?, ..Layers::default() },
        };
        let normals =
            if has(ChannelArg::Normal) { Some(engine.render_normals(camera, options).context("cannot render normals")?) } else { None };
        let (mut planes, mut attributes) = (Vec::new(), Vec::new());
        if has(ChannelArg::Id) {
            planes.push(splat_ids(camera, options, engine)?);
        }
        if let Some(Neighbours { before, after }) = &job.neighbours {
            planes.extend(motion(Motion::Forward, camera, &layers.depth, after.as_ref()));
            planes.extend(motion(Motion::Backward, camera, &layers.depth, before.as_ref()));
        }
        if let Some((names, renderer)) = &mut self.mattes {
            planes.extend(names.planes(&renderer.coverage(camera, options)?));
            attributes = names.attributes();
        }
        Ok(Picture { layers, normals, planes, attributes })
    }
}

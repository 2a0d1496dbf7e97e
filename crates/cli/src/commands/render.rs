//! `luxel render`: images of a scene in the units of the data set, and a video of them.

mod channels;
mod deep;
mod images;
mod jobs;
mod making;
mod neighbours;
mod photograph;
mod plan;
mod shots;
mod video;

use std::path::Path;

use anyhow::{Context, Result, bail};
use luxel::edit::StackInputs;
use luxel_app::output::Recipe;
use luxel_app::run::{ExplicitArgs, state};
use luxel_app::text;
use luxel_core::Engine;
use serde_json::json;

use self::channels::ChannelRenderer;
use self::making::Making;
use self::plan::{EditPlan, RenderPlan};
pub(super) use self::shots::camera_file;
use self::video::Video;
use crate::args::RenderArgs;
use crate::args::look::note_of_pictures;
use crate::inputs::scene_source::SceneSource;
use crate::inputs::{engine, masks};
use crate::output::console::Console;

/// The engine that renders.
struct OpenEngine {
    engine: Box<dyn Engine>,
    content: Content,
}

/// The content of the engine.
enum Content {
    /// Nothing yet: splats come in after edits.
    Nothing,
    /// A radiance field, or anchors, of this digest.
    NonSplat(String),
    /// The run's splats, whose colours it lifts to radiance.
    Lifted,
}

/// Opens the engine, and puts a radiance field, anchors or a scene of lifted colours into it.
fn open_engine(plan: &RenderPlan<'_>, source: &mut SceneSource, console: &Console) -> Result<OpenEngine> {
    let is_edited = plan.edits.is_some();
    if let Some((folder, config)) = source.run.as_ref().filter(|(_, config)| config.train.method.lifts_colors()) {
        if is_edited {
            console.note("edits are of the scene file, whose colours come close to those that the method lifts to radiance");
            return Ok(OpenEngine { engine: engine::engine(&plan.device)?.engine, content: Content::Nothing });
        }
        let selected = engine::engine_of(&plan.device, Some(config))?;
        return Ok(OpenEngine { engine: state::load_newest(folder, config, selected, console)?.selected.engine, content: Content::Lifted });
    }
    let selected = engine::engine_of(&plan.device, source.run.as_ref().map(|(_, config)| config))?;
    let Some(non_splat) = source.non_splat.take() else { return Ok(OpenEngine { engine: selected.engine, content: Content::Nothing }) };
    if let (Some((folder, _)), true) = (&source.run, is_edited) {
        // Edits are of splats.
        luxel_app::non_splat::refuse(folder)?;
    }
    let content = Content::NonSplat(non_splat.digest());
    Ok(OpenEngine { engine: non_splat.into_engine(selected)?.engine, content })
}

/// Edits the scene.
fn edit(plan: &RenderPlan<'_>, edits: &EditPlan, source: &mut SceneSource, engine: &mut dyn Engine, console: &Console) -> Result<()> {
    let EditPlan { stack, sh_map } = edits;
    let masks = masks::mask_shares(&stack.selecting(), source, plan.data, engine, console)?;
    let removed = masks::removed(stack, source, &masks, plan.data, engine, console)?;
    luxel::edit::apply_stack(stack, &mut source.scene, &StackInputs { masks, removed }, *sh_map, console)?;
    Ok(())
}

/// Returns the recipe of all images, but for their cameras.
fn recipe(making: &Making<'_>, content: &Content) -> Recipe {
    let recipe = Recipe::of_frames(making.scene, &making.options, making.form);
    let recipe = channels::in_recipe(making.images.channels, recipe);
    match content {
        Content::Nothing => recipe,
        Content::NonSplat(digest) => recipe.with("field", digest),
        Content::Lifted => recipe.with("colors", "lifted"),
    }
}

/// Makes the folder of the images.
fn make_folder(folder: &Path) -> Result<()> {
    if std::fs::metadata(folder).is_ok_and(|found| !found.is_dir()) {
        bail!("{}: is a file, expected a folder or a free name", folder.display());
    }
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))
}

/// Renders the images that are not there; `explicit` names the options that were given.
pub(crate) fn run(args: &RenderArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    let plan = RenderPlan::new(args, explicit)?;
    plan.images.curve.as_ref().and_then(note_of_pictures).into_iter().for_each(|note| console.note(&note));
    let mut source = SceneSource::open_to_render(plan.scene, &console)?;
    let shots = shots::shots(&plan, &source, &console)?;
    let OpenEngine { mut engine, content } = open_engine(&plan, &mut source, &console)?;
    if let Some(edits) = &plan.edits {
        edit(&plan, edits, &mut source, engine.as_mut(), &console)?;
    }
    let making = Making::new(&plan.images, &source.scene, source.background(plan.images.background), &console);
    let camera_files = shots.files(&plan, making.scene)?;
    let all = jobs::jobs(&plan, &making, shots, &recipe(&making, &content), &console)?;
    let jobs = jobs::unmade(&all, plan.files.overwrite)?;
    let video = plan.video.as_ref().map(|video| Video::find(video, &all, plan.files.overwrite)).transpose()?;
    if jobs.len() < all.len() {
        console.note(&format!("{} exist already and are kept", text::plural(all.len() - jobs.len(), "image")));
    }
    let folder = plan.files.folder;
    make_folder(folder)?;
    // Frames that are links in a folder from somebody else are replaced.
    let _confinement = luxel_io::confine(folder)?;
    for file in camera_files {
        file.write(plan.files.overwrite, &console)?;
    }
    if !plan.images.channels.matte.is_empty() && matches!(content, Content::NonSplat(_)) {
        bail!("--matte: mattes are of splats, and this scene has none; leave it out");
    }
    let channels = ChannelRenderer::new(&plan, &source, &console)?;
    if matches!(content, Content::Nothing) {
        engine.load(&source.scene.splats, None).context("cannot load the scene")?;
    }
    images::make(&making, &jobs, engine.as_mut(), channels, &console)?;
    let text = format!("{} in {}", text::plural(jobs.len(), "new image"), folder.display());
    let mut facts = json!({ "output": folder.display().to_string(), "frames": all.len(), "new_frames": jobs.len() });
    if let Some(video) = video {
        console.note(&text);
        let frames: Vec<&Path> = all.iter().map(|job| job.exr.as_path()).collect();
        facts["video"] = video.path().display().to_string().into();
        let text = video.encode(&frames, source.scene.radiance_scale)?;
        console.finish_with_note(facts, &text);
        return Ok(());
    }
    console.finish_with_note(facts, &text);
    Ok(())
}

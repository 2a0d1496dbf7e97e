//! `luxel render`: images of a scene in the units of the data set, and a video of them.

mod channels;
mod deep;
mod photograph;
mod shots;
mod video;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::edit::StackInputs;
use luxel::preview::{self, Curve, Look};
use luxel::{Device, FAR_DEPTH, FrameProgress, RADIANCE_SCALE};
use luxel_app::output::{self, FrameState, Recipe};
use luxel_app::run::evaluation::unique_stems;
use luxel_app::run::{ExplicitArgs, state};
use luxel_app::{files, text};
use luxel_core::edit::EditStack;
use luxel_core::{Camera, ColorSpace, Conversion, Engine, Layers, RasterConfig, RenderOptions, Scene};
use luxel_io::ExrOptions;
use serde_json::json;

use self::channels::{ChannelRenderer, Neighbours, Picture};
use self::deep::DeepJob;
use self::photograph::{PhotographJob, Photographer, photographs};
pub(super) use self::shots::camera_file;
use self::shots::{Shot, Shots};
use crate::args::look::note_of_pictures;
use crate::args::{DeviceArgs, EditText, RenderArgs, flag};
use crate::inputs::engine;
use crate::inputs::masks;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;

/// One image to render.
struct Job {
    name: String,
    camera: Camera,
    exr: PathBuf,
    png: Option<PathBuf>,
    deep: Option<DeepJob>,
    photograph: Option<PhotographJob>,
    neighbours: Option<Neighbours>,
    /// Digest of what decides the image.
    made_by: String,
    /// Digest of what decides the preview.
    preview_made_by: String,
}

/// Returns the edits before rendering; `None` without any. Axes stay, since cameras are of the
/// world as it is.
fn stack(args: &RenderArgs) -> Result<Option<EditStack>> {
    Ok(match (&args.edit, &args.edits) {
        (Some(EditText(edits)), _) => Some(EditStack { edits: edits.clone(), ..EditStack::default() }),
        (None, Some(path)) => Some(EditStack { up: None, origin: None, ..luxel::edit::read_stack(path)? }),
        (None, None) => None,
    })
}

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
fn open_engine(args: &RenderArgs, source: &mut SceneSource, console: &Console) -> Result<OpenEngine> {
    let is_edited = args.edit.is_some() || args.edits.is_some();
    if let Some((folder, config)) = source.run.as_ref().filter(|(_, config)| config.train.method.lifts_colors()) {
        if is_edited {
            console.note("edits are of the scene file, whose colours come close to those that the method lifts to radiance");
            return Ok(OpenEngine { engine: engine::engine(&device(args))?.engine, content: Content::Nothing });
        }
        let selected = engine::engine_of(&device(args), Some(config))?;
        return Ok(OpenEngine { engine: state::load_newest(folder, config, selected, console)?.selected.engine, content: Content::Lifted });
    }
    let selected = engine::engine_of(&device(args), source.run.as_ref().map(|(_, config)| config))?;
    let Some(non_splat) = source.non_splat.take() else { return Ok(OpenEngine { engine: selected.engine, content: Content::Nothing }) };
    if let (Some((folder, _)), true) = (&source.run, is_edited) {
        // Edits are of splats.
        luxel_app::non_splat::refuse(folder)?;
    }
    let content = Content::NonSplat(non_splat.digest());
    Ok(OpenEngine { engine: non_splat.into_engine(selected)?.engine, content })
}

/// Warns of a scene whose colours are no light.
fn warn_of_display(args: &RenderArgs, scene: &Scene, console: &Console) {
    if !color_space(args, scene).is_linear() {
        console.warn(&format!(
            "the colours of the scene are a display's (sRGB), not light: the OpenEXR files hold them as they are, and say so in colorInteropID; {} \
             linear-rec709 makes light of them",
            flag("output_color_space")
        ));
    }
}

/// The choices that all images share.
struct Making<'a> {
    args: &'a RenderArgs,
    scene: &'a Scene,
    /// Curve of previews and SDR video; `None` without them.
    curve: Option<Curve>,
}

/// Renders and writes the images of all jobs.
fn make(
    making: &Making<'_>,
    engine: &mut dyn Engine,
    options: &RenderOptions,
    jobs: &[&Job],
    mut channels: ChannelRenderer,
    console: &Console,
) -> Result<()> {
    let Making { args, scene, .. } = *making;
    let mut too_bright = 0usize;
    let mut photographer = Photographer::default();
    let mut progress = FrameProgress { observer: console, done: 0, total: u32::try_from(jobs.len()).unwrap_or(u32::MAX) };
    for job in jobs {
        let picture = channels
            .render(args, scene, job, engine, options, &mut photographer)
            .with_context(|| format!("cannot render {}", job.exr.display()))?;
        let is_cut = deep::write(args, scene, job, engine, options)
            .with_context(|| format!("cannot render the deep image of {}", job.exr.display()))?;
        too_bright += usize::from(write(making, job, picture)? || is_cut);
        let deep = job.deep.as_ref().map(|deep| &deep.path);
        progress.add(&job.name, std::iter::once(&job.exr).chain(&job.png).chain(deep).cloned().collect());
    }
    photographer.report(args, console);
    if too_bright > 0 {
        console.warn(&format!(
            "{} exceed 65504, the largest half float, and are cut there; leave --exr-type half out",
            text::plural(too_bright, "image")
        ));
    }
    Ok(())
}

/// Renders the images that are not there; `explicit` names the options that were given.
pub(crate) fn run(args: &RenderArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    output::check_folder_name(&args.output, &output::IMAGE_EXTENSIONS)?;
    let curve = args.ocio_look.curve(args.tonemap)?;
    if let Some(path) = &args.video {
        video::check(args, path, curve.as_ref())?;
    }
    curve.as_ref().and_then(note_of_pictures).into_iter().for_each(|note| console.note(&note));
    let mut source = SceneSource::open_to_render(&args.input.scene, &console)?;
    let request = DataRequest::new(&args.input, explicit);
    let shots = shots::shots(args, request, &source, &console)?;
    let OpenEngine { mut engine, content } = open_engine(args, &mut source, &console)?;
    if let Some(stack) = stack(args)? {
        let masks = masks::mask_shares(&stack.selecting(), &source, request, engine.as_mut(), &console)?;
        let removed = masks::removed(&stack, &source, &masks, request, engine.as_mut(), &console)?;
        let inputs = StackInputs { masks, removed };
        luxel::edit::apply_stack(&stack, &mut source.scene, &inputs, args.sh_map.into(), &console)?;
    }
    let background = source.background(args.background);
    let scene = &source.scene;
    warn_of_display(args, scene, &console);
    let raster = RasterConfig { samples: samples(args, scene, &console), ..scene.raster };
    let options = RenderOptions { raster, background, ..scene.render_options() };
    let cameras = (args.path.is_some() || args.write_cameras.is_some())
        .then(|| shots.all.iter().map(|shot| shot.in_world(scene)).collect::<Vec<_>>());
    let written = shots::file_of_cameras(args, &shots, cameras.as_deref())?;
    let mut recipe = recipe(args, scene, &options);
    match &content {
        Content::Nothing => {}
        Content::NonSplat(digest) => recipe = recipe.with("field", digest),
        Content::Lifted => recipe = recipe.with("colors", "lifted"),
    }
    let photographs = photographs(args, scene, &shots)?;
    let neighbours = Neighbours::of_shots(args, &shots)?;
    let making = Making { args, scene, curve };
    let all = jobs(&making, shots, photographs, neighbours, &recipe, &console)?;
    let jobs = unmade(&all, args.overwrite)?;
    let video = args.video.as_ref().map(|path| video::Video::plan(&making, path, &all)).transpose()?;
    if jobs.len() < all.len() {
        console.note(&format!("{} exist already and are kept", text::plural(all.len() - jobs.len(), "image")));
    }
    if std::fs::metadata(&args.output).is_ok_and(|found| !found.is_dir()) {
        bail!("{}: is a file, expected a folder or a free name", args.output.display());
    }
    std::fs::create_dir_all(&args.output).with_context(|| format!("{}: cannot create the folder", args.output.display()))?;
    // Frames that are links in a folder from somebody else are replaced.
    let _confinement = luxel_io::confine(&args.output)?;
    if let (Some(cameras), Some(_)) = (&cameras, args.path) {
        shots::write_path(&args.output, cameras, args.overwrite, &console)?;
    }
    if let Some(written) = written {
        written.write(args.overwrite, &console)?;
    }
    if !args.channels.matte.is_empty() && matches!(content, Content::NonSplat(_)) {
        bail!("--matte: mattes are of splats, and this scene has none; leave it out");
    }
    let channels = ChannelRenderer::new(args, &source, request, &console)?;
    if matches!(content, Content::Nothing) {
        engine.load(&scene.splats, None).context("cannot load the scene")?;
    }
    make(&making, engine.as_mut(), &options, &jobs, channels, &console)?;
    let text = format!("{} in {}", text::plural(jobs.len(), "new image"), args.output.display());
    let mut facts = json!({ "output": args.output.display().to_string(), "frames": all.len(), "new_frames": jobs.len() });
    if let Some(video) = video {
        console.note(&text);
        let frames: Vec<&Path> = all.iter().map(|job| job.exr.as_path()).collect();
        facts["video"] = args.video.as_ref().map(|path| path.display().to_string()).into();
        let text = video.encode(args, &frames, scene.radiance_scale)?;
        console.finish_with_note(facts, &text);
        return Ok(());
    }
    console.finish_with_note(facts, &text);
    Ok(())
}

/// Returns the samples along a pixel's side. Deep images have one, and the images beside them are
/// what they composite to.
fn samples(args: &RenderArgs, scene: &Scene, console: &Console) -> u8 {
    let of_scene = scene.raster.samples;
    if args.samples.is_none() && args.deep.is_some() && of_scene > 1 {
        console.note(&format!(
            "deep images have 1 sample along a pixel's side, where this scene was trained with {of_scene}, and the images beside them have 1, too: \
             fine detail is less smooth. A --size {of_scene} times as large keeps it"
        ));
        return 1;
    }
    args.samples.unwrap_or(of_scene)
}

/// Returns the recipe of all images, but for their cameras.
fn recipe(args: &RenderArgs, scene: &Scene, options: &RenderOptions) -> Recipe {
    channels::in_recipe(args, Recipe::of_frames(scene, options, channels::form(args, scene)))
}

/// Returns the colour space of the EXR files.
fn color_space(args: &RenderArgs, scene: &Scene) -> ColorSpace {
    args.output_color_space.map_or(scene.color_space, Into::into)
}

/// Returns the jobs that are to be done: their images or previews are missing, or made by another
/// recipe and may be replaced.
fn unmade(jobs: &[Job], overwrite: bool) -> Result<Vec<&Job>> {
    let (mut unmade, mut others) = (Vec::new(), Vec::new());
    for job in jobs {
        let image = output::frame_state(&job.exr, output::MADE_BY, &job.made_by);
        // The record of a preview is in its image.
        let preview = match &job.png {
            None => FrameState::Same,
            Some(png) if !png.exists() => FrameState::Missing,
            Some(_) if image == FrameState::Missing => FrameState::Other,
            Some(_) => output::frame_state(&job.exr, output::PREVIEW_MADE_BY, &job.preview_made_by),
        };
        let deep = job.deep.as_ref().map_or(FrameState::Same, |deep| deep.state(&job.exr, image));
        if [image, preview, deep] != [FrameState::Same; 3] {
            unmade.push(job);
        }
        let files = [(image, Some(&job.exr)), (preview, job.png.as_ref()), (deep, job.deep.as_ref().map(|deep| &deep.path))];
        others.extend(files.into_iter().filter(|(state, _)| *state == FrameState::Other).filter_map(|(_, path)| path.cloned()));
    }
    output::check_replaceable(&others, overwrite)?;
    Ok(unmade)
}

/// Returns the device: for channels beside radiance and deep images, which only the CPU engine
/// renders, `auto` means the CPU.
fn device(args: &RenderArgs) -> DeviceArgs {
    let mut device = args.input.device.clone();
    if (args.channels.needs_cpu() || args.deep.is_some()) && device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    device
}

/// Returns file names and cameras of the frames and the shard asked for. Names do not depend on the
/// part that is rendered.
fn jobs(
    making: &Making<'_>,
    shots: Shots,
    photographs: Option<Vec<PhotographJob>>,
    neighbours: Option<Vec<Neighbours>>,
    recipe: &Recipe,
    console: &Console,
) -> Result<Vec<Job>> {
    let args = making.args;
    let count = shots.frames_len();
    let Shots { all: shots, frames, images_per_frame, .. } = shots;
    let stems = unique_stems(shots.iter().map(|shot| shot.name.as_str()));
    let mut photographs = photographs.map_or_else(|| vec![None; shots.len()], |all| all.into_iter().map(Some).collect());
    let mut job = |(i, (shot, stem)): (usize, (Shot, String))| {
        let photograph: Option<PhotographJob> = photographs[i].take();
        let neighbours = neighbours.as_ref().map(|all| all[i].clone());
        let of_frame = recipe.clone().with_camera(&shot.camera);
        // Plain renders keep the recipe that they had before there were others.
        let of_frame = photograph.iter().fold(of_frame, |recipe, photograph| recipe.with("photograph", photograph.recipe()));
        let of_frame = neighbours.iter().fold(of_frame, |recipe, neighbours| recipe.with("motion", neighbours.recipe()));
        let exr = args.output.join(format!("{stem}.exr"));
        let preview = of_frame.clone().with("tonemap", format_args!("{:?}", args.tonemap)).with("exposure", args.exposure);
        let preview = match &making.curve {
            Some(Curve::Ocio(display)) => preview.with("ocio", display.digest()),
            _ => preview,
        };
        Job {
            name: shot.name,
            camera: shot.camera,
            deep: DeepJob::new(args, &exr, &of_frame),
            photograph,
            neighbours,
            exr,
            png: making.curve.as_ref().map(|_| args.output.join(format!("{stem}.png"))),
            made_by: of_frame.digest(),
            preview_made_by: preview.digest(),
        }
    };
    match frames {
        Some(frames) if frames.first >= count => {
            bail!("--frames starts at {}, expected less than the number of frames, {count}: they are counted from 0", frames.first)
        }
        Some(frames) if frames.last >= count => {
            console.note(&format!("--frames ends at {}, the last of {} is {}", frames.last, text::plural(count, "frame"), count - 1));
        }
        _ => {}
    }
    // Both eyes of a pair are in the same part.
    let in_frames =
        shots.into_iter().zip(stems).enumerate().filter(|(i, _)| frames.is_none_or(|frames| frames.contains(i / images_per_frame)));
    let in_shard = in_frames.enumerate().filter(|(i, _)| args.shard.is_none_or(|shard| i / images_per_frame % shard.count == shard.index));
    Ok(in_shard.map(|(_, named)| job(named)).collect())
}

/// Writes the files of a job; returns whether half floats could not hold the image.
fn write(making: &Making<'_>, job: &Job, picture: Picture) -> Result<bool> {
    let Making { args, scene, curve } = making;
    let Picture { layers: Layers { mut image, alpha, depth }, normals, planes, attributes: named } = picture;
    let form = channels::form(args, scene);
    match (&job.png, curve) {
        (Some(png), Some(curve)) => {
            preview::write(png, &image, scene.color_space, &Look { curve: curve.clone(), exposure_ev: args.exposure })?;
        }
        // A preview of the image that is replaced would be out of date.
        _ => remove_outdated(&job.exr, output::PREVIEW_MADE_BY, &job.exr.with_extension("png"))?,
    }
    if job.deep.is_none() {
        remove_outdated(&job.exr, output::DEEP_MADE_BY, &deep::path_beside(&job.exr))?;
    }
    let unit = scene.world_from_local.scale() as f32;
    let color_space = color_space(args, scene);
    let conversion = Conversion::between(scene.color_space, color_space);
    for pixel in &mut image.pixels {
        *pixel = conversion.apply(scene.color_space.towards(color_space, scene.radiance_scale.restored(*pixel)));
    }
    let mut attributes = vec![(output::MADE_BY.to_owned(), job.made_by.clone())];
    if job.png.is_some() {
        attributes.push((output::PREVIEW_MADE_BY.to_owned(), job.preview_made_by.clone()));
    }
    if let Some(deep) = &job.deep {
        attributes.push((output::DEEP_MADE_BY.to_owned(), deep.made_by.clone()));
    }
    attributes.extend(named);
    let options = ExrOptions {
        sample: args.exr_type.sample(&image),
        color_space,
        attributes,
        numbers: vec![(RADIANCE_SCALE.into(), scene.radiance_scale.get()), (output::PREVIEW_EXPOSURE.into(), args.exposure)],
        camera: Some(scene.world_camera(&job.camera)),
        frames_per_second: args.video.is_some().then_some(args.fps),
        alpha: form.alpha.then_some(alpha),
        depth: form.depth.then(|| depth.into_iter().map(|z| (z * unit).min(FAR_DEPTH)).collect()),
        normals: normals.map(|normals| scene.world_from_local.turned(&normals)),
        planes,
        ..ExrOptions::default()
    };
    let out_of_range = luxel_io::write_exr(&job.exr, &image, &options).context("cannot write an image")?;
    Ok(out_of_range > 0)
}

/// Removes the file beside an image that is replaced, if the image has a record of it.
fn remove_outdated(exr: &Path, record: &str, beside: &Path) -> Result<()> {
    if exr.is_file() && luxel_io::read_exr_attributes(exr).is_ok_and(|found| found.texts.contains_key(record)) {
        files::remove_if_there(beside)?;
    }
    Ok(())
}

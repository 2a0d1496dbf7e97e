//! `luxel render`: images of a scene in the units of the data set, and a video of them.

mod video;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::preview::{self, Look};
use luxel::run::ExplicitArgs;
use luxel::run::evaluation::unique_stems;
use luxel::{Device, files, text};
use luxel_core::{Camera, Conversion, Dataset, Engine, Layers, RasterConfig, RenderOptions, Scene};
use luxel_io::ExrOptions;

use crate::args::values::SplitArg;
use crate::args::{DeviceArgs, EditText, LoadArgs, RenderArgs};
use crate::inputs::engine;
use crate::inputs::masks;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;

/// A camera and the name of its image.
struct Shot {
    name: String,
    camera: Camera,
}

/// One image to render.
struct Job {
    camera: Camera,
    exr: PathBuf,
    png: Option<PathBuf>,
}

/// Renders the images that do not exist yet; `explicit` names the options that were given.
pub(crate) fn run(args: &RenderArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    if let Some(path) = &args.video {
        files::check_free(path, args.overwrite)?;
    }
    let mut source = SceneSource::open(&args.scene, &console)?;
    let request = DataRequest { data: args.data.as_deref(), load: &args.load, explicit };
    let shots = shots(args, request, &source, &console)?;
    if args.video.is_some() && args.tonemap.is_none() && args.hdr10.is_none() {
        bail!("--video needs --tonemap CURVE for SDR, or --hdr10");
    }
    let all = jobs(args, shots)?;
    let total = all.len();
    let missing = |job: &&Job| !job.exr.is_file() || job.png.as_ref().is_some_and(|png| !png.is_file());
    let jobs: Vec<&Job> = all.iter().filter(missing).collect();
    if jobs.len() < total {
        console.note(&format!("{} exist already and are kept", text::plural(total - jobs.len(), "image")));
    }
    let mut engine = engine::engine(&device(args))?.engine;
    if let Some(EditText(edits)) = &args.edit {
        let shares = masks::mask_shares(edits, &source, request, engine.as_mut(), &console)?;
        luxel::edit::apply(edits, &mut source.scene, &shares, args.sh_map.into(), &console)?;
    }
    let background = source.background(args.background);
    let scene = &source.scene;
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let raster = RasterConfig { samples: args.samples.unwrap_or(scene.raster.samples), ..scene.raster };
    let options = RenderOptions { raster, background, ..scene.render_options() };
    let folder = args.output.display();
    std::fs::create_dir_all(&args.output).with_context(|| format!("{folder}: cannot create the folder"))?;
    // Frames that are links in a folder from somebody else are replaced.
    let _confinement = luxel_io::confine(&args.output)?;
    let mut too_bright = 0usize;
    for job in &jobs {
        let layers =
            render(args, engine.as_mut(), &job.camera, &options).with_context(|| format!("cannot render {}", job.exr.display()))?;
        too_bright += usize::from(write(args, scene, job, layers)?);
    }
    if too_bright > 0 {
        console.warn(&format!(
            "{} exceed 65504, the largest half float, and are cut there; render again into another folder with --exr-type float",
            text::plural(too_bright, "image")
        ));
    }
    console.note(&format!("{} in {}", text::plural(jobs.len(), "new image"), args.output.display()));
    if let Some(path) = &args.video {
        let frames: Vec<&Path> = all.iter().map(|job| job.exr.as_path()).collect();
        video::encode(args, path, &frames, scene.radiance_scale, &console)?;
    }
    Ok(())
}

/// Returns the device: for coverage and depth, which only the CPU engine renders, `auto` means the
/// CPU.
fn device(args: &RenderArgs) -> DeviceArgs {
    let mut device = args.device.clone();
    if (args.alpha || args.depth) && device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    device
}

/// Renders the image, with coverage and depth if they are asked for.
fn render(args: &RenderArgs, engine: &mut dyn Engine, camera: &Camera, options: &RenderOptions) -> Result<Layers> {
    luxel::memory::check_render(camera.size_px, options.raster.samples)?;
    if args.alpha || args.depth {
        return Ok(engine.render_layers(camera, options)?);
    }
    Ok(Layers { image: engine.render(camera, options)?, ..Layers::default() })
}

/// Returns all cameras that the options name, in order, before `--frames` and `--shard`.
fn shots(args: &RenderArgs, request: DataRequest<'_>, source: &SceneSource, console: &Console) -> Result<Vec<Shot>> {
    let dataset = || source.dataset(request, console);
    if let Some(file) = &args.cameras {
        return camera_file(file, args.data.is_some(), dataset, || check_unread(args, file, request.explicit));
    }
    let Some(dataset) = dataset()? else {
        bail!("{}: a scene file has no cameras; give --data DATASET or --cameras FILE", args.scene.display())
    };
    let shots = views(&dataset, args.split);
    if shots.is_empty() {
        bail!("the data set has no views in this split; choose another --split");
    }
    Ok(shots)
}

/// Refuses options of reading a data set where neither cameras nor masks need one.
fn check_unread(args: &RenderArgs, file: &Path, explicit: &ExplicitArgs) -> Result<()> {
    let has_masks = args.edit.iter().flat_map(|EditText(edits)| edits).any(|edit| !edit.selection.masks().is_empty());
    if has_masks {
        return Ok(());
    }
    LoadArgs::refuse(explicit, &[], &format!("and {} describes its cameras without one; leave it out", file.display()))
}

/// Reads the cameras of a file. The data set completes what the file leaves out; it is read only if
/// asked for or needed, and `unread` is called otherwise.
fn camera_file(
    file: &Path,
    asked: bool,
    dataset: impl FnOnce() -> Result<Option<Dataset>>,
    unread: impl FnOnce() -> Result<()>,
) -> Result<Vec<Shot>> {
    let first = if asked { Err(None) } else { luxel_io::read_camera_path(file, None).map_err(Some) };
    let cameras = match first {
        Ok(cameras) => {
            unread()?;
            cameras
        }
        Err(error) => {
            let dataset = dataset()?;
            let default = dataset.as_ref().and_then(|dataset| dataset.train.first().or(dataset.test.first()));
            match (default, error) {
                (Some(view), _) => luxel_io::read_camera_path(file, Some(&view.camera)),
                (None, Some(error)) => Err(error),
                (None, None) => luxel_io::read_camera_path(file, None),
            }
            .context("cannot read the cameras")?
        }
    };
    Ok(cameras.into_iter().map(|named| Shot { name: named.name, camera: named.camera }).collect())
}

fn views(dataset: &Dataset, split: SplitArg) -> Vec<Shot> {
    let (train, test): (&[_], &[_]) = match split {
        SplitArg::Train => (&dataset.train, &[]),
        SplitArg::Test => (&[], &dataset.test),
        SplitArg::All => (&dataset.train, &dataset.test),
    };
    let mut shots: Vec<Shot> = train.iter().chain(test).map(|view| Shot { name: view.name.clone(), camera: view.camera.clone() }).collect();
    // Both lists are sorted; together they are sorted again, so that frame numbers follow the
    // capture.
    shots.sort_by(|a, b| a.name.cmp(&b.name));
    shots
}

/// Returns file names and cameras of the frames and the shard asked for. Names do not depend on the
/// part that is rendered.
fn jobs(args: &RenderArgs, shots: Vec<Shot>) -> Result<Vec<Job>> {
    let count = shots.len();
    let stems = unique_stems(shots.iter().map(|shot| shot.name.as_str()));
    let job = |(shot, stem): (Shot, String)| Job {
        camera: shot.camera,
        exr: args.output.join(format!("{stem}.exr")),
        png: args.tonemap.map(|_| args.output.join(format!("{stem}.png"))),
    };
    if let Some(frames) = args.frames
        && frames.first >= count
    {
        bail!("--frames starts at {}, but there are {}, counted from 0", frames.first, text::plural(count, "frame"));
    }
    let in_frames = shots.into_iter().zip(stems).enumerate().filter(|(i, _)| args.frames.is_none_or(|frames| frames.contains(*i)));
    let in_shard = in_frames.enumerate().filter(|(i, _)| args.shard.is_none_or(|shard| i % shard.count == shard.index));
    Ok(in_shard.map(|(_, (_, named))| job(named)).collect())
}

/// Depth where there is nothing, as in Blender.
const FAR: f32 = 1e10;

/// Writes the missing files of a job; returns whether half floats could not hold the image.
fn write(args: &RenderArgs, scene: &Scene, job: &Job, layers: Layers) -> Result<bool> {
    let Layers { mut image, alpha, depth } = layers;
    if let (Some(png), Some(tonemap)) = (&job.png, args.tonemap)
        && !png.is_file()
    {
        preview::write(png, &image, scene.color_space, Look { tonemap: tonemap.into(), exposure_ev: args.exposure })?;
    }
    if job.exr.is_file() {
        return Ok(false);
    }
    let color_space = args.colorspace.map_or(scene.color_space, Into::into);
    let conversion = Conversion::between(scene.color_space, color_space);
    for pixel in &mut image.pixels {
        *pixel = conversion.apply(scene.radiance_scale.restored(*pixel));
    }
    let options = ExrOptions {
        sample: args.exr_type.into(),
        color_space,
        numbers: vec![("luxel:radiance_scale".into(), scene.radiance_scale.get()), ("luxel:preview_exposure_ev".into(), args.exposure)],
        camera: Some(job.camera.clone()),
        alpha: args.alpha.then_some(alpha),
        depth: args.depth.then(|| depth.into_iter().map(|z| z.min(FAR)).collect()),
        ..ExrOptions::default()
    };
    let out_of_range = luxel_io::write_exr(&job.exr, &image, &options).context("cannot write an image")?;
    Ok(out_of_range > 0)
}

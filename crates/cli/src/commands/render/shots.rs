//! The cameras of `luxel render`: views of the data set, a file, or a path made from the views.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::camera_path::{Resized, camera_path, resized};
use luxel::edit::{mask_names, needs_dataset};
use luxel::export::Up;
use luxel::lens::{Lens, LensKind, pose_at, stereo_pair};
use luxel::output;
use luxel_app::run::ExplicitArgs;
use luxel_app::usd_space::{UsdSpace, is_usd_file};
use luxel_app::{files, text};
use luxel_core::{Camera, CameraProjection, Dataset, Scene};
use luxel_io::{PathCamera, StageChoice, StageMotion};

use crate::args::values::{Frames, LensArg, SplitArg};
use crate::args::{LoadArgs, RenderArgs};
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;

/// Frames of a path unless a number is given.
const PATH_FRAMES: usize = 120;

/// A camera and the name of its image.
#[derive(Clone)]
pub(super) struct Shot {
    pub(super) name: String,
    pub(super) camera: Camera,
    /// Distance in focus that a file states, world units.
    pub(super) focus_distance: Option<f64>,
}

impl Shot {
    fn new(name: impl Into<String>, camera: Camera) -> Self {
        Self { name: name.into(), camera, focus_distance: None }
    }

    /// Returns the shot with its camera in the world.
    pub(super) fn in_world(&self, scene: &Scene) -> Self {
        Self { camera: scene.world_camera(&self.camera), ..self.clone() }
    }
}

impl From<Shot> for PathCamera {
    fn from(Shot { name, camera, focus_distance }: Shot) -> Self {
        Self { name, camera, focus_distance }
    }
}

impl From<PathCamera> for Shot {
    fn from(PathCamera { name, camera, focus_distance }: PathCamera) -> Self {
        Self { name, camera, focus_distance }
    }
}

/// The cameras to render.
pub(super) struct Shots {
    /// All cameras that the options name, in order, before `frames` and `--shard`.
    pub(super) all: Vec<Shot>,
    /// The part of them that `--frames` names.
    pub(super) frames: Option<Frames>,
    /// Images of each frame: 2 for both eyes, else 1.
    pub(super) images_per_frame: usize,
    /// The stage that cameras are written for: that of the scene, upright as its data set is.
    pub(super) stage: Option<UsdSpace>,
}

impl Shots {
    /// Returns shots that are a frame each.
    fn new(all: Vec<Shot>, frames: Option<Frames>) -> Self {
        Self { all, frames, images_per_frame: 1, stage: None }
    }

    /// Returns the number of frames.
    pub(super) fn frames_len(&self) -> usize {
        self.all.len() / self.images_per_frame
    }
}

/// Returns the cameras that the options name, in the size that they name.
pub(super) fn shots(args: &RenderArgs, request: DataRequest<'_>, source: &SceneSource, console: &Console) -> Result<Shots> {
    let mut shots = named(args, request, source, console)?;
    match (args.projection, args.size) {
        (None, Some(size_px)) => resize(&mut shots.all, size_px, console)?,
        (None, None) => {}
        (Some(_), _) => {
            for shot in &mut shots.all {
                shot.camera = lens(args).camera(shot.camera.camera_from_world)?;
            }
        }
    }
    if let Some(distance) = args.stereo {
        // Cameras are in the scene's coordinates.
        let local = f64::from(distance) / source.scene.world_from_local.scale();
        shots.all = shots.all.into_iter().flat_map(|shot| eyes(&shot, local)).collect();
        shots.images_per_frame = 2;
        if shots.all.iter().any(|shot| shot.camera.projection == CameraProjection::Equirectangular) {
            console.note("both eyes of a panorama look ahead: depth is right around its middle, and vanishes towards the sides");
        }
    }
    Ok(shots)
}

/// Returns the lens that the options name; a pinhole if they name none.
fn lens(args: &RenderArgs) -> Lens {
    let kind = args.projection.map_or(LensKind::Pinhole, Into::into);
    Lens { kind, field_deg: args.fov.map(f64::from), size_px: args.size }
}

/// Returns the shots of both eyes.
fn eyes(shot: &Shot, distance: f64) -> [Shot; 2] {
    let [left, right] = stereo_pair(&shot.camera, distance);
    [("left", left), ("right", right)].map(|(eye, camera)| Shot {
        name: format!("{}_{eye}", shot.name),
        camera,
        focus_distance: shot.focus_distance,
    })
}

fn named(args: &RenderArgs, request: DataRequest<'_>, source: &SceneSource, console: &Console) -> Result<Shots> {
    let dataset = || source.dataset(request, console);
    if let Some(at) = args.at {
        let dataset = dataset()?;
        let stage = stage(source, dataset.as_ref())?;
        let camera = lens(args).camera(pose_at(at, Up::Default, dataset.as_ref())?)?;
        let shot = Shot::new(lens_name(args), source.scene.local_camera(&camera));
        return Ok(Shots { stage: Some(stage), ..Shots::new(vec![shot], None) });
    }
    if let Some(file) = args.cameras.as_deref().filter(|file| is_usd_file(file)) {
        return layer(args, file, source, dataset()?.as_ref(), console);
    }
    if let Some(file) = &args.cameras {
        if args.camera.is_some() {
            bail!("{}: --camera chooses one of an OpenUSD file, which this is not", file.display());
        }
        let upright = if is_written_as_usd(args) { source.dataset(request, console)? } else { None };
        let stage = stage(source, upright.as_ref())?;
        let cameras = camera_file(file, args.input.data.is_some(), dataset, || check_unread(args, file, request.explicit))?;
        let mut all: Vec<Shot> = cameras.into_iter().map(Into::into).collect();
        all.iter_mut().for_each(|shot| shot.camera = source.scene.local_camera(&shot.camera));
        return Ok(Shots { stage: Some(stage), ..Shots::new(all, args.frames) });
    }
    let Some(dataset) = dataset()? else {
        bail!("{}: a scene file has no cameras; give --data DATASET or --cameras FILE", args.input.scene.display())
    };
    let stage = Some(stage(source, Some(&dataset))?);
    if let Some(kind) = args.path {
        let frames = path_frames(args.frames)?;
        let path = camera_path(&dataset, kind.into(), frames)?;
        console.note(&format!("{}, {}", path.description, text::plural(frames, "frame")));
        return Ok(Shots { stage, ..Shots::new(path.cameras.into_iter().map(Into::into).collect(), None) });
    }
    let all = views(&dataset, args.split);
    if all.is_empty() {
        bail!("the data set has no views in this split; choose another --split");
    }
    Ok(Shots { stage, ..Shots::new(all, args.frames) })
}

/// Returns the stage of a scene.
fn stage(source: &SceneSource, dataset: Option<&Dataset>) -> Result<UsdSpace> {
    Ok(UsdSpace::new(source.scene.metres_per_unit, Up::Default, dataset)?)
}

/// Returns the cameras of an OpenUSD file.
fn layer(args: &RenderArgs, file: &Path, source: &SceneSource, dataset: Option<&Dataset>, console: &Console) -> Result<Shots> {
    let stage = stage(source, dataset)?;
    if dataset.is_none() {
        console.note(&format!("{}: no data set tells where up is: -y of the scene, as in its export without one", file.display()));
    }
    let first = dataset.and_then(|dataset| dataset.train.first().or(dataset.test.first()));
    let choice = StageChoice { camera: args.camera.as_deref(), size_px: args.size.or(first.map(|view| view.camera.size_px)) };
    let found = stage.read_cameras(file, choice)?;
    let cameras = text::plural(found.cameras.len(), "camera");
    match (found.metres_per_unit, source.scene.metres_per_unit) {
        (None, _) => console.note(&format!("{}: {cameras}; no metersPerUnit: lengths are those of the scene", file.display())),
        (Some(_), _) if (found.factor - 1.0).abs() < 1e-9 => console.note(&format!("{}: {cameras}", file.display())),
        (Some(metres), own) => {
            let own = own.map_or_else(|| "1, since it is unknown".to_owned(), |own| own.to_string());
            let factor = found.factor;
            console
                .note(&format!("{}: {cameras}; lengths times {factor:.6}: metersPerUnit is {metres}, the scene's {own}", file.display()));
        }
    }
    let shot = |named: PathCamera| Shot { camera: source.scene.local_camera(&named.camera), ..named.into() };
    let all = found.cameras.into_iter().map(shot).collect();
    Ok(Shots { stage: Some(stage), ..Shots::new(all, args.frames) })
}

/// Returns whether --write-cameras asks for OpenUSD.
fn is_written_as_usd(args: &RenderArgs) -> bool {
    let extension = args.write_cameras.as_deref().and_then(Path::extension);
    extension.is_some_and(|e| ["usda", "usd"].iter().any(|known| e.eq_ignore_ascii_case(known)))
}

/// A file of cameras to write.
pub(super) struct CameraText {
    path: PathBuf,
    text: String,
    count: usize,
}

impl CameraText {
    /// Writes the file, unless it is there as it would be.
    pub(super) fn write(&self, overwrite: bool, console: &Console) -> Result<()> {
        if luxel_io::read_file(&self.path).is_ok_and(|found| found == self.text.as_bytes()) {
            return Ok(());
        }
        output::check_free(&self.path, overwrite)?;
        files::write_text(&self.path, &self.text)?;
        console.note(&format!("{}: {}", self.path.display(), text::plural(self.count, "camera")));
        Ok(())
    }
}

/// Returns what --write-cameras asks for, of the shots in the world.
pub(super) fn file_of_cameras(args: &RenderArgs, shots: &Shots, world: Option<&[Shot]>) -> Result<Option<CameraText>> {
    let (Some(path), Some(world)) = (&args.write_cameras, world) else { return Ok(None) };
    let cameras: Vec<PathCamera> = world.iter().cloned().map(PathCamera::from).collect();
    let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    let text = match &shots.stage {
        _ if is_json => luxel_io::camera_file_text(&cameras),
        Some(stage) if is_written_as_usd(args) => {
            let is_still = args.cameras.is_none() && args.path.is_none();
            let moving = StageMotion::Moving { frames_per_second: f64::from(args.fps) };
            stage.cameras_text(path, &cameras, if is_still { StageMotion::Still } else { moving })?
        }
        _ => bail!("{}: cameras are written as .json, or as OpenUSD text, .usda or .usd; choose one of these extensions", path.display()),
    };
    Ok(Some(CameraText { path: path.clone(), text, count: cameras.len() }))
}

/// Returns the number of frames of a path.
fn path_frames(frames: Option<Frames>) -> Result<usize> {
    match frames {
        None => Ok(PATH_FRAMES),
        Some(Frames { first, last }) if first == last && first > 0 => Ok(first),
        Some(Frames { first, last }) => {
            bail!("--frames {first}-{last}: with --path, expected the number of frames, 1 or more; --shard I/N renders a part of them")
        }
    }
}

/// Returns the name of an image at a point.
fn lens_name(args: &RenderArgs) -> &'static str {
    match args.projection {
        None | Some(LensArg::Pinhole) => "view",
        Some(LensArg::Fisheye) => "fisheye",
        Some(LensArg::Equirectangular) => "panorama",
    }
}

/// Gives all cameras another image size, and reports what is cropped.
fn resize(shots: &mut [Shot], size_px: [u32; 2], console: &Console) -> Result<()> {
    let mut most = [0.0f64; 2];
    for shot in shots.iter_mut() {
        let projection = shot.camera.projection;
        if !projection.is_pinhole() {
            bail!(
                "{}: the camera has {} projection, whose field a size cannot crop; give --projection with --size",
                shot.name,
                projection.name()
            );
        }
        let Resized { camera, cropped } = resized(&shot.camera, size_px);
        most = [most[0].max(cropped[0]), most[1].max(cropped[1])];
        shot.camera = camera;
    }
    for (part, side, ends) in [(most[0], "width", "left and right"), (most[1], "height", "top and bottom")] {
        // Sizes that differ by less than a pixel have the same shape.
        if part * f64::from(size_px[0].max(size_px[1])) >= 1.0 {
            let [width, height] = size_px;
            console.note(&format!("{width}x{height}: {:.1} % of the {side} of the views is cropped, {ends} alike", 100.0 * part));
        }
    }
    Ok(())
}

/// Writes the cameras of a path beside its frames, unless they are there.
pub(super) fn write_path(folder: &Path, shots: &[Shot], overwrite: bool, console: &Console) -> Result<()> {
    let path = folder.join("cameras.json");
    let cameras: Vec<PathCamera> = shots.iter().cloned().map(PathCamera::from).collect();
    let content = luxel_io::camera_file_text(&cameras);
    if luxel_io::read_file(&path).is_ok_and(|found| found == content.as_bytes()) {
        return Ok(());
    }
    output::check_free(&path, overwrite)?;
    files::write_text(&path, &content)?;
    console.note(&format!("{}: {}", path.display(), text::plural(cameras.len(), "camera")));
    Ok(())
}

/// Refuses options of reading a data set where neither cameras nor masks need one.
fn check_unread(args: &RenderArgs, file: &Path, explicit: &ExplicitArgs) -> Result<()> {
    let stack = super::stack(args)?.unwrap_or_default();
    if stack.floaters || mask_names(&stack.selecting()).into_iter().any(needs_dataset) {
        return Ok(());
    }
    LoadArgs::refuse(explicit, &[], &format!("and {} describes its cameras without one; leave it out", file.display()))
}

/// Reads the cameras of a file. The data set completes what the file leaves out; it is read only if
/// asked for or needed, and `unread` is called otherwise.
pub(in crate::commands) fn camera_file(
    file: &Path,
    asked: bool,
    dataset: impl FnOnce() -> Result<Option<Dataset>>,
    unread: impl FnOnce() -> Result<()>,
) -> Result<Vec<PathCamera>> {
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
    Ok(cameras)
}

fn views(dataset: &Dataset, split: SplitArg) -> Vec<Shot> {
    let (train, test): (&[_], &[_]) = match split {
        SplitArg::Train => (&dataset.train, &[]),
        SplitArg::Test => (&[], &dataset.test),
        SplitArg::All => (&dataset.train, &dataset.test),
    };
    let mut shots: Vec<Shot> = train.iter().chain(test).map(|view| Shot::new(&view.name, view.camera.clone())).collect();
    // Both lists are sorted; together they are sorted again, so that frame numbers follow the
    // capture.
    shots.sort_by(|a, b| a.name.cmp(&b.name));
    shots
}

//! The cameras of `luxel render`: views of the data set, a file, or a path made from the views.

use std::path::Path;

use anyhow::{Context, Result, bail};
use luxel::camera_path::{Resized, camera_path, resized};
use luxel::edit::{mask_names, needs_dataset};
use luxel::export::Up;
use luxel::lens::{Lens, LensKind, pose_at, stereo_pair};
use luxel::run::ExplicitArgs;
use luxel::{files, output, text};
use luxel_core::{Camera, CameraProjection, Dataset, Scene};
use luxel_io::PathCamera;

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
}

impl Shot {
    /// Returns the shot with its camera in the world.
    pub(super) fn in_world(&self, scene: &Scene) -> Self {
        Self { name: self.name.clone(), camera: scene.world_camera(&self.camera) }
    }
}

impl From<PathCamera> for Shot {
    fn from(PathCamera { name, camera }: PathCamera) -> Self {
        Self { name, camera }
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
}

impl Shots {
    /// Returns shots that are a frame each.
    fn new(all: Vec<Shot>, frames: Option<Frames>) -> Self {
        Self { all, frames, images_per_frame: 1 }
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
    [("left", left), ("right", right)].map(|(eye, camera)| Shot { name: format!("{}_{eye}", shot.name), camera })
}

fn named(args: &RenderArgs, request: DataRequest<'_>, source: &SceneSource, console: &Console) -> Result<Shots> {
    let dataset = || source.dataset(request, console);
    if let Some(at) = args.at {
        let dataset = dataset()?;
        let camera = lens(args).camera(pose_at(at, Up::Default, dataset.as_ref())?)?;
        let shot = Shot { name: lens_name(args).to_owned(), camera: source.scene.local_camera(&camera) };
        return Ok(Shots::new(vec![shot], None));
    }
    if let Some(file) = &args.cameras {
        let mut all = camera_file(file, args.input.data.is_some(), dataset, || check_unread(args, file, request.explicit))?;
        all.iter_mut().for_each(|shot| shot.camera = source.scene.local_camera(&shot.camera));
        return Ok(Shots::new(all, args.frames));
    }
    let Some(dataset) = dataset()? else {
        bail!("{}: a scene file has no cameras; give --data DATASET or --cameras FILE", args.input.scene.display())
    };
    if let Some(kind) = args.path {
        let frames = path_frames(args.frames)?;
        let path = camera_path(&dataset, kind.into(), frames)?;
        console.note(&format!("{}, {}", path.description, text::plural(frames, "frame")));
        return Ok(Shots::new(path.cameras.into_iter().map(Into::into).collect(), None));
    }
    let all = views(&dataset, args.split);
    if all.is_empty() {
        bail!("the data set has no views in this split; choose another --split");
    }
    Ok(Shots::new(all, args.frames))
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
    let cameras: Vec<PathCamera> = shots.iter().map(|shot| PathCamera { name: shot.name.clone(), camera: shot.camera.clone() }).collect();
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

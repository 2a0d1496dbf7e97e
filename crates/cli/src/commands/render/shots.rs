//! The cameras of `luxel render`: views of the data set, a file, or a path made from the views.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::camera_path::{PathKind, Resized, camera_path, resized};
use luxel::export::Up;
use luxel::lens::{Lens, LensKind, pose_at, stereo_pair};
use luxel::output;
use luxel_app::usd_space::UsdSpace;
use luxel_app::{files, text};
use luxel_core::{Camera, CameraProjection, Dataset, Scene};
use luxel_io::{PathCamera, StageChoice};

use super::plan::{CameraChoice, CameraFileForm, CameraPlan, RenderPlan};
use crate::args::LoadArgs;
use crate::args::values::SplitArg;
use crate::inputs::scene_source::SceneSource;
use crate::output::console::Console;

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

    /// Returns the camera in the world.
    fn in_world(&self, scene: &Scene) -> PathCamera {
        let Self { name, camera, focus_distance } = self;
        PathCamera { name: name.clone(), camera: scene.world_camera(camera), focus_distance: *focus_distance }
    }

    /// Returns the shot of a camera in the world.
    fn of_world(PathCamera { name, camera, focus_distance }: PathCamera, scene: &Scene) -> Self {
        Self { name, camera: scene.local_camera(&camera), focus_distance }
    }
}

/// The cameras to render.
pub(super) struct Shots {
    /// All cameras that the options name, in order, before `--frames` and `--shard`.
    pub(super) all: Vec<Shot>,
    /// Images of each frame: 2 for both eyes, else 1.
    pub(super) images_per_frame: usize,
    /// The stage that cameras are written for: that of the scene, upright as its data set is.
    stage: UsdSpace,
}

impl Shots {
    /// Returns shots that are a frame each.
    fn new(all: Vec<Shot>, stage: UsdSpace) -> Self {
        Self { all, images_per_frame: 1, stage }
    }

    /// Returns the number of frames.
    pub(super) fn frames_len(&self) -> usize {
        self.all.len() / self.images_per_frame
    }

    /// Returns the files of cameras that are to be written: those of a path, beside its frames, and
    /// what --write-cameras asks for.
    pub(super) fn files(&self, plan: &RenderPlan<'_>, scene: &Scene) -> Result<Vec<CameraText>> {
        let in_world = || self.all.iter().map(|shot| shot.in_world(scene)).collect::<Vec<_>>();
        let mut files = Vec::new();
        if let CameraChoice::Path { .. } = plan.cameras.choice {
            let text = luxel_io::camera_file_text(&in_world());
            files.push(CameraText { path: plan.files.folder.join("cameras.json"), text, count: self.all.len() });
        }
        if let Some(written) = &plan.cameras.written {
            let text = match written.form {
                CameraFileForm::Json => luxel_io::camera_file_text(&in_world()),
                CameraFileForm::Usd(motion) => self.stage.cameras_text(written.path, &in_world(), motion)?,
            };
            files.push(CameraText { path: written.path.to_owned(), text, count: self.all.len() });
        }
        Ok(files)
    }
}

/// Returns the cameras that the options name, in the size that they name.
pub(super) fn shots(plan: &RenderPlan<'_>, source: &SceneSource, console: &Console) -> Result<Shots> {
    let CameraPlan { lens, size_px, eye_distance, .. } = &plan.cameras;
    let mut shots = named(plan, source, console)?;
    match (lens, size_px) {
        (None, Some(size_px)) => resize(&mut shots.all, *size_px, console)?,
        (None, None) => {}
        (Some(lens), _) => {
            for shot in &mut shots.all {
                shot.camera = lens.camera(shot.camera.camera_from_world)?;
            }
        }
    }
    if let Some(distance) = eye_distance {
        // Cameras are in the scene's coordinates.
        let local = distance / source.scene.world_from_local.scale();
        shots.all = shots.all.into_iter().flat_map(|shot| eyes(&shot, local)).collect();
        shots.images_per_frame = 2;
        if shots.all.iter().any(|shot| shot.camera.projection == CameraProjection::Equirectangular) {
            console.note("both eyes of a panorama look ahead: depth is right around its middle, and vanishes towards the sides");
        }
    }
    Ok(shots)
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

fn named(plan: &RenderPlan<'_>, source: &SceneSource, console: &Console) -> Result<Shots> {
    let dataset = || source.dataset(plan.data, console);
    let required = || {
        dataset()?.with_context(|| format!("{}: a scene file has no cameras; give --data DATASET or --cameras FILE", plan.scene.display()))
    };
    match plan.cameras.choice {
        CameraChoice::At(at) => at_point(plan, at, source, dataset()?.as_ref()),
        CameraChoice::Stage { file, camera } => {
            let choice = StageChoice { camera, size_px: plan.cameras.size_px };
            of_stage(file, choice, source, dataset()?.as_ref(), console)
        }
        CameraChoice::File(file) => of_file(plan, file, source, console),
        CameraChoice::Path { kind, frames } => along_path(&required()?, kind, frames, source, console),
        CameraChoice::Views(split) => of_views(&required()?, split, source),
    }
}

/// Returns the stage of a scene.
fn stage(source: &SceneSource, dataset: Option<&Dataset>) -> Result<UsdSpace> {
    Ok(UsdSpace::new(source.scene.metres_per_unit, Up::Default, dataset)?)
}

/// Returns the camera at a point of the world.
fn at_point(plan: &RenderPlan<'_>, at: [f64; 3], source: &SceneSource, dataset: Option<&Dataset>) -> Result<Shots> {
    let lens = plan.cameras.lens.unwrap_or(Lens { kind: LensKind::Pinhole, field_deg: None, size_px: plan.cameras.size_px });
    let camera = lens.camera(pose_at(at, Up::Default, dataset)?)?;
    let name = match lens.kind {
        LensKind::Pinhole => "view",
        LensKind::Fisheye => "fisheye",
        LensKind::Equirectangular => "panorama",
    };
    Ok(Shots::new(vec![Shot::new(name, source.scene.local_camera(&camera))], stage(source, dataset)?))
}

/// Returns the cameras of a file that is not OpenUSD.
fn of_file(plan: &RenderPlan<'_>, file: &Path, source: &SceneSource, console: &Console) -> Result<Shots> {
    let dataset = || source.dataset(plan.data, console);
    let is_usd_written = plan.cameras.written.as_ref().is_some_and(|written| matches!(written.form, CameraFileForm::Usd(_)));
    let upright = if is_usd_written { dataset()? } else { None };
    let stage = stage(source, upright.as_ref())?;
    // Options of reading a data set decide nothing where neither cameras nor masks need one.
    let unread = || match plan.edits_need_dataset() {
        true => Ok(()),
        false => {
            LoadArgs::refuse(plan.data.explicit, &[], &format!("and {} describes its cameras without one; leave it out", file.display()))
        }
    };
    let cameras = camera_file(file, plan.data.data.is_some(), dataset, unread)?;
    Ok(Shots::new(cameras.into_iter().map(|camera| Shot::of_world(camera, &source.scene)).collect(), stage))
}

/// Returns the frames of a path made from the views of a data set.
fn along_path(dataset: &Dataset, kind: PathKind, frames: usize, source: &SceneSource, console: &Console) -> Result<Shots> {
    let path = camera_path(dataset, kind, frames)?;
    console.note(&format!("{}, {}", path.description, text::plural(frames, "frame")));
    let shot = |PathCamera { name, camera, focus_distance }| Shot { name, camera, focus_distance };
    Ok(Shots::new(path.cameras.into_iter().map(shot).collect(), stage(source, Some(dataset))?))
}

/// Returns the views of a data set, in the order of their names.
fn of_views(dataset: &Dataset, split: SplitArg, source: &SceneSource) -> Result<Shots> {
    let (train, test): (&[_], &[_]) = match split {
        SplitArg::Train => (&dataset.train, &[]),
        SplitArg::Test => (&[], &dataset.test),
        SplitArg::All => (&dataset.train, &dataset.test),
    };
    let mut shots: Vec<Shot> = train.iter().chain(test).map(|view| Shot::new(&view.name, view.camera.clone())).collect();
    if shots.is_empty() {
        bail!("the data set has no views in this split; choose another --split");
    }
    // Both lists are sorted; together they are sorted again, so that frame numbers follow the
    // capture.
    shots.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(Shots::new(shots, stage(source, Some(dataset))?))
}

/// Returns the cameras of an OpenUSD file.
fn of_stage(file: &Path, choice: StageChoice<'_>, source: &SceneSource, dataset: Option<&Dataset>, console: &Console) -> Result<Shots> {
    let stage = stage(source, dataset)?;
    if dataset.is_none() {
        console.note(&format!("{}: no data set tells where up is: -y of the scene, as in its export without one", file.display()));
    }
    let first = dataset.and_then(|dataset| dataset.train.first().or(dataset.test.first()));
    let choice = StageChoice { size_px: choice.size_px.or(first.map(|view| view.camera.size_px)), ..choice };
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
    Ok(Shots::new(found.cameras.into_iter().map(|camera| Shot::of_world(camera, &source.scene)).collect(), stage))
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

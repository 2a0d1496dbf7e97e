//! The newest readable state of a run: checkpoints to resume from, and scenes to render.

use std::path::{Path, PathBuf};

use luxel::error::Context;
use luxel::step_methods::{check_is_built, step_methods};
use luxel::{Error, Observer, Result, SelectedEngine};
use luxel_core::{Dataset, Knots, Remedy, Scene, Snapshot};
use luxel_io::Supervision;
use luxel_train::{LensVignetting, Representation};

use super::{Captures, RunConfig, RunFolder};

/// Returns the newest checkpoint that `read` can read, to continue from; `None` if the run ended
/// before its first. Damaged newer ones are reported and renamed: they must not count as the newest
/// when old ones are deleted.
///
/// # Errors
/// Checkpoints of which none can be read; a folder that cannot be read.
pub(super) fn take_checkpoint<T>(
    folder: &RunFolder,
    read: impl Fn(&Path) -> Result<T>,
    observer: &dyn Observer,
) -> Result<Option<(PathBuf, T)>> {
    let mut damaged = Vec::new();
    let mut newest = None;
    for file in luxel_io::list_checkpoints(folder.root())? {
        match read(&file.path) {
            Ok(state) => {
                newest = Some((file.path, state));
                break;
            }
            Err(error) => {
                observer.warn(&format!("skipping a damaged checkpoint: {error:#}"));
                damaged.push(file.path);
            }
        }
    }
    if newest.is_none() && !damaged.is_empty() {
        let error = Error::new(format!("{}: none of the {} checkpoints can be read", folder.root().display(), damaged.len()));
        return Err(error.with_remedy(start_anew()));
    }
    for path in damaged {
        luxel_io::check_within(folder.root(), &path)?;
        let mut aside = path.clone().into_os_string();
        aside.push(".damaged");
        std::fs::rename(&path, &aside).with_context(|| format!("{}: cannot set aside", path.display()))?;
    }
    Ok(newest)
}

/// Returns the newest checkpoint's path, for messages.
pub fn newest_checkpoint(folder: &RunFolder) -> Option<PathBuf> {
    luxel_io::list_checkpoints(folder.root()).ok()?.into_iter().next().map(|file| file.path)
}

/// Returns a run's newest scene that can be read, with its step: from `point_cloud/`, or from a
/// newer checkpoint.
///
/// # Errors
/// A run of a radiance field or of anchors, which have no splats; a run without a readable scene.
pub fn newest_scene(folder: &RunFolder, observer: &dyn Observer) -> Result<(u32, Scene)> {
    crate::non_splat::refuse(folder)?;
    enum Source {
        Scene(PathBuf),
        Checkpoint(PathBuf),
    }
    let scenes = folder.scene_iterations().into_iter().map(|n| (u64::from(n), Source::Scene(folder.scene(n))));
    let states = luxel_io::list_checkpoints(folder.root())?.into_iter().map(|file| (file.iteration, Source::Checkpoint(file.path)));
    let mut candidates: Vec<(u64, Source)> = scenes.chain(states).collect();
    // Newest first; of the same step the scene, which is smaller, stays first.
    candidates.sort_by_key(|(iteration, _)| std::cmp::Reverse(*iteration));
    for (iteration, source) in candidates {
        let scene = match source {
            Source::Scene(path) => luxel_io::read_scene_file(&path).map(|file| {
                file.warnings.iter().for_each(|warning| observer.warn(&format!("{}: {warning}", path.display())));
                file.scene
            }),
            Source::Checkpoint(path) => match luxel_io::read_checkpoint(&path) {
                Ok(snapshot) => {
                    let no_scene = || format!("{}: no scene", path.display());
                    check_is_built(luxel_train::snapshot_config(&snapshot).with_context(no_scene)?.method).with_context(no_scene)?;
                    let scene = luxel_train::snapshot_scene(snapshot, step_methods()).with_context(no_scene)?;
                    return Ok((u32::try_from(iteration)?, scene));
                }
                Err(error) => Err(error),
            },
        };
        match scene {
            Ok(scene) => return Ok((u32::try_from(iteration)?, scene)),
            Err(error) => observer.warn(&format!("skipping a damaged file: {error}")),
        }
    }
    Err(Error::new(format!("{}: the run has no readable scene yet", folder.root().display())).with_remedy(continue_run()))
}

/// Reads the scene at `path`, a scene file or the newest scene of a run folder, and reports what
/// was left out or assumed.
///
/// # Errors
/// As [`luxel::Scene::open`]; a folder that is not a run, or has no scene yet.
pub fn open_scene(path: impl AsRef<Path>, observer: &dyn Observer) -> Result<luxel::Scene> {
    let path = path.as_ref();
    if !path.is_dir() {
        return luxel::Scene::open_reporting(path, observer);
    }
    let (folder, _) = RunFolder::open(path)?;
    Ok(newest_scene(&folder, observer)?.1.into())
}

/// A run's newest scene, of any kind, in an engine that renders it as its method does.
pub struct LoadedRun {
    /// Steps of training.
    pub iteration: u32,
    /// The scene; that of a field or of anchors has their units and place, and no splats. That of a
    /// method that lifts colours is without the lift, which the engine has.
    pub scene: Scene,
    /// The engine.
    pub selected: SelectedEngine,
    /// The field or the anchors; `None` for splats.
    pub non_splat: Option<LoadedNonSplat>,
}

/// Facts about a field or anchors that an engine holds.
pub struct LoadedNonSplat {
    /// Number of a field's parameters.
    pub field_parameters: Option<usize>,
    /// The camera's response, if it was learned.
    pub response: Option<Knots>,
}

/// Loads a run's newest state that can be read, of any kind, for rendering. Fields and anchors are
/// rendered on the processor: `selected` says with how many threads. Colours that a method lifts
/// are lifted as in training, by the checkpoint of that step.
///
/// # Errors
/// A run without a readable state; an engine of a GPU for a field or anchors; a device that gave
/// up; a checkpoint that is not there where colours are lifted.
pub fn load_newest(folder: &RunFolder, config: &RunConfig, mut selected: SelectedEngine, observer: &dyn Observer) -> Result<LoadedRun> {
    if !config.train.method.stores_splats() {
        let (iteration, found) = crate::non_splat::newest_scene(folder, observer)?;
        let field_parameters = (config.train.method.spec().representation == Representation::Field).then(|| found.parameter_count());
        let (scene, loaded) = (found.place.clone(), LoadedNonSplat { field_parameters, response: found.response() });
        return Ok(LoadedRun { iteration, scene, selected: found.into_engine(selected)?, non_splat: Some(loaded) });
    }
    let (iteration, scene) = newest_scene(folder, observer)?;
    if config.train.method.lifts_colors() {
        check_is_built(config.train.method)?;
        let (path, snapshot) = snapshot_of(folder, iteration, "the lift to radiance")?;
        let lifted = luxel_train::lifted_engine(&snapshot, selected.engine, step_methods())
            .with_context(|| format!("{}: no lift", path.display()))?;
        let engine = lifted.with_context(|| format!("{}: its method lifts no colours", path.display()))?;
        return Ok(LoadedRun { iteration, scene, selected: SelectedEngine { engine, ..selected }, non_splat: None });
    }
    selected.engine.load(&scene.splats, None).context("cannot load the scene")?;
    Ok(LoadedRun { iteration, scene, selected, non_splat: None })
}

/// Returns the camera response that belongs to a run's scene of `iteration` steps: that of its
/// field or anchors, or from the evaluation of that step, or from its checkpoint, which only an
/// interrupted run has. `None` for a run on radiance.
///
/// # Errors
/// A run of splats on captured LDR images that has neither.
pub fn response(folder: &RunFolder, config: &RunConfig, iteration: u32, non_splat: Option<&LoadedNonSplat>) -> Result<Option<Knots>> {
    if let Some(non_splat) = non_splat {
        return Ok(non_splat.response);
    }
    if config.load.supervision != Supervision::Ldr {
        return Ok(None);
    }
    if let Some(response) = Captures::read(folder)?.response_at(iteration) {
        return Ok(Some(response));
    }
    check_is_built(config.train.method)?;
    let (path, snapshot) = snapshot_of(folder, iteration, "the camera's response")?;
    luxel_train::snapshot_response(&snapshot, step_methods()).with_context(|| format!("{}: no response of a camera", path.display()))
}

/// Returns the vignetting that belongs to a run's scene of `iteration` steps, from where
/// [`response`] looks; empty for a run that does not learn it. `dataset` is the run's own.
///
/// # Errors
/// A run that learns it and has it nowhere.
pub fn vignetting(folder: &RunFolder, config: &RunConfig, dataset: &Dataset, iteration: u32) -> Result<Vec<LensVignetting>> {
    if !config.train.vignetting {
        return Ok(Vec::new());
    }
    if let Some(lenses) = Captures::read(folder)?.vignetting_at(iteration) {
        return Ok(lenses.to_vec());
    }
    let (path, snapshot) = snapshot_of(folder, iteration, "the vignetting")?;
    luxel_train::snapshot_vignetting(&snapshot, dataset).with_context(|| format!("{}: no vignetting", path.display()))
}

/// Reads the checkpoint of step `iteration`, which has what `captures.json` does not have.
fn snapshot_of(folder: &RunFolder, iteration: u32, what: &str) -> Result<(PathBuf, Snapshot)> {
    let states = luxel_io::list_checkpoints(folder.root())?;
    let Some(file) = states.iter().find(|file| file.iteration == u64::from(iteration)) else {
        let message = format!("{}: {what} of step {iteration} not found in captures.json or any checkpoint", folder.root().display());
        return Err(Error::new(message).with_remedy(continue_run()));
    };
    Ok((file.path.clone(), luxel_io::read_checkpoint(&file.path)?))
}

/// Returns the remedy for a run that has not come far enough.
pub(crate) fn continue_run() -> Remedy {
    Remedy::set("resume", "true")
}

/// Returns the remedy for a run that cannot continue.
pub(crate) fn start_anew() -> Remedy {
    Remedy::set("overwrite", "true")
}

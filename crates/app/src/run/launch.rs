//! Starting and resuming a run.
//!
//! In: a [`RunConfig`], an engine, a [`RunFolder`]; out: a trained scene, in the folder and in
//! memory. The data set is read and the settings are checked before anything in the folder is
//! touched.

use std::path::Path;
use std::time::Instant;

use luxel::error::{Context, bail};
use luxel::memory::RunMemory;
use luxel::step_methods::means_of;
use luxel::{Dataset, Error, ImageLimits, Observer, Result, Scene, SelectedEngine, StopFlag};
use luxel_core::{Dataset as CoreDataset, Engine, Exchange, Remedy, SingleProcess, Snapshot};
use luxel_io::{ImageMemory, ImagePlan, system_memory};
use luxel_train::{Method, RankViews, Reconstruction, SceneContent, SceneSize, TrainConfig, Trainer};

use super::ranks::{keeps, tell_settings, tell_state, views_of};
use super::{Outcome, RunConfig, RunFolder, RunLock, Session, state};
use crate::{blocks, non_splat, text};

/// The place of a run, its observer and its stop flag.
#[derive(Clone, Copy)]
pub struct Launch<'a> {
    /// Folder of the run.
    pub folder: &'a RunFolder,
    /// Receives notes, warnings, progress and evaluations.
    pub observer: &'a dyn Observer,
    /// Asks the run to save its state and end.
    pub stop: &'a StopFlag,
}

/// The result of a run.
pub struct TrainedRun {
    /// Finished or interrupted.
    pub outcome: Outcome,
    /// The settings of the run.
    pub config: RunConfig,
    /// The reconstruction, which holds the scene.
    pub trainer: Box<dyn Reconstruction>,
    /// The training and test views.
    pub dataset: Dataset,
    /// Steps made by this call.
    pub steps: u32,
}

impl TrainedRun {
    /// Returns the scene.
    ///
    /// # Errors
    /// A device that gave up; a radiance field or anchors, which store no splats.
    pub fn scene(&mut self) -> Result<Scene> {
        match self.trainer.content()? {
            SceneContent::Splats(scene) => Ok((*scene).into()),
            SceneContent::Arrays(_) => Err(Error::new(format!("method {} stores no splats", self.config.method_name()))),
        }
    }
}

/// A run that is ready for its loop.
struct ReadyRun {
    dataset: Dataset,
    trainer: Box<dyn Reconstruction>,
    threads: usize,
    /// Place where the engine runs, for people.
    machine: String,
    /// The same without a reason, for comparisons.
    computed_by: String,
    lock: RunLock,
    /// The moment at which this process began with the run.
    since: Instant,
}

/// Runs from the first step. `make_room` is called once the data set has been read and the settings
/// are accepted, and returns the folder's lock.
///
/// # Errors
/// Settings, data or a folder that cannot be used; a step or a file that fails.
pub fn fresh(
    config: RunConfig,
    selected: SelectedEngine,
    launch: Launch<'_>,
    make_room: impl FnOnce(&CoreDataset) -> Result<RunLock>,
) -> Result<TrainedRun> {
    fresh_over(Box::new(SingleProcess), config, selected, launch, make_room)
}

/// Runs as [`fresh`] does, as rank 0 of a distributed run; the other ranks [`super::follow`].
///
/// # Errors
/// As [`fresh`]; ranks that cannot be reached.
pub fn fresh_over(
    mut exchange: Box<dyn Exchange>,
    config: RunConfig,
    selected: SelectedEngine,
    launch: Launch<'_>,
    make_room: impl FnOnce(&CoreDataset) -> Result<RunLock>,
) -> Result<TrainedRun> {
    let since = Instant::now();
    let SelectedEngine { mut engine, threads, machine, computed_by, gpu, .. } = selected;
    let of_block = blocks::train_config(&config.dataset_path(launch.folder.root()), config.train.clone())?;
    let config = RunConfig { train: of_block, ..config };
    config.validate().context("cannot start training")?;
    check_time(&config, &*exchange)?;
    let config = resolve_images(config, launch)?;
    // Settings without a text form must not cost the run that is to be replaced.
    config.to_toml().with_context(|| format!("{}: config.toml cannot hold these settings", config.dataset.display()))?;
    tell_settings(&mut *exchange, &config, launch.folder)?;
    let views = views_of(&*exchange, &config);
    let scene = first_scene(&config, launch.observer)?;
    let start = RunStart { is_on_gpu: gpu.is_some(), scene_splats: scene.as_ref().map(|scene| scene.splats.len() as u64) };
    let dataset = open_dataset(&config.dataset_path(launch.folder.root()), &config, launch, start, views)?;
    limit_images(engine.as_mut(), &config);
    let trainer = first_trainer(&config, scene, &dataset, Means { threads, engine, exchange })?;
    // The trainer decides what the options leave open: samples per pixel, and with frozen geometry
    // the rasteriser's settings of its scene.
    let config = RunConfig { train: trainer.config().clone(), ..config };
    let lock = make_room(&dataset)?;
    launch.folder.write_config(&config)?;
    train(config, launch, ReadyRun { dataset, trainer, threads, machine, computed_by, lock, since })
}

/// Gives the reduction of the images as a number: whatever continues, measures or repeats the run
/// reads them as it does, and so does every rank.
fn resolve_images(config: RunConfig, launch: Launch<'_>) -> Result<RunConfig> {
    let load = Dataset::resolve_options(config.dataset_path(launch.folder.root()), &config.load, launch.observer)?;
    Ok(RunConfig { load, ..config })
}

/// Reads the scene that a run starts from, if it does.
fn first_scene(config: &RunConfig, observer: &dyn Observer) -> Result<Option<Scene>> {
    config.run.from.as_deref().map(|path| state::open_scene(path, observer)).transpose()
}

/// The means of a training.
struct Means {
    threads: usize,
    engine: Box<dyn Engine>,
    exchange: Box<dyn Exchange>,
}

/// Returns what is trained before the first step: at the scene that the run starts from, or new.
fn first_trainer(config: &RunConfig, scene: Option<Scene>, dataset: &CoreDataset, means: Means) -> Result<Box<dyn Reconstruction>> {
    let Means { threads, engine, exchange } = means;
    if !config.train.method.stores_splats() {
        return non_splat::start(dataset, &config.train, non_splat::Processor { threads, engine });
    }
    let trainer = match (config.run.from.as_deref(), scene) {
        (Some(path), Some(scene)) => Trainer::from_scene(dataset, &scene, config.train.clone(), means_of(engine))
            .with_context(|| format!("{}: cannot start training from this scene", path.display()))?,
        _ => Trainer::new(dataset, config.train.clone(), means_of(engine)).context("cannot start training")?,
    };
    Ok(Box::new(trainer.with_exchange(exchange)))
}

/// The content of a checkpoint.
#[expect(clippy::large_enum_variant, reason = "one of them, read once")]
enum Stored {
    Splats(Snapshot),
    NonSplat(non_splat::Checkpoint),
}

impl Stored {
    /// Reads a checkpoint of a run of this method.
    fn read(path: &Path, method: Method) -> Result<Self> {
        Ok(match method.stores_splats() {
            true => Self::Splats(luxel_io::read_checkpoint(path)?),
            false => Self::NonSplat(non_splat::Checkpoint::read(path)?),
        })
    }

    /// Returns what is trained as it was stored.
    fn resume(self, dataset: &CoreDataset, means: Means) -> Result<Box<dyn Reconstruction>> {
        let Means { threads, engine, exchange } = means;
        match self {
            Self::Splats(snapshot) => Ok(Box::new(Trainer::resume(dataset, snapshot, means_of(engine))?.with_exchange(exchange))),
            Self::NonSplat(checkpoint) => non_splat::resume(dataset, checkpoint, non_splat::Processor { threads, engine }),
        }
    }
}

/// Continues a run from its newest checkpoint, under the folder's lock.
///
/// # Errors
/// As [`fresh`]; a folder without a checkpoint that can be read; a checkpoint of other settings
/// than those of `config`.
pub fn resume(config: RunConfig, selected: SelectedEngine, launch: Launch<'_>, lock: RunLock) -> Result<TrainedRun> {
    resume_over(Box::new(SingleProcess), config, selected, launch, lock)
}

/// Continues a run as [`resume`] does, as rank 0 of a distributed run; the other ranks
/// [`super::follow`]. Their number may differ from that before.
///
/// # Errors
/// As [`resume`]; ranks that cannot be reached.
pub fn resume_over(
    mut exchange: Box<dyn Exchange>,
    config: RunConfig,
    selected: SelectedEngine,
    launch: Launch<'_>,
    lock: RunLock,
) -> Result<TrainedRun> {
    let since = Instant::now();
    let SelectedEngine { mut engine, threads, machine, computed_by, gpu, .. } = selected;
    config.validate().context("cannot resume")?;
    check_time(&config, &*exchange)?;
    let (folder, observer) = (launch.folder, launch.observer);
    let path = config.find_dataset(folder.root(), Remedy::give("dataset"))?;
    let config = resolve_images(config, launch)?;
    tell_settings(&mut *exchange, &config, folder)?;
    let start = RunStart { is_on_gpu: gpu.is_some(), scene_splats: None };
    let dataset = open_dataset(&path, &config, launch, start, views_of(&*exchange, &config))?;
    limit_images(engine.as_mut(), &config);
    let means = Means { threads, engine, exchange };
    let trainer = match state::take_checkpoint(folder, |path| Stored::read(path, config.train.method), observer)? {
        Some((path, stored)) => {
            let mut trainer = stored.resume(&dataset, means).with_context(|| format!("{}: cannot resume", path.display()))?;
            continue_with(&config, &mut *trainer)?;
            observer.note(&format!("resuming after step {} from {}", trainer.iteration(), path.display()));
            trainer
        }
        None if !folder.has_results() => {
            observer.note("the run ended before its first checkpoint; starting from the first step");
            first_trainer(&config, first_scene(&config, observer)?, &dataset, means)?
        }
        None => {
            let message = format!("{}: has scenes, but no checkpoint in checkpoints/ to continue from", folder.root().display());
            let remedy = Remedy::advice("put that folder back").or(state::start_anew());
            return Err(Error::new(message).with_remedy(remedy));
        }
    };
    // A run that starts anew decides what its options leave open, as its first start did.
    let config = RunConfig { train: trainer.config().clone(), ..config };
    folder.write_config(&config)?;
    train(config, launch, ReadyRun { dataset, trainer, threads, machine, computed_by, lock, since })
}

/// Facts that the memory of a run depends on, besides its settings and images.
#[derive(Clone, Copy)]
pub(super) struct RunStart {
    pub(super) is_on_gpu: bool,
    /// Splats of the scene that it starts from, if it does.
    pub(super) scene_splats: Option<u64>,
}

/// Reads the data set of a run within its limit of memory for images. Says before what the run will
/// take, and refuses what the system does not have.
pub(super) fn open_dataset(path: &Path, config: &RunConfig, launch: Launch<'_>, start: RunStart, views: RankViews) -> Result<Dataset> {
    if !config.train.method.stores_splats() {
        return non_splat::open_dataset(path, config, launch);
    }
    let RunStart { is_on_gpu, scene_splats } = start;
    let cache = launch.folder.image_cache();
    let check = |plan: &ImagePlan| RunMemory::new(plan, &config.train, scene_splats, is_on_gpu).check(plan, system_memory());
    let keep = |place| keeps(views, place);
    let limits = ImageLimits { image_memory: config.run.image_memory, cache: Some(&cache), check: Some(&check), keep: Some(&keep) };
    let planned = |plan: &ImagePlan| launch.observer.note(&RunMemory::new(plan, &config.train, scene_splats, is_on_gpu).line());
    Dataset::open_planned(path, &config.load, limits, launch.observer, &planned)
}

/// Applies a limit that was given to what the engine keeps of images, too.
pub(super) fn limit_images(engine: &mut dyn Engine, config: &RunConfig) {
    if let ImageMemory::Bytes(bytes) = config.run.image_memory {
        engine.limit_images(bytes);
    }
}

/// Gives a resumed trainer the number of steps of `config`, unless it ends early by the same rule;
/// everything else must be as the checkpoint has it.
fn continue_with(config: &RunConfig, trainer: &mut dyn Reconstruction) -> Result<()> {
    let (wanted, made) = (config.train.iterations, trainer.iteration());
    if wanted < made {
        let message = format!("{wanted} iterations: the run has made {made} steps already");
        return Err(Error::new(message).with_remedy(Remedy::set("iterations", made.to_string())));
    }
    let (end, early_end) = (trainer.config().iterations, trainer.config().early_end);
    let has_rule = early_end.is_some() && early_end == config.train.early_end;
    let is_over_early = trainer.as_splats().is_some_and(|splats| splats.ends_early());
    if !(has_rule && (is_over_early || wanted == end)) {
        trainer.set_iterations(wanted);
    }
    // Given steps leave no early end, which the checkpoint may have.
    let is_rule_kept = has_rule || config.train.early_end.is_none();
    let TrainConfig { iterations, early_end, .. } = *trainer.config();
    if !is_rule_kept || *trainer.config() != (TrainConfig { iterations, early_end, ..config.train.clone() }) {
        bail!("config.toml has other training options than the checkpoint; undo the change, or start a new run with it in another folder");
    }
    Ok(())
}

/// Refuses a limit of time over several ranks, each of which would plan another number of steps.
fn check_time(config: &RunConfig, exchange: &dyn Exchange) -> Result<()> {
    match config.run.time {
        Some(_) if exchange.ranks() > 1 => {
            let message = format!("{} ranks train one scene, and only one process can be planned by time", exchange.ranks());
            Err(Error::new(message).with_remedy(Remedy::give("iterations")))
        }
        _ => Ok(()),
    }
}

/// Says how a batch is divided, and warns of ranks that have no part in it.
fn report_ranks(exchange: &dyn Exchange, config: &RunConfig, observer: &dyn Observer) {
    let (ranks, batch) = (exchange.ranks(), config.train.batch);
    let idle = (0..ranks).filter(|rank| !RankViews { batch, ranks, rank: *rank }.are_any()).count();
    if ranks > 1 {
        observer.note(&format!("{} a step, over {ranks} ranks", text::plural(batch as usize, "view")));
    }
    if idle > 0 {
        observer
            .warn(&format!("{idle} of {ranks} ranks have no view to train on: start as many ranks as there are views a step, or fewer"));
    }
}

fn words_of(size: SceneSize) -> String {
    match size {
        SceneSize::Splats(splats) => text::plural(splats, "splat"),
        SceneSize::Anchors { anchors, .. } => text::plural(anchors, "anchor"),
        SceneSize::Field(parameters) => format!("a field of {}", text::plural(parameters, "parameter")),
    }
}

fn train(config: RunConfig, launch: Launch<'_>, ready: ReadyRun) -> Result<TrainedRun> {
    let ReadyRun { dataset, mut trainer, threads, machine, computed_by, lock: _lock, since } = ready;
    let Launch { folder, observer, stop } = launch;
    if let Some(splats) = trainer.as_splats() {
        tell_state(splats)?;
    }
    observer.note(&format!("starting with {} on {machine}", words_of(trainer.size())));
    if let Some(splats) = trainer.as_splats() {
        report_ranks(splats.exchange(), &config, observer);
    }
    let first = trainer.iteration();
    let session = Session { dataset: &dataset, folder, config: &config, threads, computed_by, observer, stop, trainer, since };
    let (outcome, trainer) = session.run()?;
    let steps = trainer.iteration().saturating_sub(first);
    // A run within a given time has found its number of steps.
    let config = RunConfig { train: trainer.config().clone(), ..config };
    Ok(TrainedRun { outcome, config, trainer, dataset, steps })
}

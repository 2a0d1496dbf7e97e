//! Starting and resuming a run without stored splats.
//!
//! The data set is read and the settings are checked before anything in the folder is touched.

use std::path::Path;
use std::time::Instant;

use luxel_core::{Dataset as CoreDataset, Remedy};
use luxel_io::{ImageMemory, ImagePlan, IoError, system_memory};
use luxel_train::TrainConfig;

use super::newest::take_checkpoint;
use super::objective::{check_exposures, network};
use super::session::ImplicitSession;
use super::trainer::Trainer;
use crate::error::{Context, bail};
use crate::run::state::start_anew;
use crate::run::{ImplicitKind, Launch, Outcome, RunConfig, RunLock};
use crate::{Dataset, Device, DeviceOptions, Error, ImageLimits, Observer, Result, SelectedEngine, text};

/// Memory of a run besides images: the scene, its moments and gradient, what a step computes, and
/// the program, bytes.
const RUN_BYTES: u64 = 400 << 20;
/// Memory of a splat of anchors besides: its share of the anchor, moments, networks' values and the
/// engine's copies, bytes.
const SPLAT_BYTES: u64 = 1000;

/// The result of a run.
pub struct TrainedImplicit {
    /// Finished or interrupted.
    pub outcome: Outcome,
    /// The settings of the run.
    pub config: RunConfig,
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
) -> Result<TrainedImplicit> {
    config.validate().context("cannot start training")?;
    config.to_toml().with_context(|| format!("{}: config.toml cannot hold these settings", config.dataset.display()))?;
    let dataset = open_dataset(&config.dataset_path(launch.folder.root()), &config, launch)?;
    let machine = Machine::of(&selected);
    let trainer = Trainer::new(&dataset, &config.train, selected.threads, selected.engine)?;
    let lock = make_room(&dataset)?;
    launch.folder.write_config(&config)?;
    train(config, machine, launch, dataset, trainer, lock)
}

/// Continues a run from its newest checkpoint, under the folder's lock.
///
/// # Errors
/// As [`fresh`]; a checkpoint of other settings than those of `config`, or of another data set.
pub fn resume(config: RunConfig, selected: SelectedEngine, launch: Launch<'_>, lock: RunLock) -> Result<TrainedImplicit> {
    config.validate().context("cannot resume")?;
    let (folder, observer) = (launch.folder, launch.observer);
    let path = config.find_dataset(folder.root(), Remedy::give("dataset"))?;
    let dataset = open_dataset(&path, &config, launch)?;
    let machine = Machine::of(&selected);
    let trainer = match take_checkpoint(folder, observer)? {
        Some((path, checkpoint)) => {
            let made = checkpoint.step();
            if checkpoint.fingerprint() != dataset.fingerprint {
                return Err(Error::from(luxel_train::TrainError::Fingerprint {
                    checkpoint: checkpoint.fingerprint().to_owned(),
                    dataset: dataset.fingerprint.clone(),
                })
                .context(format!("{}: cannot resume", path.display())));
            }
            if config.train.iterations < made {
                let message = format!("{} iterations: the run has made {made} steps already", config.train.iterations);
                return Err(Error::new(message).with_remedy(Remedy::set("iterations", made.to_string())));
            }
            if (TrainConfig { iterations: checkpoint.config().iterations, ..config.train.clone() }) != *checkpoint.config() {
                bail!(
                    "config.toml has other training options than the checkpoint; undo the change, or start a new run with it in another folder"
                );
            }
            let mut trainer =
                Trainer::resume(&dataset, checkpoint, selected.threads, selected.engine).with_context(|| path.display().to_string())?;
            trainer.set_iterations(config.train.iterations);
            observer.note(&format!("resuming after step {made} from {}", path.display()));
            trainer
        }
        None if ImplicitKind::ALL.into_iter().all(|kind| folder.implicit_iterations(kind).is_empty()) => {
            observer.note("the run ended before its first checkpoint; starting from the first step");
            Trainer::new(&dataset, &config.train, selected.threads, selected.engine)?
        }
        None => {
            let message = format!("{}: has results, but no checkpoint in checkpoints/ to continue from", folder.root().display());
            return Err(Error::new(message).with_remedy(Remedy::advice("put that folder back").or(start_anew())));
        }
    };
    folder.write_config(&config)?;
    train(config, machine, launch, dataset, trainer, lock)
}

/// Trains a run's first steps in memory, some before and some on the clock, and returns the seconds
/// per step.
pub(crate) fn seconds_per_step(config: &RunConfig, [before, timed]: [usize; 2], observer: &dyn Observer) -> Result<f64> {
    let dataset = Dataset::open_reporting(&config.dataset, &config.load, observer)?;
    check_exposures(&dataset, &config.train)?;
    let options = DeviceOptions { device: Device::Cpu, ..config.device.clone() };
    let selected = super::open_processor(&options, config.train.method)?;
    let mut trainer = Trainer::new(&dataset, &config.train, selected.threads, selected.engine)?;
    for _ in 0..before {
        trainer.step()?;
    }
    let start = Instant::now();
    for _ in 0..timed {
        trainer.step()?;
    }
    Ok(start.elapsed().as_secs_f64() / timed.max(1) as f64)
}

/// Reads the data set of a run. All its images are in memory: a step of a field looks at pixels of
/// all.
fn open_dataset(path: &Path, config: &RunConfig, launch: Launch<'_>) -> Result<Dataset> {
    let train = &config.train;
    let of_network = network(train)?.training_bytes(config.device.threads.map_or(1, |threads| threads as usize));
    let of_scene = |plan: &ImagePlan| match train.method.has_anchors() {
        // Without a bound the number of splats is not known.
        true => Some(train.splat_limit(plan.train_px) as u64).filter(|limit| *limit < u64::from(u32::MAX)).unwrap_or(0) * SPLAT_BYTES,
        false => of_network,
    };
    let needed = |plan: &ImagePlan| plan.decoded_bytes.saturating_add(RUN_BYTES).saturating_add(of_scene(plan));
    let check = |plan: &ImagePlan| match system_memory().filter(|limit| needed(plan) > *limit) {
        None => Ok(()),
        Some(limit) => {
            let [needed, limit] = [needed(plan), limit].map(text::bytes);
            let message = format!("training takes about {needed}, more memory than the system allows, {limit}");
            Err(IoError::unsupported(&plan.path, message).with_remedy(Remedy::raise("downscale")))
        }
    };
    let limits = ImageLimits { image_memory: ImageMemory::Auto, cache: None, check: Some(&check), keep: None };
    let planned = |plan: &ImagePlan| launch.observer.note(&format!("memory: about {}", text::bytes(needed(plan))));
    let dataset = Dataset::open_planned(path, &config.load, limits, launch.observer, &planned)?;
    check_exposures(&dataset, &config.train).context("cannot start training")?;
    Ok(dataset)
}

/// The place where a run is computed.
struct Machine {
    threads: usize,
    machine: String,
    computed_by: String,
}

impl Machine {
    fn of(selected: &SelectedEngine) -> Self {
        let SelectedEngine { threads, machine, computed_by, .. } = selected;
        Self { threads: *threads, machine: machine.clone(), computed_by: computed_by.clone() }
    }
}

fn train(
    config: RunConfig,
    machine: Machine,
    launch: Launch<'_>,
    dataset: Dataset,
    trainer: Trainer,
    _lock: RunLock,
) -> Result<TrainedImplicit> {
    let Machine { threads, machine, computed_by } = machine;
    launch.observer.note(&format!("starting with {} on {machine}", trainer.start_words()));
    let session = ImplicitSession { dataset: &dataset, config: &config, launch, threads, computed_by, trainer };
    let outcome = session.run()?;
    Ok(TrainedImplicit { outcome, config })
}

//! Starting and resuming a run of a field.
//!
//! The data set is read and the settings are checked before anything in the folder is touched.

use std::path::Path;
use std::time::Instant;

use luxel_core::{Dataset as CoreDataset, Remedy};
use luxel_field::FieldTrainer;
use luxel_io::{ImageMemory, ImagePlan, IoError, system_memory};
use luxel_train::TrainConfig;

use super::files::place_of;
use super::newest::take_checkpoint;
use super::objective::{check_exposures, network, options};
use super::session::FieldSession;
use crate::error::{Context, bail};
use crate::run::state::start_anew;
use crate::run::{Launch, Outcome, RunConfig, RunLock};
use crate::{Dataset, Device, DeviceOptions, Error, ImageLimits, Observer, Result, SelectedEngine, text};

/// Memory of a run besides images: the field, its moments and gradient, what a step computes, and
/// the program, bytes.
const FIELD_BYTES: u64 = 400 << 20;

/// The result of a run of a field.
pub struct TrainedField {
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
) -> Result<TrainedField> {
    config.validate().context("cannot start training")?;
    config.to_toml().with_context(|| format!("{}: config.toml cannot hold these settings", config.dataset.display()))?;
    let dataset = open_dataset(&config.dataset_path(launch.folder.root()), &config, launch)?;
    let scale = luxel_train::start_scale(&dataset, &config.train).context("cannot start training")?;
    let trainer = FieldTrainer::new(&dataset, options(&config.train, scale)?, selected.threads).context("cannot start training")?;
    let lock = make_room(&dataset)?;
    launch.folder.write_config(&config)?;
    train(config, selected, launch, dataset, trainer, lock)
}

/// Continues a run from its newest checkpoint, under the folder's lock.
///
/// # Errors
/// As [`fresh`]; a checkpoint of other settings than those of `config`, or of another data set.
pub fn resume(config: RunConfig, selected: SelectedEngine, launch: Launch<'_>, lock: RunLock) -> Result<TrainedField> {
    config.validate().context("cannot resume")?;
    let (folder, observer) = (launch.folder, launch.observer);
    let path = config.find_dataset(folder.root(), Remedy::give("dataset"))?;
    let dataset = open_dataset(&path, &config, launch)?;
    let trainer = match take_checkpoint(folder, observer)? {
        Some((path, checkpoint)) => {
            let (training, made) = (checkpoint.training, checkpoint.snapshot.state.step);
            if training.fingerprint != dataset.fingerprint {
                return Err(Error::from(luxel_train::TrainError::Fingerprint {
                    checkpoint: training.fingerprint,
                    dataset: dataset.fingerprint.clone(),
                })
                .context(format!("{}: cannot resume", path.display())));
            }
            if config.train.iterations < made {
                let message = format!("{} iterations: the run has made {made} steps already", config.train.iterations);
                return Err(Error::new(message).with_remedy(Remedy::set("iterations", made.to_string())));
            }
            if (TrainConfig { iterations: training.config.iterations, ..config.train.clone() }) != training.config {
                bail!(
                    "config.toml has other training options than the checkpoint; undo the change, or start a new run with it in another folder"
                );
            }
            let mut trainer = FieldTrainer::resume(&dataset, checkpoint.snapshot, selected.threads)
                .with_context(|| format!("{}: cannot resume", path.display()))?;
            trainer.set_iterations(config.train.iterations);
            observer.note(&format!("resuming after step {made} from {}", path.display()));
            trainer
        }
        None if folder.field_iterations().is_empty() => {
            observer.note("the run ended before its first checkpoint; starting from the first step");
            let scale = luxel_train::start_scale(&dataset, &config.train).context("cannot start training")?;
            FieldTrainer::new(&dataset, options(&config.train, scale)?, selected.threads).context("cannot start training")?
        }
        None => {
            let message = format!("{}: has fields, but no checkpoint in checkpoints/ to continue from", folder.root().display());
            return Err(Error::new(message).with_remedy(Remedy::advice("put that folder back").or(start_anew())));
        }
    };
    folder.write_config(&config)?;
    train(config, selected, launch, dataset, trainer, lock)
}

/// Trains a run's first steps in memory, some before and some on the clock, and returns the seconds
/// per step.
pub(crate) fn seconds_per_step(config: &RunConfig, [before, timed]: [usize; 2], observer: &dyn Observer) -> Result<f64> {
    let dataset = Dataset::open_reporting(&config.dataset, &config.load, observer)?;
    check_exposures(&dataset, &config.train)?;
    let scale = luxel_train::start_scale(&dataset, &config.train)?;
    let threads = super::open_processor(&DeviceOptions { device: Device::Cpu, ..config.device.clone() })?.threads;
    let mut trainer = FieldTrainer::new(&dataset, options(&config.train, scale)?, threads).context("cannot start training")?;
    for _ in 0..before {
        trainer.step().context("cannot train the field")?;
    }
    let start = Instant::now();
    for _ in 0..timed {
        trainer.step().context("cannot train the field")?;
    }
    Ok(start.elapsed().as_secs_f64() / timed.max(1) as f64)
}

/// Reads the data set of a run. All its images are in memory: a step looks at pixels of all.
fn open_dataset(path: &Path, config: &RunConfig, launch: Launch<'_>) -> Result<Dataset> {
    let of_network = network(&config.train)?.training_bytes(config.device.threads.map_or(1, |threads| threads as usize));
    let needed = |plan: &ImagePlan| plan.decoded_bytes.saturating_add(FIELD_BYTES).saturating_add(of_network);
    let check = |plan: &ImagePlan| match system_memory().filter(|limit| needed(plan) > *limit) {
        None => Ok(()),
        Some(limit) => {
            let [needed, limit] = [needed(plan), limit].map(text::bytes);
            let message = format!("training a field takes about {needed}, more memory than the system allows, {limit}");
            Err(IoError::unsupported(&plan.path, message).with_remedy(Remedy::raise("downscale")))
        }
    };
    let limits = ImageLimits { image_memory: ImageMemory::Auto, cache: None, check: Some(&check), keep: None };
    let planned = |plan: &ImagePlan| launch.observer.note(&format!("memory: about {}", text::bytes(needed(plan))));
    let dataset = Dataset::open_planned(path, &config.load, limits, launch.observer, &planned)?;
    check_exposures(&dataset, &config.train).context("cannot start training")?;
    Ok(dataset)
}

fn train(
    config: RunConfig,
    selected: SelectedEngine,
    launch: Launch<'_>,
    dataset: Dataset,
    trainer: FieldTrainer,
    _lock: RunLock,
) -> Result<TrainedField> {
    let SelectedEngine { threads, machine, computed_by, .. } = selected;
    let parameters = text::plural(trainer.field().parameter_count(), "parameter");
    launch.observer.note(&format!("starting with a field of {parameters} on {machine}"));
    let scale = trainer.state().options.radiance_scale;
    let place = place_of(scale, dataset.color_space, dataset.world_from_local, dataset.metres_per_unit);
    let session = FieldSession { dataset: &dataset, config: &config, launch, threads, computed_by, trainer, place };
    let outcome = session.run()?;
    Ok(TrainedField { outcome, config })
}

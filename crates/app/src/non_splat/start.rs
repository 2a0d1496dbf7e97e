//! Starting and resuming the training of a scene without stored splats.
//!
//! In: a data set, options or a checkpoint, threads, an engine of splats. Out: a
//! [`Reconstruction`], which a run drives as any other. Degenerate: data of which there is more
//! than memory has room for is an error.

use std::path::Path;
use std::time::Instant;

use luxel::error::Context;
use luxel::{Dataset, Device, DeviceOptions, ImageLimits, Observer, Result, SelectedEngine};
use luxel_core::{Dataset as CoreDataset, Remedy};
use luxel_io::{Arrays, ImageMemory, ImagePlan, IoError, system_memory};
use luxel_methods::{
    AnchorCheckpoint, AnchorRun, FieldCheckpoint, FieldRun, check_exposures, field_network, read_anchor_run, read_field_run,
};
use luxel_train::{ANCHOR_FORMAT, FIELD_FORMAT, Reconstruction, Representation, TrainConfig};

use super::Processor;
use crate::run::{Launch, RunConfig};
use crate::text;

/// Memory of a run besides images: the scene, its moments and gradient, what a step computes, and
/// the program, bytes.
const RUN_BYTES: u64 = 400 << 20;
/// Memory of a splat of anchors besides: its share of the anchor, moments, networks' values and the
/// engine's copies, bytes.
const SPLAT_BYTES: u64 = 1000;

/// A run that can be continued.
pub(crate) enum Checkpoint {
    /// A run of a field.
    Field(Box<FieldCheckpoint>),
    /// A run of anchors.
    Anchors(Box<AnchorCheckpoint>),
}

impl Checkpoint {
    /// Reads the checkpoint of a file.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let read = |format| luxel_io::read_arrays(path, format);
        let name = || path.display().to_string();
        if luxel_io::holds_arrays(path, ANCHOR_FORMAT) {
            let Arrays { description, tensors } = read(ANCHOR_FORMAT)?;
            return Ok(Self::Anchors(Box::new(read_anchor_run(&description, tensors).with_context(name)?)));
        }
        let Arrays { description, tensors } = read(FIELD_FORMAT)?;
        Ok(Self::Field(Box::new(read_field_run(&description, tensors).with_context(name)?)))
    }
}

/// Starts a training.
///
/// # Errors
/// Options or data that cannot be used; threads that the system refuses.
pub(crate) fn start(dataset: &CoreDataset, config: &TrainConfig, processor: Processor) -> Result<Box<dyn Reconstruction>> {
    let Processor { threads, engine } = processor;
    let context = "cannot start training";
    Ok(match config.method.spec().representation {
        Representation::Anchors => Box::new(AnchorRun::new(dataset, config, engine).context(context)?),
        _ => Box::new(FieldRun::new(dataset, config, threads).context(context)?),
    })
}

/// Continues a training from a checkpoint.
///
/// # Errors
/// A checkpoint of another data set, or that is damaged; threads that the system refuses.
pub(crate) fn resume(dataset: &CoreDataset, checkpoint: Checkpoint, processor: Processor) -> Result<Box<dyn Reconstruction>> {
    let Processor { threads, engine } = processor;
    Ok(match checkpoint {
        Checkpoint::Field(checkpoint) => Box::new(FieldRun::resume(dataset, *checkpoint, threads)?),
        Checkpoint::Anchors(checkpoint) => Box::new(AnchorRun::resume(dataset, *checkpoint, engine)?),
    })
}

/// Trains a run's first steps in memory, some before and some on the clock, and returns the seconds
/// per step.
pub(crate) fn seconds_per_step(config: &RunConfig, [before, timed]: [usize; 2], observer: &dyn Observer) -> Result<f64> {
    let dataset = Dataset::open_reporting(&config.dataset, &config.load, observer)?;
    check_exposures(&dataset, &config.train)?;
    let options = DeviceOptions { device: Device::Cpu, ..config.device.clone() };
    let SelectedEngine { threads, engine, .. } = super::open_processor(&options, config.train.method)?;
    let mut trainer = start(&dataset, &config.train, Processor { threads, engine })?;
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
///
/// # Errors
/// Data that cannot be read or used; more of it than memory has room for.
pub(crate) fn open_dataset(path: &Path, config: &RunConfig, launch: Launch<'_>) -> Result<Dataset> {
    let train = &config.train;
    let of_network = field_network(train)?.training_bytes(config.device.threads.map_or(1, |threads| threads as usize));
    let of_scene = |plan: &ImagePlan| match train.method.spec().representation {
        // Without a bound the number of splats is not known.
        Representation::Anchors => {
            Some(train.splat_limit(plan.train_px) as u64).filter(|limit| *limit < u64::from(u32::MAX)).unwrap_or(0) * SPLAT_BYTES
        }
        _ => of_network,
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

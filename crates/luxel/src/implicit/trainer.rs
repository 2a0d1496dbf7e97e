//! The trainers of fields and of anchors behind one interface, and their checkpoints.
//!
//! In: a data set, options, threads. Out: steps, and scenes to render and to store.

use std::path::Path;

use luxel_core::{Dataset, Engine, Knots, Scene, StepReport};
use luxel_field::{FieldSnapshot, FieldTrainer};
use luxel_io::IoError;
use luxel_train::{AnchorTrainer, TrainConfig};

use super::anchor_files::{self, AnchorCheckpoint};
use super::field_files::{self, FieldCheckpoint, TrainingRecord};
use super::objective::options;
use super::place::place_of;
use super::scene::{Content, ImplicitScene};
use crate::error::Context;
use crate::run::ImplicitKind;
use crate::{Result, SelectedEngine, text};

/// A trainer.
pub(super) enum Trainer {
    Field(Box<FieldTrainer>),
    Anchors(Box<AnchorTrainer>),
}

/// The loss of a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepLoss {
    pub(super) total: f64,
    /// Mean absolute difference and mean SSIM, of images.
    pub(super) parts: Option<[f64; 2]>,
}

impl StepLoss {
    /// Adds another step's.
    pub(super) fn add(&mut self, other: Self) {
        self.total += other.total;
        self.parts = other.parts.map(|[l1, ssim]| self.parts.map_or([l1, ssim], |sums| [sums[0] + l1, sums[1] + ssim]));
    }
}

/// A run that can be continued.
pub(super) enum Checkpoint {
    Field(Box<FieldCheckpoint>),
    Anchors(Box<AnchorCheckpoint>),
}

impl Checkpoint {
    pub(super) fn read(path: &Path) -> Result<Self> {
        if luxel_io::holds_arrays(path, anchor_files::FORMAT) {
            return Ok(Self::Anchors(Box::new(anchor_files::read_checkpoint(path)?)));
        }
        Ok(Self::Field(Box::new(field_files::read_checkpoint(path)?)))
    }

    pub(super) fn fingerprint(&self) -> &str {
        match self {
            Self::Field(checkpoint) => &checkpoint.training.fingerprint,
            Self::Anchors(checkpoint) => &checkpoint.fingerprint,
        }
    }

    pub(super) fn config(&self) -> &TrainConfig {
        match self {
            Self::Field(checkpoint) => &checkpoint.training.config,
            Self::Anchors(checkpoint) => &checkpoint.config,
        }
    }

    /// Returns the number of steps done.
    pub(super) fn step(&self) -> u32 {
        match self {
            Self::Field(checkpoint) => checkpoint.snapshot.state.step,
            Self::Anchors(checkpoint) => checkpoint.step,
        }
    }
}

impl Trainer {
    /// Starts a run. Anchors are trained on the engine that was opened.
    pub(super) fn new(dataset: &Dataset, config: &TrainConfig, threads: usize, engine: Box<dyn Engine>) -> Result<Self> {
        let context = "cannot start training";
        if config.method.has_anchors() {
            return Ok(Self::Anchors(Box::new(AnchorTrainer::new(dataset, config.clone(), engine).context(context)?)));
        }
        let scale = luxel_train::start_scale(dataset, config).context(context)?;
        Ok(Self::Field(Box::new(FieldTrainer::new(dataset, options(config, scale)?, threads).context(context)?)))
    }

    /// Continues a run.
    pub(super) fn resume(dataset: &Dataset, checkpoint: Checkpoint, threads: usize, engine: Box<dyn Engine>) -> Result<Self> {
        let context = "cannot resume";
        Ok(match checkpoint {
            Checkpoint::Field(checkpoint) => {
                Self::Field(Box::new(FieldTrainer::resume(dataset, checkpoint.snapshot, threads).context(context)?))
            }
            Checkpoint::Anchors(checkpoint) => {
                Self::Anchors(Box::new(AnchorTrainer::resume(dataset, checkpoint.snapshot, engine).context(context)?))
            }
        })
    }

    /// Makes a step, and returns its loss.
    pub(super) fn step(&mut self) -> Result<StepLoss> {
        let step = self.iteration() + 1;
        let context = || format!("training step {step}");
        match self {
            Self::Field(trainer) => Ok(StepLoss { total: trainer.step().with_context(context)?.loss.into(), parts: None }),
            Self::Anchors(trainer) => {
                let StepReport { loss, l1, ssim, .. } = trainer.step().with_context(context)?;
                Ok(StepLoss { total: loss.into(), parts: Some([l1.into(), ssim.into()]) })
            }
        }
    }

    /// Returns the number of steps done.
    pub(super) fn iteration(&self) -> u32 {
        match self {
            Self::Field(trainer) => trainer.state().step,
            Self::Anchors(trainer) => trainer.iteration(),
        }
    }

    pub(super) fn is_finished(&self) -> bool {
        match self {
            Self::Field(trainer) => trainer.is_finished(),
            Self::Anchors(trainer) => trainer.is_finished(),
        }
    }

    pub(super) fn set_iterations(&mut self, iterations: u32) {
        match self {
            Self::Field(trainer) => trainer.set_iterations(iterations),
            Self::Anchors(trainer) => trainer.set_iterations(iterations),
        }
    }

    /// Returns the kind of scene.
    pub(super) fn kind(&self) -> ImplicitKind {
        match self {
            Self::Field(_) => ImplicitKind::Field,
            Self::Anchors(_) => ImplicitKind::Anchors,
        }
    }

    /// Returns the number of splats; 0 for a field.
    pub(super) fn splats(&self) -> usize {
        match self {
            Self::Field(_) => 0,
            Self::Anchors(trainer) => trainer.scene().splats(),
        }
    }

    /// Returns the number of a field's parameters.
    pub(super) fn field_parameters(&self) -> Option<usize> {
        match self {
            Self::Field(trainer) => Some(trainer.field().parameter_count()),
            Self::Anchors(_) => None,
        }
    }

    /// Returns what the run starts with, in words.
    pub(super) fn start_words(&self) -> String {
        match self {
            Self::Field(trainer) => format!("a field of {}", text::plural(trainer.field().parameter_count(), "parameter")),
            Self::Anchors(trainer) => text::plural(trainer.scene().anchors.len(), "anchor"),
        }
    }

    pub(super) fn response(&self) -> Option<Knots> {
        match self {
            Self::Field(trainer) => trainer.field().response(),
            Self::Anchors(trainer) => trainer.response(),
        }
    }

    /// Returns units and place of the scene.
    pub(super) fn place(&self, dataset: &Dataset) -> Scene {
        let Dataset { color_space, world_from_local, metres_per_unit, .. } = *dataset;
        match self {
            Self::Field(trainer) => place_of(trainer.state().options.radiance_scale, color_space, world_from_local, metres_per_unit),
            Self::Anchors(trainer) => {
                Scene { raster: trainer.raster(), ..place_of(trainer.radiance_scale(), color_space, world_from_local, metres_per_unit) }
            }
        }
    }

    /// Returns the scene as it is now.
    pub(super) fn scene(&self, dataset: &Dataset) -> ImplicitScene {
        let content = match self {
            Self::Field(trainer) => Content::Field(Box::new(trainer.field().clone())),
            Self::Anchors(trainer) => {
                Content::Anchors { scene: Box::new(trainer.scene().clone()), response: trainer.response().map(Box::new) }
            }
        };
        ImplicitScene { content, place: self.place(dataset) }
    }

    /// Returns the scene in an engine that renders it.
    pub(super) fn engine(&self, dataset: &Dataset, processor: SelectedEngine) -> Result<Box<dyn Engine>> {
        Ok(self.scene(dataset).into_engine(processor)?.engine)
    }

    /// Returns what writes a checkpoint of this moment.
    pub(super) fn checkpoint(&self, dataset: &Dataset, config: &TrainConfig) -> Result<impl Fn(&Path) -> Result<(), IoError>> {
        let (config, fingerprint, place) = (config.clone(), dataset.fingerprint.clone(), self.place(dataset));
        let response = self.response();
        let checkpoint = match self {
            Self::Field(trainer) => {
                let snapshot: FieldSnapshot = trainer.snapshot();
                let training = TrainingRecord { config, fingerprint, state: *trainer.state() };
                Checkpoint::Field(Box::new(FieldCheckpoint { training, snapshot }))
            }
            Self::Anchors(trainer) => {
                let snapshot = trainer.snapshot().context("cannot save the anchors")?;
                Checkpoint::Anchors(Box::new(AnchorCheckpoint { config, fingerprint, step: trainer.iteration(), snapshot }))
            }
        };
        Ok(move |path: &Path| match &checkpoint {
            Checkpoint::Field(checkpoint) => field_files::write_checkpoint(path, &place, &checkpoint.snapshot, checkpoint.training.clone()),
            Checkpoint::Anchors(checkpoint) => anchor_files::write_checkpoint(path, &place, response.as_ref(), checkpoint),
        })
    }
}

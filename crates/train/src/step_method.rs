//! Methods on splats with a step of their own, in place of the engine's.
//!
//! In: the views of a step, an engine that blends channels and differentiates them. Out: the
//! engine's scene and the method's own numbers, updated, and the step's report; the numbers as JSON
//! for a checkpoint. The trainer knows a method by [`StepMethod`] alone, and makes it through
//! [`StepMethods`], which a program without such methods replaces by [`NoMethods`]. Degenerate: a
//! method that a program does not have is an error at the start.

use luxel_core::engine::{PlanRow, StepConfig};
use luxel_core::{Camera, Dataset, Engine, Knots, RadianceScale, Splats, StepReport, View};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::{NamedChoice, TrainConfig, TrainError};

/// The numbers of a method in a checkpoint, as JSON that only the method reads.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MethodState(Box<RawValue>);

impl PartialEq for MethodState {
    fn eq(&self, other: &Self) -> bool {
        self.0.get() == other.0.get()
    }
}

impl MethodState {
    /// Returns the state of some numbers.
    ///
    /// # Errors
    /// [`TrainError::State`] for numbers without a form in JSON.
    pub fn of(numbers: &impl Serialize) -> Result<Self, TrainError> {
        serde_json::value::to_raw_value(numbers).map(Self).map_err(|error| TrainError::State(error.to_string()))
    }

    /// Returns the numbers.
    ///
    /// # Errors
    /// [`TrainError::State`] for JSON of something else.
    pub fn numbers<T: for<'a> Deserialize<'a>>(&self) -> Result<T, TrainError> {
        serde_json::from_str(self.0.get()).map_err(|error| TrainError::State(error.to_string()))
    }
}

/// The tone mappers of a run, for people and other programs: y_c = sigmoid(bias + sum of
/// outgoing_j max(weight_j s + bias_j, 0)) with s = ln(radiance / radiance_unit) + ln(exposure /
/// reference_s).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToneMapperRecord {
    /// Radiance whose logarithm is 0, in the units of the data set.
    pub radiance_unit: f32,
    /// Exposure whose logarithm is 0, seconds.
    pub reference_s: f32,
    /// Numbers of the networks, red, green and blue: weights of the units, biases of the units,
    /// outgoing weights of the units, bias.
    pub numbers: [Vec<f32>; 3],
}

/// The images of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepImages<'a> {
    /// The view of the step, with its target.
    pub view: &'a View,
    /// The captured image beside its radiance whose turn it is; `None` without any.
    pub captured: Option<&'a View>,
}

/// A step of a method.
#[derive(Clone, Copy, Debug)]
pub struct MethodStep<'a> {
    /// The options of the run.
    pub train: &'a TrainConfig,
    /// The engine's part of the step.
    pub engine: &'a StepConfig,
    /// Radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
    /// Number of steps that the schedule is planned for.
    pub planned_iterations: u32,
}

/// A method in training, with the numbers that it trains beside splats.
pub trait StepMethod: Send {
    /// Makes a step: updates the scene of the engine, and the method's own numbers.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] before the numbers are updated, images of another kind than the
    /// method's, or the error of the engine.
    fn step(&mut self, engine: &mut dyn Engine, images: StepImages<'_>, step: MethodStep<'_>) -> Result<StepReport, TrainError>;

    /// Returns the numbers for a checkpoint.
    ///
    /// # Errors
    /// [`TrainError::State`].
    fn saved(&self) -> Result<MethodState, TrainError>;

    /// Follows splats through densification.
    fn densify(&mut self, _rows: &[PlanRow]) {}

    /// Returns the response of the camera that the method has learned; `None` if it learns none.
    fn response(&self) -> Option<Knots> {
        None
    }

    /// Returns the record of the method's tone mappers, if it has any.
    fn tone_mappers(&self, _radiance_unit: f32) -> Option<ToneMapperRecord> {
        None
    }

    /// Returns the engine as one that renders the radiance of the method's scene, in all steps to
    /// come.
    fn rendering(&self, engine: Box<dyn Engine>) -> Box<dyn Engine> {
        engine
    }

    /// Returns splats that come close to the method's scene without the method, as these cameras
    /// see it, or over the whole sphere without any.
    fn plain_splats(&self, splats: Splats, _cameras: &[&Camera]) -> Splats {
        splats
    }
}

/// The methods that a program has.
pub trait StepMethods: Sync {
    /// Checks that a data set has what the method of a run trains on. Only asked about methods with
    /// steps of their own, as everything below.
    ///
    /// # Errors
    /// Images of another kind; a method that is not there.
    fn check(&self, dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError>;

    /// Returns the first splats of a run, made of splats of radiance.
    ///
    /// # Errors
    /// Those of [`Self::check`].
    fn first_splats(&self, splats: Splats, scale: RadianceScale, dataset: &Dataset, config: &TrainConfig) -> Result<Splats, TrainError>;

    /// Starts the method of a run of so many splats.
    ///
    /// # Errors
    /// Those of [`Self::check`].
    fn start(&self, dataset: &Dataset, config: &TrainConfig, splats: usize) -> Result<Box<dyn StepMethod>, TrainError>;

    /// Continues the method of a run of so many splats from a checkpoint.
    ///
    /// # Errors
    /// Numbers of another method, or that do not fit the options or the splats.
    fn resume(&self, state: &MethodState, config: &TrainConfig, splats: usize) -> Result<Box<dyn StepMethod>, TrainError>;
}

/// The methods of a program that has none with steps of their own.
#[derive(Clone, Copy, Debug)]
pub struct NoMethods;

fn not_there(config: &TrainConfig) -> TrainError {
    TrainError::config("method", format!("{} is not among the methods of this program", config.method.name()))
}

impl StepMethods for NoMethods {
    fn check(&self, _: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
        Err(not_there(config))
    }

    fn first_splats(&self, _: Splats, _: RadianceScale, _: &Dataset, config: &TrainConfig) -> Result<Splats, TrainError> {
        Err(not_there(config))
    }

    fn start(&self, _: &Dataset, config: &TrainConfig, _: usize) -> Result<Box<dyn StepMethod>, TrainError> {
        Err(not_there(config))
    }

    fn resume(&self, _: &MethodState, config: &TrainConfig, _: usize) -> Result<Box<dyn StepMethod>, TrainError> {
        Err(not_there(config))
    }
}

/// The means of a training of splats: an engine, and the methods with steps of their own that may
/// use it.
pub struct TrainingMeans<'a> {
    /// The engine.
    pub engine: Box<dyn Engine>,
    /// The methods.
    pub methods: &'a dyn StepMethods,
}

impl<E: Engine + 'static> From<Box<E>> for TrainingMeans<'static> {
    /// Returns an engine's means without methods.
    fn from(engine: Box<E>) -> Self {
        Self { engine, methods: &NoMethods }
    }
}

impl From<Box<dyn Engine>> for TrainingMeans<'static> {
    /// Returns an engine's means without methods.
    fn from(engine: Box<dyn Engine>) -> Self {
        Self { engine, methods: &NoMethods }
    }
}

/// Continues the method of a run, if it has one with steps of its own.
pub(crate) fn resumed(
    methods: &dyn StepMethods,
    state: Option<&MethodState>,
    config: &TrainConfig,
    splats: usize,
) -> Result<Option<Box<dyn StepMethod>>, TrainError> {
    match (state, config.method.has_own_steps()) {
        (None, false) => Ok(None),
        (Some(state), true) => methods.resume(state, config, splats).map(Some),
        _ => Err(TrainError::State("the method's networks are missing, or are those of another method".to_owned())),
    }
}

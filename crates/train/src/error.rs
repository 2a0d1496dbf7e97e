//! Errors of training.

use std::sync::LazyLock;

use luxel_core::{EngineError, ExchangeError, ReadError, Remedy, SplatsError, ViewError};

use crate::{Condition, Misplaced};

/// The reason why training cannot start or continue.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// An option's value is out of range.
    #[error("{option}: {reason}")]
    Config {
        /// Name of the option, as in [`crate::OPTIONS`].
        option: &'static str,
        /// The value found and the values expected.
        reason: String,
    },
    /// An option is set although a choice that it depends on was not made.
    #[error("{option}: has an effect with {} {} only", condition.option(), condition.value())]
    Misplaced {
        /// Name of the option, as in [`crate::OPTIONS`].
        option: &'static str,
        /// The choice that the option depends on.
        condition: Condition,
        /// The remedy: make the choice, or leave the option out.
        remedy: Remedy,
    },
    /// An option asks for a scene to start from.
    #[error("freeze: {reason}")]
    NeedsScene {
        /// The reason.
        reason: String,
        /// How one is given.
        remedy: Remedy,
    },
    /// The scene to start from does not go with the data set or the options.
    #[error("the scene to start from: {reason}")]
    Scene {
        /// The property found and the one expected.
        reason: String,
        /// Advice, if there is any but another scene.
        remedy: Option<Remedy>,
    },
    /// The data set has nothing to train on.
    #[error("the data set has no training views; check its split")]
    NoTrainViews,
    /// All training pixels are masked.
    #[error("no training view has a valid pixel; all are masked, by their masks or as NaN, infinite or negative")]
    NoPixels,
    /// All training pixels are zero.
    #[error("all training images are black, so there is no radiance to learn")]
    AllBlack,
    /// A view's camera, image and mask do not agree.
    #[error(transparent)]
    View(#[from] ViewError),
    /// No splat to start from.
    #[error("no splat to start from: {0}")]
    NoSplats(&'static str),
    /// An image cannot be read again.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The ranks of a distributed run cannot exchange data, or have come apart.
    #[error(transparent)]
    Exchange(#[from] ExchangeError),
    /// The engine refused or failed.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// Some training images are radiance, others are captured LDR images.
    #[error("view {radiance} holds radiance, view {recorded} captured values; expected one kind")]
    MixedValues {
        /// Name of a view of radiance.
        radiance: String,
        /// Name of a view of captured values.
        recorded: String,
    },
    /// The exposure of a view is not a positive number.
    #[error("view {view}: an exposure of {exposure_s} s, expected a number above 0")]
    Exposure {
        /// Name of the view.
        view: String,
        /// The exposure found, in seconds.
        exposure_s: f32,
    },
    /// The method trains on radiance and captured images of the same poses.
    #[error("method {method}: view {view} {reason}")]
    NeedsPairs {
        /// Name of the method.
        method: &'static str,
        /// Name of the view.
        view: String,
        /// Property found, and the one expected.
        reason: &'static str,
    },
    /// The method trains on captured images alone.
    #[error("method {method}: view {view} {reason}")]
    NeedsCaptured {
        /// Name of the method.
        method: &'static str,
        /// Name of the view.
        view: String,
        /// Property found, and the one expected.
        reason: &'static str,
    },
    /// The method trains on captured images of one exposure.
    #[error("method {method}: captured images of {} s, expected one exposure for all", seconds(exposures_s))]
    NeedsOneExposure {
        /// Name of the method.
        method: &'static str,
        /// The exposures found, seconds, ascending.
        exposures_s: Vec<f32>,
    },
    /// The optimisation diverged.
    #[error("step {step}: the loss on view {view} is not finite")]
    NotFinite {
        /// The step, 1 for the first.
        step: u32,
        /// Name of the view.
        view: String,
    },
    /// A parameter of a splat diverged, which may leave the loss finite.
    #[error("step {step}: after training on view {view}, {source}")]
    NotFiniteSplat {
        /// The step after which it was found, 1 for the first.
        step: u32,
        /// Name of the view of that step.
        view: String,
        /// The splat and the parameter.
        source: SplatsError,
    },
    /// Pruning removed every splat.
    #[error("step {step}: every splat was pruned")]
    AllPruned {
        /// The step, 1 for the first.
        step: u32,
    },
    /// A method refuses the options or the data.
    #[error("{message}")]
    Refused {
        /// The values found and those expected.
        message: String,
        /// The remedy.
        remedy: Remedy,
    },
    /// A part of a method that has errors of its own failed.
    #[error(transparent)]
    Method(Box<dyn std::error::Error + Send + Sync>),
    /// The checkpoint's trainer state cannot be read.
    #[error("checkpoint: trainer state: {0}")]
    State(String),
    /// The checkpoint's arrays do not make up a scene.
    #[error("checkpoint: {what}: {source}")]
    Checkpoint {
        /// The part of the checkpoint: scene, first moments, second moments or average.
        what: &'static str,
        /// The reason why the array is invalid.
        source: SplatsError,
    },
    /// The checkpoint belongs to another data set.
    #[error(
        "the checkpoint was trained on data set {checkpoint}, this one is {dataset}; resume with the images, cameras and split it was started with"
    )]
    Fingerprint {
        /// Fingerprint of the checkpoint's data set.
        checkpoint: String,
        /// Fingerprint of the data set given.
        dataset: String,
    },
    /// The checkpoint's scene has another colour model than its configuration.
    #[error("the checkpoint's scene is of colour model {scene}, its configuration says {config}")]
    ColorModel {
        /// Colour model of the splats.
        scene: String,
        /// Colour model of the configuration.
        config: String,
    },
}

impl TrainError {
    /// Returns the error of a method's own part as one of training.
    pub fn of_method(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Method(Box::new(error))
    }

    /// Returns what to do about the error.
    pub fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Engine(error) => error.remedy(),
            Self::Read(error) => error.remedy.as_ref(),
            Self::Misplaced { remedy, .. } | Self::NeedsScene { remedy, .. } | Self::Refused { remedy, .. } => Some(remedy),
            Self::Scene { remedy, .. } => remedy.as_ref(),
            Self::AllBlack => Some(&ALL_BLACK),
            Self::MixedValues { .. } => Some(&MIXED_VALUES),
            Self::NeedsPairs { .. } => Some(&NEEDS_PAIRS),
            Self::NeedsCaptured { .. } => Some(&NEEDS_CAPTURED),
            Self::NeedsOneExposure { .. } => Some(&NEEDS_ONE_EXPOSURE),
            Self::NotFinite { .. } => Some(&NOT_FINITE),
            Self::NotFiniteSplat { .. } => Some(&NOT_FINITE_SPLAT),
            Self::AllPruned { .. } => Some(&ALL_PRUNED),
            _ => None,
        }
    }

    /// Returns the name of the option that the error is about, as in [`crate::OPTIONS`].
    pub fn option(&self) -> Option<&'static str> {
        match self {
            Self::Config { option, .. } | Self::Misplaced { option, .. } => Some(option),
            _ => None,
        }
    }

    pub(crate) fn misplaced(Misplaced { option, condition }: Misplaced) -> Self {
        let remedy = Remedy::set(condition.option(), condition.value()).or(Remedy::leave_out(option.name));
        Self::Misplaced { option: option.name, condition, remedy }
    }

    /// Returns the error of an option's value.
    pub fn config(option: &'static str, reason: impl Into<String>) -> Self {
        Self::Config { option, reason: reason.into() }
    }
}

/// Returns exposures as text.
fn seconds(exposures_s: &[f32]) -> String {
    exposures_s.iter().map(f32::to_string).collect::<Vec<_>>().join(", ")
}

static ALL_BLACK: LazyLock<Remedy> = LazyLock::new(|| Remedy::advice("check the images").or(Remedy::give("radiance_scale")));
static NEEDS_PAIRS: LazyLock<Remedy> = LazyLock::new(|| Remedy::set("supervision", "both").or(Remedy::set("method", "logsh3")));
static NEEDS_CAPTURED: LazyLock<Remedy> = LazyLock::new(|| Remedy::set("supervision", "ldr").or(Remedy::set("method", "logsh3")));
static NEEDS_ONE_EXPOSURE: LazyLock<Remedy> = LazyLock::new(|| Remedy::set("exposures", "middle").or(Remedy::set("exposures", "0")));
static MIXED_VALUES: LazyLock<Remedy> =
    LazyLock::new(|| Remedy::give("supervision").or(Remedy::advice("move the images of the other kind out of the data set")));
static NOT_FINITE: LazyLock<Remedy> = LazyLock::new(|| {
    Remedy::advice("continue from the last checkpoint")
        .or(Remedy::lower("luminance_lr"))
        .or(Remedy::lower("sh_lr"))
        .or(Remedy::give("radiance_scale"))
});
static NOT_FINITE_SPLAT: LazyLock<Remedy> = LazyLock::new(|| {
    Remedy::advice("continue from the last checkpoint")
        .or(Remedy::lower("position_lr"))
        .or(Remedy::lower("scale_lr"))
        .or(Remedy::lower("opacity_lr"))
        .or(Remedy::lower("rotation_lr"))
});
static ALL_PRUNED: LazyLock<Remedy> =
    LazyLock::new(|| Remedy::lower("prune_opacity").or(Remedy::advice("check the cameras and the radiance scale")));

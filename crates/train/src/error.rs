//! What can go wrong between a data set and a trained scene.

use luxel_core::{EngineError, Remedy, SplatsError, ViewError};

/// Why training cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// An option's value is out of range or does not go with another.
    #[error("--{option}: {reason}")]
    Config {
        /// Its long name, without dashes.
        option: &'static str,
        /// What was found, what is expected.
        reason: String,
    },
    /// The data set has nothing to train on.
    #[error("the data set has no training views; check its split")]
    NoTrainViews,
    /// All training pixels are masked.
    #[error("no training view has a valid pixel; all are masked, by their masks or as NaN, infinite or negative")]
    NoPixels,
    /// All training pixels are zero.
    #[error(
        "all training images are black, so there is no radiance to learn; check the images, or give --radiance-scale if that is intended"
    )]
    AllBlack,
    /// A view's camera, image and mask do not agree.
    #[error(transparent)]
    View(#[from] ViewError),
    /// No splat to start from.
    #[error("no splat to start from: {0}")]
    NoSplats(&'static str),
    /// The engine refused or failed.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// Some training images are radiance, some recorded values.
    #[error(
        "view {radiance} is of radiance, view {recorded} of recorded values; train on one kind: choose by --supervision, or move the others out"
    )]
    MixedValues {
        /// Name of a view of radiance.
        radiance: String,
        /// Name of a view of recorded values.
        recorded: String,
    },
    /// An exposure that no image has.
    #[error("view {view}: an exposure of {exposure_s} s, expected a number above 0")]
    Exposure {
        /// Name of the view.
        view: String,
        /// Seconds.
        exposure_s: f32,
    },
    /// The optimisation diverged.
    #[error(
        "step {step}: the loss on view {view} is not finite; resume from the last checkpoint, or start anew with lower learning rates (--luminance-lr, --sh-lr) or another --radiance-scale"
    )]
    NotFinite {
        /// 1 for the first.
        step: u32,
        /// Name of the view.
        view: String,
    },
    /// Pruning left nothing.
    #[error("step {step}: every splat was pruned; lower --prune-opacity, or check the cameras and the radiance scale")]
    AllPruned {
        /// 1 for the first.
        step: u32,
    },
    /// The checkpoint's trainer state cannot be read.
    #[error("checkpoint: trainer state: {0}")]
    State(String),
    /// The checkpoint's arrays do not make up a scene.
    #[error("checkpoint: {what}: {source}")]
    Checkpoint {
        /// Scene, first or second moments.
        what: &'static str,
        /// What is wrong with it.
        source: SplatsError,
    },
    /// The checkpoint belongs to another data set.
    #[error(
        "the checkpoint was trained on data set {checkpoint}, this one is {dataset}; resume with the images, cameras and split it was started with"
    )]
    Fingerprint {
        /// Of the checkpoint.
        checkpoint: String,
        /// Of the data set given.
        dataset: String,
    },
    /// The checkpoint holds another colour model than its configuration says.
    #[error("the checkpoint's scene is of colour model {scene}, its configuration says {config}")]
    ColorModel {
        /// Of the splats.
        scene: String,
        /// Of the configuration.
        config: String,
    },
}

impl TrainError {
    /// Returns what to do about the error.
    pub fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Engine(error) => error.remedy(),
            _ => None,
        }
    }

    pub(crate) fn config(option: &'static str, reason: impl Into<String>) -> Self {
        Self::Config { option, reason: reason.into() }
    }
}

//! Published methods beside Luxel's own, to compare with: radiance fields, anchors whose splats
//! networks decode for each view, and methods on splats that train on captured images.
//!
//! Fields and anchors are a [`luxel_train::Reconstruction`], which a run drives as it drives
//! splats. Methods on splats are a [`luxel_train::StepMethod`], which a [`luxel_train::Trainer`]
//! asks for its steps; [`CapturedMethods`] makes them. Equal inputs and seed give equal bits for
//! any number of threads. Sources and deviations from what was published:
//! `docs/src/guide/published-methods.md` and `docs/src/guide/radiance-fields.md`.

mod anchors;
mod captured;
mod field;
mod file_error;
mod networks;
mod place;
#[cfg(test)]
mod testing;

pub use anchors::{
    AnchorArray, AnchorCheckpoint, AnchorEngine, AnchorFile, AnchorRun, AnchorScene, AnchorSnapshot, AnchorTrainer, Anchors,
    SPLATS_PER_ANCHOR, read_anchor_run, read_anchors,
};
pub use captured::{CapturedMethods, one_exposure};
pub use field::{
    ColorHead, Field, FieldArrays, FieldCheckpoint, FieldConfig, FieldEngine, FieldError, FieldNetwork, FieldRun, FieldShape,
    FieldSnapshot, FieldState, FieldStep, FieldTrainer, GridShape, Objective, PixelLoss, Space, check_exposures, field_network, read_field,
    read_field_run,
};
pub use file_error::{FileError, Tensors};

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;

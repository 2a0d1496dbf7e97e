//! The method: initialisation, schedule, densification and the training loop.
//!
//! A [`Trainer`] takes a data set, a [`TrainConfig`] and any [`luxel_core::Engine`], and trains a
//! scene step by step. All random numbers come from one seed, so on a deterministic engine equal
//! inputs give equal scenes. A [`luxel_core::Snapshot`] holds everything that a run needs to resume
//! bit for bit.

mod ahead;
mod average;
mod camera_response;
mod companion;
mod config;
mod contribution;
mod crop;
pub mod densify;
mod error;
mod free_space;
mod gains;
mod init;
mod lenses;
mod neighbourhood;
mod pixel_weights;
mod poses;
mod reconstruction;
mod recorded;
mod reduce;
mod report_words;
mod resolution;
mod scale;
mod schedule;
mod smoothing;
mod start_views;
mod state;
mod step_method;
#[cfg(test)]
mod testing;
mod trainer;
mod turn;
mod validation_views;
mod view_order;
mod view_training;
mod views;
mod vignetting;

pub use config::{
    BatchRule, ColorValues, Colors, Condition, CutoffPreset, ExposureCompensation, FieldLoss, FieldNetworkChoice, Freeze, HdrNormalisation,
    LateViews, MAX_BATCH, MAX_SEED, MCMC_DEFAULT_MAX_SPLATS, Method, MethodSpec, Misplaced, NamedChoice, OPTIONS, OptionSpec, Preset,
    Range, Representation, ScaleRule, Scheme, Strategy, TrainConfig, ValueHelp, parse_rgb,
};
pub use contribution::add_contribution;
pub use error::TrainError;
pub use init::{Initial, first_colors_bytes, initialise, radiance_scale_of, spacing, start_scale, stereo_bytes};
pub use neighbourhood::Neighbourhood;
pub use pixel_weights::NoiseChoice;
pub use poses::{ALIGNMENT_STEPS, AlignmentScene, PoseChange, PoseReport, align_camera, pose_change};
pub use reconstruction::{ANCHOR_FORMAT, ArrayFile, FIELD_FORMAT, FileArray, Reconstruction, SavedRun, SceneContent, SceneSize};
pub use reduce::RankViews;
pub use resolution::{ResolutionSchedule, Stage};
pub use schedule::{ABSGRAD_OPACITY_CAP, RESET_OPACITY, Schedule};
pub use smoothing::smoothing;
pub use state::{snapshot_config, snapshot_response, snapshot_vignetting};
pub use step_method::{MethodState, MethodStep, NoMethods, StepImages, StepMethod, StepMethods, ToneMapperRecord, TrainingMeans};
pub use trainer::{RunState, Trainer, lifted_engine, snapshot_scene};
pub use view_training::{StepView, ViewState, ViewTraining, first_splats, train_px};
pub use vignetting::LensVignetting;

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;

//! The published methods that train on pairs of radiance and captured images, beside the colour
//! models: each step computes its own images and losses over the engine's rasteriser with
//! gradients, and hands the engine the gradients by the splats.
//!
//! In: views with captured images, the options of the method. Out: gradients and statistics in the
//! engine's form, and the shared networks of the method, which are part of the run's state. Sources
//! and deviations from what was published: `docs/src/guide/published-methods.md`. Degenerate: data
//! without pairs and options that a method does not have are errors at the start.

mod adam;
mod check;
mod hdr_gs;
mod image_loss;
mod pair;
mod radiance_loss;
mod rasterised;
mod relu_line;
mod tone_mappers;

use luxel_core::Dataset;
use serde::{Deserialize, Serialize};

pub(crate) use self::check::check_options;
pub(crate) use self::hdr_gs::HdrGsStep;
pub use self::pair::one_exposure;
pub(crate) use self::pair::{check_pairs, exposure_of, turn};
pub use self::tone_mappers::ToneMapperRecord;
use self::tone_mappers::ToneMappers;
use crate::config::Method;
use crate::{TrainConfig, TrainError};

/// The networks that all splats share, by method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SharedNetworks {
    HdrGs(ToneMappers),
}

impl SharedNetworks {
    /// Makes the networks at the start of a run; `None` for a method without any.
    pub(crate) fn new(config: &TrainConfig, dataset: &Dataset) -> Option<Self> {
        let exposures = || dataset.train.iter().flat_map(|view| &view.recordings).filter_map(exposure_of);
        match config.method {
            Method::HdrGs => Some(Self::HdrGs(ToneMappers::new(config.tone_width, exposures(), config.seed))),
            _ => None,
        }
    }

    /// Checks networks read from a file against the options.
    pub(crate) fn validate(networks: Option<&Self>, config: &TrainConfig) -> Result<(), TrainError> {
        match (networks, config.method) {
            (Some(Self::HdrGs(mappers)), Method::HdrGs) => mappers.validate(config.tone_width),
            (None, method) if !method.trains_on_pairs() => Ok(()),
            _ => Err(TrainError::State("the method's networks are missing, or are those of another method".to_owned())),
        }
    }

    /// Returns the record of the tone mappers, if these are any.
    pub(crate) fn tone_mappers(&self, radiance_unit: f32) -> Option<ToneMapperRecord> {
        match self {
            Self::HdrGs(mappers) => Some(mappers.record(radiance_unit)),
        }
    }
}

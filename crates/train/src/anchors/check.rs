//! The options that methods on anchors do not have: their steps would ignore them.

use luxel_core::Antialias;

use crate::config::{ExposureCompensation, Freeze, Method, Strategy};
use crate::{NamedChoice, TrainConfig, TrainError};

/// Checks that no option is set that a method on anchors does not have.
///
/// # Errors
/// [`TrainError::Config`] for the first one.
pub(crate) fn check_anchor_options(config: &TrainConfig) -> Result<(), TrainError> {
    if !config.method.has_anchors() {
        return Ok(());
    }
    let method = config.method.name();
    let refused = |option: &'static str, found: String, expected: &str| {
        Err(TrainError::config(option, format!("found {found}, expected {expected}: method {method} has no other")))
    };
    let blends_channels = config.method == Method::GaussHdrAnchors;
    match config {
        TrainConfig { batch, .. } if *batch > 1 => refused("batch", batch.to_string(), "1"),
        TrainConfig { strategy: Strategy::Mcmc, .. } => refused("strategy", "mcmc".to_owned(), "adc"),
        TrainConfig { absgrad: true, .. } => refused("absgrad", "true".to_owned(), "false"),
        TrainConfig { antialias: Antialias::Mip, .. } => refused("antialias", "mip".to_owned(), "off or pixel"),
        TrainConfig { freeze: Freeze::Geometry, .. } => refused("freeze", "geometry".to_owned(), "none"),
        TrainConfig { exposure_compensation, .. } if *exposure_compensation != ExposureCompensation::Off => {
            refused("exposure_compensation", exposure_compensation.name().to_owned(), "off")
        }
        TrainConfig { vignetting: true, .. } => refused("vignetting", "true".to_owned(), "false"),
        TrainConfig { refine_poses: true, .. } => refused("refine_poses", "true".to_owned(), "false"),
        TrainConfig { samples, .. } if *samples > 1 && blends_channels => refused("samples", samples.to_string(), "1"),
        TrainConfig { background, .. } if *background != [0.0; 3] && blends_channels => {
            refused("background", format!("{background:?}"), "0")
        }
        _ => Ok(()),
    }
}

//! The options that methods with steps of their own and methods on anchors do not have: their steps
//! would ignore them.

use luxel_core::Antialias;

use super::{ExposureCompensation, Freeze, NamedChoice, Representation, Scheme, Strategy, TrainConfig};
use crate::TrainError;

/// Checks that no option is set that a method with steps of its own, or on anchors, does not have.
///
/// # Errors
/// [`TrainError::Config`] for the first one.
pub(crate) fn check_options(config: &TrainConfig) -> Result<(), TrainError> {
    if config.method.spec().scheme == Scheme::Pairs && config.ldr_weight + config.hdr_weight == 0.0 {
        return Err(TrainError::config("hdr_weight", "found 0 beside an ldr_weight of 0, expected one above 0"));
    }
    if !config.method.has_own_steps() && config.method.spec().representation != Representation::Anchors {
        return Ok(());
    }
    let method = config.method.name();
    let refused = |option: &'static str, found: String, expected: &str| {
        Err(TrainError::config(option, format!("found {found}, expected {expected}: method {method} has no other")))
    };
    // Channels are blended over black, with one sample a pixel.
    let blends_channels = config.method.has_own_networks();
    match config {
        TrainConfig { batch, .. } if *batch > 1 => refused("batch", batch.to_string(), "1"),
        TrainConfig { strategy: Strategy::Mcmc, .. } => refused("strategy", "mcmc".to_owned(), "adc"),
        TrainConfig { absgrad: true, .. } => refused("absgrad", "true".to_owned(), "false"),
        TrainConfig { samples: Some(samples), .. } if *samples > 1 && blends_channels => refused("samples", samples.to_string(), "1"),
        TrainConfig { antialias: Antialias::Mip, .. } => refused("antialias", "mip".to_owned(), "off or pixel"),
        TrainConfig { freeze: Freeze::Geometry, .. } => refused("freeze", "geometry".to_owned(), "none"),
        TrainConfig { exposure_compensation, .. } if *exposure_compensation != ExposureCompensation::Off => {
            refused("exposure_compensation", exposure_compensation.name().to_owned(), "off")
        }
        TrainConfig { vignetting: true, .. } => refused("vignetting", "true".to_owned(), "false"),
        TrainConfig { refine_poses: true, .. } => refused("refine_poses", "true".to_owned(), "false"),
        TrainConfig { background, .. } if *background != [0.0; 3] && blends_channels => {
            refused("background", format!("{background:?}"), "0")
        }
        _ => Ok(()),
    }
}

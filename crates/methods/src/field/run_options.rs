//! From the options of a run to those of a field's training, and what they ask of the data.
//!
//! In: options, a data set. Out: [`FieldConfig`]. Degenerate: sizes out of range, and exposures
//! that a method cannot learn from, are errors.

use luxel_core::{Dataset, PixelValues, RadianceScale, Remedy};
use luxel_train::{ColorValues, FieldLoss, FieldNetworkChoice, NamedChoice, Representation, Scheme, TrainConfig, TrainError};

use super::{FieldConfig, FieldNetwork, Objective, PixelLoss};
use crate::captured::one_exposure;

/// Least ratio of the longest to the shortest exposure, half a stop: closer ones tell a tone mapper
/// nothing.
const LEAST_RATIO: f32 = std::f32::consts::SQRT_2;

/// Returns the options of a field's training.
///
/// # Errors
/// Sizes of a network that are out of range.
pub(super) fn options(config: &TrainConfig, radiance_scale: RadianceScale) -> Result<FieldConfig, TrainError> {
    let objective = match config.method.spec().scheme {
        Scheme::Captured => Objective::Captured { unit_value: config.unit_exposure },
        Scheme::Pairs => Objective::Pairs { captured_weight: config.ldr_weight, radiance_weight: config.hdr_weight },
        Scheme::Radiance | Scheme::RadianceOrCaptured => Objective::Radiance {
            loss: match config.field_loss.unwrap_or_default() {
                FieldLoss::Linear => PixelLoss::Linear,
                FieldLoss::Mulaw => PixelLoss::Mulaw,
            },
        },
    };
    let network = field_network(config)?;
    Ok(FieldConfig { iterations: config.iterations, seed: config.seed, objective, mu: config.mu, radiance_scale, network })
}

/// Returns the network of a field.
///
/// # Errors
/// Sizes that are out of range.
pub fn field_network(config: &TrainConfig) -> Result<FieldNetwork, TrainError> {
    let network = match config.field_network.unwrap_or_default() {
        FieldNetworkChoice::Grid => FieldNetwork::default(),
        FieldNetworkChoice::Layers { layers, units } => FieldNetwork::Layers { layers, units },
    };
    if network.is_valid() {
        return Ok(network);
    }
    let (layers, units) = (FieldNetwork::LAYERS, FieldNetwork::UNITS);
    let message = format!(
        "field_network: found {}, expected {} to {} layers of {} to {} units",
        config.field_network.unwrap_or_default(),
        layers.start(),
        layers.end(),
        units.start(),
        units.end()
    );
    Err(TrainError::Refused { message, remedy: Remedy::set("field_network", "8x256") })
}

/// Checks that the exposures of captured images are those that the method needs: several for a tone
/// mapper, one where the exposure does not enter.
///
/// # Errors
/// One exposure, or several, where the other is needed.
pub fn check_exposures(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
    let (method, spec) = (config.method, config.method.spec());
    if spec.values == ColorValues::Captured {
        one_exposure(&dataset.train, method.name())?;
    }
    if spec.representation != Representation::Field || spec.scheme != Scheme::Captured {
        return Ok(());
    }
    let exposures = dataset.train.iter().filter_map(|view| match view.values {
        PixelValues::Recorded { exposure_s } => Some(exposure_s),
        PixelValues::Radiance => None,
    });
    let (shortest, longest) = exposures.fold((f32::INFINITY, 0.0f32), |(a, b), t| (a.min(t), b.max(t)));
    if longest > 0.0 && longest < LEAST_RATIO * shortest {
        let message = format!(
            "method {}: captured images of {shortest} to {longest} s, expected exposures at least half a stop apart, which tell the camera's response",
            method.name()
        );
        let remedy = Remedy::set("exposures", "all").or(Remedy::set("method", "lcd"));
        return Err(TrainError::Refused { message, remedy });
    }
    Ok(())
}

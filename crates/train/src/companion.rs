//! Companions of the splats: numbers that a run trains beside them if its configuration asks for
//! them, and keeps in its state.
//!
//! In: what a resumed state holds, and the run that it is resumed with. Out: a clear error where a
//! companion is missing, is there unasked, or belongs to other data.

use luxel_core::Dataset;

use crate::camera_response::CameraResponse;
use crate::config::ExposureCompensation;
use crate::gains::Gains;
use crate::poses::{Corrections, Poses};
use crate::recorded::learns_response;
use crate::vignetting::{Lenses, Vignettings};
use crate::{TrainConfig, TrainError};

/// The run that a companion is of.
pub(crate) struct RunOf<'a> {
    pub(crate) dataset: &'a Dataset,
    pub(crate) config: &'a TrainConfig,
    /// Radius of the cameras' places, world units.
    pub(crate) extent: f32,
}

/// Numbers beside the splats.
pub(crate) trait Companion {
    /// The name in messages.
    const NAME: &'static str;

    /// Returns whether a run trains them.
    fn is_of(run: &RunOf<'_>) -> Result<bool, TrainError>;

    /// Checks that they are finite and as many as the run needs.
    fn validate_for(&self, run: &RunOf<'_>) -> Result<(), TrainError>;
}

/// Checks a companion that a state holds, or does not hold.
pub(crate) fn check<C: Companion>(stored: Option<&C>, run: &RunOf<'_>) -> Result<(), TrainError> {
    match (stored, C::is_of(run)?) {
        (Some(companion), true) => companion.validate_for(run),
        (None, false) => Ok(()),
        (None, true) => Err(TrainError::State(format!("{}: expected in the state of this run, and missing", C::NAME))),
        (Some(_), false) => Err(TrainError::State(format!("{}: found in the state of a run that does not train with them", C::NAME))),
    }
}

impl Companion for Gains {
    const NAME: &'static str = "gains of the images";

    fn is_of(run: &RunOf<'_>) -> Result<bool, TrainError> {
        Ok(run.config.exposure_compensation != ExposureCompensation::Off)
    }

    fn validate_for(&self, run: &RunOf<'_>) -> Result<(), TrainError> {
        self.validate(run.dataset.train.len())
    }
}

impl Companion for Vignettings {
    const NAME: &'static str = "the vignetting of the lenses";

    fn is_of(run: &RunOf<'_>) -> Result<bool, TrainError> {
        Ok(run.config.vignetting)
    }

    fn validate_for(&self, run: &RunOf<'_>) -> Result<(), TrainError> {
        self.validate(&Lenses::new(run.dataset))
    }
}

impl Companion for Corrections {
    const NAME: &'static str = "corrections of the poses";

    fn is_of(run: &RunOf<'_>) -> Result<bool, TrainError> {
        Ok(run.config.refine_poses)
    }

    fn validate_for(&self, run: &RunOf<'_>) -> Result<(), TrainError> {
        self.validate(&Poses::of_views(run.dataset, run.extent), run.config.refine_focal)
    }
}

impl Companion for CameraResponse {
    const NAME: &'static str = "the response of the camera";

    fn is_of(run: &RunOf<'_>) -> Result<bool, TrainError> {
        learns_response(run.dataset, run.config)
    }

    fn validate_for(&self, _run: &RunOf<'_>) -> Result<(), TrainError> {
        self.validate()
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;

    use super::*;
    use crate::testing::{camera_at, dataset_of, view_of};

    #[test]
    fn a_companion_is_there_if_the_run_trains_it() {
        let dataset = dataset_of(vec![view_of("0", camera_at([0.0; 3], [8, 8]), Image::filled(8, 8, [0.2; 3]))]);
        let with = |exposure_compensation| TrainConfig { exposure_compensation, ..TrainConfig::default() };
        let (trained, off) = (with(ExposureCompensation::Exposure), with(ExposureCompensation::Off));
        let of = |config| RunOf { dataset: &dataset, config, extent: 1.0 };
        let (right, other) = (Gains::ones(dataset.train.len()), Gains::ones(dataset.train.len() + 1));
        assert!(check(Some(&right), &of(&trained)).is_ok() && check::<Gains>(None, &of(&off)).is_ok());
        let errors = [check::<Gains>(None, &of(&trained)), check(Some(&right), &of(&off)), check(Some(&other), &of(&trained))];
        for (error, expected) in errors.into_iter().zip(["missing", "does not train", "gains of"]) {
            let error = error.unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}

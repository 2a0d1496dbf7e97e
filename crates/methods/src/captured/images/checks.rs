//! Checks of the training views of methods on captured images: images beside radiance or alone, and
//! the one exposure that some need.
//!
//! In: training views. Out: errors that name a view and what was expected of it.

use luxel_core::{PixelValues, View};

use luxel_train::TrainError;

const NO_CAPTURED_IMAGE: &str = "has no captured image beside its radiance, expected one or more";

/// Returns the exposure of a captured image.
pub(crate) fn exposure_of(recording: &View) -> Option<f32> {
    match recording.values {
        PixelValues::Recorded { exposure_s } => Some(exposure_s),
        PixelValues::Radiance => None,
    }
}

/// Returns the exposure that all captured images beside the training views have, seconds.
///
/// # Errors
/// [`TrainError::NeedsOneExposure`] if they differ, [`TrainError::NeedsPairs`] without any.
pub fn one_exposure(train: &[View], method: &'static str) -> Result<f32, TrainError> {
    let mut exposures_s: Vec<f32> = train.iter().flat_map(|view| &view.recordings).filter_map(exposure_of).collect();
    exposures_s.sort_by(f32::total_cmp);
    exposures_s.dedup();
    match (&exposures_s[..], train.first()) {
        ([exposure_s], _) => Ok(*exposure_s),
        ([], Some(view)) => Err(TrainError::NeedsPairs { method, view: view.name.clone(), reason: NO_CAPTURED_IMAGE }),
        ([], None) => Err(TrainError::NoTrainViews),
        _ => Err(TrainError::NeedsOneExposure { method, exposures_s }),
    }
}

/// Checks that every training view is radiance with captured images beside it, seen by a pinhole.
pub(crate) fn check_pairs(train: &[View], method: &'static str) -> Result<(), TrainError> {
    for view in train {
        let reason = if view.values != PixelValues::Radiance {
            "is a captured image, expected radiance with captured images beside it"
        } else if view.recordings.is_empty() {
            NO_CAPTURED_IMAGE
        } else if !view.camera.projection.is_pinhole() {
            "is of a lens that is no pinhole, expected pinhole cameras"
        } else {
            continue;
        };
        return Err(TrainError::NeedsPairs { method, view: view.name.clone(), reason });
    }
    Ok(())
}

/// Checks that every training view is a captured image, seen by a pinhole.
pub(crate) fn check_captured(train: &[View], method: &'static str) -> Result<(), TrainError> {
    for view in train {
        let reason = if exposure_of(view).is_none() {
            "is radiance, expected a captured image with its exposure"
        } else if !view.camera.projection.is_pinhole() {
            "is of a lens that is no pinhole, expected pinhole cameras"
        } else {
            continue;
        };
        return Err(TrainError::NeedsCaptured { method, view: view.name.clone(), reason });
    }
    Ok(())
}

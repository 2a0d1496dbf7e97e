//! The captured image of a step: which of those of a pose it is, and the one exposure that some
//! methods need.
//!
//! In: a view with its captured images, the step. Out: the index of one of them. Each pose takes
//! its captured images in turn, and poses begin at different ones, so over as many epochs as there
//! are exposures every pair of a pose and an exposure comes once. Degenerate: a view without
//! captured images is an error.

use luxel_core::{PixelValues, View};

use crate::TrainError;

const NO_CAPTURED_IMAGE: &str = "has no captured image beside its radiance, expected one or more";

/// Returns the index of the captured image of a view that `step` sees, of `views` views.
pub(crate) fn turn(step: u32, index: usize, views: usize, recordings: usize) -> usize {
    let epoch = (step.saturating_sub(1) as usize) / views.max(1);
    (epoch + index) % recordings.max(1)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_comes_once_in_as_many_epochs_as_there_are_exposures() {
        let mut seen = [[0; 3]; 7];
        for step in 1..=21 {
            // Within an epoch the order of views is any.
            let index = (step as usize * 3) % 7;
            seen[index][turn(step, index, 7, 3)] += 1;
        }
        assert_eq!(seen, [[1; 3]; 7]);
        assert_eq!([0, 1, 2].map(|index| turn(1, index, 7, 3)), [0, 1, 2]);
    }
}

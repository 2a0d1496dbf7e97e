//! The training views of a field, in memory.
//!
//! In: a data set, what the field learns from. Out: pixels by number, among those of all views.
//! Degenerate: no view, no valid pixel, and views of other values are errors.

use luxel_core::{Dataset, PixelValues, View};

use crate::field::error::FieldError;
use crate::field::objective::Objective;

/// A training view, with the captured image that is trained on beside its radiance.
pub(crate) struct TrainingView {
    pub(crate) view: View,
    pub(crate) captured: Option<View>,
}

/// The views that a field is trained on.
pub(crate) struct TrainingViews {
    views: Vec<TrainingView>,
    /// Number of the first pixel of each view, and the number of all.
    starts: Vec<u64>,
}

impl TrainingViews {
    /// Reads the training views into memory, and numbers their pixels.
    pub(crate) fn load(dataset: &Dataset, objective: Objective) -> Result<Self, FieldError> {
        let mut views = Vec::with_capacity(dataset.train.len());
        let mut starts = vec![0];
        let mut has_pixels = false;
        for view in &dataset.train {
            view.validate()?;
            check_values(view, objective)?;
            let captured = match objective {
                Objective::Pairs { .. } => view.recordings.first().map(View::loaded).transpose()?,
                Objective::Radiance { .. } | Objective::Captured { .. } => None,
            };
            let view = View { recordings: Vec::new(), ..view.loaded()? };
            has_pixels |= (0..view.image.pixels.len()).any(|i| view.is_valid(i));
            starts.push(starts.last().unwrap_or(&0) + view.pixel_count());
            views.push(TrainingView { view, captured });
        }
        match (views.is_empty(), has_pixels) {
            (true, _) => Err(FieldError::NoTrainViews),
            (_, false) => Err(FieldError::NoPixels),
            _ => Ok(Self { views, starts }),
        }
    }

    /// Returns the view and the number in it of the pixel that random bits choose among all.
    pub(crate) fn pixel(&self, bits: u64) -> Option<(&TrainingView, usize)> {
        let pixel = bits.checked_rem(*self.starts.last()?)?;
        let number = self.starts.partition_point(|start| *start <= pixel).checked_sub(1)?;
        Some((self.views.get(number)?, (pixel - self.starts[number]) as usize))
    }
}

/// Checks that a view holds what the objective reads.
fn check_values(view: &View, objective: Objective) -> Result<(), FieldError> {
    let is_radiance = view.values == PixelValues::Radiance;
    let expected = match objective {
        Objective::Radiance { .. } if !is_radiance => "radiance",
        Objective::Captured { .. } if is_radiance => "a captured LDR image with its exposure",
        Objective::Pairs { .. } if !is_radiance || view.recordings.len() != 1 => "radiance with one captured LDR image beside it",
        _ => return Ok(()),
    };
    let found = match (is_radiance, view.recordings.len()) {
        (false, _) => "holds a captured LDR image",
        (true, 0) => "holds radiance without a captured LDR image",
        (true, 1) => "holds radiance with one captured LDR image",
        (true, _) => "holds radiance with several captured LDR images",
    };
    Err(FieldError::Values { view: view.name.clone(), found, expected })
}

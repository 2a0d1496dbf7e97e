//! Gains of the training images, for exposure or white balance that drifts between views of a
//! static scene.
//!
//! In: renders of training views [H,W,3] and their images, both in normalised units. Out: a gain
//! per view and channel, by which the image is divided in training. Scene and gains are optimised
//! in alternation. Once in [`VISITS_BETWEEN`] epochs, each view is rendered after its step, and its
//! gain moves so that the median of ln(image / render) over reliable pixels is 0.
//!
//! Gauge: a scene twice as bright with gains half as large explains the images equally well; the
//! same holds for each channel. Therefore the mean of ln gain over the views is held at 0, per
//! channel, after every update. Whatever all images share stays in the scene exactly.
//!
//! The median is weighted: pixels count unless they are masked, so dark that noise and the render's
//! floor dominate, or (for captured values) black or saturated. A view with too few such pixels
//! keeps its gain.

use serde::{Deserialize, Serialize};

use crate::TrainError;

/// Number of epochs from one measurement to the next; measurements are rare because each needs a
/// render.
const VISITS_BETWEEN: u32 = 4;
/// Number of epochs before the first measurement, so that the scene has formed.
const FIRST_ROUND: u32 = 3;
/// Largest |ln gain|: ten stops either way, far beyond any drift.
const MAX_LOG_GAIN: f32 = 7.0;
/// ln gain of every training view, by channel. The sum over the views is 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Gains {
    log: Vec<[f32; 3]>,
}

impl Gains {
    /// Returns gains of 1 for `count` views.
    pub(crate) fn ones(count: usize) -> Self {
        Self { log: vec![[0.0; 3]; count] }
    }

    /// Returns the gain of view `index`.
    pub(crate) fn gain(&self, index: usize) -> [f32; 3] {
        self.log.get(index).map_or([1.0; 3], |log| log.map(f32::exp))
    }

    /// Returns ln gain of every view, for display.
    pub(crate) fn logs(&self) -> &[[f32; 3]] {
        &self.log
    }

    /// Returns whether the view of `step` (1 for the first) is measured after it.
    pub(crate) fn measures_after(&self, step: u32) -> bool {
        let round = step.saturating_sub(1) / u32::try_from(self.log.len().max(1)).unwrap_or(u32::MAX);
        round >= FIRST_ROUND && (round - FIRST_ROUND).is_multiple_of(VISITS_BETWEEN)
    }

    /// Changes the gain of view `index` by the measured ratio and shifts all gains back to a mean
    /// of 0.
    pub(crate) fn shift(&mut self, index: usize, log_ratio: [f32; 3]) {
        let Some(log) = self.log.get_mut(index) else { return };
        for (log, ratio) in log.iter_mut().zip(log_ratio) {
            *log = (*log + ratio).clamp(-MAX_LOG_GAIN, MAX_LOG_GAIN);
        }
        self.center();
    }

    fn center(&mut self) {
        let count = self.log.len().max(1) as f64;
        for channel in 0..3 {
            let mean = self.log.iter().map(|log| f64::from(log[channel])).sum::<f64>() / count;
            for log in &mut self.log {
                log[channel] = (f64::from(log[channel]) - mean) as f32;
            }
        }
    }

    /// Checks gains from a file against the number of training views.
    pub(crate) fn validate(&self, views: usize) -> Result<(), TrainError> {
        if self.log.len() != views {
            return Err(TrainError::State(format!("gains of {} views, the data set has {views}", self.log.len())));
        }
        match self.log.as_flattened().iter().find(|log| !log.is_finite()) {
            Some(log) => Err(TrainError::State(format!("a gain's logarithm is {log}, expected a finite number"))),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_without_compensation_have_no_gain() {
        use crate::config::ExposureCompensation;
        assert_eq!(ExposureCompensation::Off.gain_channels(), None);
    }

    #[test]
    fn gains_have_a_mean_of_zero_whatever_is_measured() {
        let mut gains = Gains::ones(7);
        for (i, shift) in [(0, [0.3, -0.2, 9.0]), (3, [1.0, 1.0, 1.0]), (3, [0.5, 0.0, -0.4]), (6, [-2.0, 0.1, 0.7]), (9, [1.0; 3])] {
            gains.shift(i, shift);
            for c in 0..3 {
                let sum: f64 = gains.logs().iter().map(|log| f64::from(log[c])).sum();
                assert!(sum.abs() < 1e-6, "{sum}");
            }
        }
        assert!(gains.gain(3)[0] > 1.0 && gains.validate(7).is_ok() && gains.validate(6).is_err());
        assert_eq!(gains.gain(99), [1.0; 3]);
    }

    #[test]
    fn all_views_are_measured_in_the_same_round() {
        let gains = Gains::ones(5);
        let due: Vec<u32> = (1..=45).filter(|step| gains.measures_after(*step)).collect();
        assert_eq!(due, (16..=20).chain(36..=40).collect::<Vec<_>>());
    }
}

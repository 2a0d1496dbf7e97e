//! Gains of the training images: what drifts from view to view though the scene does not, exposure or white balance.
//!
//! In: renders of training views [H,W,3] beside their images, both in normalised units; out: a gain per view and channel that its image is divided
//! by in training. Scene and gains are found by turns: once in [`VISITS_BETWEEN`] rounds through the views, each view is rendered after
//! its step, and its gain moves to where the median of ln(image / render) over reliable pixels vanishes.
//!
//! Gauge: a scene twice as bright with gains half as large explains the images as well, and a red scene under blue gains does. The mean of ln gain
//! over the views is therefore held at 0, per channel, after every update: what all images share stays in the scene, to the last digit.
//!
//! The median is weighted by what pixels are worth: not masked, above the dark where noise and the render's floor dominate, and of recorded values
//! neither black nor saturated. A view with too few such pixels keeps its gain.

use luxel_core::{Image, View};
use serde::{Deserialize, Serialize};

use crate::TrainError;
use crate::config::ExposureCompensation;

/// Rounds through the views from one measurement to the next: a render costs a third of a step.
const VISITS_BETWEEN: u32 = 4;
/// Rounds before the first measurement: the scene has to show what is there.
const FIRST_ROUND: u32 = 3;
/// Least radiance, as a part of the image's mean, of a pixel that says something of the gain.
const RELIABLE_PART: f64 = 0.05;
/// Reliable pixels that a gain takes at least.
const MIN_PIXELS: usize = 64;
/// Largest |ln gain|: ten stops either way are no drift.
const MAX_LOG_GAIN: f32 = 7.0;
/// Pixels looked at in a view; more would not move a median.
const MAX_SAMPLES: usize = 1 << 16;

/// ln gain of every training view, by channel. Sums over the views are 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Gains {
    log: Vec<[f32; 3]>,
}

impl Gains {
    /// No gain in any of `count` views.
    pub(crate) fn ones(count: usize) -> Self {
        Self { log: vec![[0.0; 3]; count] }
    }

    /// The gain of view `index`.
    pub(crate) fn of(&self, index: usize) -> [f32; 3] {
        self.log.get(index).map_or([1.0; 3], |log| log.map(f32::exp))
    }

    /// ln gains, for people.
    pub(crate) fn logs(&self) -> &[[f32; 3]] {
        &self.log
    }

    /// Whether the views of `step` (1 for the first) are measured after it.
    pub(crate) fn measures_after(&self, step: u32) -> bool {
        let round = step.saturating_sub(1) / u32::try_from(self.log.len().max(1)).unwrap_or(u32::MAX);
        round >= FIRST_ROUND && (round - FIRST_ROUND).is_multiple_of(VISITS_BETWEEN)
    }

    /// Moves the gain of view `index` by what was measured, and all back to a mean of 0.
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

/// Medians of ln(target / render) over reliable pixels, by channel or of all together; `None` of too few pixels. `target` gives radiance of a
/// pixel and channel and whether it can be relied on.
pub(crate) fn log_ratio(render: &Image, target: impl Fn(usize, usize) -> Option<f32>, kind: ExposureCompensation) -> Option<[f32; 3]> {
    let stride = (render.pixels.len() / MAX_SAMPLES + 1) | 1;
    let mut ratios: [Vec<(f32, f32)>; 3] = Default::default();
    let sampled = || render.pixels.iter().enumerate().step_by(stride);
    let values = sampled().flat_map(|(i, _)| (0..3).filter_map(|c| target(i, c)).collect::<Vec<_>>());
    let (sum, count) = values.fold((0.0f64, 0usize), |(sum, count), v| (sum + f64::from(v), count + 1));
    let least = (RELIABLE_PART * sum / count.max(1) as f64) as f32;
    for (i, pixel) in sampled() {
        for (c, ratios) in ratios.iter_mut().enumerate() {
            let Some(target) = target(i, c).filter(|target| *target > least && pixel[c] > least) else { continue };
            // Relative differences are noise where light is scarce: weight grows with it, and levels off.
            let weight = target / (target + 10.0 * least);
            ratios.push(((target / pixel[c]).ln(), weight));
        }
    }
    match kind {
        ExposureCompensation::Off => None,
        ExposureCompensation::Exposure => Some([weighted_median(ratios.concat())?; 3]),
        ExposureCompensation::Color => {
            let [r, g, b] = ratios.map(weighted_median);
            Some([r?, g?, b?])
        }
    }
}

/// [`log_ratio`] of a view whose image times `scale` is normalised radiance.
pub(crate) fn log_ratio_of_view(render: &Image, (view, scale): (&View, [f32; 3]), kind: ExposureCompensation) -> Option<[f32; 3]> {
    log_ratio(render, |i, c| view.is_valid(i).then(|| view.image.pixels.get(i).map(|pixel| pixel[c] * scale[c])).flatten(), kind)
}

/// The value that half of the weight lies below; `None` of too few values.
fn weighted_median(mut values: Vec<(f32, f32)>) -> Option<f32> {
    if values.len() < MIN_PIXELS {
        return None;
    }
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| f64::from(*weight)).sum::<f64>();
    let mut below = 0.0;
    let at = values.iter().position(|(_, weight)| {
        below += f64::from(*weight);
        below >= half
    })?;
    values.get(at).map(|(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{camera_at, view_of};

    fn ramp() -> Image {
        Image::from_pixels(20, 20, (0..400).map(|i| [0.01 * i as f32, 0.02 * i as f32, 0.005 * i as f32]).collect()).unwrap()
    }

    fn drifted(gain: [f32; 3]) -> View {
        let pixels = ramp().pixels.iter().map(|rgb| [0, 1, 2].map(|c| rgb[c] * gain[c])).collect();
        view_of("a", camera_at([0.0; 3], [20, 20]), Image::from_pixels(20, 20, pixels).unwrap())
    }

    #[test]
    fn the_gain_of_an_image_is_found_through_an_object_that_is_not_in_the_scene() {
        let mut view = drifted([1.3, 1.0, 0.8]);
        let image = std::sync::Arc::make_mut(&mut view.image);
        image.pixels.iter_mut().take(120).for_each(|pixel| *pixel = [50.0, 0.0, 9.0]);
        let found = log_ratio_of_view(&ramp(), (&view, [1.0; 3]), ExposureCompensation::Color).unwrap();
        for (found, gain) in found.into_iter().zip([1.3f32, 1.0, 0.8]) {
            assert!((found - gain.ln()).abs() < 1e-5, "{found} {gain}");
        }
        let one = log_ratio_of_view(&ramp(), (&drifted([2.5; 3]), [0.5; 3]), ExposureCompensation::Exposure).unwrap();
        assert!(one.iter().all(|log| (log - 1.25f32.ln()).abs() < 1e-5), "{one:?}");
        assert_eq!(log_ratio_of_view(&ramp(), (&drifted([1.0; 3]), [1.0; 3]), ExposureCompensation::Off), None);
    }

    #[test]
    fn a_view_that_says_nothing_keeps_its_gain() {
        let mut view = drifted([2.0; 3]);
        view.mask = Some(std::sync::Arc::new(luxel_core::Mask::of_valid(vec![false; 400])));
        assert_eq!(log_ratio_of_view(&ramp(), (&view, [1.0; 3]), ExposureCompensation::Color), None);
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
        assert!(gains.of(3)[0] > 1.0 && gains.validate(7).is_ok() && gains.validate(6).is_err());
        assert_eq!(gains.of(99), [1.0; 3]);
    }

    #[test]
    fn all_views_are_measured_in_the_same_round() {
        let gains = Gains::ones(5);
        let due: Vec<u32> = (1..=45).filter(|step| gains.measures_after(*step)).collect();
        assert_eq!(due, (16..=20).chain(36..=40).collect::<Vec<_>>());
    }
}

//! The numbers of a training at a step: a line of a run's log, and the content of a progress event.

use luxel_train::PoseReport;
use serde::{Deserialize, Serialize};

/// A line of the log. Losses are means over the steps since the line before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogRecord {
    /// Steps made.
    pub iteration: u32,
    /// Training loss.
    pub loss: f64,
    /// Mean absolute difference under the mu-law; `None` from a radiance field, which is trained on
    /// single pixels.
    #[serde(default)]
    pub l1: Option<f64>,
    /// Mean SSIM under the mu-law; `None` from a radiance field.
    #[serde(default)]
    pub ssim: Option<f64>,
    /// PSNR of one training view, protocol `scene`, dB.
    pub psnr_train: Option<f64>,
    /// Mean PSNR of the test views at the last evaluation, protocol `scene`, dB.
    pub psnr_test: Option<f64>,
    /// Mean PSNR of a few test views at the last look at them, protocol `scene`, dB.
    #[serde(default)]
    pub psnr_test_sample: Option<f64>,
    /// Corrections of the poses so far; `None` unless they are refined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses: Option<PoseReport>,
    /// Gain in the corners of each lens relative to its axis, stops; none unless vignetting is
    /// learned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vignetting_corner_ev: Vec<f64>,
    /// Splats.
    pub splats: usize,
    /// Splats that touched the last image.
    pub visible: u32,
    /// Speed since the line before.
    pub iterations_per_second: f64,
    /// Steps left, in steps as costly as those since the line before; `None` where all steps cost
    /// about the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_left_at_pace: Option<f64>,
    /// Seconds spent training, evaluation left out, over all resumed parts.
    pub elapsed_s: f64,
    /// Seconds of processors meanwhile, all threads together; `None` where the system does not
    /// tell.
    #[serde(default)]
    pub cpu_s: Option<f64>,
    /// Resident memory.
    pub rss_bytes: Option<u64>,
    /// Most resident memory, over all resumed parts.
    pub peak_rss_bytes: Option<u64>,
}

impl LogRecord {
    /// Returns the seconds until step `total`, from the present speed.
    pub fn seconds_left(&self, total: u32) -> Option<f64> {
        let left = self.steps_left_at_pace.unwrap_or_else(|| f64::from(total.saturating_sub(self.iteration)));
        (self.iterations_per_second > 0.0).then(|| left / self.iterations_per_second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_follows_from_the_speed() {
        let record = LogRecord {
            iteration: 100,
            loss: 0.1,
            l1: Some(0.05),
            ssim: Some(0.9),
            psnr_train: None,
            psnr_test: None,
            psnr_test_sample: None,
            poses: None,
            vignetting_corner_ev: Vec::new(),
            splats: 10,
            visible: 5,
            iterations_per_second: 20.0,
            steps_left_at_pace: None,
            elapsed_s: 5.0,
            cpu_s: None,
            rss_bytes: None,
            peak_rss_bytes: None,
        };
        assert_eq!(record.seconds_left(300), Some(10.0));
        assert_eq!(LogRecord { steps_left_at_pace: Some(900.0), ..record.clone() }.seconds_left(300), Some(45.0));
        assert_eq!(LogRecord { iterations_per_second: 0.0, ..record }.seconds_left(300), None);
    }
}

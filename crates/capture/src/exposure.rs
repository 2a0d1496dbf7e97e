//! The signal that time, sensitivity and aperture make of radiance.
//!
//! In: exposure time in seconds, ISO speed, f-number. Out: the signal (1: saturation) of a
//! luminance of 1 cd/m2. A sensor of ISO speed S saturates at 78 / S lux seconds (ISO 12232,
//! saturation-based speed), and a lens of f-number N gives 0.65 L t / N^2 of them, so that signal =
//! L t S / (120 N^2). Cameras differ from it by up to half a stop, all frames of one camera by the
//! same factor.
//!
//! Missing values count as ISO 100 and f/4: frames stay on one scale as long as all of
//! them leave it out.

use serde::{Deserialize, Serialize};

/// The exposure of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Shutter time, above 0.
    pub seconds: f64,
    /// ISO speed, above 0.
    pub iso: Option<f64>,
    /// Aperture, above 0.
    pub f_number: Option<f64>,
}

/// Saturation-based speed of ISO 12232: luminance that saturates at f/1, 1 s and ISO 1.
const SATURATION: f64 = 120.0;
/// ISO speed where the file has none.
const DEFAULT_ISO: f64 = 100.0;
/// F-number where the file has none.
const DEFAULT_F_NUMBER: f64 = 4.0;

impl Exposure {
    /// Returns whether every value that is given is finite and above 0.
    pub fn is_valid(&self) -> bool {
        let good = |v: f64| v.is_finite() && v > 0.0;
        good(self.seconds) && self.iso.is_none_or(good) && self.f_number.is_none_or(good) && good(self.signal_per_radiance())
    }

    /// Returns the signal of 1 cd/m2.
    ///
    /// ```
    /// use luxel_capture::Exposure;
    ///
    /// // 1/100 s at ISO 100 and f/16 is for daylight: white paper stays below saturation.
    /// let exposure = Exposure { seconds: 0.01, iso: Some(100.0), f_number: Some(16.0) };
    /// assert!(30_000.0 * exposure.signal_per_radiance() < 1.0);
    /// // Twice the time is a stop more.
    /// let longer = Exposure { seconds: 0.02, ..exposure };
    /// assert!((longer.stops() - exposure.stops() - 1.0).abs() < 1e-12);
    /// ```
    pub fn signal_per_radiance(&self) -> f64 {
        let f_number = self.f_number.unwrap_or(DEFAULT_F_NUMBER);
        self.seconds * self.iso.unwrap_or(DEFAULT_ISO) / (SATURATION * f_number * f_number)
    }

    /// Returns [`Self::signal_per_radiance`] in stops.
    pub fn stops(&self) -> f64 {
        self.signal_per_radiance().log2()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sunny_sixteen_exposes_white_below_saturation() {
        // 1/100 s at ISO 100 and f/16 is for daylight, where a white wall has some 30,000 cd/m2.
        let sunny = Exposure { seconds: 0.01, iso: Some(100.0), f_number: Some(16.0) };
        let white = 30_000.0 * sunny.signal_per_radiance();
        assert!((0.5..1.0).contains(&white), "{white}");
    }

    #[test]
    fn a_stop_is_a_stop_however_it_is_made() {
        let base = Exposure { seconds: 0.02, iso: Some(400.0), f_number: Some(5.6) };
        for other in [
            Exposure { seconds: 0.04, ..base },
            Exposure { iso: Some(800.0), ..base },
            Exposure { f_number: Some(5.6 / std::f64::consts::SQRT_2), ..base },
        ] {
            assert!((other.stops() - base.stops() - 1.0).abs() < 1e-12);
        }
        assert!(base.is_valid() && !Exposure { seconds: 0.0, ..base }.is_valid() && !Exposure { iso: Some(f64::NAN), ..base }.is_valid());
    }
}

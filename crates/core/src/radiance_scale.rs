//! The factor between normalised units, in which splats are trained, and the data set's radiance.
//!
//! In: radiance of the data set or normalised values, f32, linear. Out: the other of the two.
//! Degenerate: a scale that is not a positive finite number cannot be made; results beyond f32 are
//! infinite or 0, as multiplication has them.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::Image;

/// The data-set radiance of one normalised unit: a positive finite number.
///
/// In files it is a plain number.
///
/// ```
/// use luxel_core::{Image, RadianceScale};
///
/// let scale = RadianceScale::new(4.0).unwrap();
/// let mut image = Image::filled(2, 1, [8.0, 4.0, 2.0]);
/// scale.normalise(&mut image);
/// assert_eq!(image.pixels[0], [2.0, 1.0, 0.5]);
/// scale.restore(&mut image);
/// assert_eq!(image.pixels[0], [8.0, 4.0, 2.0]);
/// assert!(RadianceScale::new(0.0).is_none());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(try_from = "f32", into = "f32")]
pub struct RadianceScale(f32);

impl RadianceScale {
    /// The scale of images that are in normalised units already.
    pub const ONE: Self = Self(1.0);

    /// Returns the scale `radiance`; `None` if it is not a positive finite number.
    pub const fn new(radiance: f32) -> Option<Self> {
        if radiance.is_finite() && radiance > 0.0 { Some(Self(radiance)) } else { None }
    }

    /// Returns the data-set radiance of one normalised unit.
    #[inline]
    pub const fn get(self) -> f32 {
        self.0
    }

    /// Returns the scale `factor` times as large; `None` if that is not a positive finite number.
    pub fn times(self, factor: f32) -> Option<Self> {
        Self::new(self.0 * factor)
    }

    /// Converts an image from the data set's radiance to normalised units.
    pub fn normalise(self, image: &mut Image) {
        image.scale(1.0 / self.0);
    }

    /// Converts an image from normalised units to the data set's radiance.
    pub fn restore(self, image: &mut Image) {
        image.scale(self.0);
    }

    /// Returns radiance of the data set, such as a background, in normalised units.
    ///
    /// It is divided by the scale, and so correctly rounded; [`Self::normalise`] multiplies by the
    /// reciprocal.
    #[inline]
    pub fn normalised(self, radiance: [f32; 3]) -> [f32; 3] {
        radiance.map(|channel| channel / self.0)
    }

    /// Returns one value of data-set radiance, such as a luminance, in normalised units.
    #[inline]
    pub fn normalised_value(self, radiance: f32) -> f32 {
        radiance / self.0
    }

    /// Returns normalised values as radiance of the data set.
    #[inline]
    pub fn restored(self, normalised: [f32; 3]) -> [f32; 3] {
        normalised.map(|channel| channel * self.0)
    }

    /// Returns one normalised value, such as a luminance, as radiance of the data set.
    #[inline]
    pub fn restored_value(self, normalised: f32) -> f32 {
        normalised * self.0
    }

    /// Returns what an image of this `gain` by channel is multiplied by to be in normalised units
    /// without the gain.
    #[inline]
    pub fn target_scale(self, gain: [f32; 3]) -> [f32; 3] {
        gain.map(|gain| 1.0 / self.0 / gain)
    }

    /// Returns the exposure of one normalised unit, radiance times seconds, by channel: what a
    /// camera's response is evaluated at.
    #[inline]
    pub fn exposure(self, exposure_s: f32, gain: [f32; 3]) -> [f32; 3] {
        gain.map(|gain| self.0 * exposure_s * gain)
    }
}

impl Default for RadianceScale {
    fn default() -> Self {
        Self::ONE
    }
}

impl fmt::Display for RadianceScale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

impl fmt::LowerExp for RadianceScale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::LowerExp::fmt(&self.0, f)
    }
}

impl TryFrom<f32> for RadianceScale {
    type Error = RadianceScaleError;

    fn try_from(radiance: f32) -> Result<Self, RadianceScaleError> {
        Self::new(radiance).ok_or(RadianceScaleError(radiance))
    }
}

impl From<RadianceScale> for f32 {
    fn from(scale: RadianceScale) -> Self {
        scale.0
    }
}

/// Explains why a number is not a radiance scale.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("radiance scale {0}, expected a positive number")]
pub struct RadianceScaleError(pub f32);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_positive_finite_numbers_are_scales() {
        for wrong in [0.0, -0.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(RadianceScale::new(wrong), None);
        }
        assert!(serde_json::from_str::<RadianceScale>("-1.0").unwrap_err().to_string().contains("radiance scale -1, expected a positive"));
        assert_eq!(RadianceScale::new(f32::MAX).unwrap().times(2.0), None);
        assert_eq!(RadianceScale::new(1e-45).unwrap().get(), 1e-45);
    }

    #[test]
    fn a_scale_is_a_plain_number_in_json() {
        let scale = RadianceScale::new(12.345_679).unwrap();
        let json = serde_json::to_string(&scale).unwrap();
        assert_eq!(json, "12.345679");
        assert_eq!(serde_json::from_str::<RadianceScale>(&json).unwrap(), scale);
        assert_eq!(format!("{scale:e} {scale}"), "1.2345679e1 12.345679");
    }

    #[test]
    fn gains_and_exposures_are_by_channel() {
        let scale = RadianceScale::new(2.0).unwrap();
        assert_eq!(scale.target_scale([1.0, 2.0, 0.5]), [0.5, 0.25, 1.0]);
        assert_eq!(scale.exposure(0.25, [1.0, 2.0, 4.0]), [0.5, 1.0, 2.0]);
        assert_eq!(scale.restored(scale.normalised([3.0, 5.0, 7.0])), [3.0, 5.0, 7.0]);
    }
}

//! Vignetting: the light that a lens loses away from its axis.
//!
//! In: a place in an image. Out: the gain there, by which the radiance of the scene is multiplied
//! to give that of the image. ln gain is a polynomial of degree 3 in r^2, the same in all channels,
//! where r is the distance from the axis and 1 at [`Vignetting::unit_px`]. Degenerate: beyond r = 1
//! the gain is that at 1.

use crate::{Image, Real};

/// Number of coefficients of ln gain: those of 1, r^2, r^4 and r^6.
pub const VIGNETTING_TERMS: usize = 4;

/// The vignetting of an image.
///
/// ```
/// use luxel_core::Vignetting;
///
/// let log_gain = [0.0, 0.5f32.ln(), 0.0, 0.0];
/// let half = Vignetting { axis_px: [8.0, 6.0], unit_px: 10.0, log_gain };
/// assert_eq!(half.gain([8.0, 6.0]), 1.0);
/// assert!((half.gain([16.0, 12.0]) - 0.5).abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vignetting {
    /// Place of the lens's axis in the image, pixels from the upper left corner.
    pub axis_px: [f32; 2],
    /// Distance from the axis at which r is 1, pixels.
    pub unit_px: f32,
    /// Coefficients of 1, r^2, r^4 and r^6 in ln gain.
    pub log_gain: [f32; VIGNETTING_TERMS],
}

impl Vignetting {
    /// Returns r^2 at a place in pixels, at most 1.
    #[inline(always)]
    pub fn radius_squared<R: Real>(&self, [x, y]: [R; 2]) -> R {
        let scale = x.lift(1.0 / self.unit_px);
        let (x, y) = ((x - x.lift(self.axis_px[0])) * scale, (y - y.lift(self.axis_px[1])) * scale);
        x.mul_add(x, y * y).min(x.lift(1.0))
    }

    /// Returns ln gain at r^2.
    #[inline(always)]
    pub fn log_gain_at<R: Real>(&self, radius_squared: R) -> R {
        let [c0, c1, c2, c3] = self.log_gain;
        let r = radius_squared;
        r.lift(c3).mul_add(r, r.lift(c2)).mul_add(r, r.lift(c1)).mul_add(r, r.lift(c0))
    }

    /// Returns the gain at a place in pixels.
    pub fn gain(&self, at_px: [f32; 2]) -> f32 {
        self.log_gain_at(self.radius_squared(at_px)).exp()
    }

    /// Multiplies an image by the gain at its pixels' centres.
    pub fn apply(&self, image: &mut Image) {
        let width = image.width.max(1);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let gain = self.gain([(i % width) as f32 + 0.5, (i / width) as f32 + 0.5]);
            *pixel = pixel.map(|value| value * gain);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_the_polynomials_up_to_the_unit_and_constant_beyond() {
        let vignetting = Vignetting { axis_px: [3.0, -1.0], unit_px: 5.0, log_gain: [0.1, -0.3, 0.2, -0.4] };
        let mut image = Image::filled(4, 3, [1.0, 2.0, 4.0]);
        vignetting.apply(&mut image);
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = ((i % 4) as f64 + 0.5 - 3.0, (i / 4) as f64 + 0.5 + 1.0);
            let r2 = ((x * x + y * y) / 25.0).min(1.0);
            let expected = (0.1 - 0.3 * r2 + 0.2 * r2 * r2 - 0.4 * r2.powi(3)).exp();
            assert!((f64::from(pixel[0]) - expected).abs() < 1e-6 && pixel[2] == 4.0 * pixel[0], "{i}: {pixel:?} {expected}");
        }
        assert_eq!(vignetting.gain([3.0, 4.0]), vignetting.gain([900.0, 4.0]));
    }
}

//! The shape and power of a lamp from the light that cameras see of it.
//!
//! In: radiant intensities (radiance times projected area) towards several cameras. Out: a model
//! whose intensity holds in every direction. A ball shines alike everywhere; a flat lamp by
//! Lambert's cosine law, I(w) = max(0, w . v), whose vector v is found by linear least squares:
//! its direction is the lamp's normal, its length the intensity along it. So the open side of a
//! shade, of which cameras see a part at a slant, has the power that it has towards the table.
//!
//! Degenerate: cameras on one side cannot tell a ball from a disc that faces them: then it is a
//! ball.

use glam::{DMat3, DVec3};

/// Another shape must explain the intensities this many times as well as a ball.
pub(super) const LEAST_GAIN: f64 = 2.0;
/// Relative error of a ball up to which nothing else is looked for.
pub(super) const ALIKE: f64 = 0.05;
/// Least number of cameras that a flat lamp is fitted to.
const LEAST_CAMERAS: usize = 5;
/// A flat lamp's intensity is at most this many times the largest that was seen.
const MOST_BEYOND: f64 = 4.0;
/// Part of the mean square by which least squares are kept from running off.
const DAMPING: f64 = 1e-4;

/// The light of a lamp that a camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Direction from the lamp to the camera, a unit vector.
    pub(super) towards: DVec3,
    /// Radiant intensity by channel, radiance times squared length.
    pub(super) intensity: [f64; 3],
    /// Projected area, squared length.
    pub(super) area: f64,
}

impl Sample {
    fn sum(&self) -> f64 {
        self.intensity.iter().sum()
    }
}

/// A lamp's distribution of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Distribution {
    /// The same in all directions.
    Ball,
    /// On one side of a plane, by the cosine to this unit normal.
    Flat(DVec3),
}

/// A distribution of light that explains the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    pub(super) distribution: Distribution,
    /// Intensity of a ball, or of a flat lamp along its normal, by channel.
    pub(super) intensity: [f64; 3],
    /// Area of a ball's disc, or of a flat lamp.
    pub(super) area: f64,
    /// Root mean square error over the mean intensity.
    pub(super) error: f64,
}

impl Fit {
    /// Returns the factor of the intensity in a direction.
    pub(super) fn factor(&self, towards: DVec3) -> f64 {
        match self.distribution {
            Distribution::Ball => 1.0,
            Distribution::Flat(normal) => normal.dot(towards).max(0.0),
        }
    }
}

/// Fits a lamp; `None` without light.
pub(super) fn fit(samples: &[Sample]) -> Option<Fit> {
    let ball = with(samples, Distribution::Ball)?;
    if ball.error < ALIKE || samples.len() < LEAST_CAMERAS {
        return Some(ball);
    }
    let largest = samples.iter().map(Sample::sum).fold(0.0, f64::max);
    let flat = normal(samples).and_then(|normal| with(samples, Distribution::Flat(normal)));
    let is_better = |flat: &Fit| LEAST_GAIN * flat.error < ball.error && flat.intensity.iter().sum::<f64>() < MOST_BEYOND * largest;
    Some(flat.filter(is_better).unwrap_or(ball))
}

/// Returns the direction of the vector whose products with the directions are nearest to the
/// intensities.
fn normal(samples: &[Sample]) -> Option<DVec3> {
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    // Cameras behind a lamp see nothing of it, whatever the product is.
    for sample in samples.iter().filter(|sample| sample.sum() > 0.0) {
        let w = sample.towards;
        matrix += DMat3::from_cols(w * w.x, w * w.y, w * w.z);
        right += w * sample.sum();
    }
    let trace = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
    matrix += DMat3::from_diagonal(DVec3::splat(DAMPING * trace));
    (trace > 0.0).then(|| matrix.inverse() * right)?.try_normalize()
}

/// Fits intensity and area to a distribution by least squares.
fn with(samples: &[Sample], distribution: Distribution) -> Option<Fit> {
    let unit = Fit { distribution, intensity: [0.0; 3], area: 0.0, error: 0.0 };
    let factors: Vec<f64> = samples.iter().map(|sample| unit.factor(sample.towards)).collect();
    let Scaled { intensity, area, error } = scaled(samples, &factors)?;
    Some(Fit { intensity, area, error, ..unit })
}

/// Factors of the samples times one intensity, or area, that is nearest to theirs.
pub(super) struct Scaled {
    /// By channel.
    pub(super) intensity: [f64; 3],
    pub(super) area: f64,
    /// Root mean square error over the mean intensity.
    pub(super) error: f64,
}

/// Fits intensity and area to a factor for each sample; `None` without light.
pub(super) fn scaled(samples: &[Sample], factors: &[f64]) -> Option<Scaled> {
    let square: f64 = factors.iter().map(|f| f * f).sum();
    let mean = samples.iter().map(Sample::sum).sum::<f64>() / samples.len().max(1) as f64;
    if square <= 0.0 || mean <= 0.0 {
        return None;
    }
    let by = |value: &dyn Fn(&Sample) -> f64| samples.iter().zip(factors).map(|(s, f)| value(s) * f).sum::<f64>() / square;
    let intensity = [0, 1, 2].map(|c| by(&|s| s.intensity[c]));
    let whole: f64 = intensity.iter().sum();
    let squares = samples.iter().zip(factors).map(|(s, f)| (s.sum() - whole * f).powi(2));
    let error = (squares.sum::<f64>() / samples.len() as f64).sqrt() / mean;
    Some(Scaled { intensity, area: by(&|s| s.area), error })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples of a lamp from directions on a cap around an axis.
    fn seen(lamp: impl Fn(DVec3) -> f64, axis: DVec3, spread: f64) -> Vec<Sample> {
        let side = axis.any_orthonormal_vector();
        let other = axis.cross(side);
        (0..12)
            .map(|i| {
                let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
                let towards = (axis + spread * f64::from(i) / 12.0 * (cos * side + sin * other)).normalize();
                let i = lamp(towards);
                Sample { towards, intensity: [i, 0.5 * i, 0.25 * i], area: 0.01 * i }
            })
            .collect()
    }

    #[test]
    fn a_ball_shines_alike_everywhere() {
        let found = fit(&seen(|_| 3.0, DVec3::X, 0.4)).unwrap();
        assert_eq!((found.distribution, found.intensity), (Distribution::Ball, [3.0, 1.5, 0.75]));
        assert!((found.area - 0.03).abs() < 1e-12 && found.error < 1e-12);
    }

    #[test]
    fn the_open_side_of_a_shade_is_found_from_slanting_views() {
        let normal = DVec3::new(0.55, -0.29, -0.78).normalize();
        // Cameras at 50 to 80 degrees from the normal, all on one side.
        let axis = (normal.any_orthonormal_vector() + 0.4 * normal).normalize();
        let found = fit(&seen(|w| 2.4 * normal.dot(w).max(0.0), axis, 0.5)).unwrap();
        let Distribution::Flat(direction) = found.distribution else { panic!("{found:?}") };
        assert!(direction.dot(normal) > 0.9999, "{direction}");
        assert!((found.intensity[0] / 2.4 - 1.0).abs() < 0.01 && (found.area / 0.024 - 1.0).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn few_cameras_and_no_light_do_not_invent_a_shape() {
        assert_eq!(fit(&seen(|w| w.x, DVec3::X, 0.4)[..4]).unwrap().distribution, Distribution::Ball);
        assert_eq!((fit(&[]), fit(&seen(|_| 0.0, DVec3::X, 0.4))), (None, None));
    }
}

//! Camera colours to the scene's space, by the matrices of a DNG.
//!
//! In: one or two matrices from XYZ to camera colours, each with the temperature of its illuminant,
//! maybe forward matrices (balanced camera colours to XYZ at D50), and a neutral: the camera's
//! colours of white. Out: the gains that balance, and the matrix from balanced camera colours to
//! linear RGB of a space, which maps white to white (DNG 1.7, chapter 6). Between two illuminants
//! matrices are mixed by inverse temperature, at the temperature that the neutral has by them.
//! Adaptation is Bradford's.
//!
//! Degenerate: matrices without an inverse and neutrals that are not above 0 are refused.

use glam::{DMat3, DVec3};
use luxel_core::{ColorSpace, Conversion};

/// Matrices of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraColor {
    /// Temperature of the illuminant in kelvin, and camera colours from XYZ; one or two, in any
    /// order.
    pub camera_from_xyz: Vec<CalibratedMatrix>,
    /// XYZ at D50 from balanced camera colours; as many as above, or none.
    pub d50_from_balanced: Vec<DMat3>,
}

/// A colour matrix and the illuminant that it was measured under.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibratedMatrix {
    /// Temperature of the illuminant, kelvin.
    pub kelvin: f64,
    /// The matrix.
    pub matrix: DMat3,
}

/// The matrices make no colours.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraColorError {
    /// Singular or not finite.
    #[error("the camera's colour matrix has no inverse")]
    Singular,
    /// Not above 0.
    #[error("white balance {0:?}, expected three numbers above 0: the camera's colours of white")]
    Neutral([f64; 3]),
    /// None.
    #[error("no colour matrix, expected one or two")]
    None,
}

/// XYZ of D50, Y = 1.
const D50: DVec3 = DVec3::new(0.9642, 1.0, 0.8249);
/// Temperatures a matrix may be mixed for, kelvin.
const TEMPERATURES: [f64; 2] = [1500.0, 25_000.0];

impl CameraColor {
    /// Returns the gains that make `neutral` white, green's being 1.
    ///
    /// ```
    /// use luxel_capture::CameraColor;
    ///
    /// assert_eq!(CameraColor::balance([0.5, 1.0, 0.8])?, [2.0, 1.0, 1.25]);
    /// assert!(CameraColor::balance([0.0, 1.0, 0.8]).is_err());
    /// # Ok::<(), luxel_capture::CameraColorError>(())
    /// ```
    ///
    /// # Errors
    /// A neutral that is not above 0.
    pub fn balance(neutral: [f64; 3]) -> Result<[f32; 3], CameraColorError> {
        if !neutral.iter().all(|n| n.is_finite() && *n > 1e-6) {
            return Err(CameraColorError::Neutral(neutral));
        }
        Ok(neutral.map(|n| (neutral[1] / n) as f32))
    }

    /// Returns the matrix from balanced camera colours to `space`.
    ///
    /// # Errors
    /// Matrices without an inverse, or a neutral that is not above 0.
    pub fn scene_from_balanced(&self, neutral: [f64; 3], space: ColorSpace) -> Result<DMat3, CameraColorError> {
        Self::balance(neutral)?;
        let neutral = DVec3::from_array(neutral);
        let kelvin = self.temperature(neutral)?;
        let matrix = if self.d50_from_balanced.len() == self.camera_from_xyz.len() && !self.d50_from_balanced.is_empty() {
            let forward: Vec<CalibratedMatrix> = self
                .camera_from_xyz
                .iter()
                .zip(&self.d50_from_balanced)
                .map(|(of, m)| CalibratedMatrix { kelvin: of.kelvin, matrix: *m })
                .collect();
            rgb_from_xyz(D50, space)? * mix(&forward, kelvin)?
        } else {
            let xyz_from_camera = inverse(mix(&self.camera_from_xyz, kelvin)?)?;
            let white = xyz_from_camera * neutral;
            rgb_from_xyz(white / white.y, space)? * xyz_from_camera * DMat3::from_diagonal(neutral)
        };
        // White is white by construction, but for the rounding of forward matrices and a factor:
        // now it is exactly.
        let white = matrix * DVec3::ONE;
        if !(white.is_finite() && white.min_element() > 1e-6) {
            return Err(CameraColorError::Singular);
        }
        Ok(DMat3::from_diagonal(white.recip()) * matrix)
    }

    /// Returns the temperature of the light whose white has these camera colours, kelvin.
    ///
    /// # Errors
    /// A matrix cannot be inverted.
    pub fn temperature(&self, neutral: DVec3) -> Result<f64, CameraColorError> {
        let mut kelvin = 5000.0;
        // Converges in a few rounds; a camera for which it swings is left in the middle of the
        // swing.
        for _ in 0..30 {
            let xyz = inverse(mix(&self.camera_from_xyz, kelvin)?)? * neutral;
            let next = correlated_temperature(xyz).unwrap_or(kelvin);
            if (next - kelvin).abs() < 0.5 {
                return Ok(next);
            }
            kelvin = 0.5 * (kelvin + next);
        }
        Ok(kelvin)
    }
}

/// Mixes two matrices by inverse temperature; outside of the two it is the nearer one.
fn mix(matrices: &[CalibratedMatrix], kelvin: f64) -> Result<DMat3, CameraColorError> {
    match matrices {
        [] => Err(CameraColorError::None),
        [only] => Ok(only.matrix),
        [first, second, ..] => {
            let [a, b] = [first.kelvin, second.kelvin];
            let share = ((1.0 / kelvin - 1.0 / b) / (1.0 / a - 1.0 / b)).clamp(0.0, 1.0);
            let share = if share.is_finite() { share } else { 1.0 };
            Ok(first.matrix * share + second.matrix * (1.0 - share))
        }
    }
}

/// Computes the correlated colour temperature by McCamy's formula (1992).
fn correlated_temperature(xyz: DVec3) -> Option<f64> {
    let sum = xyz.element_sum();
    let (x, y) = (xyz.x / sum, xyz.y / sum);
    let n = (x - 0.3320) / (0.1858 - y);
    let kelvin = ((449.0 * n + 3525.0) * n + 6823.3) * n + 5520.33;
    kelvin.is_finite().then(|| kelvin.clamp(TEMPERATURES[0], TEMPERATURES[1]))
}

fn rgb_from_xyz(white: DVec3, space: ColorSpace) -> Result<DMat3, CameraColorError> {
    Conversion::from_xyz(white, space).ok_or(CameraColorError::Singular)
}

fn inverse(matrix: DMat3) -> Result<DMat3, CameraColorError> {
    let determinant = matrix.determinant();
    if determinant.is_finite() && determinant.abs() > 1e-9 { Ok(matrix.inverse()) } else { Err(CameraColorError::Singular) }
}

/// Returns the median of each ratio to green, for one balance of a whole set; `None` of none.
pub fn median_neutral(neutrals: &[[f64; 3]]) -> Option<[f64; 3]> {
    let median = |channel: usize| {
        let mut ratios: Vec<f64> = neutrals.iter().map(|n| n[channel] / n[1]).filter(|r| r.is_finite()).collect();
        ratios.sort_by(f64::total_cmp);
        let middle = ratios.len() / 2;
        let upper = *ratios.get(middle)?;
        Some(if ratios.len().is_multiple_of(2) { 0.5 * (upper + ratios.get(middle.checked_sub(1)?)?) } else { upper })
    };
    Some([median(0)?, 1.0, median(2)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a camera whose colours are linear Rec.709 of the scene: its matrix is the
    /// standard's.
    fn rec709_camera() -> CameraColor {
        let d65 = DVec3::new(0.3127 / 0.3290, 1.0, (1.0 - 0.3127 - 0.3290) / 0.3290);
        let rgb_from_xyz = Conversion::from_xyz(d65, ColorSpace::LinearRec709).unwrap();
        CameraColor { camera_from_xyz: vec![CalibratedMatrix { kelvin: 6504.0, matrix: rgb_from_xyz }], d50_from_balanced: Vec::new() }
    }

    #[test]
    fn a_camera_that_sees_rec709_needs_no_matrix() {
        let matrix = rec709_camera().scene_from_balanced([1.0; 3], ColorSpace::LinearRec709).unwrap();
        assert!(matrix.abs_diff_eq(DMat3::IDENTITY, 1e-6), "{matrix}");
        assert_eq!(CameraColor::balance([0.5, 1.0, 0.6]).unwrap(), [2.0, 1.0, (1.0 / 0.6) as f32]);
    }

    #[test]
    fn white_is_white_in_every_space_and_light() {
        let tungsten = DMat3::from_cols_array(&[0.9, -0.3, -0.05, -0.2, 1.1, 0.1, -0.1, 0.15, 0.6]);
        let daylight = DMat3::from_cols_array(&[0.8, -0.4, -0.1, -0.1, 1.2, 0.2, -0.1, 0.1, 0.7]);
        let camera = CameraColor {
            camera_from_xyz: vec![
                CalibratedMatrix { kelvin: 2856.0, matrix: tungsten },
                CalibratedMatrix { kelvin: 6504.0, matrix: daylight },
            ],
            d50_from_balanced: Vec::new(),
        };
        for neutral in [[0.5, 1.0, 0.6], [0.8, 1.0, 0.3], [0.4, 1.0, 0.9]] {
            for space in ColorSpace::ALL {
                let white = camera.scene_from_balanced(neutral, space).unwrap() * DVec3::ONE;
                assert!((white - DVec3::ONE).length() < 1e-12, "{neutral:?} {space:?} {white}");
            }
        }
    }

    #[test]
    fn forward_matrices_go_before_colour_matrices() {
        // A forward matrix by which balanced camera colours are linear Rec.709.
        let d50_from_rec709 = Conversion::from_xyz(D50, ColorSpace::LinearRec709).unwrap().inverse();
        let camera = CameraColor { d50_from_balanced: vec![d50_from_rec709], ..rec709_camera() };
        let matrix = camera.scene_from_balanced([0.5, 1.0, 0.7], ColorSpace::LinearRec709).unwrap();
        assert!(matrix.abs_diff_eq(DMat3::IDENTITY, 1e-6), "{matrix}");
    }

    #[test]
    fn temperature_follows_the_neutral() {
        let warm = rec709_camera().temperature(DVec3::new(1.3, 1.0, 0.4)).unwrap();
        let cold = rec709_camera().temperature(DVec3::new(0.8, 1.0, 1.3)).unwrap();
        assert!((2000.0..4500.0).contains(&warm) && cold > 7500.0, "{warm} {cold}");
    }

    #[test]
    fn what_makes_no_colours_is_refused() {
        let flat =
            CameraColor { camera_from_xyz: vec![CalibratedMatrix { kelvin: 5000.0, matrix: DMat3::ZERO }], d50_from_balanced: Vec::new() };
        assert_eq!(flat.scene_from_balanced([1.0; 3], ColorSpace::AcesCg), Err(CameraColorError::Singular));
        assert!(rec709_camera().scene_from_balanced([0.0, 1.0, 1.0], ColorSpace::AcesCg).is_err());
        assert_eq!(mix(&[], 5000.0), Err(CameraColorError::None));
    }

    #[test]
    fn the_set_has_the_median_balance() {
        assert_eq!(median_neutral(&[[0.5, 1.0, 0.6], [1.0, 2.0, 1.4], [0.9, 1.0, 0.5]]), Some([0.5, 1.0, 0.6]));
        assert_eq!(median_neutral(&[]), None);
    }
}

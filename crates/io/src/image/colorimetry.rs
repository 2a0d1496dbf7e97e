//! Colour spaces by their primaries: which one a file's chromaticities are, and the matrix between two.
//!
//! Matrices map linear RGB to linear RGB through CIE XYZ, with Bradford's adaptation from white to white (ICC.1:2022, annex E).

use glam::{DMat3, DVec3};
use luxel_core::{ColorSpace, Image};

/// Files round chromaticities to three or four digits; no two spaces in use are nearer to each other than this.
const TOLERANCE: f32 = 1.5e-3;

/// The known space of these chromaticities.
pub(super) fn known_space(chromaticities: &[[f32; 2]; 4]) -> Option<ColorSpace> {
    let near = |space: &ColorSpace| {
        let (found, expected) = (chromaticities.as_flattened(), space.chromaticities());
        found.iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() <= TOLERANCE)
    };
    [ColorSpace::LinearRec709, ColorSpace::AcesCg].into_iter().find(near)
}

/// Names the space of `image`, converting it to linear Rec.709 (with a warning) if it is not a known one. `Err` says what is wrong
/// with the chromaticities.
pub(super) fn settle_space(image: &mut Image, chromaticities: &[[f32; 2]; 4], warnings: &mut Vec<String>) -> Result<ColorSpace, String> {
    if let Some(space) = known_space(chromaticities) {
        return Ok(space);
    }
    let rec709 = ColorSpace::LinearRec709;
    let matrix = rgb_conversion(chromaticities, &rec709.chromaticities()).ok_or_else(|| {
        format!("chromaticities {chromaticities:?} are not a colour space, expected CIE xy of red, green, blue and white")
    })?;
    convert(image, &matrix);
    let [red, green, blue, white] = chromaticities;
    warnings.push(format!("colours converted to linear Rec.709 from primaries {red:?} {green:?} {blue:?} with white {white:?}"));
    Ok(rec709)
}

/// Applies a matrix to every pixel.
fn convert(image: &mut Image, matrix: &DMat3) {
    for pixel in &mut image.pixels {
        let [r, g, b] = pixel.map(f64::from);
        let converted = *matrix * DVec3::new(r, g, b);
        *pixel = converted.to_array().map(|value| value as f32);
    }
}

/// Matrix from linear RGB of one set of chromaticities (CIE xy of red, green, blue, white) to another; `None` if one of them is
/// degenerate.
fn rgb_conversion(from: &[[f32; 2]; 4], to: &[[f32; 2]; 4]) -> Option<DMat3> {
    let (xyz_from_source, source_white) = xyz_from_rgb(from)?;
    let (xyz_from_target, target_white) = xyz_from_rgb(to)?;
    let matrix = inverse(xyz_from_target)? * adaptation(source_white, target_white)? * xyz_from_source;
    matrix.is_finite().then_some(matrix)
}

/// XYZ of RGB, and XYZ of white (Y = 1).
fn xyz_from_rgb(chromaticities: &[[f32; 2]; 4]) -> Option<(DMat3, DVec3)> {
    let [red, green, blue, white] = chromaticities.map(|xy| {
        let [x, y] = xy.map(f64::from);
        DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
    });
    let primaries = DMat3::from_cols(red, green, blue);
    let amounts = inverse(primaries)? * white;
    Some((primaries * DMat3::from_diagonal(amounts), white)).filter(|(m, w)| m.is_finite() && w.is_finite())
}

/// Bradford's chromatic adaptation of XYZ.
fn adaptation(from_white: DVec3, to_white: DVec3) -> Option<DMat3> {
    let cones_from_xyz = DMat3::from_cols_array(&[0.8951, -0.7502, 0.0389, 0.2664, 1.7135, -0.0685, -0.1614, 0.0367, 1.0296]);
    let gain = (cones_from_xyz * to_white) / (cones_from_xyz * from_white);
    Some(inverse(cones_from_xyz)? * DMat3::from_diagonal(gain) * cones_from_xyz)
}

fn inverse(matrix: DMat3) -> Option<DMat3> {
    let determinant = matrix.determinant();
    (determinant.is_finite() && determinant.abs() > 1e-9).then(|| matrix.inverse())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn acescg_to_rec709_is_the_published_matrix() {
        // Colour-science and OpenColorIO's "ACEScg to Linear Rec.709 (sRGB)" with Bradford adaptation.
        let expected = [[1.705_05, -0.621_79, -0.083_26], [-0.130_26, 1.140_80, -0.010_55], [-0.024_00, -0.128_97, 1.152_97]];
        let matrix = rgb_conversion(&ColorSpace::AcesCg.chromaticities(), &ColorSpace::LinearRec709.chromaticities()).unwrap();
        for (row, values) in expected.iter().enumerate() {
            let found = matrix.row(row).to_array();
            assert!(found.iter().zip(values).all(|(a, b)| (a - b).abs() < 2e-4), "row {row}: {found:?}, expected {values:?}");
        }
    }

    #[test]
    fn white_stays_white() {
        let dci_p3 = [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], [0.314, 0.351]];
        let matrix = rgb_conversion(&dci_p3, &ColorSpace::LinearRec709.chromaticities()).unwrap();
        assert!((matrix * DVec3::ONE - DVec3::ONE).length() < 1e-9);
    }

    #[test]
    fn rounded_chromaticities_are_known() {
        let rounded = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.313, 0.329]];
        assert_eq!(known_space(&rounded), Some(ColorSpace::LinearRec709));
        assert_eq!(known_space(&ColorSpace::AcesCg.chromaticities()), Some(ColorSpace::AcesCg));
        assert_eq!(known_space(&[[0.0; 2]; 4]), None);
    }

    #[test]
    fn degenerate_chromaticities_are_refused() {
        let rec709 = ColorSpace::LinearRec709.chromaticities();
        for bad in [[[0.0; 2]; 4], [[0.3, 0.3]; 4], [[f32::NAN; 2]; 4], [[f32::INFINITY; 2]; 4]] {
            assert_eq!(rgb_conversion(&bad, &rec709), None, "{bad:?}");
        }
    }
}

//! What a file's chromaticities make of its pixels: a space with a name, or a conversion to one.

use luxel_core::{Chromaticities, ColorSpace, Conversion, Image};

/// Names the space of `image`, converting it to linear Rec.709 (with a warning) if it is not a known one. `Err` says what is wrong
/// with the chromaticities.
pub(super) fn settle_space(image: &mut Image, chromaticities: &Chromaticities, warnings: &mut Vec<String>) -> Result<ColorSpace, String> {
    if let Some(space) = ColorSpace::of_chromaticities(chromaticities) {
        return Ok(space);
    }
    convert(image, &conversion_to_rec709(chromaticities)?);
    let [red, green, blue, white] = chromaticities;
    warnings.push(format!("colours converted to linear Rec.709 from primaries {red:?} {green:?} {blue:?} with white {white:?}"));
    Ok(ColorSpace::LinearRec709)
}

/// The conversion to linear Rec.709; `Err` says what is wrong with the chromaticities.
pub(super) fn conversion_to_rec709(chromaticities: &Chromaticities) -> Result<Conversion, String> {
    Conversion::of_chromaticities(chromaticities, &ColorSpace::LinearRec709.chromaticities())
        .ok_or_else(|| format!("chromaticities {chromaticities:?} are not a colour space, expected CIE xy of red, green, blue and white"))
}

/// Applies a matrix to every pixel.
pub(crate) fn convert(image: &mut Image, conversion: &Conversion) {
    for pixel in &mut image.pixels {
        *pixel = conversion.apply(*pixel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_primaries_become_rec709_and_white_stays_white() {
        let dci_p3 = [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], [0.314, 0.351]];
        let mut image = Image::filled(1, 1, [2.0; 3]);
        let mut warnings = Vec::new();
        assert_eq!(settle_space(&mut image, &dci_p3, &mut warnings), Ok(ColorSpace::LinearRec709));
        assert!(image.at(0, 0).iter().all(|c| (c - 2.0).abs() < 1e-6) && warnings.len() == 1);
        assert!(settle_space(&mut image, &[[0.3; 2]; 4], &mut warnings).is_err());
    }
}

//! Pixels by a file's chromaticities or its ICC profile: a space with a name, or a conversion to
//! one.

use luxel_core::{Chromaticities, ColorSpace, Conversion, Image};

use super::DecodedImage;
use crate::icc::profile_of_file;

/// Names the space of `image`, converting it to linear Rec.709 (with a warning) if it is not a
/// known one. The error explains what is wrong with the chromaticities.
pub(super) fn settle_space(image: &mut Image, chromaticities: &Chromaticities, warnings: &mut Vec<String>) -> Result<ColorSpace, String> {
    if let Some(space) = ColorSpace::from_chromaticities(chromaticities) {
        return Ok(space);
    }
    let [red, green, blue, white] = chromaticities;
    let source = format!("primaries {red:?} {green:?} {blue:?} with white {white:?}");
    convert(image, &conversion_to_rec709(chromaticities)?, &source, warnings);
    Ok(ColorSpace::LinearRec709)
}

/// Names the space of an image by the chromaticities that its file states, as [`settle_space`] does.
/// Those that make no colour space, such as zeros of a program that knew none, count as not stated,
/// with a warning.
pub(super) fn settle_stated(decoded: &mut DecodedImage, format: &str) {
    let Some(found) = decoded.chromaticities else { return };
    match settle_space(&mut decoded.image, &found, &mut decoded.warnings) {
        Ok(space) => decoded.color_space = Some(space),
        Err(reason) => {
            decoded.chromaticities = None;
            decoded.warnings.push(format!("{format}: {reason}; they are ignored"));
        }
    }
}

/// Sets the space of an image from the ICC profile in its file, if the file states nothing else
/// about its primaries and the profile's space is known. Curves of profiles are not evaluated.
pub(super) fn settle_profile(decoded: &mut DecodedImage, bytes: &[u8]) {
    let Some(profile) = profile_of_file(bytes) else { return };
    match profile.space {
        Some(space) => (decoded.color_space, decoded.chromaticities) = (Some(space), Some(space.chromaticities())),
        None => decoded
            .warnings
            .push(format!("its ICC profile ({}) is not applied: its primaries are not those of a known space", profile.name)),
    }
}

/// Returns the conversion to linear Rec.709; the error explains what is wrong with the
/// chromaticities.
pub(super) fn conversion_to_rec709(chromaticities: &Chromaticities) -> Result<Conversion, String> {
    Conversion::from_chromaticities(chromaticities, &ColorSpace::LinearRec709.chromaticities())
        .ok_or_else(|| format!("chromaticities {chromaticities:?} are not a colour space, expected CIE xy of red, green, blue and white"))
}

/// Converts radiance to linear Rec.709 from `source`. Channels that only the matrix makes negative
/// become 0: the nearest radiance there is, where a negative one would count as damage. What was
/// negative before stays, for the caller to judge.
pub(crate) fn convert(image: &mut Image, conversion: &Conversion, source: &str, warnings: &mut Vec<String>) {
    let mut is_cut = false;
    for pixel in &mut image.pixels {
        let was_light = pixel.iter().all(|v| *v >= 0.0);
        *pixel = conversion.apply(*pixel);
        if was_light && pixel.iter().any(|v| *v < 0.0) {
            *pixel = pixel.map(|v| v.max(0.0));
            is_cut = true;
        }
    }
    warnings.push(format!("colours converted to linear Rec.709 from {source}"));
    if is_cut {
        warnings.push("some colours are more saturated than linear Rec.709 holds: their negative channels are set to 0".to_owned());
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

    #[test]
    fn colours_outside_of_rec709_stay_radiance() {
        let from_rec2020 = Conversion::between(ColorSpace::LinearRec2020, ColorSpace::LinearRec709);
        let mut image = Image { width: 4, height: 1, pixels: vec![[0.2; 3], [0.02, 50.0, 0.02], [-1.0, 0.5, 0.5], [f32::NAN, 1.0, 1.0]] };
        let mut warnings = Vec::new();
        convert(&mut image, &from_rec2020, "linear-rec2020", &mut warnings);
        assert!(warnings.len() == 2 && warnings[1].contains("more saturated"), "{warnings:?}");
        let [grey, lamp, negative, damaged] = image.pixels.as_slice() else { panic!("four pixels") };
        assert!(grey.iter().all(|v| (v - 0.2).abs() < 1e-6));
        assert!(lamp[0] == 0.0 && lamp[1] > 50.0 && lamp[2] == 0.0, "{lamp:?}");
        assert!(negative[0] < 0.0 && damaged[0].is_nan());
    }
}

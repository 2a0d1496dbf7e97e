//! The conversion of a developed picture's colours to the scene's space.

use luxel_core::{Chromaticities, ColorSpace, Conversion};

/// Returns the conversion to `scene` from the primaries that a picture states, or else from
/// `input`.
pub fn conversion_from(stated: Option<Chromaticities>, input: ColorSpace, scene: ColorSpace) -> Conversion {
    // Primaries of a named space are rounded in files.
    let named = stated.and_then(|found| ColorSpace::from_chromaticities(&found));
    let unnamed = stated.filter(|_| named.is_none()).and_then(|found| Conversion::from_chromaticities(&found, &scene.chromaticities()));
    unnamed.unwrap_or_else(|| Conversion::between(named.unwrap_or(input), scene))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stated_primaries_go_before_the_input_space() {
        let (input, scene) = (ColorSpace::LinearRec2020, ColorSpace::LinearRec709);
        assert_eq!(conversion_from(None, input, scene), Conversion::between(input, scene));
        // Rounded as files do.
        let p3 = [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06], [0.313, 0.329]];
        assert_eq!(conversion_from(Some(p3), input, scene), Conversion::between(ColorSpace::LinearDisplayP3, scene));
        let dci_p3 = [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06], [0.314, 0.351]];
        let found = conversion_from(Some(dci_p3), input, scene);
        assert!(found != Conversion::between(input, scene) && found.apply([1.0; 3]).iter().all(|v| (v - 1.0).abs() < 1e-5), "{found:?}");
    }
}

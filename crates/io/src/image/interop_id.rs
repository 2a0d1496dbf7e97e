//! The colour space of an OpenEXR file by its name: the attribute `colorInteropID` of OpenEXR 3.5,
//! with the names of the Color Interop Forum.
//!
//! In: the name. Out: primaries, and the curve of names that are not linear: the numbers of such a
//! file are decoded to light. A name is `CURVE_PRIMARIES_scene` or `..._display`; `data` and
//! `unknown` state no space. Where a file has chromaticities, too, the name goes first.

use luxel_core::{Chromaticities, ColorSpace};

use super::Transfer;
use super::samples::{Curve, LINEAR};

/// Name of the attribute.
pub(super) const ATTRIBUTE: &str = "colorInteropID";

const D65: [f32; 2] = [0.3127, 0.3290];

/// What a name says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum InteropSpace {
    /// Colours of these primaries, under a curve, where white is the numbers of `white`.
    Colors { chromaticities: Chromaticities, curve: Curve, white: [f32; 3] },
    /// Numbers that are no colours.
    Data,
    /// A curve of absolute luminance or of a display's brightness, which is not decoded here.
    Refused,
    /// Nothing that is known here.
    Unknown,
}

/// Returns what a name says.
pub(super) fn parse(name: &str) -> InteropSpace {
    if name == "data" {
        return InteropSpace::Data;
    }
    let base = name.strip_suffix("_scene").or_else(|| name.strip_suffix("_display"));
    let Some((curve, primaries)) = base.and_then(|base| base.split_once('_')) else { return InteropSpace::Unknown };
    let chromaticities = match primaries {
        "rec709" => ColorSpace::LinearRec709.chromaticities(),
        "p3d65" => ColorSpace::LinearDisplayP3.chromaticities(),
        "rec2020" => ColorSpace::LinearRec2020.chromaticities(),
        "ap0" => ColorSpace::Aces2065.chromaticities(),
        "ap1" => ColorSpace::AcesCg.chromaticities(),
        "adobergb" => [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06], D65],
        "ciexyzd65" | "xyzd65" => [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], D65],
        _ => return InteropSpace::Unknown,
    };
    let curve = match curve {
        "lin" => LINEAR,
        "srgb" | "srgbe" => Curve::Named(Transfer::Srgb),
        "g18" => Curve::Power(1.8),
        "g22" => Curve::Power(2.2),
        "g24" => Curve::Power(2.4),
        "g26" => Curve::Power(2.6),
        "pq" | "hlg" => return InteropSpace::Refused,
        _ => return InteropSpace::Unknown,
    };
    // Tristimulus values have those of white there, where RGB has 1.
    let [x, y] = D65;
    let white = if primaries.contains("xyz") { [x / y, 1.0, (1.0 - x - y) / y] } else { [1.0; 3] };
    InteropSpace::Colors { chromaticities, curve, white }
}

/// Returns the name that the Color Interop Forum has for a space: `colorInteropID` of OpenEXR files.
pub fn name(space: ColorSpace) -> &'static str {
    match space {
        ColorSpace::LinearRec709 => "lin_rec709_scene",
        ColorSpace::LinearDisplayP3 => "lin_p3d65_scene",
        ColorSpace::LinearRec2020 => "lin_rec2020_scene",
        ColorSpace::Aces2065 => "lin_ap0_scene",
        ColorSpace::AcesCg => "lin_ap1_scene",
        ColorSpace::DisplaySrgb => "srgb_rec709_display",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_are_written_are_read_as_what_they_were() {
        for space in ColorSpace::ALL {
            assert_eq!(parse(name(space)), InteropSpace::Colors { chromaticities: space.chromaticities(), curve: LINEAR, white: [1.0; 3] });
        }
        let InteropSpace::Colors { curve, .. } = parse(name(ColorSpace::DisplaySrgb)) else { panic!("a display's colours") };
        assert_eq!(curve, Curve::Named(Transfer::Srgb));
    }

    #[test]
    fn names_without_a_linear_meaning_are_told_apart() {
        assert_eq!(
            (parse("data"), parse("unknown"), parse("studio:plate")),
            (InteropSpace::Data, InteropSpace::Unknown, InteropSpace::Unknown)
        );
        assert_eq!((parse("pq_rec2020_display"), parse("lin_ap7_scene")), (InteropSpace::Refused, InteropSpace::Unknown));
        assert!(matches!(parse("g22_ap1_scene"), InteropSpace::Colors { curve: Curve::Power(2.2), .. }));
    }
}

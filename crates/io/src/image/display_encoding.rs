//! Code values of a display: which primaries and curve they are for, and how pictures say so.
//!
//! In: an id of the Color Interop Forum, as OpenColorIO's configurations state it. Out: a PNG's
//! chunks (sRGB, cICP by ITU-T H.273, iCCP by ICC.1:2022), and ffmpeg's names. Programs that know
//! only one of the chunks show the picture right, too; the third edition of the PNG specification
//! prefers cICP. Degenerate: curves that H.273 has no number for have a profile alone, and PQ,
//! which profiles hold only as a table, has cICP alone.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use moxcms::{
    CicpColorPrimaries, CicpProfile, ColorDateTime, ColorProfile, LocalizableString, MatrixCoefficients, ProfileText, ToneReprCurve,
    TransferCharacteristics,
};

use super::png_chunks::chunk;

/// Primaries of a display.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DisplayPrimaries {
    /// Rec.709.
    #[default]
    Rec709,
    /// P3 with white D65.
    P3D65,
    /// Rec.2020.
    Rec2020,
}

/// Curve of a display.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DisplayCurve {
    /// That of sRGB.
    #[default]
    Srgb,
    /// A power of 2.2.
    Gamma22,
    /// A power of 2.4, as BT.1886.
    Gamma24,
    /// A power of 2.6.
    Gamma26,
    /// The perceptual quantizer (SMPTE ST 2084).
    Pq,
}

/// The display that code values are for; sRGB by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DisplayEncoding {
    /// Primaries.
    pub primaries: DisplayPrimaries,
    /// Curve.
    pub curve: DisplayCurve,
}

impl DisplayEncoding {
    /// Returns the encoding of an id such as `srgb_p3d65_display`; `None` for one that is not
    /// known. Extended sRGB is sRGB here: codes end at 1.
    ///
    /// ```
    /// use luxel_io::{DisplayEncoding, DisplayPrimaries};
    ///
    /// let encoding = DisplayEncoding::from_interop_id("srgb_p3d65_display").unwrap();
    /// assert_eq!(encoding.primaries, DisplayPrimaries::P3D65);
    /// ```
    pub fn from_interop_id(id: &str) -> Option<Self> {
        let mut words = id.strip_suffix("_display")?.split('_');
        let curve = match words.next()? {
            "srgb" | "srgbe" => DisplayCurve::Srgb,
            "g22" => DisplayCurve::Gamma22,
            "g24" => DisplayCurve::Gamma24,
            "g26" => DisplayCurve::Gamma26,
            "pq" => DisplayCurve::Pq,
            _ => return None,
        };
        let primaries = match words.next()? {
            "rec709" => DisplayPrimaries::Rec709,
            "p3d65" => DisplayPrimaries::P3D65,
            "rec2020" => DisplayPrimaries::Rec2020,
            _ => return None,
        };
        words.next().is_none().then_some(Self { primaries, curve })
    }

    /// Returns ffmpeg's names of primaries and curve, if it has one for the curve.
    pub fn ffmpeg(self) -> Option<[&'static str; 2]> {
        let primaries = match self.primaries {
            DisplayPrimaries::Rec709 => "bt709",
            DisplayPrimaries::P3D65 => "smpte432",
            DisplayPrimaries::Rec2020 => "bt2020",
        };
        let curve = match self.curve {
            DisplayCurve::Srgb => "iec61966-2-1",
            DisplayCurve::Gamma22 => "gamma22",
            DisplayCurve::Gamma24 => "bt709",
            DisplayCurve::Pq => "smpte2084",
            DisplayCurve::Gamma26 => return None,
        };
        Some([primaries, curve])
    }

    /// Returns the numbers of primaries and curve in H.273, if the curve has one. Displays show
    /// codes of BT.709's curve by BT.1886.
    fn h273(self) -> Option<[u8; 2]> {
        let primaries = match self.primaries {
            DisplayPrimaries::Rec709 => 1,
            DisplayPrimaries::P3D65 => 12,
            DisplayPrimaries::Rec2020 => 9,
        };
        let curve = match self.curve {
            DisplayCurve::Srgb => 13,
            DisplayCurve::Gamma22 => 4,
            DisplayCurve::Gamma24 => 1,
            DisplayCurve::Pq => 16,
            DisplayCurve::Gamma26 => return None,
        };
        Some([primaries, curve])
    }

    /// Returns the chunks that say so in a PNG, for behind its header.
    pub(super) fn png_chunks(self) -> Vec<u8> {
        if self == Self::default() {
            // Rendering intent "perceptual".
            return chunk(*b"sRGB", &[0]);
        }
        let [mut named, mut profiled] = [Vec::new(), Vec::new()];
        if let Some([primaries, curve]) = self.h273() {
            named = chunk(*b"cICP", &[primaries, curve, 0, 1]);
        }
        if let Some(profile) = self.profile() {
            profiled = chunk(*b"iCCP", &profile);
        }
        [named, profiled].concat()
    }

    /// Returns the content of a chunk iCCP; `None` for curves that profiles hold no formula of.
    fn profile(self) -> Option<Vec<u8>> {
        let gamma = match self.curve {
            DisplayCurve::Srgb => None,
            DisplayCurve::Gamma22 => Some((2.2, "gamma 2.2")),
            DisplayCurve::Gamma24 => Some((2.4, "gamma 2.4")),
            DisplayCurve::Gamma26 => Some((2.6, "gamma 2.6")),
            DisplayCurve::Pq => return None,
        };
        let (mut profile, primaries, number) = match self.primaries {
            DisplayPrimaries::Rec709 => (ColorProfile::new_srgb(), "Rec.709", CicpColorPrimaries::Bt709),
            DisplayPrimaries::P3D65 => (ColorProfile::new_display_p3(), "Display P3", CicpColorPrimaries::Smpte432),
            DisplayPrimaries::Rec2020 => (ColorProfile::new_bt2020(), "Rec.2020", CicpColorPrimaries::Bt2020),
        };
        // The same picture has the same bytes on any day.
        profile.creation_date_time = ColorDateTime { year: 2000, month: 1, day_of_the_month: 1, hours: 0, minutes: 0, seconds: 0 };
        // The library's own numbers for Display P3 are those of DCI's white, and of YCbCr.
        profile.cicp = (self.curve == DisplayCurve::Srgb).then_some(CicpProfile {
            color_primaries: number,
            transfer_characteristics: TransferCharacteristics::Srgb,
            matrix_coefficients: MatrixCoefficients::Identity,
            full_range: true,
        });
        let name = gamma.map_or_else(|| primaries.to_owned(), |(_, curve)| format!("{primaries}, {curve}"));
        if let Some((power, _)) = gamma {
            let curve = ToneReprCurve::Parametric(vec![power]);
            profile.red_trc = Some(curve.clone());
            profile.green_trc = Some(curve.clone());
            profile.blue_trc = Some(curve);
        }
        profile.description = Some(ProfileText::Localizable(vec![LocalizableString::new("en".to_owned(), "US".to_owned(), name.clone())]));
        let encoded = padded(profile.encode().ok()?);
        let mut content = name.into_bytes();
        // The end of the name, and the compression method.
        content.extend([0, 0]);
        let mut packed = ZlibEncoder::new(content, Compression::default());
        packed.write_all(&encoded).ok()?;
        packed.finish().ok()
    }
}

/// Returns a profile with the length that version 4 asks for, a multiple of four: libpng drops
/// others without a word.
fn padded(mut profile: Vec<u8>) -> Vec<u8> {
    profile.resize(profile.len().next_multiple_of(4), 0);
    let length = profile.len() as u32;
    if let Some(head) = profile.first_chunk_mut() {
        *head = length.to_be_bytes();
    }
    profile
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::icc::profile_of_file;
    use luxel_core::ColorSpace;

    fn png(display: Option<DisplayEncoding>) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.png");
        crate::write_display_png(&path, [1, 1], &[255, 128, 0], display).unwrap();
        std::fs::read(path).unwrap()
    }

    fn content(png: &[u8], kind: &[u8]) -> Option<Vec<u8>> {
        let at = png.windows(4).position(|window| window == kind)?;
        let length = u32::from_be_bytes(png[at - 4..at].try_into().unwrap()) as usize;
        Some(png[at + 4..at + 4 + length].to_vec())
    }

    #[test]
    fn pictures_say_which_display_they_are_for() {
        for (id, cicp, has_profile) in [
            ("srgb_p3d65_display", Some([12, 13, 0, 1]), true),
            ("g22_rec709_display", Some([1, 4, 0, 1]), true),
            ("g24_rec709_display", Some([1, 1, 0, 1]), true),
            ("g26_p3d65_display", None, true),
            ("pq_rec2020_display", Some([9, 16, 0, 1]), false),
            ("pq_p3d65_display", Some([12, 16, 0, 1]), false),
        ] {
            let png = png(DisplayEncoding::from_interop_id(id));
            assert_eq!(content(&png, b"cICP"), cicp.map(Vec::from), "{id}");
            assert_eq!((content(&png, b"iCCP").is_some(), content(&png, b"sRGB")), (has_profile, None), "{id}");
            ::image::load_from_memory(&png).unwrap();
        }
        assert_eq!(content(&png(DisplayEncoding::from_interop_id("srgb_rec709_display")), b"sRGB"), Some(vec![0]));
        let unnamed = png(None);
        assert!([&b"sRGB"[..], b"cICP", b"iCCP"].iter().all(|kind| content(&unnamed, kind).is_none()));
        let unknown = ["ocio:lin_ap1_display", "srgb_rec709_scene", "srgb_rec709_display_2", "hlg_rec2020_display"];
        assert!(unknown.iter().all(|id| DisplayEncoding::from_interop_id(id).is_none()));
    }

    #[test]
    fn profiles_hold_the_primaries_that_readers_find() {
        let found = |id| profile_of_file(&png(DisplayEncoding::from_interop_id(id))).unwrap();
        assert_eq!(found("srgb_p3d65_display").space, Some(ColorSpace::LinearDisplayP3));
        let profile = padded(vec![0; 598]);
        assert_eq!((profile.len(), &profile[..4]), (600, &[0, 0, 2, 88][..]));
        assert_eq!(found("g26_p3d65_display").name, "Display P3, gamma 2.6");
        assert_eq!(found("g22_rec709_display").space, Some(ColorSpace::LinearRec709));
    }
}

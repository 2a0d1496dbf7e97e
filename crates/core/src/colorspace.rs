//! Colour spaces of scene-linear RGB: their primaries, and the matrix from one to another; and the
//! one space of a display, whose numbers are not proportional to light.
//!
//! Matrices map linear RGB to linear RGB through CIE XYZ, with Bradford's adaptation between white
//! points (ICC.1:2022, annex E). Nothing is clipped: a colour outside a space's gamut has negative
//! channels. A matrix is linear, so it can be applied to harmonics instead of the colours they sum
//! to ([`Conversion::apply_to_sh`]).
//!
//! Degenerate: chromaticities that define no colour space (collinear primaries, a white with y of 0,
//! NaN) have no matrix.

use std::sync::LazyLock;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::tone::srgb_decode;
use crate::{SH_OFFSET, sh};

/// A colour space of scene-linear RGB, or that of a display's colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColorSpace {
    /// Rec.709 primaries (those of sRGB), D65.
    #[default]
    LinearRec709,
    /// Display P3 primaries (those of DCI-P3), D65.
    LinearDisplayP3,
    /// Rec.2020 primaries, D65.
    LinearRec2020,
    /// ACES2065-1: AP0 primaries, ACES white. Contains all visible colours, and imaginary ones.
    #[serde(rename = "aces2065-1")]
    Aces2065,
    /// AP1 primaries, ACES white.
    #[serde(rename = "acescg", alias = "aces-cg")]
    AcesCg,
    /// Rec.709 primaries, D65, under sRGB's curve: the colours of a display, which most programs of
    /// 3D Gaussian splatting train on and write. Of scenes only: images are decoded to light.
    DisplaySrgb,
}

/// CIE xy coordinates of red, green, blue and white.
pub type Chromaticities = [[f32; 2]; 4];

/// Tolerance of chromaticities: files round them to three or four digits, and no two spaces in use
/// are closer than this.
const TOLERANCE: f32 = 1.5e-3;

impl ColorSpace {
    /// All spaces of scene-linear RGB.
    pub const ALL: [Self; 5] = [Self::LinearRec709, Self::LinearDisplayP3, Self::LinearRec2020, Self::Aces2065, Self::AcesCg];

    /// Names of those, for messages.
    pub const NAMES: &str = "linear-rec709, linear-display-p3, linear-rec2020, aces2065-1 or acescg";

    /// Returns the name written in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::LinearRec709 => "linear-rec709",
            Self::LinearDisplayP3 => "linear-display-p3",
            Self::LinearRec2020 => "linear-rec2020",
            Self::Aces2065 => "aces2065-1",
            Self::AcesCg => "acescg",
            Self::DisplaySrgb => "display-srgb",
        }
    }

    /// Returns the scene-linear space of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|space| space.name() == name)
    }

    /// Returns the space of this name, of a scene's colours: also a display's.
    pub fn of_scene(name: &str) -> Option<Self> {
        Self::from_name(name).or_else(|| (name == Self::DisplaySrgb.name()).then_some(Self::DisplaySrgb))
    }

    /// Returns whether numbers are proportional to light.
    ///
    /// ```
    /// use luxel_core::ColorSpace;
    ///
    /// assert!(ColorSpace::AcesCg.is_linear() && !ColorSpace::DisplaySrgb.is_linear());
    /// ```
    pub fn is_linear(self) -> bool {
        self != Self::DisplaySrgb
    }

    /// Returns the space of its light, in the same primaries.
    pub fn linear(self) -> Self {
        if self.is_linear() { self } else { Self::LinearRec709 }
    }

    /// Returns a colour as [`Conversion::between`] this space and `to` takes it: its light, where `to`
    /// is one of light.
    #[inline]
    pub fn towards(self, to: Self, rgb: [f32; 3]) -> [f32; 3] {
        if to.is_linear() { self.light(rgb) } else { rgb }
    }

    /// Returns the light of a colour, in the same primaries.
    #[inline]
    pub fn light(self, rgb: [f32; 3]) -> [f32; 3] {
        if self.is_linear() { rgb } else { rgb.map(srgb_decode) }
    }

    /// Returns primaries and white (ITU-R BT.709, SMPTE EG 432-1, ITU-R BT.2020, SMPTE ST 2065-1,
    /// ACES S-2014-004).
    pub fn chromaticities(self) -> Chromaticities {
        const D65: [f32; 2] = [0.3127, 0.3290];
        const ACES_WHITE: [f32; 2] = [0.32168, 0.33767];
        match self {
            Self::LinearRec709 | Self::DisplaySrgb => [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], D65],
            Self::LinearDisplayP3 => [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], D65],
            Self::LinearRec2020 => [[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], D65],
            Self::Aces2065 => [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.0770], ACES_WHITE],
            Self::AcesCg => [[0.713, 0.293], [0.165, 0.830], [0.128, 0.044], ACES_WHITE],
        }
    }

    /// Returns the space of these chromaticities, within the rounding of files.
    pub fn from_chromaticities(chromaticities: &Chromaticities) -> Option<Self> {
        let near = |space: &Self| {
            let (found, expected) = (chromaticities.as_flattened(), space.chromaticities());
            found.iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() <= TOLERANCE)
        };
        Self::ALL.into_iter().find(near)
    }
}

/// A matrix from linear RGB of one space to linear RGB of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    matrix: DMat3,
}

impl Conversion {
    /// Returns the conversion between two named spaces, of light; exactly the identity from a space to
    /// itself. That of a display is taken by its primaries: see [`ColorSpace::light`].
    pub fn between(from: ColorSpace, to: ColorSpace) -> Self {
        if from == to || (from.chromaticities() == to.chromaticities()) {
            return Self { matrix: DMat3::IDENTITY };
        }
        // All named spaces have valid primaries; a test checks every pair.
        Self::from_chromaticities(&from.chromaticities(), &to.chromaticities()).unwrap_or(Self { matrix: DMat3::IDENTITY })
    }

    /// Returns the conversion between two sets of chromaticities; `None` if one of them defines no
    /// colour space.
    pub fn from_chromaticities(from: &Chromaticities, to: &Chromaticities) -> Option<Self> {
        let (xyz_from_source, source_white) = xyz_from_rgb(from)?;
        let (xyz_from_target, target_white) = xyz_from_rgb(to)?;
        let matrix = inverse(xyz_from_target)? * adaptation(source_white, target_white)? * xyz_from_source;
        matrix.is_finite().then_some(Self { matrix })
    }

    /// Returns the matrix from CIE XYZ under the white point `white` (XYZ, Y = 1) to linear RGB of
    /// `to`; `None` if `white` is invalid.
    pub fn from_xyz(white: DVec3, to: ColorSpace) -> Option<DMat3> {
        let (xyz_from_target, target_white) = xyz_from_rgb(&to.chromaticities())?;
        let matrix = inverse(xyz_from_target)? * adaptation(white, target_white)?;
        matrix.is_finite().then_some(matrix)
    }

    /// Returns whether the conversion changes nothing.
    pub fn is_identity(&self) -> bool {
        self.matrix == DMat3::IDENTITY
    }

    /// Returns the rows of the matrix.
    pub fn rows(&self) -> [[f64; 3]; 3] {
        [0, 1, 2].map(|row| self.matrix.row(row).to_array())
    }

    /// Converts a colour.
    #[inline]
    pub fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        if self.is_identity() {
            return rgb;
        }
        (self.matrix * DVec3::from_array(rgb.map(f64::from))).to_array().map(|c| c as f32)
    }

    /// Converts harmonics `[K,3]` of [`crate::ColorModel::Sh`]: k' = M k, and the offset of 1/2
    /// moves into the DC.
    ///
    /// Exact wherever no channel is clipped at 0, in either space.
    pub fn apply_to_sh(&self, sh: &mut [f32]) {
        if self.is_identity() {
            return;
        }
        for k in sh.chunks_exact_mut(3) {
            let converted = self.apply([k[0], k[1], k[2]]);
            k.copy_from_slice(&converted);
        }
        let offset = self.apply([SH_OFFSET; 3]);
        for (k, moved) in sh.iter_mut().zip(offset) {
            *k += (moved - SH_OFFSET) / sh::C0;
        }
    }
}

/// Conversions to linear Rec.709, in the order of [`ColorSpace::ALL`].
static TO_REC709: LazyLock<[Conversion; ColorSpace::ALL.len()]> =
    LazyLock::new(|| ColorSpace::ALL.map(|space| Conversion::between(space, ColorSpace::LinearRec709)));

impl ColorSpace {
    /// Converts colours in this space to linear Rec.709. Out-of-gamut colours have negative
    /// channels.
    #[inline]
    pub fn to_rec709(self, rgb: [f32; 3]) -> [f32; 3] {
        match self {
            Self::LinearRec709 => rgb,
            Self::DisplaySrgb => self.light(rgb),
            _ => TO_REC709[self as usize].apply(rgb),
        }
    }
}

/// Returns the matrix from RGB to XYZ, and XYZ of white (Y = 1).
fn xyz_from_rgb(chromaticities: &Chromaticities) -> Option<(DMat3, DVec3)> {
    let [red, green, blue, white] = chromaticities.map(|xy| {
        let [x, y] = xy.map(f64::from);
        // Of a primary only the direction counts: those of CIE XYZ have a y of 0.
        if y == 0.0 { DVec3::new(x, 0.0, 1.0 - x) } else { DVec3::new(x / y, 1.0, (1.0 - x - y) / y) }
    });
    if white.y != 1.0 {
        return None;
    }
    let primaries = DMat3::from_cols(red, green, blue);
    let amounts = inverse(primaries)? * white;
    Some((primaries * DMat3::from_diagonal(amounts), white)).filter(|(m, w)| m.is_finite() && w.is_finite())
}

/// Returns Bradford's chromatic adaptation of XYZ.
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
    use proptest::prelude::*;

    use super::*;
    use crate::{ColorBasis, ColorModel};

    #[test]
    fn matrices_are_the_published_ones() {
        // Matrices of OpenColorIO and colour-science with Bradford adaptation; ACES2065-1 and
        // ACEScg by S-2014-004.
        let cases = [
            (
                ColorSpace::AcesCg,
                ColorSpace::LinearRec709,
                [[1.705_05, -0.621_79, -0.083_26], [-0.130_26, 1.140_80, -0.010_55], [-0.024_00, -0.128_97, 1.152_97]],
            ),
            (
                ColorSpace::LinearRec709,
                ColorSpace::AcesCg,
                [[0.613_097, 0.339_523, 0.047_379], [0.070_194, 0.916_354, 0.013_452], [0.020_616, 0.109_570, 0.869_815]],
            ),
            (
                ColorSpace::LinearRec709,
                ColorSpace::LinearRec2020,
                [[0.627_404, 0.329_283, 0.043_313], [0.069_097, 0.919_540, 0.011_362], [0.016_391, 0.088_013, 0.895_595]],
            ),
            (
                ColorSpace::LinearRec709,
                ColorSpace::LinearDisplayP3,
                [[0.822_462, 0.177_538, 0.0], [0.033_194, 0.966_806, 0.0], [0.017_083, 0.072_397, 0.910_520]],
            ),
            (
                ColorSpace::Aces2065,
                ColorSpace::AcesCg,
                [[1.451_439, -0.236_511, -0.214_929], [-0.076_554, 1.176_230, -0.099_676], [0.008_316, -0.006_032, 0.997_716]],
            ),
        ];
        for (from, to, expected) in cases {
            let found = Conversion::between(from, to).rows();
            for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
                assert!((found - expected).abs() < 2e-5, "{from:?} to {to:?}: {found}, expected {expected}");
            }
        }
    }

    #[test]
    fn white_stays_white_and_there_and_back_is_nothing() {
        for from in ColorSpace::ALL {
            for to in ColorSpace::ALL {
                let there = Conversion::between(from, to);
                assert_eq!(there.is_identity(), from == to);
                let white = DVec3::from_array(there.apply([1.0; 3]).map(f64::from));
                assert!((white - DVec3::ONE).length() < 1e-6, "{from:?} {to:?} {white}");
                let round = Conversion::between(to, from).matrix * there.matrix;
                assert!(round.abs_diff_eq(DMat3::IDENTITY, 1e-9), "{from:?} {to:?}");
            }
        }
    }

    #[test]
    fn rounded_chromaticities_are_known() {
        for space in ColorSpace::ALL {
            let rounded = space.chromaticities().map(|xy| xy.map(|v| (v * 1e3).round() / 1e3));
            assert_eq!(ColorSpace::from_chromaticities(&rounded), Some(space));
            assert_eq!(ColorSpace::from_name(space.name()), Some(space));
            assert!(ColorSpace::NAMES.contains(space.name()));
            assert_eq!(serde_json::to_string(&space).unwrap(), format!("\"{}\"", space.name()));
        }
        assert_eq!(ColorSpace::from_chromaticities(&[[0.0; 2]; 4]), None);
    }

    #[test]
    fn colours_of_a_display_are_decoded_to_light_and_are_no_space_of_images() {
        let space = ColorSpace::DisplaySrgb;
        assert!((space.to_rec709([0.5, 1.0, 0.0])[0] - 0.214_041).abs() < 1e-6);
        assert_eq!(space.light([1.0; 3]), [1.0; 3]);
        assert_eq!((ColorSpace::from_name(space.name()), ColorSpace::of_scene(space.name())), (None, Some(space)));
        assert_eq!(ColorSpace::from_chromaticities(&space.chromaticities()), Some(ColorSpace::LinearRec709));
    }

    #[test]
    fn primaries_of_cie_xyz_are_a_colour_space() {
        let xyz = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [1.0 / 3.0, 1.0 / 3.0]];
        let conversion = Conversion::from_chromaticities(&xyz, &ColorSpace::LinearRec709.chromaticities()).unwrap();
        assert!(conversion.apply([1.0; 3]).iter().all(|v| (v - 1.0).abs() < 1e-5));
        // XYZ under D65, as sRGB's standard has its matrix.
        let d65 = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.3127, 0.3290]];
        let rows = Conversion::from_chromaticities(&d65, &ColorSpace::LinearRec709.chromaticities()).unwrap().rows();
        // Units of X and Z are those of white, which is 1 1 1 here.
        assert!((rows[0][0] - 3.2406 * 0.95046).abs() < 1e-3 && (rows[2][2] - 1.0570 * 1.08906).abs() < 1e-3, "{rows:?}");
    }

    #[test]
    fn degenerate_chromaticities_have_no_matrix() {
        let rec709 = ColorSpace::LinearRec709.chromaticities();
        for bad in [[[0.0; 2]; 4], [[0.3, 0.3]; 4], [[f32::NAN; 2]; 4], [[f32::INFINITY; 2]; 4]] {
            assert_eq!(Conversion::from_chromaticities(&bad, &rec709), None, "{bad:?}");
        }
    }

    proptest! {
        #[test]
        fn harmonics_convert_as_their_colours_do(
            k in prop::collection::vec(-0.02f32..0.02, 48),
            dc in prop::array::uniform3(0.0f32..3.0),
            pair in 0usize..25,
        ) {
            let (from, to) = (ColorSpace::ALL[pair / 5], ColorSpace::ALL[pair % 5]);
            let conversion = Conversion::between(from, to);
            let model = ColorModel::Sh { degree: 3 };
            let mut before = k;
            before[..3].copy_from_slice(&dc);
            let mut after = before.clone();
            conversion.apply_to_sh(&mut after);
            for direction in [[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [-0.48, 0.64, -0.6]] {
                let basis = ColorBasis::new(3, direction);
                let color = |sh: &[f32]| model.radiance(&basis, |m, c| sh[3 * m + c], |_| 0.0);
                let (found, expected) = (color(&after), conversion.apply(color(&before)));
                for c in 0..3 {
                    prop_assert!((found[c] - expected[c].max(0.0)).abs() < 4e-6, "{:?} {:?}", found, expected);
                }
            }
        }
    }
}

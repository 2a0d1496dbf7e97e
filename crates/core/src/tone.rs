//! Tone curves: the mu-law of loss and metrics, and the display encoder of previews.
//!
//! In: linear radiance in the scene's normalised units. Out: floating-point values under a curve;
//! [`display_rgb8`] is the only place that makes 8-bit values.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{ColorSpace, luminance_rec709};

/// mu of the mu-law, as in LCD-GS and its predecessors.
pub const MU: f32 = 5000.0;

/// Returns the mu-law ln(1 + mu p) / ln(1 + mu) of p >= 0.
#[inline]
pub fn mu_law(p: f32, mu: f32) -> f32 {
    (mu * p).ln_1p() / mu.ln_1p()
}

/// [`mu_law`] with a fixed mu for many values: faster, and equal to within the rounding of f32
/// (2e-7).
#[derive(Clone, Copy, Debug)]
pub struct MuLaw {
    mu: f64,
    /// Factor 1 / ln(1 + mu).
    scale: f64,
}

impl MuLaw {
    /// Returns the curve of `mu`, which is above 0.
    pub fn new(mu: f32) -> Self {
        let mu = f64::from(mu);
        Self { mu, scale: mu.ln_1p().recip() }
    }

    /// Returns the mu-law of `p`, finite and >= 0.
    #[inline]
    pub fn apply(self, p: f32) -> f32 {
        let x = self.mu * f64::from(p);
        // For small x the sum 1 + x loses digits; the series of ln(1 + x) restores them. Its first
        // omitted term is x^4 / 4.
        let small = x * (1.0 - x * (0.5 - x / 3.0));
        ((if x < 1e-4 { small } else { ln(1.0 + x) }) * self.scale) as f32
    }
}

/// Returns the natural logarithm of a normal number above 0, to 1e-10.
///
/// It sums the series of `ln m = 2 artanh((m - 1) / (m + 1))`, where y = 2^e m and m in
/// `[sqrt(1/2), sqrt(2))`. It has no branches, so that loops over it can be vectorised.
#[inline]
fn ln(y: f64) -> f64 {
    /// Bits of sqrt(1/2).
    const LOWEST: u64 = 0x3fe6_a09e_667f_3bcd;
    let above = y.to_bits().wrapping_sub(LOWEST);
    let exponent = (above as i64 >> 52) as f64;
    let m = f64::from_bits(y.to_bits().wrapping_sub(above & 0xfff0_0000_0000_0000));
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    // z <= 0.0295: the first omitted term is z^6 / 13 = 5e-11.
    let series = 1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0 + z / 11.0))));
    exponent * std::f64::consts::LN_2 + 2.0 * s * series
}

/// Returns the p of a mu-law value: the inverse of [`mu_law`].
#[inline]
pub fn mu_law_inverse(t: f32, mu: f32) -> f32 {
    (t * mu.ln_1p()).exp_m1() / mu
}

/// A curve from scene-linear radiance to a display, for previews only; data is never changed by it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tonemap {
    /// Clipped at 1, sRGB-encoded.
    None,
    /// The mu-law (mu = 5000) as display value, as in the figures of papers on HDR view synthesis.
    Mulaw,
    /// Y / (1 + Y) of the luminance with unchanged hue (Reinhard et al. 2002, eq. 3).
    Reinhard,
    /// The ACES reference rendering and output transform, in the fit by S. Hill (MJP's BakingLab,
    /// ACES.hlsl).
    Aces,
    /// AgX (T. Sobotka), the base look: highlights fade to white through lighter hues. Fit of the
    /// contrast curve by B. Wrensch, "Minimal AgX implementation", 2023.
    #[default]
    Agx,
}

impl Tonemap {
    /// All curves.
    pub const ALL: [Self; 5] = [Self::None, Self::Mulaw, Self::Reinhard, Self::Aces, Self::Agx];

    /// Returns the curve's name, such as `agx`.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Mulaw => "mulaw",
            Self::Reinhard => "reinhard",
            Self::Aces => "aces",
            Self::Agx => "agx",
        }
    }

    /// Returns encoded display values in `[0, 1]`, as a PNG stores them before rounding, of linear
    /// Rec.709 radiance.
    ///
    /// NaN and negative values count as 0.
    pub fn encode(self, rgb: [f32; 3]) -> [f32; 3] {
        // All curves are flat above this, and none overflows below it.
        let rgb = rgb.map(|v| if v > 0.0 { v.min(1e9) } else { 0.0 });
        let display = match self {
            Self::None => rgb.map(srgb_encode),
            Self::Mulaw => rgb.map(|v| mu_law(v, MU)),
            Self::Reinhard => {
                let factor = 1.0 / (1.0 + luminance_rec709(rgb));
                rgb.map(|v| srgb_encode(v * factor))
            }
            Self::Aces => aces(rgb).map(srgb_encode),
            Self::Agx => agx(rgb),
        };
        display.map(|v| v.clamp(0.0, 1.0))
    }
}

impl fmt::Display for Tonemap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Explains that no curve has this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown tone curve \"{0}\", expected none, mulaw, reinhard, aces or agx")]
pub struct UnknownTonemap(String);

impl FromStr for Tonemap {
    type Err = UnknownTonemap;

    fn from_str(name: &str) -> Result<Self, UnknownTonemap> {
        Self::ALL.into_iter().find(|t| t.name() == name).ok_or_else(|| UnknownTonemap(name.into()))
    }
}

/// Returns the 8-bit display value of `radiance` (linear Rec.709, normalised units): multiplied by
/// 2^`exposure_ev`, encoded with the curve, rounded.
pub fn display_rgb8(tonemap: Tonemap, exposure_ev: f32, radiance: [f32; 3]) -> [u8; 3] {
    let gain = exposure_ev.exp2();
    // The value is in [0, 1], so the sum is below 256 and the cast rounds.
    tonemap.encode(radiance.map(|v| v * gain)).map(|v| (v * 255.0 + 0.5) as u8)
}

/// Returns the sRGB encoding of a linear value in `[0, 1]` (IEC 61966-2-1).
///
/// Larger values continue the power law; negative ones give 0.
#[inline]
pub fn srgb_encode(linear: f32) -> f32 {
    let linear = linear.max(0.0);
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Returns the linear value of an sRGB-encoded one: the inverse of [`srgb_encode`].
#[inline]
pub fn srgb_decode(encoded: f32) -> f32 {
    let encoded = encoded.max(0.0);
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Luminance of reference white in HDR pictures, cd/m2 (ITU-R BT.2408).
pub const REFERENCE_WHITE_NITS: f32 = 203.0;

/// Returns the perceptual quantizer's value in `[0, 1]` of an absolute luminance, cd/m2 (SMPTE ST
/// 2084): 10,000 gives 1.
///
/// NaN and negative values give 0.
#[inline]
pub fn pq_encode(nits: f32) -> f32 {
    const M1: f32 = 2610.0 / 16384.0;
    const M2: f32 = 2523.0 / 32.0;
    const C1: f32 = 3424.0 / 4096.0;
    const C2: f32 = 2413.0 / 128.0;
    const C3: f32 = 2392.0 / 128.0;
    let y = if nits > 0.0 { (nits / 10_000.0).min(1.0) } else { 0.0 };
    let p = y.powf(M1);
    ((C1 + C2 * p) / (1.0 + C3 * p)).powf(M2)
}

/// Converts radiance in `space` to linear Rec.709, as the curves and [`display_rgb8`] expect it.
/// Out-of-gamut colours have negative channels.
#[inline]
pub fn rec709_of(space: ColorSpace, rgb: [f32; 3]) -> [f32; 3] {
    space.to_rec709(rgb)
}

/// Returns colours in `space` as linear Rec.709 light, times an exposure: on the numbers where they
/// are proportional to light, else on the light that they stand for.
#[inline]
pub fn exposed_rec709(space: ColorSpace, rgb: [f32; 3], exposure: f32) -> [f32; 3] {
    match space.is_linear() {
        true => rec709_of(space, rgb.map(|c| c * exposure)),
        false => rec709_of(space, rgb).map(|c| c * exposure),
    }
}

fn transform(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Matrix from Rec.709 to AP1 with the reference rendering transform's desaturation.
const ACES_FROM_REC709: [[f32; 3]; 3] = [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]];
/// Matrix of the output transform's desaturation and from AP1 to Rec.709.
const REC709_FROM_ACES: [[f32; 3]; 3] = [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]];

/// Returns linear display light; the caller encodes it.
fn aces(rgb: [f32; 3]) -> [f32; 3] {
    let curve = |v: f32| (v * (v + 0.024_578_6) - 0.000_090_537) / (v * (0.983_729 * v + 0.432_951) + 0.238_081);
    transform(&REC709_FROM_ACES, transform(&ACES_FROM_REC709, rgb).map(curve))
}

/// AgX's inset matrix: moves the primaries inwards, so that saturated light reaches all three
/// channels and can become white.
const AGX_INSET: [[f32; 3]; 3] =
    [[0.842_479_06, 0.078_433_6, 0.079_223_745], [0.042_328_242, 0.878_468_64, 0.079_166_13], [0.042_375_655, 0.078_433_6, 0.879_143]];
/// Inverse of [`AGX_INSET`].
const AGX_OUTSET: [[f32; 3]; 3] =
    [[1.196_879, -0.098_020_88, -0.099_029_74], [-0.052_896_852, 1.151_903_1, -0.098_961_18], [-0.052_971_636, -0.098_043_45, 1.151_073_7]];
/// Lower end of AgX's range, 10 stops below middle grey: log2(0.18) - 10.
const AGX_MIN_EV: f32 = -12.473_931;
/// Upper end of AgX's range, 6.5 stops above middle grey: log2(0.18) + 6.5.
const AGX_MAX_EV: f32 = 4.026_069;
/// Contrast curve on `[0, 1]`: coefficients by ascending powers; mean squared error of the fit
/// 3.7e-6.
const AGX_CONTRAST: [f32; 7] = [-0.002_32, 0.119_1, 0.429_8, -6.868, 31.96, -40.14, 15.5];

/// Returns encoded display values: AgX's curve includes the encoding.
fn agx(rgb: [f32; 3]) -> [f32; 3] {
    let curve = |v: f32| {
        let place = ((v.max(f32::MIN_POSITIVE).log2() - AGX_MIN_EV) / (AGX_MAX_EV - AGX_MIN_EV)).clamp(0.0, 1.0);
        AGX_CONTRAST.iter().rev().fold(0.0, |sum, coefficient| sum * place + coefficient)
    };
    transform(&AGX_OUTSET, transform(&AGX_INSET, rgb).map(curve))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn mu_law_has_its_known_values() {
        for (p, expected) in [(0.0, 0.0), (1e-3, 0.210), (0.01, 0.462), (0.05, 0.649), (0.1, 0.730), (0.5, 0.919), (1.0, 1.0)] {
            assert!((mu_law(p, MU) - expected).abs() < 6e-4, "T({p}) = {}", mu_law(p, MU));
        }
    }

    #[test]
    fn srgb_has_its_known_values() {
        // Middle grey 0.18 is 118 of 255, half of the light is 188, and code 10 is the second to
        // last on the linear part.
        for (linear, code) in [(0.0, 0), (0.18, 118), (0.5, 188), (1.0, 255), (10.0 / 255.0 / 12.92, 10)] {
            assert_eq!(display_rgb8(Tonemap::None, 0.0, [linear; 3]), [code; 3]);
        }
    }

    #[test]
    fn pq_has_its_published_values() {
        // ITU-R BT.2100 and BT.2408: 100 cd/m2 is 50.8 %, reference white of 203 is 58.1 %, 1000 is
        // 75.2 %.
        for (nits, value) in [(0.0, 0.0), (100.0, 0.508), (203.0, 0.581), (1000.0, 0.752), (10_000.0, 1.0), (1e9, 1.0), (f32::NAN, 0.0)] {
            assert!((pq_encode(nits) - value).abs() < 6e-4, "{nits}: {}", pq_encode(nits));
        }
    }

    #[test]
    fn exposure_is_in_stops() {
        for tonemap in Tonemap::ALL {
            assert_eq!(display_rgb8(tonemap, 3.0, [0.01, 0.02, 0.03]), display_rgb8(tonemap, 0.0, [0.08, 0.16, 0.24]));
        }
    }

    #[test]
    fn the_mulaw_display_is_the_mu_law() {
        assert_eq!(display_rgb8(Tonemap::Mulaw, 0.0, [1e-3, 0.05, 7.0]), [54, 165, 255]);
    }

    #[test]
    fn curves_map_middle_grey_to_their_published_values() {
        // AgX pivots there: half of the encoded range. Hill's fit: 0.1058 of linear light.
        let agx = Tonemap::Agx.encode([0.18; 3]);
        assert!((agx[0] - 0.5).abs() < 0.005, "{agx:?}");
        let aces = srgb_decode(Tonemap::Aces.encode([0.18; 3])[1]);
        assert!((aces - 0.1058).abs() < 2e-3, "{aces}");
        assert!((srgb_decode(Tonemap::Reinhard.encode([1.0; 3])[1]) - 0.5).abs() < 1e-4);
    }

    #[test]
    fn agx_outset_undoes_the_inset() {
        for axis in 0..3 {
            let mut unit = [0.0; 3];
            unit[axis] = 1.0;
            let back = transform(&AGX_OUTSET, transform(&AGX_INSET, unit));
            assert!((0..3).all(|c| (back[c] - unit[c]).abs() < 1e-5), "{back:?}");
        }
    }

    #[test]
    fn hostile_values_are_black_or_white() {
        for tonemap in Tonemap::ALL {
            assert!(display_rgb8(tonemap, 0.0, [f32::NAN, -1.0, f32::NEG_INFINITY]).iter().all(|&v| v < 3), "{tonemap}");
            assert!(display_rgb8(tonemap, 0.0, [f32::INFINITY; 3]).iter().all(|&v| v > 250), "{tonemap}");
            assert!(display_rgb8(tonemap, 300.0, [0.0; 3]).iter().all(|&v| v < 3), "{tonemap}");
        }
    }

    #[test]
    fn names_parse_back() {
        for tonemap in Tonemap::ALL {
            assert_eq!(tonemap.to_string().parse(), Ok(tonemap));
            assert_eq!(serde_json::to_string(&tonemap).unwrap(), format!("\"{tonemap}\""));
        }
        let error = "filmic".parse::<Tonemap>().unwrap_err();
        assert_eq!(error.to_string(), "unknown tone curve \"filmic\", expected none, mulaw, reinhard, aces or agx");
    }

    proptest! {
        #[test]
        fn srgb_decode_undoes_encode(v in 0f32..4.0) {
            prop_assert!((srgb_decode(srgb_encode(v)) - v).abs() < 2e-6 * v.max(1.0));
        }

        #[test]
        fn the_curve_of_many_values_is_that_of_one(ev in -40f32..40.0, decade in -20f32..20.0) {
            let mu = 10f32.powf(decade);
            let (found, expected) = (MuLaw::new(mu).apply(ev.exp2()), (f64::from(mu) * f64::from(ev.exp2())).ln_1p() / f64::from(mu).ln_1p());
            prop_assert!((f64::from(found) - expected).abs() <= 1.2e-7 * expected, "{found} {expected}");
        }

        #[test]
        fn mu_law_inverse_undoes_it(p in 0f32..100.0) {
            prop_assert!((mu_law_inverse(mu_law(p, MU), MU) - p).abs() < 1e-5 * p.max(1e-4));
        }

        /// On greys every curve rises, except for rounding in f32 and the foot of AgX's fit, which
        /// dips by less than an 8-bit step.
        #[test]
        fn curves_of_greys_do_not_fall(ev in -14f32..10.0, step in 0f32..2.0) {
            for tonemap in Tonemap::ALL {
                let (low, high) = (tonemap.encode([ev.exp2(); 3]), tonemap.encode([(ev + step).exp2(); 3]));
                for c in 0..3 {
                    prop_assert!(high[c] >= low[c] - 1.0 / 255.0, "{} at {} EV: {} {}", tonemap, ev, low[c], high[c]);
                }
            }
        }
    }
}

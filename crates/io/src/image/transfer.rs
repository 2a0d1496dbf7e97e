//! Curves between samples and light: linear, sRGB, and those of cameras and of video in high
//! dynamic range.
//!
//! In: a sample, 0 to 1 of its range. Out: light. Of cameras' log curves 1 is the light of a white
//! surface of 100 % (18 % grey is 0.18), PQ's 1 is 100 cd/m2, and HLG's 0.25 is at half of the
//! signal. Sources: the makers' papers on their formats; SMPTE ST 2084; ITU-R BT.2100; tests hold
//! them equal to OpenColorIO's.

use std::fmt;
use std::str::FromStr;

use luxel_core::{Chromaticities, ColorSpace};
use serde::{Deserialize, Serialize};

/// Curve between samples and light.
///
/// Those of cameras and of video have primaries of their own ([`Self::plate_primaries`]): together
/// they say all about a plate, whatever its file states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transfer {
    /// Samples are proportional to light.
    Linear,
    /// IEC 61966-2-1, the piecewise curve.
    Srgb,
    /// ARRI LogC3 at exposure index 800, ARRI Wide Gamut 3.
    LogC3,
    /// ARRI LogC4, ARRI Wide Gamut 4.
    LogC4,
    /// Sony S-Log3, S-Gamut3.
    SLog3,
    /// Sony S-Log3, S-Gamut3.Cine.
    SLog3Cine,
    /// Panasonic V-Log, V-Gamut.
    VLog,
    /// DJI D-Log, D-Gamut.
    DLog,
    /// Canon Log 2, Cinema Gamut.
    CLog2,
    /// Canon Log 3, Cinema Gamut.
    CLog3,
    /// Apple Log, Rec.2020 primaries.
    AppleLog,
    /// RED Log3G10, REDWideGamutRGB.
    Log3G10,
    /// ACEScct, AP1 primaries.
    AcesCct,
    /// SMPTE ST 2084 (PQ), Rec.2020 primaries.
    Pq,
    /// Hybrid Log-Gamma of ITU-R BT.2100, Rec.2020 primaries.
    Hlg,
}

const D65: [f32; 2] = [0.3127, 0.3290];
const CINEMA_GAMUT: Chromaticities = [[0.740, 0.270], [0.170, 1.140], [0.080, -0.100], D65];

impl Transfer {
    /// All curves, with the names they are chosen by.
    pub const ALL: [(&'static str, Self); 15] = [
        ("linear", Self::Linear),
        ("srgb", Self::Srgb),
        ("logc3", Self::LogC3),
        ("logc4", Self::LogC4),
        ("slog3", Self::SLog3),
        ("slog3cine", Self::SLog3Cine),
        ("vlog", Self::VLog),
        ("dlog", Self::DLog),
        ("clog2", Self::CLog2),
        ("clog3", Self::CLog3),
        ("applelog", Self::AppleLog),
        ("log3g10", Self::Log3G10),
        ("acescct", Self::AcesCct),
        ("pq", Self::Pq),
        ("hlg", Self::Hlg),
    ];

    /// Returns CIE xy of red, green, blue and white of plates with this curve; `None`: the curve
    /// says nothing about primaries.
    pub fn plate_primaries(self) -> Option<Chromaticities> {
        Some(match self {
            Self::Linear | Self::Srgb => return None,
            Self::LogC3 => [[0.6840, 0.3130], [0.2210, 0.8480], [0.0861, -0.1020], D65],
            Self::LogC4 => [[0.7347, 0.2653], [0.1424, 0.8576], [0.0991, -0.0308], D65],
            Self::SLog3 => [[0.730, 0.280], [0.140, 0.855], [0.100, -0.050], D65],
            Self::SLog3Cine => [[0.766, 0.275], [0.225, 0.800], [0.089, -0.087], D65],
            Self::VLog => [[0.730, 0.280], [0.165, 0.840], [0.100, -0.030], D65],
            Self::DLog => [[0.71, 0.31], [0.21, 0.88], [0.09, -0.08], D65],
            Self::CLog2 | Self::CLog3 => CINEMA_GAMUT,
            Self::Log3G10 => [[0.780_308, 0.304_253], [0.121_595, 1.493_994], [0.095_612, -0.084_589], D65],
            Self::AcesCct => ColorSpace::AcesCg.chromaticities(),
            Self::AppleLog | Self::Pq | Self::Hlg => ColorSpace::LinearRec2020.chromaticities(),
        })
    }

    /// Returns the light of a sample.
    pub fn light(self, x: f64) -> f64 {
        match self {
            Self::Linear => x,
            Self::Srgb => srgb(x),
            Self::LogC3 => logc3(x),
            Self::LogC4 => logc4(x),
            Self::SLog3 | Self::SLog3Cine => slog3(x),
            Self::VLog => vlog(x),
            Self::DLog => dlog(x),
            Self::CLog2 => clog2(x),
            Self::CLog3 => clog3(x),
            Self::AppleLog => apple_log(x),
            Self::Log3G10 => log3g10(x),
            Self::AcesCct => acescct(x),
            Self::Pq => pq(x),
            Self::Hlg => hlg(x),
        }
    }
}

fn srgb(x: f64) -> f64 {
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

fn logc3(x: f64) -> f64 {
    const CUT: f64 = 0.010_591;
    let (a, b, c, d, e, f) = (5.555_556, 0.052_272, 0.247_190, 0.385_537, 5.367_655, 0.092_809);
    if x > e * CUT + f { (10f64.powf((x - d) / c) - b) / a } else { (x - f) / e }
}

fn logc4(x: f64) -> f64 {
    let a = (f64::from(1 << 18) - 16.0) / 117.45;
    let (b, c) = ((1023.0 - 95.0) / 1023.0, 95.0 / 1023.0);
    let light = |x: f64| ((14.0 * (x - c) / b + 6.0).exp2() - 64.0) / a;
    let slope = 7.0 * std::f64::consts::LN_2 * (7.0 - 14.0 * c / b).exp2() / (a * b);
    if x < 0.0 { x * slope + light(0.0) } else { light(x) }
}

fn slog3(x: f64) -> f64 {
    const CUT: f64 = 171.210_294_692_9;
    let code = x * 1023.0;
    if code >= CUT { 10f64.powf((code - 420.0) / 261.5) * 0.19 - 0.01 } else { (code - 95.0) * 0.011_25 / (CUT - 95.0) }
}

fn vlog(x: f64) -> f64 {
    if x < 0.181 { (x - 0.125) / 5.6 } else { 10f64.powf((x - 0.598_206) / 0.241_514) - 0.008_73 }
}

fn dlog(x: f64) -> f64 {
    if x <= 0.14 { (x - 0.0929) / 6.025 } else { (10f64.powf(3.89616 * x - 2.27752) - 0.0108) / 0.9892 }
}

fn clog2(x: f64) -> f64 {
    const CUT: f64 = 0.092_864_125;
    let light = |x: f64| (10f64.powf((x - CUT) / 0.241_360_77) - 1.0) / 87.099_375;
    0.9 * if x < CUT { -light(2.0 * CUT - x) } else { light(x) }
}

fn clog3(x: f64) -> f64 {
    let light = |x: f64| (10f64.powf(x / 0.367_268_45) - 1.0) / 14.98325;
    0.9 * if x < 0.097_465_473 {
        -light(0.127_839_01 - x)
    } else if x <= 0.152_778_91 {
        (x - 0.125_122_19) / 1.975_479_8
    } else {
        light(x - 0.122_405_37)
    }
}

fn apple_log(x: f64) -> f64 {
    const LOWEST: f64 = -0.056_410_88;
    const FACTOR: f64 = 47.287_112_36;
    let cut = FACTOR * (0.01 - LOWEST) * (0.01 - LOWEST);
    if x >= cut { ((x - 0.693_369_45) / 0.085_504_79).exp2() - 0.009_640_52 } else { (x.max(0.0) / FACTOR).sqrt() + LOWEST }
}

fn log3g10(x: f64) -> f64 {
    let light = if x < 0.0 { x / 15.1927 } else { (10f64.powf(x / 0.224_282) - 1.0) / 155.975_327 };
    light - 0.01
}

fn acescct(x: f64) -> f64 {
    if x <= 0.155_251_141_552_511 { (x - 0.072_905_534_195_835_5) / 10.540_237_741_654_5 } else { (x * 17.52 - 9.72).exp2() }
}

fn pq(x: f64) -> f64 {
    let (m1, m2) = (2610.0 / 16384.0, 2523.0 / 32.0);
    let (c1, c2, c3) = (107.0 / 128.0, 2413.0 / 128.0, 2392.0 / 128.0);
    let power = x.max(0.0).powf(1.0 / m2);
    100.0 * ((power - c1).max(0.0) / (c2 - c3 * power)).powf(1.0 / m1)
}

fn hlg(x: f64) -> f64 {
    let (a, b, c) = (0.178_832_77, 0.284_668_92, 0.559_910_73);
    if x <= 0.5 { x * x.abs() } else { (((x - c) / a).exp() + b) / 4.0 }
}

impl FromStr for Transfer {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL.iter().find(|(name, _)| *name == text).map(|&(_, transfer)| transfer).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|&(name, _)| name).collect();
            format!("unknown transfer \"{text}\", expected one of {}", names.join(", "))
        })
    }
}

impl fmt::Display for Transfer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(Self::ALL.iter().find(|(_, transfer)| transfer == self).map_or("", |&(name, _)| name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The light at 0, 0.05, 0.125, 0.2, 0.3, 0.5, 0.7, 0.9 and 1, by OpenColorIO 2.6 (its green
    /// channel, which its matrices leave at the light of a neutral to six digits).
    const REFERENCES: [(Transfer, [f64; 9]); 11] = [
        (
            Transfer::LogC3,
            [
                -0.017_290_486,
                -0.007_975_430_2,
                0.005_997_150_2,
                0.022_556_858,
                0.071_731_091,
                0.513_383_39,
                3.359_008_3,
                21.693_686,
                55.080_143,
            ],
        ),
        (
            Transfer::LogC4,
            [-0.018_056_996, -0.010_546_797, 0.011_764_552, 0.061_534_192, 0.234_255_31, 2.204_968_5, 18.946_442, 161.167_27, 469.801_21],
        ),
        (
            Transfer::SLog3,
            [
                -0.014_023_697,
                -0.006_473_043,
                0.004_852_936_6,
                0.018_513_151,
                0.060_185_596,
                0.415_263_06,
                2.566_718_3,
                15.602_673,
                38.420_853,
            ],
        ),
        (
            Transfer::SLog3Cine,
            [
                -0.014_023_696,
                -0.006_473_043_5,
                0.004_852_936_6,
                0.018_513_149,
                0.060_185_593,
                0.415_263_06,
                2.566_718_3,
                15.602_674,
                38.420_856,
            ],
        ),
        (
            Transfer::VLog,
            [
                -0.022_321_31,
                -0.013_392_755,
                7.716_658_2e-08,
                0.013_719_613,
                0.049_515_888,
                0.383_347_96,
                2.630_538_7,
                17.757_351,
                46.085_476,
            ],
        ),
        (
            Transfer::CLog2,
            [
                -0.014_726_903,
                -0.005_220_229_7,
                0.003_707_138_8,
                0.018_382_065,
                0.064_213_604,
                0.492_082_57,
                3.375_754_4,
                22.810_593,
                59.234_501,
            ],
        ),
        (
            Transfer::CLog3,
            [
                -0.073_813_342,
                -0.037_786_558,
                -5.566_799_5e-05,
                0.037_636_723,
                0.122_823_77,
                0.580_777_65,
                2.185_435_5,
                7.808_114_1,
                14.668_302,
            ],
        ),
        (
            Transfer::AppleLog,
            [
                -0.056_410_879,
                -0.023_893_645,
                -0.004_996_617_8,
                0.008_623_589_8,
                0.031_578_273,
                0.198_913_89,
                1.045_583,
                5.329_463_5,
                12.000_002,
            ],
        ),
        (
            Transfer::Log3G10,
            [
                -0.009_999_999_8,
                -0.005_699_102_3,
                0.006_724_241_2,
                0.033_555_232,
                0.123_079_73,
                1.070_717_8,
                8.456_170_1,
                66.015_007,
                184.322_59,
            ],
        ),
        (
            Transfer::AcesCct,
            [
                -0.006_916_881_1,
                -0.002_173_155_1,
                0.004_942_434_4,
                0.013_452_325,
                0.045_310_762,
                0.514_056_03,
                5.832_025_5,
                66.165_024,
                222.861_08,
            ],
        ),
        (Transfer::Pq, [0.0, 0.000_600_016_44, 0.005_938_900_2, 0.024_292_642, 0.100_382_34, 0.922_457_1, 6.208_807_9, 39.056_503, 100.0]),
    ];

    #[test]
    fn curves_are_those_of_opencolorio() {
        for (transfer, expected) in REFERENCES {
            for (x, expected) in [0.0, 0.05, 0.125, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0].into_iter().zip(expected) {
                let found = transfer.light(x);
                assert!((found - expected).abs() <= 2e-5 * expected.abs() + 2e-7, "{transfer} at {x}: {found}, expected {expected}");
            }
        }
    }

    #[test]
    fn middle_grey_is_where_the_makers_say() {
        // 18 % grey: DJI states 39.8765 % of the signal, Sony code 420 of 1023.
        assert!((Transfer::DLog.light(0.398_765) - 0.18).abs() < 1e-4, "{}", Transfer::DLog.light(0.398_765));
        assert!((Transfer::SLog3.light(420.0 / 1023.0) - 0.18).abs() < 1e-9);
        assert!((Transfer::Log3G10.light(1.0 / 3.0) - 0.18).abs() < 1e-4);
        // BT.2100: 58 % of PQ's signal is 203 cd/m2; HLG's pieces meet at half.
        assert!((Transfer::Pq.light(0.58) - 2.03).abs() < 0.02);
        assert!((Transfer::Hlg.light(0.5) - Transfer::Hlg.light(0.500_000_1)).abs() < 1e-6);
    }

    #[test]
    fn curves_rise_without_a_step() {
        for (name, transfer) in Transfer::ALL {
            let mut before = transfer.light(0.0);
            for i in 1..=4096 {
                let now = transfer.light(f64::from(i) / 4096.0);
                assert!(now >= before && now.is_finite(), "{name} at {i}: {before}, {now}");
                assert!(now - before <= 0.02 * now.abs().max(0.15), "{name} at {i}: a step from {before} to {now}");
                before = now;
            }
        }
    }

    #[test]
    fn names_lead_to_the_curve_and_back() {
        for (name, transfer) in Transfer::ALL {
            assert_eq!(name.parse(), Ok(transfer));
            assert_eq!(transfer.to_string(), name);
            assert_eq!(serde_json::to_string(&transfer).unwrap(), format!("\"{name}\""));
        }
        assert!("dlogm".parse::<Transfer>().unwrap_err().contains("expected one of linear, srgb, logc3"));
    }
}

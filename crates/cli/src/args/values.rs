//! Values of options: their names on the command line, and their ranges.

mod captures;
mod markers;
mod transfer;
mod world;

use clap::ValueEnum;
use luxel::camera_path::PathKind;
use luxel::output::ExrType;
use luxel_core::tone::Tonemap;
use luxel_core::{ColorSpace, Image, MAX_SIDE_PX};
use luxel_cpu::InstructionSet;
use luxel_io::{DatasetFormat, ExrSample};
use luxel_metrics::FlipChoice;
use serde::Serialize;

pub(crate) use self::captures::{SupervisionArg, parse_masks};
pub(crate) use self::markers::MarkerFamilyArg;
pub(crate) use self::transfer::TransferArg;
pub(crate) use self::world::{
    LensArg, RotationArg, UpArg, parse_crop, parse_direction, parse_length, parse_point, parse_positive_f64, rotation,
};

/// `--format`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FormatArg {
    /// transforms.json of nerfstudio, instant-ngp or Blender.
    Transforms,
    /// COLMAP model in sparse/0, images in images/.
    Colmap,
    /// HDR-NeRF's synthetic scenes.
    HdrNerf,
    /// HDR-NeRF's real scenes (--supervision ldr).
    HdrNerfReal,
    /// HDR-GS's repack of the synthetic ones.
    HdrGs,
    /// GaussHDR's repack of them.
    #[value(name = "gausshdr")]
    GaussHdr,
    /// LLFF's poses_bounds.npy, images in images/.
    Llff,
    /// RealityScan's table (.csv), or XMP files beside the images.
    #[value(name = "realityscan")]
    RealityScan,
    /// Metashape's cameras (.xml).
    Metashape,
    /// Cameras of OpenUSD (.usda, .usdc, .usdz), images in images/.
    Usd,
    /// Polycam's raw data.
    Polycam,
    /// Record3D's EXR + RGB.
    #[value(name = "record3d")]
    Record3d,
}

impl From<FormatArg> for DatasetFormat {
    fn from(arg: FormatArg) -> Self {
        match arg {
            FormatArg::Transforms => Self::Transforms,
            FormatArg::Colmap => Self::Colmap,
            FormatArg::HdrNerf => Self::HdrNerf,
            FormatArg::HdrNerfReal => Self::HdrNerfReal,
            FormatArg::HdrGs => Self::HdrGs,
            FormatArg::GaussHdr => Self::GaussHdr,
            FormatArg::Llff => Self::Llff,
            FormatArg::RealityScan => Self::RealityScan,
            FormatArg::Metashape => Self::Metashape,
            FormatArg::Usd => Self::Usd,
            FormatArg::Polycam => Self::Polycam,
            FormatArg::Record3d => Self::Record3d,
        }
    }
}

/// `--input-color-space`, and `--output-color-space` of data sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ColorSpaceArg {
    /// Linear light, Rec.709 primaries.
    LinearRec709,
    /// Linear light, AP1 primaries.
    #[value(name = "acescg")]
    AcesCg,
}

impl From<ColorSpaceArg> for ColorSpace {
    fn from(arg: ColorSpaceArg) -> Self {
        match arg {
            ColorSpaceArg::LinearRec709 => Self::LinearRec709,
            ColorSpaceArg::AcesCg => Self::AcesCg,
        }
    }
}

/// `--output-color-space`, and `--input-color-space` of photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SpaceArg {
    /// Rec.709 primaries, those of sRGB; D65.
    LinearRec709,
    /// Display P3 primaries; D65.
    LinearDisplayP3,
    /// Rec.2020 primaries; D65.
    LinearRec2020,
    /// ACES2065-1: AP0 primaries.
    #[value(name = "aces2065-1")]
    Aces2065,
    /// AP1 primaries.
    #[value(name = "acescg")]
    AcesCg,
}

impl From<SpaceArg> for ColorSpace {
    fn from(arg: SpaceArg) -> Self {
        match arg {
            SpaceArg::LinearRec709 => Self::LinearRec709,
            SpaceArg::LinearDisplayP3 => Self::LinearDisplayP3,
            SpaceArg::LinearRec2020 => Self::LinearRec2020,
            SpaceArg::Aces2065 => Self::Aces2065,
            SpaceArg::AcesCg => Self::AcesCg,
        }
    }
}

/// `--split`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum SplitArg {
    /// Views trained on.
    Train,
    /// Views held out.
    #[default]
    Test,
    /// Both.
    All,
}

/// `--path`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PathArg {
    /// Around what the cameras look at: a full circle, or there and back on the side they saw.
    Orbit,
    /// Two turns about the mean camera.
    Spiral,
    /// Through all views.
    BetweenViews,
}

impl From<PathArg> for PathKind {
    fn from(arg: PathArg) -> Self {
        match arg {
            PathArg::Orbit => Self::Orbit,
            PathArg::Spiral => Self::Spiral,
            PathArg::BetweenViews => Self::BetweenViews,
        }
    }
}

/// `--exr-type`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExrTypeArg {
    /// Half, or float where a value of the image is beyond 65504.
    #[default]
    Auto,
    /// 16 bits a channel, up to 65504.
    Half,
    /// 32 bits a channel.
    Float,
}

impl ExrTypeArg {
    /// Returns the number format of an image.
    pub(crate) fn sample(self, image: &Image) -> ExrSample {
        ExrType::from(self).sample(image)
    }
}

impl From<ExrTypeArg> for ExrType {
    fn from(arg: ExrTypeArg) -> Self {
        match arg {
            ExrTypeArg::Auto => Self::Auto,
            ExrTypeArg::Half => Self::Half,
            ExrTypeArg::Float => Self::Float,
        }
    }
}

/// `--tonemap`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum TonemapArg {
    /// Clipped at 1, sRGB-encoded.
    None,
    /// The mu-law value as display value, as papers print their pictures.
    Mulaw,
    /// Y / (1 + Y) on the luminance.
    Reinhard,
    /// The ACES output transform, fitted.
    Aces,
    /// AgX: highlights go to white.
    Agx,
}

impl From<TonemapArg> for Tonemap {
    fn from(arg: TonemapArg) -> Self {
        match arg {
            TonemapArg::None => Self::None,
            TonemapArg::Mulaw => Self::Mulaw,
            TonemapArg::Reinhard => Self::Reinhard,
            TonemapArg::Aces => Self::Aces,
            TonemapArg::Agx => Self::Agx,
        }
    }
}

/// `--metrics`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MetricsArg {
    /// All but HDR-FLIP.
    Fast,
    /// All metrics; HDR-FLIP takes several times as long as the others together.
    All,
}

impl From<MetricsArg> for FlipChoice {
    fn from(arg: MetricsArg) -> Self {
        match arg {
            MetricsArg::Fast => Self::Skip,
            MetricsArg::All => Self::Compute,
        }
    }
}

/// `--order`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum OrderArg {
    /// Neighbours in space are neighbours in memory, as training keeps them.
    #[default]
    Spatial,
    /// The order of the file; that of the synthetic room is random.
    File,
}

/// `--instruction-set`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum InstructionSetArg {
    /// The best that the processor has.
    #[default]
    Best,
    /// AVX2 with FMA, also on a processor that has AVX-512.
    Avx2,
    /// Instructions that every processor of this kind has: SSE2, NEON.
    Baseline,
}

impl From<InstructionSetArg> for InstructionSet {
    fn from(arg: InstructionSetArg) -> Self {
        match arg {
            InstructionSetArg::Best => Self::Best,
            InstructionSetArg::Avx2 => Self::Avx2,
            InstructionSetArg::Baseline => Self::Baseline,
        }
    }
}

/// `--frames`: both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Frames {
    /// First.
    pub(crate) first: usize,
    /// Last.
    pub(crate) last: usize,
}

/// `--shard`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shard {
    /// 0 to `count` - 1.
    pub(crate) index: usize,
    /// At least 1.
    pub(crate) count: usize,
}

/// Parses `A-B` or `A`.
pub(crate) fn parse_frames(text: &str) -> Result<Frames, String> {
    let expected = || format!("expected two frame numbers such as 0-99, got \"{text}\"");
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let first: usize = first.trim().parse().map_err(|_| expected())?;
    let last: usize = last.trim().parse().map_err(|_| expected())?;
    if last < first {
        return Err(format!("the last frame {last} comes before the first {first}"));
    }
    Ok(Frames { first, last })
}

/// Parses `I/N`.
pub(crate) fn parse_shard(text: &str) -> Result<Shard, String> {
    let expected = || format!("expected index/count such as 0/4, got \"{text}\"");
    let (index, count) = text.split_once('/').ok_or_else(expected)?;
    let index: usize = index.trim().parse().map_err(|_| expected())?;
    let count: usize = count.trim().parse().map_err(|_| expected())?;
    if count == 0 {
        return Err(format!("{text}: expected 1 shard or more, such as 0/4"));
    }
    if index >= count {
        return Err(format!("shard {index}/{count}: the index counts from 0, so it must be below {count}"));
    }
    Ok(Shard { index, count })
}

/// Parses the factor by which `luxel prepare` reduces images: 1, 2, 4 or 8.
pub(crate) fn parse_prepared_downscale(text: &str) -> Result<u32, String> {
    match text {
        "1" => Ok(1),
        "2" => Ok(2),
        "4" => Ok(4),
        "8" => Ok(8),
        _ => Err("expected 1, 2, 4 or 8".into()),
    }
}

/// Parses a finite number.
pub(crate) fn parse_finite(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|v: &f32| v.is_finite()).ok_or_else(|| format!("expected a finite number, got \"{text}\""))
}

/// Parses a finite number above 0.
pub(crate) fn parse_positive(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|v: &f32| v.is_normal() && *v > 0.0).ok_or_else(|| format!("expected a finite number above 0, got \"{text}\""))
}

/// Parses a finite number that is not negative.
pub(crate) fn parse_zero_or_more(text: &str) -> Result<f32, String> {
    let found = text.parse().ok().filter(|v: &f32| v.is_finite() && *v >= 0.0);
    found.ok_or_else(|| format!("expected a finite number, 0 or more, got \"{text}\""))
}

/// Parses a finite number of at least 1.
pub(crate) fn parse_ratio(text: &str) -> Result<f32, String> {
    let found = text.parse().ok().filter(|v: &f32| v.is_finite() && *v >= 1.0);
    found.ok_or_else(|| format!("expected a number of at least 1, got \"{text}\""))
}

/// Parses `X,Y`, a pixel.
pub(crate) fn parse_pixel(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once(',').and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
    sides.ok_or_else(|| format!("expected column,row such as 230,180, counted from 0, got \"{text}\""))
}

/// Parses `WxH`, pixels.
pub(crate) fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let side = |text: &str| text.parse().ok().filter(|side| (1..=MAX_SIDE_PX).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| Some([side(width)?, side(height)?]));
    sides.ok_or_else(|| format!("expected width x height such as 640x480, 1 to {MAX_SIDE_PX} pixels a side, got \"{text}\""))
}

impl Frames {
    /// Returns whether frame `i` is among them.
    pub(crate) fn contains(self, i: usize) -> bool {
        (self.first..=self.last).contains(&i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_an_inclusive_range() {
        assert_eq!(parse_frames("3-7"), Ok(Frames { first: 3, last: 7 }));
        assert_eq!(parse_frames("5"), Ok(Frames { first: 5, last: 5 }));
        for bad in ["", "-", "7-3", "a-b", "1-2-3", "-1"] {
            assert!(parse_frames(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn shards_count_from_zero() {
        assert_eq!(parse_shard("0/4"), Ok(Shard { index: 0, count: 4 }));
        for bad in ["4/4", "0/0", "1", "a/2", "1/", "-1/2"] {
            assert!(parse_shard(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn sizes_and_positive_numbers_are_checked() {
        assert_eq!(parse_size("640x480"), Ok([640, 480]));
        for bad in ["640", "640x", "0x480", "640x65537", "-1x2", "1x2x3", ""] {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_positive("1e-3"), Ok(1e-3));
        for bad in ["0", "-1", "nan", "inf", "x", "1e-40"] {
            assert!(parse_positive(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn spaces_have_the_files_names() {
        for (arg, space) in SpaceArg::value_variants().iter().zip(ColorSpace::ALL) {
            assert_eq!(ColorSpace::from(*arg), space);
            assert_eq!(arg.to_possible_value().unwrap().get_name(), space.name());
        }
    }

    #[test]
    fn formats_have_the_readers_names() {
        for (arg, format) in FormatArg::value_variants().iter().zip(DatasetFormat::ALL) {
            assert_eq!(DatasetFormat::from(*arg), format);
            assert_eq!(arg.to_possible_value().unwrap().get_name(), format.name());
        }
    }

    #[test]
    fn prepared_images_are_reduced_by_powers_of_two_up_to_eight() {
        assert_eq!(["1", "2", "4", "8"].map(parse_prepared_downscale), [Ok(1), Ok(2), Ok(4), Ok(8)]);
        for bad in ["0", "3", "16", "-2", ""] {
            assert!(parse_prepared_downscale(bad).is_err(), "{bad}");
        }
    }
}

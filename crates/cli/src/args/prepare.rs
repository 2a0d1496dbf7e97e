//! `luxel prepare`.

use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, ValueEnum};
use luxel_app::prepare::{
    CameraModel, Features, KnownDistance, Mapper, Markers, Matching, OcioChoice, PrepareOptions, ProjectionChoice, ResponseChoice,
    StructureFromMotion, WhiteBalance,
};

use super::ConsoleArgs;
use crate::args::values::{ColorSpaceArg, MarkerFamilyArg, SpaceArg, TransferArg, parse_positive_f64, parse_prepared_downscale};

/// `luxel prepare`.
#[derive(Debug, Args)]
#[command(
    after_help = "You can stop it at any time; the same command continues. The guide explains each step: docs/src/guide/brackets-and-raw.md."
)]
pub(crate) struct PrepareArgs {
    /// Folder of photographs: DNG, JPEG, PNG, TIFF, DPX, or OpenEXR and Radiance HDR; or a video.
    #[arg(value_name = "PHOTOS")]
    pub(crate) photos: PathBuf,
    /// Folder for the data set.
    #[arg(long, short, value_name = "DATASET")]
    pub(crate) output: PathBuf,
    /// Projection of the photographs.
    #[arg(long, value_enum, default_value_t, help_heading = "Images")]
    pub(crate) projection: PhotoProjectionArg,
    /// Photographs that are exposures of one view: auto (by name, else by time and exposure), off,
    /// names, or a number in a row, at least 2.
    #[arg(long, default_value = "auto", value_name = "auto|off|names|N", help_heading = "Exposure")]
    pub(crate) brackets: BracketsArg,
    /// Text file of exposures that EXIF lacks or has wrong: one line per photograph with name,
    /// seconds, and optionally ISO and f-number, separated by spaces. Values left out are taken
    /// from EXIF.
    #[arg(long, value_name = "FILE", help_heading = "Exposure")]
    pub(crate) exposures: Option<PathBuf>,
    /// Response curve of developed pictures (JPEG, PNG, integer TIFF).
    #[arg(long, value_enum, default_value_t, help_heading = "Exposure")]
    pub(crate) response: ResponseArg,
    /// White balance of all RAW files: as-shot (the median of the camera's choices), the name of a
    /// photograph to take it from, or the camera's red,green,blue of white.
    #[arg(long, default_value = "as-shot", value_name = "as-shot|NAME|R,G,B", help_heading = "Colour")]
    pub(crate) white_balance: WhiteBalanceArg,
    /// Colour space of the data set's images.
    #[arg(long, value_enum, default_value_t = ColorSpaceArg::LinearRec709, value_name = "SPACE", help_heading = "Colour")]
    pub(crate) output_color_space: ColorSpaceArg,
    /// Primaries of files that do not state theirs.
    #[arg(long, value_enum, default_value_t = SpaceArg::LinearRec709, value_name = "SPACE", help_heading = "Colour")]
    pub(crate) input_color_space: SpaceArg,
    /// OpenColorIO configuration with the colour space of OpenEXR, HDR and float TIFF files.
    #[arg(long, value_name = "CONFIG", requires = "ocio_space", help_heading = "Colour")]
    pub(crate) ocio: Option<PathBuf>,
    /// Colour space of these files in the configuration; overrides what the files state.
    #[arg(long, value_name = "NAME", requires = "ocio", help_heading = "Colour")]
    pub(crate) ocio_space: Option<String>,
    /// Takes all files as light with this curve, those of plates with its primaries, whatever
    /// their files state.
    #[arg(long, value_enum, value_name = "CURVE", conflicts_with_all = ["ocio", "response"], help_heading = "Colour")]
    pub(crate) transfer: Option<TransferArg>,
    /// Part, layer or view to read of OpenEXR files that have several, names separated by /
    /// [default: the beauty pass of the first view].
    #[arg(long, value_name = "NAMES", help_heading = "Images")]
    pub(crate) layer: Option<String>,
    /// Number of frames to take of a video, the sharpest of each window of time.
    #[arg(long, default_value_t = 150, value_parser = clap::value_parser!(u32).range(2..=100_000), value_name = "N", help_heading = "Images")]
    pub(crate) frames: u32,
    /// Path of the ffmpeg program, 5.1 or newer, for videos.
    #[arg(long, default_value = "ffmpeg", value_name = "PROGRAM", help_heading = "Images")]
    pub(crate) ffmpeg: PathBuf,
    /// Reduce images this many times a side, by area average in linear light.
    #[arg(long, default_value = "1", value_parser = parse_prepared_downscale, value_name = "1|2|4|8", help_heading = "Images")]
    pub(crate) downscale: u32,
    /// Whether COLMAP finds the poses.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) sfm: SfmArg,
    /// The COLMAP program, 3.8 or newer; pycolmap or the path of a Python interpreter stands for
    /// the Python package, which is also used where there is no program colmap.
    #[arg(long, default_value = "colmap", value_name = "PROGRAM", help_heading = "Structure from motion")]
    pub(crate) colmap: PathBuf,
    /// Features that COLMAP finds in the pictures.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) features: FeaturesArg,
    /// COLMAP's way from matches to poses.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) mapper: MapperArg,
    /// Lens model; one camera for all photographs of the same camera, lens and size.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) camera_model: CameraModelArg,
    /// Which views COLMAP matches with each other.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) matching: MatchingArg,
    /// Keep COLMAP's coordinates, instead of turning the scene upright, moving the origin to where
    /// the cameras look, and scaling to metres.
    #[arg(long, conflicts_with_all = ["known_distance", "marker_size"], help_heading = "Coordinates")]
    pub(crate) keep_coordinates: bool,
    /// Distance that gives the scale: A and B are names of views, for the places of their cameras,
    /// or points x,y,z in the coordinates that the data set has without this option.
    #[arg(long, value_name = "A,B,METRES", allow_hyphen_values = true, help_heading = "Coordinates")]
    pub(crate) known_distance: Option<KnownDistance>,
    /// Edge of the black squares of AprilTags in the photographs, metres; it gives the scale. Each
    /// number may be there once, and two views have to see it.
    #[arg(long, value_name = "METRES", value_parser = parse_positive_f64, conflicts_with = "known_distance", help_heading = "Coordinates")]
    pub(crate) marker_size: Option<f64>,
    /// Family of the AprilTags.
    #[arg(long, value_enum, default_value_t, value_name = "FAMILY", requires = "marker_size", help_heading = "Coordinates")]
    pub(crate) marker_family: MarkerFamilyArg,
    /// Memory for views that are processed at the same time, GiB; one view is processed in any
    /// case, however large it is.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=4096), value_name = "GIB", help_heading = "Machine")]
    pub(crate) memory: u32,
    /// Threads [default: all cores].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(luxel::MAX_THREADS)), value_name = "N", help_heading = "Machine")]
    pub(crate) threads: Option<u32>,
    /// Output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

/// `--projection`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum PhotoProjectionArg {
    /// Equirectangular if the files say so, or if all are twice as wide as high and none states a
    /// focal length; else pinhole.
    #[default]
    Auto,
    /// Photographs of a lens.
    Pinhole,
    /// Whole panoramas, twice as wide as high.
    Equirectangular,
}

impl From<PhotoProjectionArg> for ProjectionChoice {
    fn from(arg: PhotoProjectionArg) -> Self {
        match arg {
            PhotoProjectionArg::Auto => Self::Auto,
            PhotoProjectionArg::Pinhole => Self::Pinhole,
            PhotoProjectionArg::Equirectangular => Self::Equirectangular,
        }
    }
}

/// `--brackets`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BracketsArg(pub(crate) luxel_capture::BracketRule);

impl FromStr for BracketsArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        use luxel_capture::BracketRule;
        Ok(Self(match text {
            "auto" => BracketRule::Auto,
            "off" => BracketRule::Off,
            "names" => BracketRule::Names,
            count => match count.parse() {
                Ok(count) if count >= 2 => BracketRule::Count(count),
                _ => return Err(format!("expected auto, off, names or a number from 2 on, got \"{text}\"")),
            },
        }))
    }
}

/// `--response`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ResponseArg {
    /// Recovered from brackets if there are any, else sRGB.
    #[default]
    Auto,
    /// Values are proportional to light.
    Linear,
    /// The curve of sRGB.
    Srgb,
    /// Recovered from brackets; an error without them.
    Recover,
}

impl From<ResponseArg> for ResponseChoice {
    fn from(arg: ResponseArg) -> Self {
        match arg {
            ResponseArg::Auto => Self::Auto,
            ResponseArg::Linear => Self::Linear,
            ResponseArg::Srgb => Self::Srgb,
            ResponseArg::Recover => Self::Recover,
        }
    }
}

/// `--white-balance`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum WhiteBalanceArg {
    /// The median.
    AsShot,
    /// That of a photograph.
    Photo(String),
    /// The camera's colours of white.
    Neutral([f64; 3]),
}

impl From<WhiteBalanceArg> for WhiteBalance {
    fn from(arg: WhiteBalanceArg) -> Self {
        match arg {
            WhiteBalanceArg::AsShot => Self::AsShot,
            WhiteBalanceArg::Photo(name) => Self::Photo(name),
            WhiteBalanceArg::Neutral(neutral) => Self::Neutral(neutral),
        }
    }
}

impl FromStr for WhiteBalanceArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "as-shot" {
            return Ok(Self::AsShot);
        }
        let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match numbers.map(<[f64; 3]>::try_from) {
            Some(Ok(neutral)) if neutral.iter().all(|v| v.is_finite() && *v > 0.0) => Ok(Self::Neutral(neutral)),
            Some(_) => Err(format!("expected three numbers above 0 such as 0.5,1,0.6, got \"{text}\"")),
            None if text.is_empty() => Err("expected as-shot, the name of a photograph, or three numbers".into()),
            None => Ok(Self::Photo(text.to_owned())),
        }
    }
}

/// `--sfm`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum SfmArg {
    /// COLMAP is used if it is installed.
    #[default]
    Auto,
    /// COLMAP is used; an error without it.
    Colmap,
    /// Writes radiance, proxies and the commands to run, without poses.
    Off,
}

/// `--camera-model`: COLMAP's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum CameraModelArg {
    /// One focal length.
    SimplePinhole,
    /// Two focal lengths.
    Pinhole,
    /// One focal length, one radial term.
    SimpleRadial,
    /// One focal length, two radial terms.
    #[default]
    Radial,
    /// Two focal lengths, two radial and two tangential terms.
    #[value(name = "opencv")]
    OpenCv,
}

impl From<CameraModelArg> for CameraModel {
    fn from(arg: CameraModelArg) -> Self {
        match arg {
            CameraModelArg::SimplePinhole => Self::SimplePinhole,
            CameraModelArg::Pinhole => Self::Pinhole,
            CameraModelArg::SimpleRadial => Self::SimpleRadial,
            CameraModelArg::Radial => Self::Radial,
            CameraModelArg::OpenCv => Self::OpenCv,
        }
    }
}

/// `--matching`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum MatchingArg {
    /// Exhaustive up to 200 views; above, spatial if most have GPS, else sequential.
    #[default]
    Auto,
    /// Each view with each.
    Exhaustive,
    /// Each view with the next ones by name, and every n-th view with each other.
    Sequential,
    /// Each view with the nearest ones by GPS.
    Spatial,
}

/// `--features`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum FeaturesArg {
    /// SIFT, matched by brute force.
    #[default]
    Sift,
    /// ALIKED, matched by LightGlue: COLMAP 4 with ONNX.
    Aliked,
}

impl From<FeaturesArg> for Features {
    fn from(arg: FeaturesArg) -> Self {
        match arg {
            FeaturesArg::Sift => Self::Sift,
            FeaturesArg::Aliked => Self::Aliked,
        }
    }
}

/// `--mapper`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum MapperArg {
    /// View by view.
    #[default]
    Incremental,
    /// All views at once: COLMAP 4.
    Global,
}

impl From<MapperArg> for Mapper {
    fn from(arg: MapperArg) -> Self {
        match arg {
            MapperArg::Incremental => Self::Incremental,
            MapperArg::Global => Self::Global,
        }
    }
}

impl From<MatchingArg> for Matching {
    fn from(arg: MatchingArg) -> Self {
        match arg {
            MatchingArg::Auto => Self::Auto,
            MatchingArg::Exhaustive => Self::Exhaustive,
            MatchingArg::Sequential => Self::Sequential,
            MatchingArg::Spatial => Self::Spatial,
        }
    }
}

impl From<SfmArg> for StructureFromMotion {
    fn from(arg: SfmArg) -> Self {
        match arg {
            SfmArg::Auto => Self::Auto,
            SfmArg::Colmap => Self::Colmap,
            SfmArg::Off => Self::Off,
        }
    }
}

impl PrepareArgs {
    /// Returns the library's options.
    pub(crate) fn options(&self) -> PrepareOptions {
        let ocio = self.ocio.clone().zip(self.ocio_space.clone()).map(|(config, space)| OcioChoice { config, space });
        PrepareOptions {
            projection: self.projection.into(),
            brackets: self.brackets.0,
            exposures: self.exposures.clone(),
            response: self.response.into(),
            white_balance: self.white_balance.clone().into(),
            color_space: self.output_color_space.into(),
            input_space: self.input_color_space.into(),
            ocio,
            transfer: self.transfer.map(Into::into),
            layer: self.layer.clone(),
            downscale: self.downscale,
            frames: self.frames as usize,
            ffmpeg: self.ffmpeg.clone(),
            structure_from_motion: self.sfm.into(),
            colmap: self.colmap.clone(),
            camera_model: self.camera_model.into(),
            features: self.features.into(),
            mapper: self.mapper.into(),
            matching: self.matching.into(),
            keep_coordinates: self.keep_coordinates,
            known_distance: self.known_distance.clone(),
            markers: self.marker_size.map(|edge_m| Markers { edge_m, family: self.marker_family.into() }),
            memory_bytes: u64::from(self.memory) << 30,
            ..PrepareOptions::new(&self.photos, &self.output)
        }
    }
}

#[cfg(test)]
mod tests {
    use luxel_capture::BracketRule;

    use super::*;

    #[test]
    fn brackets_are_a_word_or_a_number() {
        assert_eq!("5".parse(), Ok(BracketsArg(BracketRule::Count(5))));
        assert_eq!("names".parse(), Ok(BracketsArg(BracketRule::Names)));
        for bad in ["1", "0", "-3", "five", ""] {
            assert!(bad.parse::<BracketsArg>().is_err(), "{bad}");
        }
    }

    #[test]
    fn white_balance_is_a_word_a_name_or_numbers() {
        assert_eq!("as-shot".parse(), Ok(WhiteBalanceArg::AsShot));
        assert_eq!("0.5, 1,0.6".parse(), Ok(WhiteBalanceArg::Neutral([0.5, 1.0, 0.6])));
        assert_eq!("IMG_0007.DNG".parse(), Ok(WhiteBalanceArg::Photo("IMG_0007.DNG".into())));
        for bad in ["", "0.5,1", "1,2,-3", "nan,1,1"] {
            assert!(bad.parse::<WhiteBalanceArg>().is_err(), "{bad}");
        }
    }
}

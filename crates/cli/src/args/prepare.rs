//! `luxel prepare`.

use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, ValueEnum};
use luxel_capture::prepare::{ResponseChoice, WhiteBalance};

use super::ConsoleArgs;
use crate::args::values::{ColorSpaceArg, SpaceArg, parse_downscale};

/// `luxel prepare`.
#[derive(Debug, Args)]
#[command(
    after_help = "Stop it whenever you like: the same command goes on where it was. What it does and what it needs: docs/src/guide/brackets-and-raw.md."
)]
pub(crate) struct PrepareArgs {
    /// Folder of photographs: DNG, JPEG, PNG, TIFF, or OpenEXR and Radiance HDR.
    #[arg(value_name = "PHOTOS")]
    pub(crate) photos: PathBuf,
    /// Folder for the data set.
    #[arg(long, short, value_name = "DATASET")]
    pub(crate) output: PathBuf,
    /// Which photographs are exposures of one view: auto (by name, else by time and exposure), off,
    /// names, or how many in a row.
    #[arg(long, default_value = "auto", value_name = "auto|off|names|N", help_heading = "Exposure")]
    pub(crate) brackets: BracketsArg,
    /// Exposures that EXIF lacks or has wrong: a text file with a line for each photograph, name,
    /// seconds, ISO (optional), f-number (optional), separated by spaces. What is left out stays
    /// that of EXIF.
    #[arg(long, value_name = "FILE", help_heading = "Exposure")]
    pub(crate) exposures: Option<PathBuf>,
    /// Curve of developed pictures (JPEG, PNG, integer TIFF).
    #[arg(long, value_enum, default_value_t, help_heading = "Exposure")]
    pub(crate) response: ResponseArg,
    /// White balance of RAW files, one for the whole set: as-shot (the median of what the camera
    /// chose), the name of a photograph whose choice is taken, or the camera's red,green,blue of
    /// white.
    #[arg(long, default_value = "as-shot", value_name = "as-shot|NAME|R,G,B", help_heading = "Colour")]
    pub(crate) white_balance: WhiteBalanceArg,
    /// Space of the images of the data set.
    #[arg(long, value_enum, default_value_t = ColorSpaceArg::LinearRec709, value_name = "SPACE", help_heading = "Colour")]
    pub(crate) color_space: ColorSpaceArg,
    /// Primaries of files that do not state theirs.
    #[arg(long, value_enum, default_value_t = SpaceArg::LinearRec709, value_name = "SPACE", help_heading = "Colour")]
    pub(crate) input_space: SpaceArg,
    /// OpenColorIO configuration that has the space of OpenEXR, HDR and float TIFF files.
    #[arg(long, value_name = "CONFIG", requires = "ocio_space", help_heading = "Colour")]
    pub(crate) ocio: Option<PathBuf>,
    /// The space of the configuration that these files are in, whatever they state.
    #[arg(long, value_name = "NAME", requires = "ocio", help_heading = "Colour")]
    pub(crate) ocio_space: Option<String>,
    /// Reduce images this many times a side, by area average in linear light.
    #[arg(long, default_value = "1", value_parser = parse_downscale, value_name = "1|2|4|8", help_heading = "Images")]
    pub(crate) downscale: u32,
    /// Whether poses are found with COLMAP.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) sfm: SfmArg,
    /// COLMAP's program.
    #[arg(long, default_value = "colmap", value_name = "PROGRAM", help_heading = "Structure from motion")]
    pub(crate) colmap: PathBuf,
    /// Lens model; one camera for all photographs of the same camera, lens and size.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) camera_model: CameraModelArg,
    /// Which views are matched with each other.
    #[arg(long, value_enum, default_value_t, help_heading = "Structure from motion")]
    pub(crate) matching: MatchingArg,
    /// Memory that views under way may take together, GiB; one view is worked on however large it
    /// is.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=4096), value_name = "GIB", help_heading = "Machine")]
    pub(crate) memory: u32,
    /// Threads [default: all cores].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4096), value_name = "N", help_heading = "Machine")]
    pub(crate) threads: Option<u32>,
    /// How the command talks.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
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
    /// Found from brackets, if there are any, else sRGB.
    #[default]
    Auto,
    /// Codes are proportional to light.
    Linear,
    /// The curve of sRGB.
    Srgb,
    /// Found from brackets, or an error.
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
    /// If COLMAP is installed.
    #[default]
    Auto,
    /// With COLMAP, or an error.
    Colmap,
    /// No: radiance and pictures for structure from motion, and the commands to run.
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

impl CameraModelArg {
    /// COLMAP's name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::OpenCv => "OPENCV",
        }
    }

    /// COLMAP's parameters of a lens without distortion.
    pub(crate) fn params(self, focal_px: f64, center_px: [f64; 2]) -> String {
        let (f, [x, y]) = (focal_px, center_px);
        match self {
            Self::SimplePinhole => format!("{f},{x},{y}"),
            Self::Pinhole => format!("{f},{f},{x},{y}"),
            Self::SimpleRadial => format!("{f},{x},{y},0"),
            Self::Radial => format!("{f},{x},{y},0,0"),
            Self::OpenCv => format!("{f},{f},{x},{y},0,0,0,0"),
        }
    }
}

/// `--matching`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum MatchingArg {
    /// Exhaustive up to 200 views, else sequential.
    #[default]
    Auto,
    /// Each with each.
    Exhaustive,
    /// Each with the next ones by name.
    Sequential,
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

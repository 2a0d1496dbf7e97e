//! Options of [`prepare`](super::prepare).

use std::path::PathBuf;

use luxel_capture::BracketRule;
use luxel_capture::prepare::{PlanOptions, PrepareNote, ProjectionChoice, ResponseChoice, WhiteBalance};
use luxel_capture::world::KnownDistance;
use luxel_core::ColorSpace;
use luxel_io::Transfer;

/// Options of [`prepare`](super::prepare).
///
/// ```
/// use luxel_app::prepare::{PrepareOptions, StructureFromMotion};
///
/// let options = PrepareOptions {
///     structure_from_motion: StructureFromMotion::Off,
///     ..PrepareOptions::new("photographs", "my-images")
/// };
/// assert_eq!(options.downscale, 1);
/// ```
#[derive(Clone, Debug)]
pub struct PrepareOptions {
    /// The folder of photographs, or a video.
    pub photos: PathBuf,
    /// Number of frames to take of a video, the sharpest of each window.
    pub frames: usize,
    /// The program ffmpeg, for videos.
    pub ffmpeg: PathBuf,
    /// The folder of the data set.
    pub output: PathBuf,
    /// Whether photographs are panoramas.
    pub projection: ProjectionChoice,
    /// How photographs are grouped into brackets.
    pub brackets: BracketRule,
    /// List of exposures that replace those of EXIF.
    pub exposures: Option<PathBuf>,
    /// The response curve of developed pictures.
    pub response: ResponseChoice,
    /// The white balance of RAW files.
    pub white_balance: WhiteBalance,
    /// The colour space of the data set's images.
    pub color_space: ColorSpace,
    /// The primaries of files that do not state theirs.
    pub input_space: ColorSpace,
    /// The space of radiance files by an OpenColorIO configuration.
    pub ocio: Option<OcioChoice>,
    /// The curve of all files, which are light then; that of plates has primaries, too
    /// ([`Transfer::plate_primaries`]).
    pub transfer: Option<Transfer>,
    /// Part, layer or view of OpenEXR files that have several: [`luxel_io::ReadOptions::layer`].
    pub layer: Option<String>,
    /// Factor by which each side of the images is reduced: 1, 2, 4 or 8.
    pub downscale: u32,
    /// Whether COLMAP finds the poses.
    pub structure_from_motion: StructureFromMotion,
    /// COLMAP's program; a Python interpreter, or `pycolmap`, is the Python package.
    pub colmap: PathBuf,
    /// Features that COLMAP finds.
    pub features: Features,
    /// COLMAP's way from matches to poses.
    pub mapper: Mapper,
    /// The lens model that COLMAP fits.
    pub camera_model: CameraModel,
    /// Pairs of views that COLMAP matches.
    pub matching: Matching,
    /// Whether coordinates stay as COLMAP left them.
    pub keep_coordinates: bool,
    /// A distance that gives the scale of coordinates.
    pub known_distance: Option<KnownDistance>,
    /// Markers in the photographs that give the scale of coordinates.
    pub markers: Option<Markers>,
    /// Memory for the views in progress together, bytes. One view is developed whatever its size.
    pub memory_bytes: u64,
    /// Words a note with its remedy for the report and the observer.
    pub word_note: fn(&PrepareNote) -> String,
}

impl PrepareOptions {
    /// Returns the defaults for a folder of photographs and a folder for the data set.
    pub fn new(photos: impl Into<PathBuf>, output: impl Into<PathBuf>) -> Self {
        Self {
            photos: photos.into(),
            output: output.into(),
            frames: 150,
            ffmpeg: "ffmpeg".into(),
            projection: ProjectionChoice::Auto,
            brackets: BracketRule::Auto,
            exposures: None,
            response: ResponseChoice::Auto,
            white_balance: WhiteBalance::AsShot,
            color_space: ColorSpace::LinearRec709,
            input_space: ColorSpace::LinearRec709,
            ocio: None,
            transfer: None,
            layer: None,
            downscale: 1,
            structure_from_motion: StructureFromMotion::Auto,
            colmap: "colmap".into(),
            camera_model: CameraModel::default(),
            features: Features::default(),
            mapper: Mapper::default(),
            matching: Matching::default(),
            keep_coordinates: false,
            known_distance: None,
            markers: None,
            memory_bytes: 4 << 30,
            word_note,
        }
    }

    /// Returns the options of the plan.
    pub(super) fn plan(&self) -> PlanOptions {
        PlanOptions {
            brackets: self.brackets,
            has_exposure_list: self.exposures.is_some(),
            response: self.response,
            white_balance: self.white_balance.clone(),
            color_space: self.color_space,
            input_space: self.input_space,
            projection: self.projection,
        }
    }
}

/// Words a note in neutral terms.
fn word_note(note: &PrepareNote) -> String {
    note.remedy.as_ref().map_or_else(|| note.text.clone(), |remedy| format!("{}; {remedy}", note.text))
}

/// Markers in photographs: AprilTags (Wang and Olson 2016), each number once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Markers {
    /// Edge of the black square, metres.
    pub edge_m: f64,
    /// Their family.
    pub family: MarkerFamily,
}

/// A family of AprilTags: bits, and the least number in which two markers differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MarkerFamily {
    /// 36 bits, 11.
    #[default]
    Tag36h11,
    /// 25 bits, 9.
    Tag25h9,
    /// 16 bits, 5.
    Tag16h5,
}

/// A colour space of an OpenColorIO configuration.
#[derive(Clone, Debug)]
pub struct OcioChoice {
    /// The configuration file.
    pub config: PathBuf,
    /// The name of the space in it.
    pub space: String,
}

/// Whether COLMAP finds the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StructureFromMotion {
    /// COLMAP finds them if it is installed.
    #[default]
    Auto,
    /// COLMAP finds them; without it this is an error.
    Colmap,
    /// Nothing finds them: radiance, proxies and the commands to run are written.
    Off,
}

/// A lens model of COLMAP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraModel {
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
    OpenCv,
}

impl CameraModel {
    /// Returns COLMAP's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::OpenCv => "OPENCV",
        }
    }

    /// Returns COLMAP's parameters of a lens without distortion.
    pub(super) fn params(self, focal_px: f64, center_px: [f64; 2]) -> String {
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

/// The pairs of views that COLMAP matches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Matching {
    /// Exhaustive up to 200 views; above, spatial where most views have GPS, else sequential.
    #[default]
    Auto,
    /// Every pair.
    Exhaustive,
    /// Each view with the next ones by name, and every n-th view with each other.
    Sequential,
    /// Each view with the nearest ones by GPS.
    Spatial,
}

/// The features that COLMAP finds in pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Features {
    /// SIFT, matched by brute force.
    #[default]
    Sift,
    /// ALIKED, matched by LightGlue: COLMAP 4 with ONNX.
    Aliked,
}

/// COLMAP's way from matches to poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mapper {
    /// View by view.
    #[default]
    Incremental,
    /// All views at once (GLOMAP): COLMAP 4.
    Global,
}

/// Options of COLMAP.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionOptions {
    pub(super) features: Features,
    pub(super) mapper: Mapper,
}

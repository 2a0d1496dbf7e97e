//! The metadata and stored samples of a photograph: what file readers pass to RAW development.
//!
//! Codes are as stored, not linear. Matrices are row by row. Values that a file does not state are
//! `None`.

mod corrections;

pub use corrections::{CropRect, Gain, GainMap, GainShape, LensStep, RawCorrections, SampleRegion, Warp, WarpKind, WarpPlane};

use crate::{Chromaticities, ColorSpace};

/// Stops by which exposures that are equal may differ in EXIF, which rounds them.
pub const EQUAL_EXPOSURES_STOPS: f64 = 0.15;

/// The kind of content of a photograph's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotoKind {
    /// Sensor data.
    Raw,
    /// Integer codes of a developed picture.
    Developed,
    /// Scene-linear floats.
    Radiance,
}

/// The facts that a photograph's headers state.
#[derive(Clone, Debug, PartialEq)]
pub struct PhotoInfo {
    /// Kind of the file's content.
    pub kind: PhotoKind,
    /// Width and height as stored, pixels.
    pub size_px: [u32; 2],
    /// Facts that the camera wrote.
    pub exif: Exif,
    /// Colours and levels of a RAW file.
    pub raw: Option<RawInfo>,
    /// ICC profile of a developed picture.
    pub profile: Option<IccProfile>,
    /// CIE xy of red, green, blue and white that a developed picture states: by PNG's chunks, or by
    /// a profile of a known space.
    pub primaries: Option<Chromaticities>,
    /// Curve of a developed picture's codes, where its file states one: PNG's chunks.
    pub curve: Option<StatedCurve>,
    /// Whether the file has a gain map, which makes light beyond white of its picture.
    pub has_gain_map: bool,
}

/// A curve between codes and light that a file states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StatedCurve {
    /// Codes are proportional to light.
    Linear,
    /// IEC 61966-2-1.
    Srgb,
    /// light = code ^ exponent.
    Power(f64),
}

/// The facts that a camera wrote about a photograph (Exif).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exif {
    /// Maker of the camera.
    pub make: Option<String>,
    /// Model of the camera.
    pub model: Option<String>,
    /// Serial number of the camera's body.
    pub serial: Option<String>,
    /// Name of the lens.
    pub lens: Option<String>,
    /// Shutter time, seconds.
    pub seconds: Option<f64>,
    /// ISO speed.
    pub iso: Option<f64>,
    /// Aperture, as the f-number.
    pub f_number: Option<f64>,
    /// Seconds since 1970 by the camera's clock, with fractions if it writes them.
    pub time_s: Option<f64>,
    /// Whether the camera chose the white balance for this frame.
    pub is_white_balance_automatic: Option<bool>,
    /// Orientation of the camera, 1 to 8.
    pub orientation: Option<u16>,
    /// Focal length of the lens, millimetres.
    pub focal_mm: Option<f64>,
    /// Focal length that has the same angle of view on 36 x 24 mm, millimetres.
    pub focal_35mm: Option<f64>,
    /// Position by GPS.
    pub gps: Option<GpsPosition>,
    /// Angle of the viewing direction above the horizon, degrees; drones state that of their
    /// gimbal.
    pub pitch_deg: Option<f64>,
    /// Panorama that the file says it is.
    pub panorama: Option<StatedPanorama>,
}

/// How much of the sphere of directions an equirectangular picture shows, by its file (Google's
/// Photo Sphere XMP, OpenEXR's `envmap`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatedPanorama {
    /// All of it.
    Whole,
    /// A part of it.
    Part,
}

/// A position by GPS, on WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GpsPosition {
    /// Latitude, degrees, north is positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east is positive.
    pub longitude_deg: f64,
    /// Altitude above the sea, metres.
    pub altitude_m: Option<f64>,
}

impl Exif {
    /// Returns maker and model, which name the camera and tell it from others.
    ///
    /// ```
    /// use luxel_core::photo::Exif;
    ///
    /// let (make, model) = (Some("Nikon".into()), Some("Z 8".into()));
    /// let exif = Exif { make, model, ..Exif::default() };
    /// assert_eq!(exif.camera_name().as_deref(), Some("Nikon Z 8"));
    /// assert_eq!(Exif::default().camera_name(), None);
    /// ```
    pub fn camera_name(&self) -> Option<String> {
        let model = self.model.clone()?;
        let make = self.make.as_deref().filter(|make| !model.to_lowercase().starts_with(&make.to_lowercase()));
        Some(make.map_or(model.clone(), |make| format!("{make} {model}")))
    }
}

/// The colours and levels that a RAW file states.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawInfo {
    /// White as shot, in the camera's colours.
    pub as_shot_neutral: Option<[f64; 3]>,
    /// Temperature of the illuminant in kelvin, and camera colours from XYZ, row by row.
    pub camera_from_xyz: Vec<(f64, [f64; 9])>,
    /// XYZ at D50 from balanced camera colours, row by row; as many as above or none.
    pub d50_from_balanced: Vec<[f64; 9]>,
    /// Stops by which the camera exposed less than its ISO speed says.
    pub baseline_exposure_ev: f64,
    /// Variance of a signal s by [shot, read^2]: shot * s + read^2.
    pub noise: Option<[f64; 2]>,
    /// Corrections that the file asks for and that are applied.
    pub applied: Vec<String>,
    /// Corrections that the file asks for and that are not applied.
    pub not_applied: Vec<String>,
    /// Whether a correction moves pixels, so that the picture has no distortion of the lens.
    pub is_straightened: bool,
}

/// An ICC profile, as far as it matters for linear light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IccProfile {
    /// Name for people.
    pub name: String,
    /// Space of its primaries, if it is a known one.
    pub space: Option<ColorSpace>,
}

/// The samples of a RAW file.
#[derive(Clone, Debug, PartialEq)]
pub struct RawPixels {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Colours of the mosaic's 2x2 cell, row by row (0 red, 1 green, 2 blue); `None`: three samples
    /// per pixel.
    pub cell: Option<[u8; 4]>,
    /// Codes, `[H*W]` or `[H*W*3]`.
    pub codes: Vec<u16>,
    /// Code of no light, by place in the cell or by channel.
    pub black: [f32; 4],
    /// Code of saturation.
    pub white: f32,
    /// Corrections of the lens that the file asks for, if any.
    pub corrections: Option<RawCorrections>,
}

/// Integer samples as a file stores them.
#[derive(Clone, Debug, PartialEq)]
pub enum Codes {
    /// 8 bits.
    U8(Vec<u8>),
    /// 16 bits.
    U16(Vec<u16>),
}

impl Codes {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::U16(v) => v.len(),
        }
    }

    /// Returns whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the code of sample `i`; 0 out of range.
    #[inline]
    pub fn code(&self, i: usize) -> usize {
        match self {
            Self::U8(v) => v.get(i).map_or(0, |&c| usize::from(c)),
            Self::U16(v) => v.get(i).map_or(0, |&c| usize::from(c)),
        }
    }

    /// Returns the number of codes that a sample may have.
    pub fn levels(&self) -> usize {
        match self {
            Self::U8(_) => 1 << 8,
            Self::U16(_) => 1 << 16,
        }
    }
}

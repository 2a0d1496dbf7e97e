//! Cameras of OpenUSD: prims of type `Camera` (UsdGeomCamera) with the transforms of the prims
//! around them, each over time.
//!
//! In: a layer, as text, in the binary form or in a package. Out: cameras that can be asked at a
//! time: axes and place in the stage, focal length and shift of the principal point as shares of
//! the image's width. Focal length and apertures are in tenths of a unit, of which only quotients
//! count; where they are missing, the schema's fallbacks hold. Values between two samples are
//! interpolated linearly, before the first and behind the last they are held. Nothing is composed:
//! cameras in other layers are other programs' business (`usdcat --flatten`).
//!
//! Degenerate cases: orthographic cameras, unknown transforms and axes that are no rotation times a
//! scale are errors with the prim's path.

mod text;
mod timed;
mod transform;

use std::collections::HashMap;
use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::{DMat3, DMat4, DVec3};

use self::text::read_text;
pub(super) use self::timed::{Sample, Timed, sorted};
pub(super) use self::transform::Transform;
use super::binary;
use crate::IoError;
use crate::memory::check_memory;
use crate::read_file::{open_regular, read_file};

/// Fallbacks of the schema, tenths of a unit.
const FOCAL_LENGTH: f64 = 50.0;
const HORIZONTAL_APERTURE: f64 = 20.955;
/// Metres of a unit where the layer states none.
const METERS_PER_UNIT: f64 = 0.01;
/// Beginning of the names of operations of a transform.
pub(super) const OPERATION: &str = "xformOp:";
/// Properties of cameras that are read.
pub(super) const PROPERTIES: [&str; 8] = [
    "focalLength",
    "focusDistance",
    "horizontalAperture",
    "verticalAperture",
    "horizontalApertureOffset",
    "verticalApertureOffset",
    // Luxel's own: the size of the images in pixels, which the schema does not have.
    "luxel:width",
    "luxel:height",
];

/// The cameras of a layer.
#[derive(Clone, Debug, PartialEq)]
pub struct UsdCameras {
    /// In the order of the file.
    pub(crate) cameras: Vec<UsdCamera>,
    /// Metres of a unit.
    pub(crate) meters_per_unit: f64,
    /// Whether the layer states them.
    pub(crate) states_unit: bool,
    /// First and last time code, where the layer states them.
    pub(crate) range: [Option<f64>; 2],
    /// `Y` or `Z`.
    pub(crate) up_axis: String,
}

impl Default for UsdCameras {
    fn default() -> Self {
        Self { cameras: Vec::new(), meters_per_unit: METERS_PER_UNIT, states_unit: false, range: [None; 2], up_axis: "Y".to_owned() }
    }
}

impl UsdCameras {
    /// Takes the metres of a unit.
    pub(super) fn set_unit(&mut self, metres: f64) -> Result<(), String> {
        if !(metres.is_normal() && metres > 0.0) {
            return Err(format!("metersPerUnit is {metres}, expected a number above 0"));
        }
        self.meters_per_unit = metres;
        self.states_unit = true;
        Ok(())
    }

    /// Returns the number of cameras.
    pub fn len(&self) -> usize {
        self.cameras.len()
    }

    /// Returns whether there is none.
    pub fn is_empty(&self) -> bool {
        self.cameras.is_empty()
    }

    /// Returns the places in the stage of the cameras that can be used at a time.
    pub fn eyes_at(&self, time: Option<f64>) -> Vec<DVec3> {
        self.cameras.iter().filter_map(|camera| camera.at(time).ok()).map(|placed| placed.eye).filter(|eye| eye.is_finite()).collect()
    }
}

/// A camera over time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct UsdCamera {
    /// Path of the prim: `/World/Shot_1`.
    pub(crate) path: String,
    pub(super) properties: HashMap<String, Timed>,
    pub(super) is_orthographic: bool,
    /// Transforms of the prims around it and its own, the outermost first.
    pub(super) transforms: Vec<Transform>,
}

/// A camera at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlacedCamera {
    /// OpenGL axes: right, up, backwards.
    pub(crate) axes: DMat3,
    pub(crate) eye: DVec3,
    /// Focal length as a share of the image's width.
    pub(crate) focal: f64,
    /// Principal point from the middle, to the right and down, as a share of the image's width.
    pub(crate) shift: [f64; 2],
    /// Width of the aperture over its height, where the file states both.
    pub(crate) aspect: Option<f64>,
    /// The lens as shares of the image's height, where the file states the vertical aperture.
    pub(crate) vertical: Option<VerticalLens>,
    /// Size of the image, where the file states it: Luxel's own attributes.
    pub(crate) size_px: Option<[f64; 2]>,
    /// Distance in focus; 0, the schema's fallback, states none.
    pub(crate) focus_distance: Option<f64>,
}

/// A lens as shares of the image's height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct VerticalLens {
    /// Focal length.
    pub(crate) focal: f64,
    /// Principal point from the middle, down.
    pub(crate) shift: f64,
}

impl UsdCamera {
    /// Returns the last part of its path.
    pub(crate) fn name(&self) -> &str {
        self.path.rsplit('/').next().unwrap_or(&self.path)
    }

    /// Returns the times that have a sample of the pose or the lens, in order.
    pub(crate) fn times(&self) -> Vec<f64> {
        let of_transforms = self.transforms.iter().flat_map(Transform::values);
        let mut times: Vec<f64> = of_transforms.chain(self.properties.values()).flat_map(|v| &v.samples).map(|s| s.time).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    /// Returns the camera at a time; errors say what is wrong, without a place.
    pub(crate) fn at(&self, time: Option<f64>) -> Result<PlacedCamera, String> {
        if self.is_orthographic {
            return Err("an orthographic camera, expected a perspective one".to_owned());
        }
        let mut world_from_camera = DMat4::IDENTITY;
        for transform in &self.transforms {
            if transform.is_reset() {
                world_from_camera = DMat4::IDENTITY;
            }
            world_from_camera *= transform.matrix(time)?;
        }
        let axes = DMat3::from_mat4(world_from_camera);
        let scale = axes.determinant().cbrt();
        if !(scale.is_normal() && scale > 0.0) {
            return Err(format!("axes with determinant {}, expected a rotation and a scale", axes.determinant()));
        }
        let stated = |name: &str| self.properties.get(name).and_then(|value| value.at(time)).and_then(|values| values.first().copied());
        let property = |name: &str, fallback: f64| stated(name).unwrap_or(fallback);
        let (focal, across) = (property("focalLength", FOCAL_LENGTH), property("horizontalAperture", HORIZONTAL_APERTURE));
        if !(focal > 0.0 && across > 0.0 && (focal / across).is_normal()) {
            return Err(format!("focalLength {focal} with horizontalAperture {across}, expected numbers above 0"));
        }
        let offset = [property("horizontalApertureOffset", 0.0), property("verticalApertureOffset", 0.0)];
        let aspect = stated("horizontalAperture").zip(stated("verticalAperture")).map(|(x, y)| x / y);
        Ok(PlacedCamera {
            axes: axes * scale.recip(),
            eye: world_from_camera.w_axis.truncate(),
            focal: focal / across,
            // The aperture moves to the right and up, the principal point within it the other way.
            shift: [-offset[0] / across, offset[1] / across],
            aspect: aspect.filter(|aspect| aspect.is_finite() && *aspect > 0.0),
            vertical: stated("verticalAperture")
                .filter(|down| *down > 0.0 && (focal / down).is_normal())
                .map(|down| VerticalLens { focal: focal / down, shift: offset[1] / down }),
            focus_distance: stated("focusDistance").filter(|distance| *distance > 0.0 && distance.is_finite()),
            size_px: stated("luxel:width").zip(stated("luxel:height")).map(|(width, height)| [width, height]),
        })
    }
}

/// Decodes the cameras of a layer, text or binary, or of a package; `name` is for errors.
///
/// # Errors
/// A damaged file, or values of cameras and transforms that are not numbers.
pub fn decode_usd_cameras(name: &Path, bytes: &[u8]) -> Result<UsdCameras, IoError> {
    let invalid = |message: String| IoError::invalid(name, message);
    let layer = if bytes.starts_with(binary::PACKAGE_MAGIC) { binary::layer_in_package(bytes).map_err(invalid)? } else { bytes };
    if layer.starts_with(binary::MAGIC) { binary::read_cameras(layer).map_err(invalid) } else { read_text(name, layer) }
}

/// Reads the cameras of a layer's file.
pub(crate) fn read_cameras(path: &Path) -> Result<UsdCameras, IoError> {
    let (file, _) = open_regular(path)?;
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let is_text =
        reader.fill_buf().is_ok_and(|head| ![&binary::MAGIC[..], binary::PACKAGE_MAGIC].iter().any(|magic| head.starts_with(magic)));
    if is_text {
        return read_text(path, reader);
    }
    let bytes = read_file(path)?;
    check_memory(path, bytes.len() as u64 * 3)?;
    decode_usd_cameras(path, &bytes)
}

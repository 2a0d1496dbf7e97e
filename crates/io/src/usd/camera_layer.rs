//! Cameras of OpenUSD to render from, and the writer of such layers.
//!
//! In and out: pinhole cameras in the coordinates of a stage, world units as the layer states them.
//! A camera that moves is a shot: a camera at each whole time code of the layer's range, or of its
//! samples where the layer states none. Layers do not have the size of images: it is given, its
//! width that of the aperture, or Luxel's own attributes `luxel:width` and `luxel:height` have it.
//! Lenses are kept as quotients of 32-bit floats, as the schema has them, poses in 64 bits.
//!
//! Degenerate: cameras without a common choice, cameras that are not pinholes, and shots without
//! end are errors.

use std::fmt::Write as _;
use std::path::Path;

use glam::{DAffine3, DVec2};
use luxel_core::{Camera, CameraProjection, Distortion, MAX_SIDE_PX};

use super::cameras::{PlacedCamera, UsdCamera, UsdCameras};
use super::decode_usd_cameras;
use crate::camera_path::PathCamera;
use crate::dataset::{from_opengl, rigid};
use crate::{IoError, write_atomically};

/// Most frames of a shot.
const MAX_FRAMES: f64 = 1e5;
/// Horizontal aperture of written cameras: that of 35 mm film, metres.
const APERTURE_M: f64 = 0.036;
/// Cameras that a message lists.
const MAX_LISTED: usize = 5;

/// The cameras of a layer in its stage.
#[derive(Clone, Debug, PartialEq)]
pub struct StageCameras {
    /// Valid and undistorted; in the stage's coordinates.
    pub cameras: Vec<PathCamera>,
    /// Metres of a unit; `None` where the layer states none.
    pub metres_per_unit: Option<f64>,
    /// Whether +Z is up, else +Y.
    pub is_z_up: bool,
}

/// How the cameras of a layer are read.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageChoice<'a> {
    /// Name or path of the prim; the only one, or all that do not move, if absent.
    pub camera: Option<&'a str>,
    /// Size of the images where the layer has none.
    pub size_px: Option<[u32; 2]>,
}

/// Returns whether bytes are an OpenUSD layer, or a package.
pub fn is_usd(bytes: &[u8]) -> bool {
    bytes.starts_with(b"#usda") || bytes.starts_with(super::BINARY_MAGIC) || bytes.starts_with(super::PACKAGE_MAGIC)
}

/// Decodes the cameras of a layer; `name` is for errors.
///
/// # Errors
/// A damaged file; no camera, or several of which none is chosen; cameras that are not pinholes; a
/// size that is neither given nor stated.
pub fn decode_stage_cameras(name: &Path, bytes: &[u8], choice: StageChoice<'_>) -> Result<StageCameras, IoError> {
    let layer = decode_usd_cameras(name, bytes)?;
    let invalid = |message: String| IoError::invalid(name, message);
    let is_z_up = match layer.up_axis.as_str() {
        "Y" => false,
        "Z" => true,
        other => return Err(invalid(format!("upAxis is {other:?}, expected \"Y\" or \"Z\""))),
    };
    let mut cameras = Vec::new();
    let chosen = chosen(&layer, choice.camera).map_err(invalid)?;
    let are_unique =
        chosen.iter().enumerate().all(|(i, one)| !chosen[..i].iter().any(|other| other.name().eq_ignore_ascii_case(one.name())));
    for camera in chosen {
        let stem = if are_unique { camera.name().to_owned() } else { camera.path.trim_start_matches('/').replace('/', "_") };
        let wrong = |message: String| invalid(format!("camera {}: {message}", camera.path));
        let times = camera.times();
        if times.len() < 2 {
            cameras.push(placed(stem, camera, times.first().copied(), choice.size_px).map_err(wrong)?);
            continue;
        }
        for time in shot(&times, layer.range).map_err(wrong)? {
            let wrong = |message: String| invalid(format!("camera {} at time {time}: {message}", camera.path));
            // Whole time codes have four digits, as frames of plates do.
            let number = if time.fract() == 0.0 { format!("{time:04}") } else { format!("{time}").replace('.', "_") };
            cameras.push(placed(format!("{stem}.{number}"), camera, Some(time), choice.size_px).map_err(wrong)?);
        }
    }
    Ok(StageCameras { cameras, metres_per_unit: layer.states_unit.then_some(layer.meters_per_unit), is_z_up })
}

/// Returns the cameras that a choice means.
fn chosen<'a>(layer: &'a UsdCameras, choice: Option<&str>) -> Result<Vec<&'a UsdCamera>, String> {
    let listed = |cameras: &[&UsdCamera]| {
        let more = if cameras.len() > MAX_LISTED { ", ..." } else { "" };
        format!("{}{more}", cameras.iter().take(MAX_LISTED).map(|camera| camera.path.as_str()).collect::<Vec<_>>().join(", "))
    };
    let all: Vec<&UsdCamera> = layer.cameras.iter().collect();
    if all.is_empty() {
        return Err("no prim of type Camera, expected one; flatten the stage with `usdcat --flatten` if it is in another layer".to_owned());
    }
    let Some(wanted) = choice else {
        if all.len() > 1 && all.iter().any(|camera| camera.times().len() > 1) {
            return Err(format!("{} cameras, of which some move ({}); name the one to use", all.len(), listed(&all)));
        }
        return Ok(all);
    };
    let found: Vec<&UsdCamera> = all.iter().copied().filter(|camera| camera.path == wanted || camera.name() == wanted).collect();
    match found.len() {
        1 => Ok(found),
        0 => Err(format!("no camera {wanted:?}, expected one of {}", listed(&all))),
        n => Err(format!("{n} cameras are called {wanted:?} ({}); give the path of one", listed(&found))),
    }
}

/// Returns the times of a camera with these samples: the whole ones of the layer's range, or of
/// that of the samples; the samples where there is no whole one.
fn shot(samples: &[f64], stated: [Option<f64>; 2]) -> Result<Vec<f64>, String> {
    let first = stated[0].or(samples.first().copied()).unwrap_or(0.0).ceil();
    let last = stated[1].or(samples.last().copied()).unwrap_or(0.0).floor();
    if last - first >= MAX_FRAMES {
        return Err(format!("{} frames from time {first} to {last}, expected at most {MAX_FRAMES}", last - first + 1.0));
    }
    // Counted, since times of many digits do not grow by 1.
    let count = if last >= first { (last - first) as u32 + 1 } else { 0 };
    let whole: Vec<f64> = (0..count).map(|n| first + f64::from(n)).collect();
    Ok(if whole.is_empty() { samples.to_vec() } else { whole })
}

/// Returns the camera at a time.
fn placed(name: String, camera: &UsdCamera, time: Option<f64>, given: Option<[u32; 2]>) -> Result<PathCamera, String> {
    let PlacedCamera { axes, eye, focal, shift, aspect, vertical, size_px, focus_distance } = camera.at(time)?;
    let camera_from_world: DAffine3 = rigid(from_opengl(axes), eye)?;
    let side = |side: f64| (side.fract() == 0.0 && (1.0..=f64::from(MAX_SIDE_PX)).contains(&side)).then_some(side as u32);
    let stated = match size_px {
        Some([width, height]) => match (side(width), side(height)) {
            (Some(width), Some(height)) => Some([width, height]),
            _ => {
                return Err(format!(
                    "luxel:width and luxel:height are {width} and {height}, expected whole numbers from 1 to {MAX_SIDE_PX}"
                ));
            }
        },
        None => None,
    };
    let (size_px, lens) = match (stated, given, vertical) {
        // With its size a layer of Luxel's has the lens of both directions.
        (Some(size), _, Some(vertical)) => (size, [focal, vertical.focal]),
        (Some(size), ..) => (size, [focal, focal * f64::from(size[0]) / f64::from(size[1])]),
        (None, Some([width, height]), _) => {
            let height = aspect.map_or(height, |aspect| (f64::from(width) / aspect).round().clamp(1.0, f64::from(MAX_SIDE_PX)) as u32);
            ([width, height], [focal, focal * f64::from(width) / f64::from(height)])
        }
        (None, None, _) => {
            return Err("layers do not have the size of images; give it in pixels, or name a data set to take it from".to_owned());
        }
    };
    let size = DVec2::from(size_px.map(f64::from));
    let focal_px = DVec2::from(lens) * size;
    // The shift is a share of the width, down in the file's pixels; those of Luxel need not be
    // square.
    let down = match (stated, vertical) {
        (Some(_), Some(vertical)) => vertical.shift * size.y,
        _ => shift[1] * size.x,
    };
    let center_px = size / 2.0 + DVec2::new(shift[0] * size.x, down);
    let projection = CameraProjection::Pinhole;
    let camera = Camera { camera_from_world, focal_px, center_px, size_px, distortion: Distortion::default(), projection };
    camera.validate().map_err(|error| error.to_string())?;
    Ok(PathCamera { name, camera, focus_distance })
}

/// The prims that cameras are written as.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StageMotion {
    /// A prim for each camera.
    Still,
    /// One prim, `shot`, with a sample for each camera, at the time codes 0, 1, 2 and so on.
    Moving {
        /// Time codes of a second.
        frames_per_second: f64,
    },
}

/// Returns the text of a layer with cameras in the coordinates of a stage, in which +Y is up;
/// `name` is for errors.
///
/// # Errors
/// Cameras that are not undistorted pinholes.
pub fn stage_cameras_text(name: &Path, cameras: &StageCameras, motion: StageMotion) -> Result<String, IoError> {
    let other = cameras.cameras.iter().find(|named| !named.camera.projection.is_pinhole() || !named.camera.distortion.is_none());
    if let Some(PathCamera { name: camera, .. }) = other {
        let message = format!("{camera}: OpenUSD has pinhole cameras without distortion only, expected one; write a .json file");
        return Err(IoError::unsupported(name, message));
    }
    let (metres, doubt) = cameras.metres_per_unit.map_or((1.0, "; metersPerUnit is not measured"), |metres| (metres, ""));
    let up = if cameras.is_z_up { "Z" } else { "Y" };
    let mut text = format!("#usda 1.0\n(\n    defaultPrim = \"Cameras\"\n    doc = \"Cameras by Luxel{doubt}\"\n");
    // Writing to a string does not fail.
    if let StageMotion::Moving { frames_per_second } = motion {
        let last = cameras.cameras.len().saturating_sub(1);
        let _ = writeln!(text, "    endTimeCode = {last}\n    framesPerSecond = {frames_per_second}");
    }
    let _ = writeln!(text, "    metersPerUnit = {metres}");
    if let StageMotion::Moving { frames_per_second } = motion {
        let _ = writeln!(text, "    startTimeCode = 0\n    timeCodesPerSecond = {frames_per_second}");
    }
    let _ = writeln!(text, "    upAxis = \"{up}\"\n)\n\ndef Xform \"Cameras\"\n{{");
    match motion {
        StageMotion::Still => {
            let mut names: Vec<String> = Vec::new();
            for named in &cameras.cameras {
                let name = prim_name(&named.name, &names);
                prim(&mut text, &name, std::slice::from_ref(named), false, metres);
                names.push(name);
            }
        }
        StageMotion::Moving { .. } => prim(&mut text, "shot", &cameras.cameras, true, metres),
    }
    text.push_str("}\n");
    Ok(text)
}

/// Writes the text of [`stage_cameras_text`], whole or not at all.
///
/// # Errors
/// The same, and the file system's refusal.
pub fn write_stage_cameras(path: &Path, cameras: &StageCameras, motion: StageMotion) -> Result<(), IoError> {
    let text = stage_cameras_text(path, cameras, motion)?;
    write_atomically(path, |out| out.write_all(text.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))
}

/// Returns a prim's name: other characters become `_`, a digit at the beginning has one before it,
/// and so has a name that is taken.
fn prim_name(name: &str, taken: &[String]) -> String {
    let mut prim: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if prim.is_empty() || prim.starts_with(|c: char| c.is_ascii_digit()) {
        prim.insert(0, '_');
    }
    while taken.contains(&prim) {
        prim.push('_');
    }
    prim
}

/// The numbers of a camera's lens.
struct Lens {
    focal_length: f64,
    aperture: [f64; 2],
    offset: [f64; 2],
}

impl Lens {
    /// Returns a camera's lens for the usual aperture, in numbers that are floats of 32 bits. They
    /// are tenths of a unit of the stage, so that focus and aperture of other programs have the
    /// right size: millimetres only where a unit is a centimetre.
    fn of(camera: &Camera, metres_per_unit: f64) -> Self {
        let round = |value: f64| f64::from(value as f32);
        let [width, height] = camera.size_px.map(f64::from);
        let aperture = round(10.0 * APERTURE_M / metres_per_unit);
        let focal_length = round(aperture * camera.focal_px.x / width);
        let vertical = round(focal_length * height / camera.focal_px.y);
        let offset_x = round(aperture * (0.5 - camera.center_px.x / width));
        let offset_y = round(vertical * (camera.center_px.y / height - 0.5));
        Self { focal_length, aperture: [aperture, vertical], offset: [offset_x, offset_y] }
    }
}

/// Appends a camera, at the time codes 0, 1, 2 and so on if it moves.
fn prim(text: &mut String, name: &str, cameras: &[PathCamera], moves: bool, metres_per_unit: f64) {
    let _ = writeln!(text, "    def Camera \"{name}\"\n    {{");
    let mut property = |kind: &str, name: &str, value: &dyn Fn(&Camera) -> String| {
        let values: Vec<String> = cameras.iter().map(|named| value(&named.camera)).collect();
        write_property(&mut *text, kind, name, &values, moves);
    };
    property("float2", "clippingRange", &|_| "(0.01, 1000000)".to_owned());
    let lens = |camera: &Camera| Lens::of(camera, metres_per_unit);
    let float = |value: f64| (value as f32).to_string();
    property("float", "focalLength", &|camera| float(lens(camera).focal_length));
    property("float", "horizontalAperture", &|camera| float(lens(camera).aperture[0]));
    property("float", "horizontalApertureOffset", &|camera| float(lens(camera).offset[0]));
    property("custom int", "luxel:height", &|camera| camera.size_px[1].to_string());
    property("custom int", "luxel:width", &|camera| camera.size_px[0].to_string());
    property("float", "verticalAperture", &|camera| float(lens(camera).aperture[1]));
    property("float", "verticalApertureOffset", &|camera| float(lens(camera).offset[1]));
    property("matrix4d", "xformOp:transform", &|camera| {
        let pose = camera.camera_from_world.inverse();
        let (axes, eye) = (from_opengl(pose.matrix3), pose.translation);
        let row = |v: glam::DVec3, w: u8| format!("({}, {}, {}, {w})", v.x, v.y, v.z);
        format!("( {}, {}, {}, {} )", row(axes.x_axis, 0), row(axes.y_axis, 0), row(axes.z_axis, 0), row(eye, 1))
    });
    if let Some(distances) = cameras.iter().map(|named| named.focus_distance).collect::<Option<Vec<f64>>>() {
        let distances: Vec<String> = distances.iter().map(|distance| (*distance as f32).to_string()).collect();
        write_property(text, "float", "focusDistance", &distances, moves);
    }
    text.push_str("        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }\n\n");
}

/// Appends a property, with a sample for each camera if it moves.
fn write_property(text: &mut String, kind: &str, name: &str, values: &[String], moves: bool) {
    match values.first() {
        Some(first) if !moves || values.iter().all(|value| value == first) && !name.starts_with("xformOp") => {
            let _ = writeln!(text, "        {kind} {name} = {first}");
        }
        _ => {
            let _ = writeln!(text, "        {kind} {name}.timeSamples = {{");
            for (time, value) in values.iter().enumerate() {
                let _ = writeln!(text, "            {time}: {value},");
            }
            text.push_str("        }\n");
        }
    }
}

//! Cameras to render from: a `transforms.json` whose images need not exist, or nerfstudio's camera
//! path.
//!
//! Out: undistorted cameras (renders have no lens distortion: that of the file is left out) with
//! names for their files. Poses of both formats are camera-to-world in OpenGL axes, world units of
//! the scene. What a file leaves out comes from a default camera: the size, and in a
//! `transforms.json` without any focal length the whole lens, scaled to the file's height if it has
//! one. nerfstudio's `fov` is the full vertical angle in degrees, its pixels are square; `aspect`
//! matters only where the width is not given.

use std::collections::HashSet;
use std::path::Path;

use luxel_core::{Camera, Distortion, MAX_SIDE_PX, Remedy};
use serde_json::{Map, Value, json};

use crate::IoError;
use crate::byte_order_mark::bytes_without_mark;
use crate::camera_writer::{FOCUS_KEY, lens_fields};
use crate::dataset::{TransformsFrame, parse_transforms};
use crate::read_file::read_file;

/// Keys of a lens in `transforms.json`.
const FOCAL_KEYS: [&str; 4] = ["fl_x", "fl_y", "camera_angle_x", "camera_angle_y"];

/// A camera to render from.
#[derive(Clone, Debug, PartialEq)]
pub struct PathCamera {
    /// Unique within the file, without folders: the image's stem, or `frame_00000` where there is
    /// none.
    pub name: String,
    /// Valid and undistorted.
    pub camera: Camera,
    /// Distance along the camera's axis that is in focus, where the file states one.
    pub focus_distance: Option<f64>,
}

impl PathCamera {
    /// Returns a camera without a stated focus.
    pub fn new(name: impl Into<String>, camera: Camera) -> Self {
        Self { name: name.into(), camera, focus_distance: None }
    }
}

/// Reads the cameras of a file; `default` gives values that the file leaves out.
///
/// # Errors
/// A missing or damaged file, no cameras, a camera that cannot be used (the message names the
/// frame), or one that is not a perspective camera.
pub fn read_camera_path(path: &Path, default: Option<&Camera>) -> Result<Vec<PathCamera>, IoError> {
    decode_camera_path(path, &read_file(path)?, default)
}

/// Decodes a file's bytes as [`read_camera_path`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_camera_path`].
pub fn decode_camera_path(name: &Path, bytes: &[u8], default: Option<&Camera>) -> Result<Vec<PathCamera>, IoError> {
    if crate::usd::is_usd(bytes) {
        return Err(IoError::unsupported(
            name,
            "cameras of OpenUSD, whose axes need the scene they belong to; here a .json file is expected",
        ));
    }
    let file = File { path: name, default };
    let bytes = bytes_without_mark(bytes);
    let root = serde_json::from_slice(bytes).map_err(|e| IoError::invalid(name, format_args!("not JSON: {e}")))?;
    let Value::Object(root) = root else {
        return Err(IoError::invalid(name, "expected an object with \"frames\" (transforms.json) or \"camera_path\" (nerfstudio)"));
    };
    let cameras = match (root.contains_key("camera_path"), root.contains_key("frames")) {
        (true, _) => file.nerfstudio(&root)?,
        (false, true) => file.transforms(root)?,
        (false, false) => {
            return Err(IoError::invalid(name, "neither \"frames\" (transforms.json) nor \"camera_path\" (nerfstudio): not a camera file"));
        }
    };
    if cameras.is_empty() {
        return Err(IoError::invalid(name, "no cameras, expected at least one"));
    }
    Ok(cameras)
}

/// A file under way of being read.
struct File<'a> {
    path: &'a Path,
    default: Option<&'a Camera>,
}

impl File<'_> {
    fn invalid(&self, place: impl std::fmt::Display, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.path, format_args!("{place}: {message}"))
    }

    /// Fills in values that the file leaves to the default camera and to its frames' numbers.
    fn transforms(&self, mut root: Map<String, Value>) -> Result<Vec<PathCamera>, IoError> {
        let has_focal = |object: &Map<String, Value>| FOCAL_KEYS.iter().any(|key| object.contains_key(*key));
        let frames = root.get("frames").and_then(Value::as_array);
        let is_focal_known = has_focal(&root) || frames.is_some_and(|f| f.iter().filter_map(Value::as_object).any(has_focal));
        let default = self.default.filter(|_| !is_focal_known);
        let shared_height = root.get("h").cloned();
        let frames = root.get_mut("frames").and_then(Value::as_array_mut);
        for (i, frame) in frames.into_iter().flatten().enumerate() {
            let Some(frame) = frame.as_object_mut() else { continue };
            if !frame.contains_key("file_path") {
                frame.insert("file_path".into(), frame_name(i).into());
            }
            if let Some(default) = default {
                add_lens(frame, shared_height.as_ref(), default);
            }
        }
        self.parse(&Value::Object(root))
    }

    /// Returns the cameras of a complete `transforms.json`.
    fn parse(&self, transforms: &Value) -> Result<Vec<PathCamera>, IoError> {
        let bytes = serde_json::to_vec(transforms).map_err(|e| self.invalid("not JSON", e))?;
        let frames = parse_transforms(self.path, &bytes)?.frames;
        let names = names(&frames);
        let camera = |(i, (frame, name)): (usize, (&TransformsFrame, String))| {
            let size_px = frame.size_px().or(self.default.map(|camera| camera.size_px));
            let size_px = size_px.ok_or_else(|| {
                self.invalid(
                    format_args!("frame {i} ({:?})", frame.file_path),
                    "no \"w\" and \"h\", expected the image size in pixels; add them, or name a data set to take them from",
                )
            })?;
            let camera = frame.camera(size_px).map_err(|e| self.invalid(format_args!("frame {i} ({:?})", frame.file_path), e))?;
            let focus_distance = self.focus_distance(transforms, i)?;
            Ok(PathCamera { name, camera: Camera { distortion: Distortion::default(), ..camera }, focus_distance })
        };
        frames.iter().zip(names).enumerate().map(camera).collect()
    }

    /// Returns the focus that frame `i` states, or the file for all frames.
    fn focus_distance(&self, transforms: &Value, i: usize) -> Result<Option<f64>, IoError> {
        let of = |object: &Value| object.get(FOCUS_KEY).cloned();
        let Some(stated) = of(&transforms["frames"][i]).or_else(|| of(transforms)) else { return Ok(None) };
        let distance = stated.as_f64().filter(|distance| *distance > 0.0);
        let wrong = || {
            self.invalid(format_args!("frame {i}"), format_args!("\"{FOCUS_KEY}\" is {stated}, expected a distance above 0 in world units"))
        };
        distance.map(Some).ok_or_else(wrong)
    }

    /// Returns a camera path, by way of the equivalent `transforms.json`.
    fn nerfstudio(&self, root: &Map<String, Value>) -> Result<Vec<PathCamera>, IoError> {
        let of_path = self.lens_type("header", root)?.unwrap_or(LensType::Perspective);
        let Some(cameras) = root.get("camera_path").and_then(Value::as_array) else {
            return Err(self.invalid("\"camera_path\"", "expected a list of cameras"));
        };
        let size_px = [self.side(root, "render_width")?, self.side(root, "render_height")?];
        let frame = |(i, camera): (usize, &Value)| {
            let place = format!("camera {i}");
            let camera = camera.as_object().ok_or_else(|| self.invalid(&place, "expected an object with \"camera_to_world\""))?;
            let lens = self.lens_type(&place, camera)?.unwrap_or(of_path);
            self.nerfstudio_frame(&place, camera, lens, size_px, frame_name(i))
        };
        let frames: Vec<Value> = cameras.iter().enumerate().map(frame).collect::<Result<_, _>>()?;
        self.parse(&json!({ "frames": frames })).map_err(|mut e| {
            // The names this file has for the same things.
            e.message = e.message.replace("transform_matrix", "camera_to_world").replace("frame ", "camera ");
            e
        })
    }

    fn nerfstudio_frame(
        &self,
        place: &str,
        camera: &Map<String, Value>,
        lens: LensType,
        size_px: [Option<u32>; 2],
        name: String,
    ) -> Result<Value, IoError> {
        let matrix: Option<Vec<f64>> =
            camera.get("camera_to_world").and_then(Value::as_array).and_then(|m| m.iter().map(Value::as_f64).collect());
        let Some(matrix) = matrix.filter(|m| m.len() == 16) else {
            return Err(self.invalid(place, "\"camera_to_world\" is missing or wrong, expected a list of 16 numbers (4 rows of 4)"));
        };
        let rows: Vec<&[f64]> = matrix.chunks(4).collect();
        let [w, h] = self.render_size(place, camera, size_px)?;
        let mut frame = json!({ "file_path": name, "transform_matrix": rows, "w": w, "h": h });
        if lens == LensType::Equirectangular {
            frame["camera_model"] = "EQUIRECTANGULAR".into();
            return Ok(frame);
        }
        let fov = camera.get("fov").and_then(Value::as_f64).filter(|fov| *fov > 0.0 && *fov < 180.0);
        let fov =
            fov.ok_or_else(|| self.invalid(place, "\"fov\" is missing or wrong, expected the vertical angle of view, 0 to 180 degrees"))?;
        if lens == LensType::Fisheye {
            // Nerfstudio has the focal length of a pinhole of this angle.
            let focal_px = 0.5 * f64::from(h) / (0.5 * fov.to_radians()).tan();
            frame["camera_model"] = "OPENCV_FISHEYE".into();
            (frame["fl_x"], frame["fl_y"]) = (focal_px.into(), focal_px.into());
            return Ok(frame);
        }
        frame["camera_angle_y"] = fov.to_radians().into();
        Ok(frame)
    }

    /// Returns the size that the file states; the height alone with the camera's aspect; the
    /// default camera's.
    fn render_size(&self, place: &str, camera: &Map<String, Value>, size_px: [Option<u32>; 2]) -> Result<[u32; 2], IoError> {
        if let [Some(w), Some(h)] = size_px {
            return Ok([w, h]);
        }
        let aspect = camera.get("aspect").and_then(Value::as_f64).filter(|a| *a > 0.0);
        if let ([None, Some(h)], Some(aspect)) = (size_px, aspect) {
            let w = (f64::from(h) * aspect).round().clamp(1.0, f64::from(MAX_SIDE_PX));
            return Ok([w as u32, h]);
        }
        let message =
            "no \"render_width\" and \"render_height\", expected the image size in pixels; add them, or name a data set to take them from";
        self.default.map(|default| default.size_px).ok_or_else(|| self.invalid(place, message))
    }

    fn side(&self, root: &Map<String, Value>, key: &str) -> Result<Option<u32>, IoError> {
        let Some(value) = root.get(key) else { return Ok(None) };
        let side = value.as_f64().filter(|s| s.fract() == 0.0 && (1.0..=f64::from(MAX_SIDE_PX)).contains(s));
        let message = || format!("\"{key}\" is {value}, expected a whole number of pixels from 1 to {MAX_SIDE_PX}");
        side.map(|s| Some(s as u32)).ok_or_else(|| self.invalid("header", message()))
    }

    /// Returns the kind of lens that an object of a path states.
    fn lens_type(&self, place: &str, object: &Map<String, Value>) -> Result<Option<LensType>, IoError> {
        let Some(stated) = object.get("camera_type") else { return Ok(None) };
        let kind = stated.as_str().unwrap_or_default().to_ascii_lowercase();
        match kind.as_str() {
            "perspective" => Ok(Some(LensType::Perspective)),
            "fisheye" => Ok(Some(LensType::Fisheye)),
            "equirectangular" => Ok(Some(LensType::Equirectangular)),
            _ => {
                let message = format!("{place}: \"camera_type\" is {stated}, expected \"perspective\", \"fisheye\" or \"equirectangular\"");
                let stereo = Remedy::advice("for two eyes render panoramas as pairs");
                let remedy = Remedy::set("projection", "equirectangular").or(stereo);
                Err(IoError::unsupported(self.path, message).with_remedy(remedy))
            }
        }
    }
}

/// The lens of a camera path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LensType {
    Perspective,
    /// Equidistant.
    Fisheye,
    /// A whole panorama.
    Equirectangular,
}

/// Gives a frame the default camera's lens, scaled to the height that the frame or the file states;
/// the principal point only with the size.
fn add_lens(frame: &mut Map<String, Value>, shared_height: Option<&Value>, default: &Camera) {
    let [w, h] = default.size_px.map(f64::from);
    let height = frame.get("h").or(shared_height);
    let scale = height.and_then(Value::as_f64).map_or(1.0, |height| height / h);
    let has_height = height.is_some();
    let scaled = Camera { focal_px: default.focal_px * scale, ..default.clone() };
    for (key, value) in lens_fields(&scaled) {
        frame.entry(key).or_insert(value);
    }
    if !has_height {
        for (key, value) in [("w", w), ("h", h), ("cx", default.center_px.x), ("cy", default.center_px.y)] {
            frame.entry(key).or_insert(json!(value));
        }
    }
}

fn frame_name(index: usize) -> String {
    format!("frame_{index:05}")
}

/// Returns the stems of the images; the frames' numbers where stems are not unique or not names.
fn names(frames: &[TransformsFrame]) -> Vec<String> {
    let stems: Vec<String> = frames.iter().map(|frame| stem(&frame.file_path)).collect();
    let mut seen = HashSet::new();
    let are_usable = stems.iter().all(|stem| !stem.is_empty() && seen.insert(stem.to_lowercase()));
    if are_usable { stems } else { (0..frames.len()).map(frame_name).collect() }
}

/// Returns the last part of a path without its extension; characters that are not for file names
/// become `_`.
fn stem(file_path: &str) -> String {
    let last = file_path.rsplit(['/', '\\']).next().unwrap_or_default();
    let stem = Path::new(last).file_stem().and_then(|s| s.to_str()).unwrap_or_default();
    stem.chars().map(|c| if c.is_control() || ":*?\"<>|".contains(c) { '_' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec2, DVec3};
    use luxel_core::CameraProjection;
    use proptest::prelude::*;

    use super::*;
    use crate::IoErrorKind;

    fn decode(json: &str, default: Option<&Camera>) -> Result<Vec<PathCamera>, IoError> {
        decode_camera_path(Path::new("path.json"), json.as_bytes(), default)
    }

    fn default_camera() -> Camera {
        Camera {
            camera_from_world: DAffine3::IDENTITY,
            focal_px: DVec2::new(300.0, 310.0),
            center_px: DVec2::new(201.0, 149.0),
            size_px: [400, 300],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        }
    }

    fn transforms(shared: &str, frame: &str) -> String {
        format!(r#"{{{shared} "frames": [{{{frame} "transform_matrix": [[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]}}]}}"#)
    }

    fn nerfstudio(root: &str, camera: &str) -> String {
        format!(r#"{{{root} "camera_path": [{{"camera_to_world": [1,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1], {camera}}}]}}"#)
    }

    #[test]
    fn transforms_give_cameras_of_images_that_need_not_exist() {
        let json = transforms(r#""fl_x": 100, "w": 80, "h": 60, "k1": 0.1,"#, r#""file_path": "./images/a b.0001.exr","#);
        let cameras = decode(&json, None).unwrap();
        assert_eq!(cameras.len(), 1);
        assert_eq!(cameras[0].name, "a b.0001");
        let camera = &cameras[0].camera;
        assert_eq!((camera.focal_px, camera.center_px, camera.size_px), (DVec2::splat(100.0), DVec2::new(40.0, 30.0), [80, 60]));
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        assert_eq!(camera.forward(), DVec3::new(0.0, 0.0, -1.0));
        assert!(camera.distortion.is_none());
    }

    #[test]
    fn the_default_camera_gives_what_the_file_leaves_out() {
        let default = default_camera();
        let lens = |shared: &str| {
            let camera = decode(&transforms(shared, ""), Some(&default)).unwrap().remove(0);
            assert_eq!(camera.name, "frame_00000");
            (camera.camera.focal_px, camera.camera.center_px, camera.camera.size_px)
        };
        assert_eq!(lens(""), (default.focal_px, default.center_px, default.size_px));
        assert_eq!(lens(r#""fl_x": 50,"#), (DVec2::splat(50.0), DVec2::new(200.0, 150.0), [400, 300]));
        assert_eq!(lens(r#""w": 800, "h": 600,"#), (DVec2::new(600.0, 620.0), DVec2::new(400.0, 300.0), [800, 600]));
        let error = decode(&transforms(r#""fl_x": 50,"#, ""), None).unwrap_err().to_string();
        assert!(error.contains("frame 0 (\"frame_00000\"): no \"w\" and \"h\", expected the image size"), "{error}");
        assert!(decode(&transforms("", ""), None).unwrap_err().to_string().contains("no focal length"));
    }

    #[test]
    fn names_that_would_overwrite_one_another_become_numbers() {
        let frame = |path: &str| format!(r#"{{"file_path": "{path}", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#);
        let of = |a: &str, b: &str| {
            let json = format!(r#"{{"fl_x": 9, "w": 9, "h": 9, "frames": [{}, {}]}}"#, frame(a), frame(b));
            decode(&json, None).unwrap().into_iter().map(|c| c.name).collect::<Vec<_>>()
        };
        assert_eq!(of("x/1.exr", "x/2.exr"), ["1", "2"]);
        assert_eq!(of("left/1.exr", "right/1.exr"), ["frame_00000", "frame_00001"]);
        assert_eq!(of("A.exr", "a.exr"), ["frame_00000", "frame_00001"]);
        assert_eq!(of("..", "a.exr"), ["frame_00000", "frame_00001"]);
        assert_eq!(of("a:b.exr", "..\\\\c.exr"), ["a_b", "c"]);
    }

    #[test]
    fn nerfstudio_paths_have_a_vertical_angle_of_view() {
        let json = nerfstudio(
            r#""camera_type": "perspective", "render_width": 640, "render_height": 480, "fps": 24,"#,
            r#""fov": 90, "aspect": 1.5"#,
        );
        let cameras = decode(&json, None).unwrap();
        assert_eq!(cameras[0].name, "frame_00000");
        let camera = &cameras[0].camera;
        assert!((camera.focal_px - DVec2::splat(240.0)).length() < 1e-9, "{:?}", camera.focal_px);
        assert_eq!((camera.center_px, camera.size_px), (DVec2::new(320.0, 240.0), [640, 480]));
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        let size = |root: &str, default| decode(&nerfstudio(root, r#""fov": 90, "aspect": 1.5"#), default).map(|c| c[0].camera.size_px);
        assert_eq!(size(r#""render_height": 200,"#, None).unwrap(), [300, 200]);
        let default = default_camera();
        assert_eq!(size("", Some(&default)).unwrap(), [400, 300]);
        assert!(size("", None).unwrap_err().to_string().contains("camera 0: no \"render_width\""));
    }

    #[test]
    fn nerfstudio_paths_of_panoramas_and_fisheyes_are_read() {
        let camera = |root: &str, own: &str| {
            let json = nerfstudio(&format!(r#"{root} "render_width": 256, "render_height": 128,"#), &format!(r#"{own} "fov": 90"#));
            decode(&json, None).unwrap().remove(0).camera
        };
        let panorama = camera(r#""camera_type": "equirectangular","#, "");
        assert_eq!((panorama.projection, panorama.size_px), (CameraProjection::Equirectangular, [256, 128]));
        // The middle of the picture looks along the camera's axis.
        assert_eq!(panorama.forward(), DVec3::new(0.0, 0.0, -1.0));
        let fisheye = camera("", r#""camera_type": "fisheye","#);
        assert!(matches!(fisheye.projection, CameraProjection::Fisheye(_)) && (fisheye.focal_px.x - 64.0).abs() < 1e-9);
        // A camera's own kind goes before the path's.
        let own = camera(r#""camera_type": "equirectangular","#, r#""camera_type": "perspective","#);
        assert_eq!(own.projection, CameraProjection::Pinhole);
    }

    #[test]
    fn bad_files_are_refused_with_place_and_expectation() {
        let size = r#""render_width": 64, "render_height": 48,"#;
        let path = |root: &str, camera: &str| decode(&nerfstudio(root, camera), None).unwrap_err();
        let error = path(&format!(r#""camera_type": "omnidirectional", {size}"#), r#""fov": 90"#);
        assert_eq!(error.kind, IoErrorKind::Unsupported);
        assert!(error.message.contains("expected \"perspective\"") && error.remedy.is_some(), "{error}");
        assert!(path(size, r#""fov": 180"#).message.starts_with("camera 0: \"fov\" is missing or wrong"));
        assert!(path(r#""render_width": 0, "render_height": 48,"#, r#""fov": 90"#).message.contains("\"render_width\" is 0"));
        assert!(path(r#""render_width": 1e9, "render_height": 48,"#, r#""fov": 90"#).message.contains("from 1 to 65536"));
        let matrix = |numbers: &str| {
            let json = nerfstudio(size, r#""fov": 90"#).replace("1,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1", numbers);
            decode(&json, None).unwrap_err().message
        };
        assert!(matrix("1,0,0,1").contains("expected a list of 16 numbers"));
        assert!(matrix("null,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1").contains("expected a list of 16 numbers"));
        let error = matrix("2,0,0,1, 0,2,0,2, 0,0,2,3, 0,0,0,1");
        assert!(error.contains("camera 0") && error.contains("\"camera_to_world\" is not a rotation"), "{error}");
        let error = |json: &str| decode(json, None).unwrap_err().message;
        assert!(error("[1]").contains("expected an object"));
        assert!(error("{}").contains("neither \"frames\""));
        assert!(error("{").contains("not JSON"));
        assert!(error(&"[".repeat(200)).contains("not JSON"));
        assert!(error(r#"{"frames": []}"#).contains("no cameras"));
        assert!(error(r#"{"camera_path": 3}"#).contains("expected a list"));
        assert!(error(r#"{"camera_path": [3]}"#).contains("camera 0: expected an object"));
        assert!(read_camera_path(Path::new("."), None).is_err());
        assert_eq!(read_camera_path(Path::new("absent.json"), None).unwrap_err().kind, IoErrorKind::System);
    }

    proptest! {
        #[test]
        fn any_damage_gives_valid_cameras_or_an_error(at: prop::sample::Index, byte: u8, cut: prop::sample::Index, is_path: bool) {
            let whole = if is_path {
                nerfstudio(r#""render_width": 64, "render_height": 48,"#, r#""fov": 90"#)
            } else {
                transforms(r#""fl_x": 100, "w": 80, "h": 60,"#, r#""file_path": "a.exr","#)
            };
            let default = default_camera();
            let mut bytes = whole.into_bytes();
            prop_assert!(decode_camera_path(Path::new("p"), &bytes[..cut.index(bytes.len())], Some(&default)).is_err());
            let at = at.index(bytes.len());
            bytes[at] = byte;
            for camera in decode_camera_path(Path::new("p"), &bytes, Some(&default)).unwrap_or_default() {
                prop_assert_eq!(camera.camera.validate(), Ok(()));
                prop_assert!(!camera.name.is_empty() && !camera.name.contains(['/', '\\']));
            }
        }
    }
}

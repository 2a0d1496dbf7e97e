//! Parser of `transforms.json` (nerfstudio, instant-ngp, Blender): bytes -> frames with poses and
//! lenses. Opens no image.
//!
//! Poses are camera-to-world matrices in OpenGL axes. Lens parameters of a frame take precedence
//! over the file's, group by group: focal lengths and angles of view; the centre, which a frame of
//! another size has of its own; distortion. Understood: `fl_x fl_y cx cy w h`, `camera_angle_x
//! camera_angle_y`, `k1 k2 p1 p2`, `ply_file_path`, `applied_transform`, `applied_scale`,
//! `train_filenames`, `val_filenames`, `test_filenames`, `mask_path`; `exposure` (seconds) of
//! recorded images, `noise` or `iso` and `white` of noisy ones; lenses as [`super::lens_fields`]
//! says.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use luxel_core::{Camera, NoiseModel};
use serde_json::Value;

use super::intrinsics::Intrinsics;
use super::json_fields::{Fields, kind_of, parse_json, string_list};
use super::lens_fields::intrinsics;
use crate::IoError;

/// Most noise that is read, in radiance: far beyond any sensor's, and its square is a number.
const MAX_NOISE: f64 = 1e9;

/// A parsed `transforms.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Transforms {
    /// In the order of the file.
    pub frames: Vec<TransformsFrame>,
    /// Point cloud in the cameras' frame, relative to the file.
    pub(super) ply_file_path: Option<String>,
    /// From the frame of the reconstruction (COLMAP's points beside the file) to the cameras'
    /// frame.
    pub(super) world_from_reconstruction: DAffine3,
    /// `train_filenames`, `val_filenames`, `test_filenames`.
    pub(super) split: Option<[Vec<String>; 3]>,
}

/// A frame of [`Transforms`].
#[derive(Clone, Debug, PartialEq)]
pub struct TransformsFrame {
    /// Image as the file names it.
    pub file_path: String,
    /// Pose: rigid motion from world to camera coordinates, OpenCV axes.
    pub camera_from_world: DAffine3,
    /// Lens.
    pub(super) intrinsics: Intrinsics,
    /// Exposure, seconds.
    pub(super) exposure_s: Option<f32>,
    /// Noise of the image.
    pub(super) noise: Option<NoiseModel>,
    /// Image of weights, relative to the file.
    pub(super) mask_path: Option<String>,
}

impl TransformsFrame {
    /// Returns the image size that the frame states.
    pub fn size_px(&self) -> Option<[u32; 2]> {
        self.intrinsics.size_px
    }

    /// Returns the frame's camera for an image of `image_px` pixels (the stated size or 1/2, 1/4,
    /// 1/8 of it), lens distortion included.
    ///
    /// # Errors
    /// An explanation of what is wrong with the pose, the lens or the size.
    pub fn camera(&self, image_px: [u32; 2]) -> Result<Camera, String> {
        self.intrinsics.camera(self.camera_from_world, image_px)
    }
}

/// Parses the content of a `transforms.json`; `path` is for error messages.
///
/// ```
/// use std::path::Path;
///
/// let json = br#"{"camera_angle_x": 1.0, "frames": [{
///     "file_path": "images/000.exr",
///     "transform_matrix": [[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
/// }]}"#;
/// let transforms = luxel_io::parse_transforms(Path::new("transforms.json"), json)?;
/// let camera = transforms.frames[0].camera([400, 300])?;
/// assert_eq!(camera.eye().to_array(), [2.0, 0.0, 4.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`] and [`crate::IoErrorKind::Unsupported`], naming frame and key.
pub fn parse_transforms(path: &Path, bytes: &[u8]) -> Result<Transforms, IoError> {
    let root = parse_json(path, bytes)?;
    let Value::Object(root) = &root else {
        return Err(IoError::invalid(path, format!("the file holds {}, expected an object with \"frames\"", kind_of(&root))));
    };
    let file = Fields { path, place: String::new(), own: root, shared: None };
    let frames = match root.get("frames") {
        Some(Value::Array(frames)) => frames,
        Some(other) => return Err(file.error(format!("\"frames\" is {}, expected a list", kind_of(other)))),
        None => return Err(file.error("\"frames\" is missing, expected a list of images with poses")),
    };
    let frames = frames.iter().enumerate().map(|(i, frame)| parse_frame(&file, i, frame)).collect::<Result<Vec<_>, _>>()?;
    Ok(Transforms {
        frames,
        ply_file_path: file.string("ply_file_path")?,
        world_from_reconstruction: applied_transform(&file)?,
        split: filenames(&file)?,
    })
}

fn parse_frame(file: &Fields<'_>, index: usize, frame: &Value) -> Result<TransformsFrame, IoError> {
    let place = format!("frame {index}: ");
    let Value::Object(own) = frame else {
        return Err(file.error(format!("{place}{}, expected an object", kind_of(frame))));
    };
    let mut fields = Fields { path: file.path, place, own, shared: None };
    let file_path = fields.string("file_path")?.filter(|path| !path.is_empty());
    let Some(file_path) = file_path else {
        return Err(fields.error("\"file_path\" is missing, expected the image's path relative to this file"));
    };
    fields.place = format!("frame {index} ({file_path:?}): ");
    let Some(matrix) = own.get("transform_matrix") else {
        return Err(fields.error("\"transform_matrix\" is missing, expected the 4x4 camera-to-world matrix"));
    };
    let camera_from_world = pose(&fields, matrix)?;
    let mask_path = fields.string("mask_path")?;
    fields.shared = Some(file.own);
    Ok(TransformsFrame {
        file_path,
        camera_from_world,
        intrinsics: intrinsics(&fields)?,
        exposure_s: fields.positive("exposure")?.map(|seconds| seconds as f32),
        noise: noise(&fields)?,
        mask_path,
    })
}

/// Reads the noise as `"noise": [read, shot]` states it, or as a typical sensor has it at `"iso"`,
/// where a pixel of radiance `"white"` (1 if left out) is saturated.
fn noise(fields: &Fields<'_>) -> Result<Option<NoiseModel>, IoError> {
    let is_usable = |v: f64| (0.0..=MAX_NOISE).contains(&v);
    if let Some(value) = fields.get("noise") {
        let parts: Vec<f64> = value.as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
        return match parts.as_slice() {
            [read, shot] if is_usable(*read) && is_usable(*shot) => Ok(Some(NoiseModel { read: *read as f32, shot: *shot as f32 })),
            _ => Err(fields.error(format!(
                "\"noise\" is not [read, shot], two numbers from 0 to {MAX_NOISE:e}: the variance of radiance p is read^2 + shot p"
            ))),
        };
    }
    let white = fields.positive("white")?.unwrap_or(1.0);
    let Some(iso) = fields.positive("iso")? else { return Ok(None) };
    let model = NoiseModel::from_iso(iso, white);
    match is_usable(model.read.into()) && is_usable(model.shot.into()) {
        true => Ok(Some(model)),
        false => Err(fields.error(format!("\"iso\" {iso} with \"white\" {white} is more noise than radiance, expected a camera's"))),
    }
}

fn pose(fields: &Fields<'_>, matrix: &Value) -> Result<DAffine3, IoError> {
    let m: [[f64; 4]; 4] = fields.matrix("transform_matrix", matrix)?;
    if m[3].iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b): (&f64, f64)| (a - b).abs() > 1e-6) {
        return Err(fields.error(format!("\"transform_matrix\" row 3 is {:?}, expected [0, 0, 0, 1]", m[3])));
    }
    let rotation = DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| [m[0][c], m[1][c], m[2][c]]));
    let eye = DVec3::new(m[0][3], m[1][3], m[2][3]);
    let mut pose = Camera::pose_from_opengl(rotation, eye);
    let deviation = (pose.matrix3 * pose.matrix3.transpose() - DMat3::IDENTITY).to_cols_array();
    if deviation.iter().all(|v| v.abs() <= 1e-3) && pose.matrix3.determinant() > 0.0 {
        // One Newton step towards the nearest rotation removes the rounding of matrices written
        // with few digits. The eye stays.
        let r = pose.matrix3;
        pose.matrix3 = r * ((DMat3::IDENTITY * 3.0 - r.transpose() * r) * 0.5);
        pose.translation = -(pose.matrix3 * eye);
        return Ok(pose);
    }
    let determinant = rotation.determinant();
    Err(fields.error(format!(
        "\"transform_matrix\" is not a rotation and translation (determinant {determinant:.4}, expected 1): remove scale, shear and mirroring"
    )))
}

/// Reads `applied_scale * applied_transform`: the transform of the reconstruction before its poses
/// were written here.
fn applied_transform(file: &Fields<'_>) -> Result<DAffine3, IoError> {
    const KEY: &str = "applied_transform";
    let scale = file.number("applied_scale")?.unwrap_or(1.0);
    let Some(value) = file.get(KEY) else { return Ok(DAffine3::from_scale(DVec3::splat(scale))) };
    // Written as 3x4; some tools add the fourth row.
    let m: [[f64; 4]; 3] = match value.as_array() {
        Some(rows) if rows.len() == 4 => {
            let [a, b, c, _] = file.matrix::<4>(KEY, value)?;
            [a, b, c]
        }
        _ => file.matrix(KEY, value)?,
    };
    let matrix3 = DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| [m[0][c], m[1][c], m[2][c]]));
    let translation = DVec3::new(m[0][3], m[1][3], m[2][3]);
    Ok(DAffine3 { matrix3: matrix3 * scale, translation: translation * scale })
}

fn filenames(file: &Fields<'_>) -> Result<Option<[Vec<String>; 3]>, IoError> {
    let list = |key: &str| match file.get(key) {
        None => Ok(None),
        Some(value) => string_list(value).map(Some).map_err(|found| file.error(format!("\"{key}\" {found}"))),
    };
    let lists = [list("train_filenames")?, list("val_filenames")?, list("test_filenames")?];
    // Without a training list the others do not state what to train on.
    Ok(lists[0].is_some().then(|| lists.map(Option::unwrap_or_default)))
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use luxel_core::Distortion;

    use super::super::intrinsics::Focal;
    use super::*;
    use crate::IoErrorKind;

    const POSE: &str = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";

    fn parse(json: &str) -> Result<Transforms, IoError> {
        parse_transforms(Path::new("scene/transforms.json"), json.as_bytes())
    }

    fn with_lens(lens: &str) -> Result<Transforms, IoError> {
        parse(&format!(r#"{{{lens} "frames": [{{"file_path": "a.exr", "transform_matrix": {POSE}}}]}}"#))
    }

    fn message(result: Result<Transforms, IoError>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn lens_of_a_frame_goes_before_the_files() {
        let json = format!(
            r#"{{"fl_x": 100, "w": 80.0, "h": 60, "frames": [
                {{"file_path": "a.exr", "transform_matrix": {POSE}}},
                {{"file_path": "b.exr", "fl_x": 50, "k1": 0.1, "transform_matrix": {POSE}}}]}}"#
        );
        let frames = parse(&json).unwrap().frames;
        assert_eq!(frames[0].intrinsics.focal, Focal::Pixels(DVec2::splat(100.0)));
        assert_eq!(frames[1].intrinsics.focal, Focal::Pixels(DVec2::splat(50.0)));
        assert_eq!(frames[1].intrinsics.distortion.k1, 0.1);
        let camera = frames[0].camera([80, 60]).unwrap();
        assert_eq!(camera.eye(), DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(camera.center_px, DVec2::new(40.0, 30.0));
    }

    #[test]
    fn a_lens_is_never_mixed_from_a_frames_and_the_files_numbers() {
        let shared = r#""fl_x": 50, "fl_y": 51, "w": 64, "h": 32, "cx": 33, "cy": 15, "k1": 0.1, "k2": 0.2"#;
        let lens = |own: &str| {
            let json = format!(r#"{{{shared}, "frames": [{{"file_path": "a", {own} "transform_matrix": {POSE}}}]}}"#);
            parse(&json).unwrap().frames.remove(0).intrinsics
        };
        assert_eq!(lens("").focal, Focal::Pixels(DVec2::new(50.0, 51.0)));
        assert_eq!(lens("").center_px, [Some(33.0), Some(15.0)]);
        assert_eq!(lens(r#""fl_x": 100,"#).focal, Focal::Pixels(DVec2::splat(100.0)));
        assert_eq!(lens(r#""camera_angle_x": 1.5,"#).focal, Focal::Angle { x: Some(1.5), y: None });
        assert_eq!(lens(r#""w": 64, "h": 32,"#).center_px, [Some(33.0), Some(15.0)]);
        assert_eq!(lens(r#""w": 128, "h": 64,"#).center_px, [None, None]);
        assert_eq!(lens(r#""w": 128, "h": 64, "cx": 65,"#).center_px, [Some(65.0), None]);
        assert_eq!(lens(r#""k1": 0.3,"#).distortion, Distortion { k1: 0.3, ..Distortion::default() });
    }

    #[test]
    fn noise_without_bounds_is_an_error() {
        let noise = |own: &str| with_lens(own).map(|file| file.frames[0].noise);
        assert_eq!(noise(r#""fl_x": 9, "noise": [0.5, 0],"#).unwrap(), Some(NoiseModel { read: 0.5, shot: 0.0 }));
        assert!(message(with_lens(r#""fl_x": 9, "noise": [1e300, 0],"#)).contains("two numbers from 0 to 1e9"));
        assert!(message(with_lens(r#""fl_x": 9, "iso": 1e38, "white": 1e30,"#)).contains("expected a camera's"));
    }

    #[test]
    fn errors_name_frame_key_and_expectation() {
        let frame = |matrix: &str| parse(&format!(r#"{{"fl_x": 9, "frames": [{{"file_path": "a", "transform_matrix": {matrix}}}]}}"#));
        assert_eq!(
            message(frame("[[1,0,0,0],[0,1,0,0],[0,0,1,0]]")),
            "scene/transforms.json: frame 0 (\"a\"): \"transform_matrix\" has 3 rows, expected 4"
        );
        assert!(message(frame("[[1,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")).contains("row 0 has 3 numbers, expected 4"));
        assert!(message(frame("[[null,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")).contains("row 0 column 0 is null"));
        assert!(message(frame("[[0,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")).contains("determinant 0.0000"));
        assert!(message(frame("[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")).contains("mirroring"));
        assert!(message(frame("[[1,0,0,1e999],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")).contains("not JSON"));
        assert!(message(frame("[[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")).contains("NaN and Infinity are not JSON numbers"));
        assert!(message(parse("[]")).contains("a list, expected an object"));
        assert!(message(parse("{}")).contains("\"frames\" is missing"));
        assert!(message(parse(r#"{"frames": [3]}"#)).contains("frame 0: a number, expected an object"));
        assert!(message(parse(r#"{"frames": [{}]}"#)).contains("\"file_path\" is missing"));
        assert!(message(with_lens("")).contains("no focal length"));
        assert!(message(with_lens("\"fl_x\": 0,")).contains("focal length 0 x 0"));
        assert!(message(with_lens("\"fl_x\": null,")).contains("\"fl_x\" is null"));
        assert!(message(with_lens("\"camera_angle_x\": 0,")).contains("between 0 and pi"));
        assert!(message(with_lens("\"fl_x\": 9, \"w\": 1e12, \"h\": 3,")).contains("\"w\" is 1000000000000"));
        assert!(message(with_lens("\"fl_x\": 9, \"w\": 10,")).contains("expected both or neither"));
    }

    #[test]
    fn other_lens_models_are_unsupported_with_a_remedy() {
        for lens in ["\"fl_x\": 9, \"p3\": 0.01,", "\"fl_x\": 9, \"camera_model\": \"OMNIDIRECTIONAL\","] {
            let error = with_lens(lens).unwrap_err();
            assert_eq!(error.kind, IoErrorKind::Unsupported);
            assert!(error.message.contains("image_undistorter"), "{error}");
        }
        assert!(with_lens("\"fl_x\": 9, \"k3\": 0.0, \"camera_model\": \"OPENCV\",").is_ok());
    }

    #[test]
    fn poses_of_few_digits_become_rotations() {
        let matrix = "[[0.8660,-0.5,0,1],[0.5,0.8660,0,2],[0,0,1,3],[0,0,0,1]]";
        let json = format!(r#"{{"fl_x": 9, "frames": [{{"file_path": "a", "transform_matrix": {matrix}}}]}}"#);
        let camera = parse(&json).unwrap().frames[0].camera([4, 4]).unwrap();
        let r = camera.camera_from_world.matrix3;
        let worst = (r * r.transpose() - DMat3::IDENTITY).to_cols_array().iter().fold(0.0f64, |a, v| a.max(v.abs()));
        assert!(worst < 1e-8, "{worst}");
        assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-7);
    }

    #[test]
    fn deep_nesting_is_an_error() {
        assert!(message(parse(&"[".repeat(200))).contains("not JSON"));
    }

    #[test]
    fn applied_transform_and_scale_move_the_reconstruction() {
        let json = with_lens(r#""fl_x": 9, "applied_scale": 2, "applied_transform": [[0,1,0,0],[1,0,0,0],[0,0,-1,1]],"#).unwrap();
        assert_eq!(json.world_from_reconstruction.transform_point3(DVec3::new(1.0, 2.0, 3.0)), DVec3::new(4.0, 2.0, -4.0));
    }
}

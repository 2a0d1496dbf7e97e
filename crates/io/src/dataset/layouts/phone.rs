//! Exports of scanning apps on phones: Polycam's keyframes and Record3D's RGBD sequences. Poses are
//! ARKit's, OpenGL axes (x right, y up, z backwards) in a world whose y is up, metres.
//!
//! Polycam ("raw data"): `keyframes/corrected_images/<n>.jpg` with
//! `keyframes/corrected_cameras/<n>.json`, else `keyframes/images` with `keyframes/cameras`; a file
//! holds t_00 to t_23 (rows of the camera-to-world matrix), fx, fy, cx, cy, width, height.
//!
//! Record3D ("EXR + RGB"): `metadata.json` (or `metadata`) with `poses` (quaternion x y z w, then
//! the place), `K` (column by column), `w`, `h`, and in newer versions `perFrameIntrinsicCoeffs`
//! (fx, fy, cx, cy of each frame); images `rgb/<n>.jpg`, the pose's number n.

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec2, DVec3};
use serde_json::{Map, Value};

use crate::IoError;
use crate::dataset::Supervision;
use crate::dataset::files::{is_image, without_extension};
use crate::dataset::intrinsics::LensImage;
use crate::dataset::json_fields::{Fields, kind_of, parse_json};
use crate::dataset::posed::{CameraFile, PosedCamera, PosedLens, from_opengl, rigid};
use crate::dataset::source::DatasetSource;
use crate::lens::Lens;
use crate::read_file::read_file;

/// Polycam's folders of cameras with those of their images, best first.
const POLYCAM: [[&str; 2]; 2] = [["corrected_cameras", "corrected_images"], ["cameras", "images"]];

/// Folders of cameras and images of an export.
pub(in crate::dataset) struct PolycamFolders {
    cameras: PathBuf,
    images: PathBuf,
}

/// Returns the folders of a Polycam export at `folder`, which is the export or its `keyframes`.
pub(in crate::dataset) fn polycam_folders(folder: &Path) -> Option<PolycamFolders> {
    let roots = [folder.join("keyframes"), folder.to_path_buf()];
    let pairs = roots.iter().flat_map(|root| POLYCAM.map(|[cameras, images]| [root.join(cameras), root.join(images)]));
    pairs
        .into_iter()
        .find(|[cameras, images]| cameras.is_dir() && images.is_dir())
        .map(|[cameras, images]| PolycamFolders { cameras, images })
}

/// Returns the files of a folder with this property, sorted by name.
fn files(folder: &Path, is_one: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, IoError> {
    let system = |e: std::io::Error| IoError::system(folder, "read folder", &e);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(system)? {
        let path = entry.map_err(system)?.path();
        if path.file_name().is_some_and(|name| is_one(&name.to_string_lossy())) {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Reads a Polycam export.
pub(in crate::dataset) fn polycam_source(folder: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let Some(PolycamFolders { cameras, images }) = polycam_folders(folder) else {
        return Err(IoError::invalid(
            folder,
            "no Polycam export: expected keyframes/corrected_cameras with keyframes/corrected_images, or keyframes/cameras with keyframes/images",
        ));
    };
    let files = files(&cameras, |name| name.ends_with(".json") && !name.starts_with('.'))?;
    let posed = files.iter().map(|file| parse_polycam_camera(file, &read_file(file)?)).collect::<Result<Vec<_>, _>>()?;
    let corrected = if cameras.ends_with(POLYCAM[0][0]) { "corrected cameras" } else { "uncorrected cameras" };
    let parent = images.parent().unwrap_or(folder);
    let prefix = images.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let named = posed.into_iter().map(|camera| PosedCamera { name: format!("{prefix}/{}", camera.name), ..camera }).collect();
    let file = CameraFile { format: format!("Polycam ({corrected})"), folder: parent, path: &cameras, supervision };
    file.source(named, Vec::new())
}

/// Parses a camera of Polycam; `path` names the image, too.
///
/// # Errors
/// Text that is not JSON, and numbers that are missing or wrong.
pub fn parse_polycam_camera(path: &Path, bytes: &[u8]) -> Result<PosedCamera, IoError> {
    let root = parse_json(path, bytes)?;
    let own = object(path, &root)?;
    let fields = Fields { path, place: String::new(), own, shared: None };
    let needed = |key: &str| fields.number(key)?.ok_or_else(|| fields.error(format!("\"{key}\" is missing, expected a number")));
    let row = |r: usize| -> Result<[f64; 4], IoError> {
        let mut row = [0.0; 4];
        for (c, value) in row.iter_mut().enumerate() {
            *value = needed(&format!("t_{r}{c}"))?;
        }
        Ok(row)
    };
    let rows = [row(0)?, row(1)?, row(2)?];
    let axes = DMat3::from_cols_array_2d(&[0, 1, 2].map(|c| rows.map(|row| row[c])));
    let pose =
        rigid(from_opengl(axes), DVec3::from(rows.map(|row| row[3]))).map_err(|e| fields.error(format!("\"t_00\" to \"t_23\": {e}")))?;
    let side = |key: &str| fields.side(key)?.ok_or_else(|| fields.error(format!("\"{key}\" is missing, expected pixels")));
    let image = LensImage {
        size_px: [side("width")?, side("height")?],
        focal_px: DVec2::new(needed("fx")?, needed("fy")?),
        center_px: DVec2::new(needed("cx")?, needed("cy")?),
        lens: Lens::default(),
    };
    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(PosedCamera { name, camera_from_world: pose, lens: PosedLens::Pixels(image), place: "camera".to_owned() })
}

fn object<'a>(path: &Path, root: &'a Value) -> Result<&'a Map<String, Value>, IoError> {
    root.as_object().ok_or_else(|| IoError::invalid(path, format!("the file holds {}, expected an object", kind_of(root))))
}

/// Returns the metadata of a Record3D export at `folder`, which is the export or holds it.
pub(in crate::dataset) fn record3d_metadata(folder: &Path) -> Option<PathBuf> {
    let roots = [folder.to_path_buf(), folder.join("EXR_RGBD")];
    let is_export = |root: &&PathBuf| root.join("rgb").is_dir();
    let files = |root: &PathBuf| ["metadata.json", "metadata"].map(|name| root.join(name));
    roots.iter().filter(is_export).flat_map(files).find(|path| path.is_file())
}

/// Reads a Record3D export.
pub(in crate::dataset) fn record3d_source(folder: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let Some(path) = record3d_metadata(folder) else {
        return Err(IoError::invalid(folder, "no Record3D export: expected metadata.json beside rgb/ (export as \"EXR + RGB\")"));
    };
    let scene = path.parent().unwrap_or(folder);
    let cameras = parse_record3d(&path, &read_file(&path)?)?;
    let images = files(&scene.join("rgb"), |name| is_image(name) && !name.starts_with('.'))?;
    let mut posed = Vec::with_capacity(images.len());
    for image in &images {
        let name = image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let number: Option<usize> = without_extension(&name).parse().ok();
        let Some(camera) = number.and_then(|number| cameras.get(number)) else {
            let count = cameras.len();
            return Err(IoError::invalid(
                image,
                format!("the name is not the number of a pose, expected 0 to {}", count.saturating_sub(1)),
            ));
        };
        posed.push(PosedCamera { name: format!("rgb/{name}"), ..camera.clone() });
    }
    let missing = cameras.len().saturating_sub(posed.len());
    let warning = (missing > 0).then(|| format!("{missing} of {} poses have no image in rgb/", cameras.len()));
    let file = CameraFile { format: "Record3D".to_owned(), folder: scene, path: &path, supervision };
    file.source(posed, warning.into_iter().collect())
}

/// Parses the metadata of Record3D: a camera for each pose, named by its number.
///
/// # Errors
/// Text that is not JSON, and lists that are missing, of another length, or not of numbers.
pub fn parse_record3d(path: &Path, bytes: &[u8]) -> Result<Vec<PosedCamera>, IoError> {
    let root = parse_json(path, bytes)?;
    let own = object(path, &root)?;
    let fields = Fields { path, place: String::new(), own, shared: None };
    let side = |key: &str| fields.side(key)?.ok_or_else(|| fields.error(format!("\"{key}\" is missing, expected pixels")));
    let size_px = [side("w")?, side("h")?];
    let [fx, _, _, _, fy, _, cx, cy, _] = list::<9>(&fields, "K", own.get("K").unwrap_or(&Value::Null))?;
    let rows = |key: &str| match own.get(key) {
        None => Ok(None),
        Some(Value::Array(rows)) => Ok(Some(rows)),
        Some(other) => Err(fields.error(format!("\"{key}\" is {}, expected a list", kind_of(other)))),
    };
    let Some(poses) = rows("poses")? else { return Err(fields.error("\"poses\" is missing, expected a list of poses")) };
    let own_lens = rows("perFrameIntrinsicCoeffs")?;
    if let Some(lenses) = own_lens.filter(|lenses| lenses.len() != poses.len()) {
        let (found, expected) = (lenses.len(), poses.len());
        return Err(fields.error(format!("\"perFrameIntrinsicCoeffs\" has {found} entries, expected {expected}, one for each pose")));
    }
    let mut cameras = Vec::with_capacity(poses.len());
    for (i, value) in poses.iter().enumerate() {
        let place = format!("pose {i}");
        let [x, y, z, w, ex, ey, ez] = list(&fields, &place, value)?;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        if !(0.5..=2.0).contains(&rotation.length()) {
            return Err(fields.error(format!("{place}: quaternion of length {}, expected 1", rotation.length())));
        }
        let axes = DMat3::from_quat(rotation.normalize());
        let pose = rigid(from_opengl(axes), DVec3::new(ex, ey, ez)).map_err(|e| fields.error(format!("{place}: {e}")))?;
        let [fx, fy, cx, cy] = match own_lens.and_then(|lenses| lenses.get(i)) {
            Some(lens) => list(&fields, &format!("perFrameIntrinsicCoeffs {i}"), lens)?,
            None => [fx, fy, cx, cy],
        };
        let image = LensImage { size_px, focal_px: DVec2::new(fx, fy), center_px: DVec2::new(cx, cy), lens: Lens::default() };
        cameras.push(PosedCamera { name: i.to_string(), camera_from_world: pose, lens: PosedLens::Pixels(image), place });
    }
    Ok(cameras)
}

/// Returns a list of `N` finite numbers.
fn list<const N: usize>(fields: &Fields<'_>, what: &str, value: &Value) -> Result<[f64; N], IoError> {
    let numbers: Option<Vec<f64>> = value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
    let numbers = numbers.and_then(|numbers| <[f64; N]>::try_from(numbers).ok()).filter(|list| list.iter().all(|v| v.is_finite()));
    numbers.ok_or_else(|| fields.error(format!("{what} is {}, expected a list of {N} numbers", kind_of(value))))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const POLYCAM: &str = r#"{"fx": 50.5, "fy": 51, "cx": 20, "cy": 14.5, "width": 40, "height": 30, "blur_score": 9.1,
        "t_00": 0, "t_01": 0, "t_02": 1, "t_03": 1, "t_10": 0, "t_11": 1, "t_12": 0, "t_13": 2, "t_20": -1, "t_21": 0, "t_22": 0, "t_23": 3}"#;

    const RECORD3D: &str = r#"{"w": 40, "h": 30, "fps": 60, "K": [50.5, 0, 0, 0, 51, 0, 20, 14.5, 1],
        "poses": [[0, 0, 0, 1, 1, 2, 3], [0, 0.7071067811865476, 0, 0.7071067811865476, 1, 2, 3]], "initPose": [0, 0, 0, 1, 0, 0, 0]}"#;

    /// Checks where a camera sees a point.
    fn check(camera: &PosedCamera) {
        let seen = camera.camera([40, 30]).unwrap();
        assert!(seen.eye().distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-12);
        // Turned a quarter to the left, the camera looks along -x; its right is -z, its up y.
        let (px, depth) = seen.project(DVec3::new(-1.0, 2.5, 2.6)).unwrap();
        assert!((depth - 2.0).abs() < 1e-12);
        assert!(px.distance(DVec2::new(20.0 + 50.5 * 0.2, 14.5 - 51.0 * 0.25)) < 1e-9, "{px}");
    }

    #[test]
    fn points_land_where_the_phones_saw_them() {
        let polycam = parse_polycam_camera(Path::new("keyframes/cameras/17.json"), POLYCAM.as_bytes()).unwrap();
        assert_eq!(polycam.name, "17");
        check(&polycam);
        let cameras = parse_record3d(Path::new("metadata.json"), RECORD3D.as_bytes()).unwrap();
        check(&cameras[1]);
        let own = RECORD3D.replace("\"fps\": 60", "\"perFrameIntrinsicCoeffs\": [[50.5, 51, 20, 14.5], [60, 61, 21, 15]]");
        let camera = parse_record3d(Path::new("metadata.json"), own.as_bytes()).unwrap()[1].camera([40, 30]).unwrap();
        assert_eq!((camera.focal_px, camera.center_px), (DVec2::new(60.0, 61.0), DVec2::new(21.0, 15.0)));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let polycam = |from: &str, to: &str| {
            assert!(POLYCAM.contains(from));
            parse_polycam_camera(Path::new("1.json"), POLYCAM.replace(from, to).as_bytes()).unwrap_err().message
        };
        assert!(polycam("\"t_03\": 1, ", "").contains("\"t_03\" is missing"));
        assert!(polycam("\"t_11\": 1", "\"t_11\": 2").contains("not a rotation"));
        assert!(polycam("\"width\": 40", "\"width\": 40.5").contains("\"width\" is 40.5"));
        assert!(polycam("\"fx\": 50.5", "\"fx\": null").contains("\"fx\" is null"));
        let record3d = |from: &str, to: &str| {
            assert!(RECORD3D.contains(from));
            parse_record3d(Path::new("metadata.json"), RECORD3D.replace(from, to).as_bytes()).unwrap_err().message
        };
        assert!(record3d("[0, 0, 0, 1, 1, 2, 3]", "[0, 0, 0, 0, 1, 2, 3]").contains("pose 0: quaternion of length 0"));
        assert!(record3d("[0, 0, 0, 1, 1, 2, 3]", "[0, 0, 0, 1]").contains("pose 0 is a list, expected a list of 7 numbers"));
        assert!(record3d("\"K\"", "\"k\"").contains("K is null, expected a list of 9"));
        assert!(record3d("\"poses\"", "\"pose\"").contains("\"poses\" is missing"));
        assert!(record3d("\"fps\": 60", "\"perFrameIntrinsicCoeffs\": []").contains("has 0 entries, expected 2"));
        assert!(parse_record3d(Path::new("m"), b"[]").unwrap_err().message.contains("a list, expected an object"));
    }

    proptest! {
        #[test]
        fn damage_gives_cameras_or_errors(at: prop::sample::Index, byte: u8) {
            for whole in [POLYCAM, RECORD3D] {
                let mut bytes = whole.as_bytes().to_vec();
                let at = at.index(bytes.len());
                bytes[at] = byte;
                let found = parse_record3d(Path::new("m"), &bytes).unwrap_or_default().into_iter();
                for camera in found.chain(parse_polycam_camera(Path::new("p"), &bytes).ok()) {
                    let _ = camera.camera([40, 30]);
                }
            }
        }
    }
}

//! One pinhole camera from a JSON object, as workloads for measuring have it.
//!
//! In: `width` and `height` (pixels), `fx`, `fy`, `cx`, `cy` (pixels, the centre from the image's
//! top left corner, pixel centres at +0.5), `world_to_camera` (four rows of four numbers, OpenCV
//! axes: x right, y down, z forward). Other keys are notes of the program that wrote the file and
//! are left out. Out: a valid camera without distortion.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Distortion, MAX_SIDE_PX};
use serde_json::{Map, Value};

use crate::IoError;
use crate::byte_order_mark::bytes_without_mark;
use crate::read_file::read_file;

/// Reads a camera file.
///
/// # Errors
/// A missing or damaged file, a number that is missing or out of range, a pose that is not a rigid
/// motion.
pub fn read_pinhole_camera(path: &Path) -> Result<Camera, IoError> {
    decode_pinhole_camera(path, &read_file(path)?)
}

/// Decodes a file's bytes as [`read_pinhole_camera`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_pinhole_camera`].
pub fn decode_pinhole_camera(name: &Path, bytes: &[u8]) -> Result<Camera, IoError> {
    let bytes = bytes_without_mark(bytes);
    let root = serde_json::from_slice(bytes).map_err(|e| IoError::invalid(name, format_args!("not JSON: {e}")))?;
    let Value::Object(root) = root else {
        return Err(IoError::invalid(
            name,
            format_args!("found {}, expected an object with \"width\", \"fx\" and so on", told(Some(&root))),
        ));
    };
    let file = File { name, root };
    let side = |key| {
        let is_side = |v: f64| v.fract() == 0.0 && (1.0..=f64::from(MAX_SIDE_PX)).contains(&v);
        file.number(key, &format!("a whole number of pixels from 1 to {MAX_SIDE_PX}"), is_side)
    };
    let focal = |key| file.number(key, "a focal length in pixels, above 0", |v| v > 0.0);
    let center = |key| file.number(key, "a coordinate of the principal point in pixels", |_| true);
    let camera = Camera {
        size_px: [side("width")? as u32, side("height")? as u32],
        focal_px: DVec2::new(focal("fx")?, focal("fy")?),
        center_px: DVec2::new(center("cx")?, center("cy")?),
        camera_from_world: file.pose()?,
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    };
    // Numbers were checked one by one; the pose remains.
    camera.validate().map_err(|e| IoError::invalid(name, format_args!("\"{POSE}\": {e}")))?;
    Ok(camera)
}

const POSE: &str = "world_to_camera";

/// A file under way of being read.
struct File<'a> {
    name: &'a Path,
    root: Map<String, Value>,
}

impl File<'_> {
    /// Returns a finite number that is as `expected`.
    fn number(&self, key: &str, expected: &str, is_expected: impl Fn(f64) -> bool) -> Result<f64, IoError> {
        let value = self.root.get(key);
        let number = value.and_then(Value::as_f64).filter(|v| v.is_finite() && is_expected(*v));
        number.ok_or_else(|| IoError::invalid(self.name, format_args!("\"{key}\" is {}, expected {expected}", told(value))))
    }

    fn pose(&self) -> Result<DAffine3, IoError> {
        let invalid = |message: String| IoError::invalid(self.name, format_args!("\"{POSE}\" {message}"));
        let Some(Value::Array(rows)) = self.root.get(POSE) else {
            return Err(invalid(format!("is {}, expected 4 rows of 4 numbers", told(self.root.get(POSE)))));
        };
        let mut matrix = [[0.0; 4]; 4];
        if rows.len() != 4 {
            return Err(invalid(format!("has {} rows, expected 4 rows of 4 numbers", rows.len())));
        }
        for (i, (row, out)) in rows.iter().zip(&mut matrix).enumerate() {
            let Value::Array(row) = row else { return Err(invalid(format!("row {i} is {}, expected 4 numbers", told(Some(row))))) };
            if row.len() != 4 {
                return Err(invalid(format!("row {i} has {} entries, expected 4 numbers", row.len())));
            }
            for (j, (value, out)) in row.iter().zip(out).enumerate() {
                let number = value.as_f64().filter(|v| v.is_finite());
                *out = number.ok_or_else(|| invalid(format!("row {i} column {j} is {}, expected a number", told(Some(value)))))?;
            }
        }
        let [x, y, z, last] = matrix;
        if last != [0.0, 0.0, 0.0, 1.0] {
            return Err(invalid(format!("row 3 is {last:?}, expected 0 0 0 1: write the matrix row by row")));
        }
        let row = |[a, b, c, _]: [f64; 4]| DVec3::new(a, b, c);
        let rotation = DMat3::from_cols(row(x), row(y), row(z)).transpose();
        Ok(DAffine3 { matrix3: rotation, translation: DVec3::new(x[3], y[3], z[3]) })
    }
}

/// Returns a value as an error message shows it.
fn told(value: Option<&Value>) -> String {
    match value {
        None => "missing".into(),
        Some(Value::Null) => "null".into(),
        Some(Value::Bool(value)) => value.to_string(),
        Some(Value::Number(number)) => number.to_string(),
        Some(Value::String(_)) => "a text".into(),
        Some(Value::Array(_)) => "a list".into(),
        Some(Value::Object(_)) => "an object".into(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::IoErrorKind;

    const WHOLE: &str = r#"{"width": 40, "height": 30, "fx": 50.5, "fy": 51, "cx": 20, "cy": 14.5, "near": 0.01,
        "world_to_camera": [[0, 0, -1, 4], [0, 1, 0, 5], [1, 0, 0, 6], [0, 0, 0, 1]]}"#;

    fn decode(json: &str) -> Result<Camera, IoError> {
        decode_pinhole_camera(Path::new("camera.json"), json.as_bytes())
    }

    #[test]
    fn camera_stands_as_the_file_says() {
        let camera = decode(WHOLE).unwrap();
        assert_eq!((camera.size_px, camera.focal_px, camera.center_px), ([40, 30], DVec2::new(50.5, 51.0), DVec2::new(20.0, 14.5)));
        // A row is a camera axis in the world.
        assert_eq!(camera.camera_from_world.transform_point3(DVec3::new(1.0, 2.0, 3.0)), DVec3::new(1.0, 7.0, 7.0));
        assert_eq!(camera.forward(), DVec3::X);
        assert_eq!(decode(&format!("\u{feff}{WHOLE}")).unwrap(), camera);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (from, to, part) in [
            ("\"width\": 40, ", "", "\"width\" is missing, expected a whole number of pixels"),
            ("\"width\": 40", "\"width\": 40.5", "\"width\" is 40.5"),
            ("\"height\": 30", "\"height\": 0", "\"height\" is 0"),
            ("\"height\": 30", "\"height\": 1e9", "from 1 to 65536"),
            ("\"fx\": 50.5", "\"fx\": -1", "\"fx\" is -1, expected a focal length"),
            ("\"fy\": 51", "\"fy\": \"51\"", "\"fy\" is a text"),
            ("\"cx\": 20", "\"cx\": null", "\"cx\" is null"),
            ("[0, 1, 0, 5], ", "", "has 3 rows, expected 4"),
            ("[0, 1, 0, 5]", "[0, 1, 0]", "row 1 has 3 entries"),
            ("[0, 1, 0, 5]", "7", "row 1 is 7, expected 4 numbers"),
            ("[0, 1, 0, 5]", "[0, 1, [], 5]", "row 1 column 2 is a list"),
            ("[0, 1, 0, 5]", "[0, 2, 0, 5]", "not a rotation"),
            ("[0, 0, 0, 1]", "[4, 5, 6, 1]", "row by row"),
            ("\"world_to_camera\"", "\"camera_to_world\"", "\"world_to_camera\" is missing"),
        ] {
            let json = WHOLE.replace(from, to);
            assert_ne!(json, WHOLE, "{from}");
            let error = decode(&json).unwrap_err();
            assert!(error.message.contains(part) && error.kind == IoErrorKind::Invalid, "{part}: {error}");
        }
        assert!(decode("[1]").unwrap_err().message.contains("found a list, expected an object"));
        assert!(decode("").unwrap_err().message.contains("not JSON"));
        assert!(decode(&"[".repeat(200)).unwrap_err().message.contains("not JSON"));
        assert_eq!(read_pinhole_camera(Path::new("absent.json")).unwrap_err().kind, IoErrorKind::System);
    }

    proptest! {
        #[test]
        fn any_damage_gives_a_valid_camera_or_an_error(at: prop::sample::Index, byte: u8, cut: prop::sample::Index) {
            let mut bytes = WHOLE.as_bytes().to_vec();
            prop_assert!(decode_pinhole_camera(Path::new("c"), &bytes[..cut.index(bytes.len())]).is_err());
            let at = at.index(bytes.len());
            bytes[at] = byte;
            if let Ok(camera) = decode_pinhole_camera(Path::new("c"), &bytes) {
                prop_assert_eq!(camera.validate(), Ok(()));
            }
        }
    }
}

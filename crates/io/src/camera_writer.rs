//! Writer of camera files that [`crate::read_camera_path`] reads: a `transforms.json` without
//! images.
//!
//! In: undistorted cameras, world of the data set. Out: each frame has its own lens and size, poses
//! are camera-to-world in OpenGL axes. Numbers are written so that they are read to the same bits,
//! but for rounding in the inversion of poses.

use std::f64::consts::PI;
use std::path::Path;

use luxel_core::{Camera, CameraProjection};
use serde_json::{Value, json};

use crate::{IoError, PathCamera, write_atomically};

/// Key of the distance that is in focus: Luxel's own.
pub(crate) const FOCUS_KEY: &str = "focus_distance";

/// Returns the text of a camera file.
///
/// ```
/// use luxel_core::synthetic::room_camera;
/// use luxel_io::{PathCamera, camera_file_text, decode_camera_path};
///
/// let cameras = [PathCamera::new("frame_00000", room_camera([64, 48]))];
/// let text = camera_file_text(&cameras);
/// let read = decode_camera_path("path.json".as_ref(), text.as_bytes(), None)?;
/// assert_eq!((read[0].name.as_str(), read[0].camera.size_px), ("frame_00000", [64, 48]));
/// # Ok::<(), luxel_io::IoError>(())
/// ```
pub fn camera_file_text(cameras: &[PathCamera]) -> String {
    let frames: Vec<Value> = cameras.iter().map(frame).collect();
    format!("{:#}\n", json!({ "camera_model": "OPENCV", "frames": frames }))
}

/// Writes a camera file.
///
/// # Errors
/// The file system's refusal.
pub fn write_cameras(path: &Path, cameras: &[PathCamera]) -> Result<(), IoError> {
    let text = camera_file_text(cameras);
    write_atomically(path, |out| out.write_all(text.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))
}

fn frame(PathCamera { name, camera, focus_distance }: &PathCamera) -> Value {
    let world_from_camera = camera.camera_from_world.matrix3.transpose();
    let (right, down, forward, eye) = (world_from_camera.x_axis, world_from_camera.y_axis, world_from_camera.z_axis, camera.eye());
    let row = |i: usize| [right[i], -down[i], -forward[i], eye[i]];
    let [w, h] = camera.size_px;
    let mut frame = json!({
        "file_path": name,
        "cx": camera.center_px.x, "cy": camera.center_px.y,
        "w": w, "h": h,
        "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
    });
    for (key, value) in lens_fields(camera) {
        frame[key] = value;
    }
    if let Some(distance) = focus_distance {
        frame[FOCUS_KEY] = json!(distance);
    }
    frame
}

/// Returns the fields of a frame of `transforms.json` that describe focal lengths and projection.
pub fn lens_fields(camera: &Camera) -> Vec<(&'static str, Value)> {
    // nerfstudio's focal length of a panorama is the pixels of half a turn.
    let focal_px = camera.focal_px * if camera.projection == CameraProjection::Equirectangular { PI } else { 1.0 };
    let mut fields = vec![("fl_x", json!(focal_px.x)), ("fl_y", json!(focal_px.y))];
    match camera.projection {
        CameraProjection::Pinhole => {}
        CameraProjection::Fisheye(lens) => {
            fields.push(("camera_model", json!("OPENCV_FISHEYE")));
            fields.extend(["k1", "k2", "k3", "k4"].into_iter().zip(lens.coefficients.map(|k| json!(k))));
            let radius_px = lens.radius(lens.max_angle_rad) * camera.focal_px.min_element();
            fields.push(("fisheye_crop_radius", json!(radius_px)));
        }
        CameraProjection::Equirectangular => fields.push(("camera_model", json!("EQUIRECTANGULAR"))),
    }
    fields
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, DVec2, DVec3};
    use luxel_core::{Distortion, Fisheye};

    use super::*;

    #[test]
    fn written_cameras_are_read_back() {
        let camera = |i: u32| {
            let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.3 * f64::from(i), -0.2, 1.1);
            PathCamera {
                name: format!("frame_{i:05}"),
                camera: Camera {
                    camera_from_world: DAffine3::from_rotation_translation(rotation, DVec3::new(1.0, -2.5e3, 0.1 * f64::from(i))),
                    focal_px: DVec2::new(100.0 / 3.0, 41.7),
                    center_px: DVec2::new(20.25, 15.0),
                    size_px: [40, 30 + i],
                    distortion: Distortion::default(),
                    projection: CameraProjection::Pinhole,
                },
                focus_distance: (i > 0).then(|| 0.1 * f64::from(i)),
            }
        };
        let written: Vec<PathCamera> = (0..3).map(camera).collect();
        // Lenses of every projection keep their fields.
        let mut written = written;
        written[1].camera.projection = CameraProjection::Fisheye(Fisheye { max_angle_rad: 1.4, ..Fisheye::new([0.01, 0.02, 0.0, -0.001]) });
        written[2].camera = Camera { size_px: [64, 32], ..Camera::panorama(written[2].camera.camera_from_world, 64) };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.json");
        write_cameras(&path, &written).unwrap();
        let read = crate::read_camera_path(&path, None).unwrap();
        assert_eq!(read.len(), 3);
        for (read, written) in read.iter().zip(&written) {
            assert_eq!((&read.name, read.camera.size_px), (&written.name, written.camera.size_px));
            assert!((read.camera.focal_px - written.camera.focal_px).length() < 1e-12);
            assert_eq!(read.camera.center_px, written.camera.center_px);
            match (read.camera.projection, written.camera.projection) {
                (CameraProjection::Fisheye(read), CameraProjection::Fisheye(written)) => {
                    assert!(read.coefficients == written.coefficients && (read.max_angle_rad - written.max_angle_rad).abs() < 1e-12);
                }
                (read, written) => assert_eq!(read, written),
            }
            // Eyes are thousands of units from the origin.
            assert!(read.camera.camera_from_world.abs_diff_eq(written.camera.camera_from_world, 1e-9), "{read:?}\n{written:?}");
        }
    }
}

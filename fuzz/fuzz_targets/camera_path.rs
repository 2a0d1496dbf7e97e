//! Camera paths: reading does not panic, with and without a default camera, and the cameras that
//! are read can be used.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_core::{Camera, CameraProjection, Distortion};

fuzz_target!(|data: &[u8]| {
    let default = Camera {
        camera_from_world: glam::DAffine3::IDENTITY,
        focal_px: glam::DVec2::new(300.0, 310.0),
        center_px: glam::DVec2::new(201.0, 149.0),
        size_px: [400, 300],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    };
    for default in [None, Some(&default)] {
        for camera in luxel_io::decode_camera_path(Path::new("path.json"), data, default).unwrap_or_default() {
            assert_eq!(camera.camera.validate(), Ok(()));
            assert!(camera.camera.distortion.is_none() && !camera.name.is_empty());
        }
    }
});

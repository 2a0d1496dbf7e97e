//! `poses_bounds_exps.npy`: poses that a camera can have, or an error.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_core::Camera;

fuzz_target!(|bytes: &[u8]| {
    let Ok(poses) = luxel_io::parse_recorded_poses(Path::new("poses_bounds_exps.npy"), bytes) else { return };
    for pose in poses {
        let camera = Camera {
            camera_from_world: pose.camera_from_world,
            focal_px: glam::DVec2::splat(pose.focal_px),
            center_px: glam::DVec2::new(pose.size_px[0].into(), pose.size_px[1].into()) * 0.5,
            size_px: pose.size_px,
            distortion: luxel_core::Distortion::default(),
            projection: luxel_core::CameraProjection::Pinhole,
        };
        assert_eq!(camera.validate(), Ok(()));
        assert!(pose.exposure_s.is_normal() && pose.exposure_s > 0.0);
    }
});

//! LLFF's table: poses that are rigid motions, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    for pose in luxel_io::parse_poses_bounds(Path::new("input"), data).unwrap_or_default() {
        assert!(pose.camera_from_world.is_finite() && pose.focal_px > 0.0);
    }
});

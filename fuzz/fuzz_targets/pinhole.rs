//! Camera files: reading does not panic, and a camera that is read can be used.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(camera) = luxel_io::decode_pinhole_camera(Path::new("camera.json"), data) {
        assert_eq!(camera.validate(), Ok(()));
        assert!(camera.distortion.is_none());
    }
});

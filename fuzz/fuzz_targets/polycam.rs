//! A camera of Polycam, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(camera) = luxel_io::parse_polycam_camera(Path::new("input"), data)
        && let Ok(seen) = camera.camera([64, 48])
    {
        assert_eq!(seen.validate(), Ok(()));
    }
});

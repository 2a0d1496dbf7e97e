//! RealityScan's table of cameras: cameras that are valid where they say so, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    for camera in luxel_io::parse_realityscan_table(Path::new("input"), data).unwrap_or_default() {
        if let Ok(seen) = camera.camera([64, 48]) {
            assert_eq!(seen.validate(), Ok(()));
        }
    }
});

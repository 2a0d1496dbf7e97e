//! Metashape's XML: cameras, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    for camera in luxel_io::parse_metashape(Path::new("input"), data).unwrap_or_default().cameras {
        if let Ok(seen) = camera.camera([64, 48]) {
            assert_eq!(seen.validate(), Ok(()));
        }
    }
});

//! RealityScan's XMP: a camera, none, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(Some(camera)) = luxel_io::parse_realityscan_xmp(Path::new("input"), data)
        && let Ok(seen) = camera.camera([64, 48])
    {
        assert_eq!(seen.validate(), Ok(()));
    }
});

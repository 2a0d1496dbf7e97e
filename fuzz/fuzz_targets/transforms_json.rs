//! `transforms.json`: parsing and making cameras neither panics nor hangs, and cameras that are
//! made are valid.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(parsed) = luxel_io::parse_transforms(Path::new("transforms.json"), data) else { return };
    for frame in parsed.frames {
        let size = frame.size_px().unwrap_or([640, 480]);
        for image in [size, size.map(|s| s.div_ceil(2))] {
            if let Ok(camera) = frame.camera(image) {
                assert_eq!(camera.validate(), Ok(()));
            }
        }
    }
});

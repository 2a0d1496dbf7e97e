//! Depth maps of every format: a number for each pixel, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(map) = luxel_io::decode_depth_map(Path::new("input"), data) {
        assert_eq!(map.values.len(), map.size_px[0] * map.size_px[1]);
        assert!(map.values.iter().all(|v| v.is_finite() && *v >= 0.0));
    }
});

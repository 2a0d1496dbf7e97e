//! Cameras of OpenUSD, text or binary, at several times, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(layer) = luxel_io::decode_usd_cameras(Path::new("input"), data) {
        for time in [None, Some(0.0), Some(1001.5)] {
            assert!(layer.eyes_at(time).iter().all(|eye| eye.is_finite()));
        }
    }
});

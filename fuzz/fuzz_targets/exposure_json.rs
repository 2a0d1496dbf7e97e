//! `exposure.json` of captured LDR images: seconds above 0, or an error.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(exposures) = luxel_io::parse_exposures(Path::new("exposure.json"), bytes) {
        assert!(exposures.values().all(|seconds| seconds.is_finite() && *seconds > 0.0));
        assert!(exposures.keys().all(|name| !name.contains('/')));
    }
});

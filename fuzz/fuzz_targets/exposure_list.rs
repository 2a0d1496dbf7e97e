//! Exposures as text: valid ones, or the line that is wrong.

#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_capture::parse_exposure_list;

fuzz_target!(|text: &str| {
    match parse_exposure_list(text) {
        Ok(exposures) => assert!(exposures.iter().all(|(name, exposure)| !name.is_empty() && exposure.is_valid())),
        Err(e) => assert!((1..=text.lines().count()).contains(&e.line)),
    }
});

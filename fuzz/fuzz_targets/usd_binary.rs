//! Binary OpenUSD and packages: a scene or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(scene) = luxel_io::decode_usdc(Path::new("scene.usdc"), data) {
        assert_eq!(scene.splats.validate(), Ok(()));
    }
});

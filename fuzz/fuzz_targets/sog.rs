//! SOG: a scene that an engine can take, or an error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(scene) = luxel_io::decode_sog(Path::new("scene.sog"), data) {
        assert_eq!(scene.splats.validate(), Ok(()));
        assert!(scene.radiance_scale.get().is_finite() && scene.radiance_scale.get() > 0.0);
    }
});

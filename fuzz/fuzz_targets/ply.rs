//! PLY: reading scenes and points neither panics nor allocates beyond its input, and a scene that
//! is read is written and read back alike.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let name = Path::new("scene.ply");
    let _ = luxel_io::decode_points_ply(name, data);
    let Ok(scene) = luxel_io::decode_scene_ply(name, data) else { return };
    assert_eq!(scene.splats.validate(), Ok(()));
    let bytes = luxel_io::encode_scene_ply(name, &scene).expect("what is read can be written");
    let again = luxel_io::decode_scene_ply(name, &bytes).expect("what is written can be read");
    assert_eq!(again, scene);
});

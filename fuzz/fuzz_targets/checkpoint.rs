//! Checkpoints: reading neither panics nor allocates beyond its input, and what is read is written
//! and read back alike.
//!
//! Everything but the finiteness of the splats is parsed before the digest is compared, so damaged
//! inputs reach nearly all of the reader.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let name = Path::new("step.safetensors");
    let Ok(snapshot) = luxel_io::decode_checkpoint(name, data) else { return };
    let bytes = luxel_io::encode_checkpoint(name, &snapshot).expect("what is read can be written");
    assert_eq!(luxel_io::decode_checkpoint(name, &bytes).expect("what is written can be read"), snapshot);
});

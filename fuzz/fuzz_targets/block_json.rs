//! `block.json`: parsing does not panic.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let _ = luxel_io::parse_block(Path::new("block.json"), data);
});

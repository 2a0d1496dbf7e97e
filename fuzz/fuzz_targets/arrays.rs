//! Files of arrays, such as radiance fields: reading neither panics nor allocates beyond its input,
//! and what is read is written and read back alike.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_io::NamedArray;

fuzz_target!(|data: &[u8]| {
    let name = Path::new("field.safetensors");
    let Ok(found) = luxel_io::decode_arrays(name, "luxel-field", data) else { return };
    let arrays: Vec<NamedArray<'_>> =
        found.tensors.iter().map(|(name, (shape, values))| NamedArray { name, shape, values }).collect();
    let bytes = luxel_io::encode_arrays(name, "luxel-field", &found.description, &arrays).expect("what is read can be written");
    let again = luxel_io::decode_arrays(name, "luxel-field", &bytes).expect("what is written can be read");
    assert_eq!((again.description, again.tensors.len()), (found.description, found.tensors.len()));
});

//! Weights of networks: reading neither panics nor allocates beyond its input, and every tensor has
//! as many values as its shape calls for.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(tensors) = luxel_io::decode_tensors(Path::new("weights.safetensors"), data) else { return };
    let values: usize = tensors.values().map(|(_, values)| values.len()).sum();
    assert!(4 * values <= data.len());
    for (name, (shape, values)) in &tensors {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "{name}");
    }
});

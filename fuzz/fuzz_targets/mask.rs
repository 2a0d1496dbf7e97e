//! Masks: weights between 0 and 1, as many as the image has pixels, or an error.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_io::{ReadOptions, decode_image, decode_mask};

fuzz_target!(|bytes: &[u8]| {
    let name = Path::new("mask");
    let size = decode_image(name, bytes, &ReadOptions::default()).map_or([9, 5], |decoded| [decoded.image.width, decoded.image.height]);
    // A few bytes may encode 16 megapixels: once is enough.
    if size[0] * size[1] > 1 << 18 {
        return;
    }
    if let Ok(mask) = decode_mask(name, bytes, size) {
        assert_eq!(mask.weights.len(), size[0] * size[1]);
        assert!(mask.weights.iter().all(|weight| (0.0..=1.0).contains(weight)));
        assert!(decode_mask(name, bytes, [size[0] + 1, size[1]]).is_err());
    }
});

//! NumPy arrays as images: an image or an error.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_io::{ReadOptions, Transfer, decode_image};

fuzz_target!(|bytes: &[u8]| {
    let options = ReadOptions { transfer: Some(Transfer::Srgb), layer: None };
    if let Ok(decoded) = decode_image(Path::new("fuzz.npy"), bytes, &options) {
        let (width, height) = (decoded.image.width, decoded.image.height);
        assert_eq!(decoded.image.pixels.len(), width * height);
        assert!(decoded.alpha.is_none_or(|alpha| alpha.len() == width * height));
    }
});

//! Plates, DPX among them, with the curve that the first byte chooses: an image or an error.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_io::{ReadOptions, Transfer, decode_image};

fuzz_target!(|bytes: &[u8]| {
    let Some((&curve, file)) = bytes.split_first() else { return };
    let (_, transfer) = Transfer::ALL[usize::from(curve) % Transfer::ALL.len()];
    let options = ReadOptions { transfer: Some(transfer), layer: None };
    if let Ok(decoded) = decode_image(Path::new("fuzz"), file, &options) {
        let (width, height) = (decoded.image.width, decoded.image.height);
        assert_eq!(decoded.image.pixels.len(), width * height);
        assert!(decoded.alpha.is_none_or(|alpha| alpha.len() == width * height));
    }
});

//! Developed pictures with their Exif: codes or an error, and facts that are numbers.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_io::{Codes, Photo, decode_photo, photo_info};

fuzz_target!(|bytes: &[u8]| {
    let name = Path::new("fuzz.jpg");
    if let Ok(info) = photo_info(name, bytes) {
        let numbers = [info.exif.seconds, info.exif.iso, info.exif.f_number];
        assert!(numbers.iter().flatten().all(|v| v.is_finite() && *v > 0.0));
    }
    if let Ok(Photo::Developed { width, height, codes }) = decode_photo(name, bytes) {
        let found = match codes {
            Codes::U8(v) => v.len(),
            Codes::U16(v) => v.len(),
        };
        assert_eq!(found, width * height * 3);
    }
});

//! Camera RAW as DNG: sensor data or an error, and the facts of its tags.

#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use luxel_io::{Photo, decode_photo, photo_info};

fuzz_target!(|bytes: &[u8]| {
    let name = Path::new("fuzz.dng");
    let info = photo_info(name, bytes);
    if let Ok(Photo::Raw(pixels)) = decode_photo(name, bytes) {
        let per_pixel = if pixels.cell.is_some() { 1 } else { 3 };
        assert_eq!(pixels.codes.len(), pixels.width * pixels.height * per_pixel);
        assert!(pixels.black.iter().all(|black| *black < pixels.white));
        assert_eq!(info.map(|i| i.size_px).ok(), Some([pixels.width as u32, pixels.height as u32]));
    }
});

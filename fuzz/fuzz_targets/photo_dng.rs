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
        // A warp is of the whole active area, and the picture a part of it.
        let warped = pixels.corrections.as_ref().filter(|corrections| !corrections.steps.is_empty());
        let size = warped.map_or([pixels.width, pixels.height], |corrections| [corrections.crop.width, corrections.crop.height]);
        assert_eq!(info.map(|i| i.size_px).ok(), Some(size.map(|side| side as u32)));
    }
});

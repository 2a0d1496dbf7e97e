//! COLMAP's binary model: neither panics nor allocates beyond its input, and indices of tracks are
//! in range. The three files are separated by `SEPARATOR`.
#![no_main]

use std::path::PathBuf;

use libfuzzer_sys::fuzz_target;
use luxel_io::colmap::{ColmapFiles, parse_binary};

const SEPARATOR: &[u8] = b"\n@@\n";

fuzz_target!(|data: &[u8]| {
    let mut rest = data;
    let mut next = || match rest.windows(SEPARATOR.len()).position(|window| window == SEPARATOR) {
        Some(end) => {
            let file = rest[..end].to_vec();
            rest = &rest[end + SEPARATOR.len()..];
            file
        }
        None => std::mem::take(&mut rest).to_vec(),
    };
    let bytes = ColmapFiles { cameras: next(), images: next(), points: next() };
    let file = |stem: &str| PathBuf::from(format!("{stem}.bin"));
    let paths = ColmapFiles { cameras: file("cameras"), images: file("images"), points: file("points3D") };
    let Ok(model) = parse_binary(&paths, &bytes) else { return };
    for point in &model.points {
        for [image, feature] in &point.track {
            let _ = model.images[*image as usize].features_px[*feature as usize];
        }
    }
});

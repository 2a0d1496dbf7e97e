//! OpenColorIO configurations, and the tables that they name: a conversion of radiance or an error.
//!
//! Input that begins with the name of a table (`lut.cube` and others) and a new line is that table,
//! under a configuration that names it; other input is the configuration.

#![no_main]

use std::fs::{create_dir_all, write};

use libfuzzer_sys::fuzz_target;
use luxel_core::{ColorSpace, Image};
use luxel_io::OcioSpace;

const TABLES: [&str; 12] = [
    "lut.cube",
    "lut.spi1d",
    "lut.spi3d",
    "lut.spimtx",
    "lut.csp",
    "lut.clf",
    "lut.ctf",
    "lut.3dl",
    "lut.vf",
    "lut.lut",
    "lut.cdl",
    "lut.mga",
];

/// Ends within the colour space `input`, whose way to the scene is missing.
const CONFIG: &str = include_str!("config.ocio");

fuzz_target!(|bytes: &[u8]| {
    let folder = std::env::temp_dir().join(format!("luxel-fuzz-ocio-{}", std::process::id()));
    create_dir_all(&folder).expect("a folder for temporary files");
    let config = folder.join("config.ocio");
    let table = TABLES.into_iter().find_map(|name| Some((name, bytes.strip_prefix(name.as_bytes())?.strip_prefix(b"\n")?)));
    match table {
        Some((name, content)) => {
            write(folder.join(name), content).expect("a temporary file");
            write(&config, format!("{CONFIG}    to_scene_reference: !<FileTransform> {{src: {name}}}\n")).expect("a temporary file");
        }
        None => write(&config, bytes).expect("a temporary file"),
    }
    if let Ok(space) = OcioSpace::open(&config, "input") {
        let mut image = Image::filled(3, 2, [0.2, 7e4, -1.0]);
        image.pixels[1] = [f32::NAN, f32::INFINITY, 1e-40];
        let _ = space.convert(&mut image, ColorSpace::LinearRec709);
    }
});

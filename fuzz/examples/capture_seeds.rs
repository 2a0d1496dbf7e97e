//! Writes small valid files of captures to the corpora: masks, LDR images, exposures, names of
//! photographs, colour configurations and tables. `cargo run --release --example capture_seeds`.

use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let grey: Vec<u8> = (0..9 * 5).flat_map(|i| [(i * 5) as u8; 3]).collect();
    write("mask", "grey.png", &luxel_io::encode_png(9, 5, &grey)?)?;
    write("mask", "grey.jpg", &luxel_io::encode_jpeg(9, 5, &grey, 90)?)?;
    write("exposure_json", "nerf", br#"{"train/r_0_0.png": 0.125, "r_0_1.png": 0.5, "r_0_2": 2, "test\\r_1_0.JPG": 8.0}"#)?;
    write("exposure_json", "numbers", br#"{"a": 1e-3, "b/../c.png": 1E2}"#)?;
    write("recorded_poses", "two", &poses())?;
    write("exposure_list", "words", "\u{feff}# name s\r\na.jpg 1/100\r\n b 0.5, 200 \n\nc\t2 100 5.6\n\"my desk_1\";1/4\n".as_bytes())?;
    // Camera, time, stops and seconds as bytes, then the name.
    let shot = |i: u8, name: String| [&[0, 2 * i + 10 * (i / 3), 60 + 12 * (i % 3), 1], name.as_bytes(), b"\n"].concat();
    write("brackets", "sequence", &(0..9).flat_map(|i| shot(i, format!("IMG_{}", 9998 + u32::from(i)))).collect::<Vec<u8>>())?;
    write("brackets", "names", &(0..9).flat_map(|i| shot(i, format!("desk{}_{}", i / 3, i % 3))).collect::<Vec<u8>>())?;
    write("brackets", "ev", &(0..9).flat_map(|i| shot(i, format!("d{}-ev{:+}", i / 3, i32::from(i % 3) - 1))).collect::<Vec<u8>>())?;
    for (name, transform) in TRANSFORMS {
        write("ocio", name, format!("{CONFIG}    to_scene_reference: {transform}\n").as_bytes())?;
    }
    for (name, table) in TABLES {
        write("ocio", name, format!("{name}\n{table}").as_bytes())?;
    }
    Ok(())
}

fn write(target: &str, file: &str, bytes: &[u8]) -> std::io::Result<()> {
    let folder = PathBuf::from("corpus").join(target);
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join(file), bytes)
}

/// Returns two rows of `poses_bounds_exps.npy`.
fn poses() -> Vec<u8> {
    let row = |seconds: f64| [0.0, 1.0, 0.0, 0.5, 8.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 4.0, 20.0, 1.0, 9.0, seconds];
    let header = format!("{:<117}\n", "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 18), }");
    let samples = [row(0.125), row(2.0)].concat().into_iter().flat_map(f64::to_le_bytes);
    [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat().into_iter().chain(samples).collect()
}

/// Ends within the colour space `input`, whose way to the scene is missing.
const CONFIG: &str = include_str!("../fuzz_targets/config.ocio");

const TRANSFORMS: [(&str, &str); 4] = [
    ("matrix", "!<MatrixTransform> {matrix: [0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1]}"),
    ("log", "!<LogAffineTransform> {base: 10, log_side_slope: [0.25, 0.25, 0.25], lin_side_slope: [5.5, 5.5, 5.5], direction: inverse}"),
    (
        "group",
        "!<GroupTransform>\n      children:\n        - !<ExponentTransform> {value: [2.4, 2.4, 2.4, 1]}\n        - !<BuiltinTransform> {style: ACEScct_to_ACES2065-1}",
    ),
    ("file", "!<FileTransform> {src: nowhere.spimtx}"),
];

const TABLES: [(&str, &str); 6] = [
    ("lut.cube", "LUT_3D_SIZE 2\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 0 1\n1 0 1\n0 1 1\n1 1 1\n"),
    ("lut.spi1d", "Version 1\nFrom 0.0 1.0\nLength 3\nComponents 1\n{\n0\n0.5\n1\n}\n"),
    ("lut.spimtx", "1 0 0 0\n0 1 0 0\n0 0 1 0\n"),
    ("lut.csp", "CSPLUTV100\n1D\n\n2\n0 1\n0 1\n2\n0 1\n0 1\n2\n0 1\n0 1\n\n3\n0 0 0\n.5 .5 .5\n1 1 1\n"),
    (
        "lut.clf",
        "<?xml version=\"1.0\"?>\n<ProcessList id=\"a\" compCLFversion=\"3.0\">\n<LUT1D inBitDepth=\"32f\" outBitDepth=\"32f\"><Array dim=\"3 1\">0 .5 1</Array></LUT1D></ProcessList>\n",
    ),
    ("lut.3dl", "0 1023\n0 0 0\n0 0 4095\n0 4095 0\n0 4095 4095\n4095 0 0\n4095 0 4095\n4095 4095 0\n4095 4095 4095\n"),
];

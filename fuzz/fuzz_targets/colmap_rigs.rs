//! COLMAP's rigs and frames, binary and text. The two files are separated by `SEPARATOR`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_io::colmap::{RigFiles, parse_rigs_binary, parse_rigs_text};

const SEPARATOR: &[u8] = b"\n@@\n";

fuzz_target!(|data: &[u8]| {
    let end = data.windows(SEPARATOR.len()).position(|window| window == SEPARATOR);
    let (rigs, frames) = end.map_or((data, &[][..]), |end| (&data[..end], &data[end + SEPARATOR.len()..]));
    let bytes = RigFiles { rigs: rigs.to_vec(), frames: frames.to_vec() };
    let paths = RigFiles { rigs: "rigs".into(), frames: "frames".into() };
    let _ = parse_rigs_binary(&paths, &bytes);
    let _ = parse_rigs_text(&paths, &bytes);
});

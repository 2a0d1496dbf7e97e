//! NumPy's .npy in: one array `[H,W,3]` of little-endian float32 in C order, linear RGB, rows from
//! the top; or a table `[rows, columns]` of float64.
//!
//! Format: a magic string, a version, the length of a header, the header (a Python dictionary of
//! type, order and shape, in ASCII), the samples (NumPy enhancement proposal 1). Other types,
//! orders and shapes are refused with the line of NumPy that makes the right one.

use std::fmt::Display;
use std::io::{Read, Seek};
use std::path::Path;

use ::exr::prelude::f16;
use luxel_core::Image;

use super::{DecodedImage, SampleDepth};
use crate::IoError;
use crate::input::Input;

/// First bytes of every file.
pub(super) const SIGNATURE: &[u8] = b"\x93NUMPY";

/// Longest header that is believed to be one: NumPy's own limit.
const MAX_HEADER_BYTES: usize = 10_000;

/// Longest start of a file: signature, version, a four-byte length, header.
const MAX_START_BYTES: u64 = MAX_HEADER_BYTES as u64 + 12;

/// Advice on how to write an image that is read.
const REMEDY: &str = "save it with numpy.save(file, numpy.ascontiguousarray(image, dtype=\"<f4\"))";

/// The array that is expected.
struct Expected {
    /// Number type, as the header states it.
    descr: &'static str,
    /// For messages.
    kind: &'static str,
    /// For messages.
    shape: &'static str,
    remedy: &'static str,
}

const IMAGE: Expected = Expected { descr: "'<f4'", kind: "little-endian float32", shape: "(height, width, 3)", remedy: REMEDY };
const TABLE: Expected = Expected {
    descr: "'<f8'",
    kind: "little-endian float64",
    shape: "(rows, columns)",
    remedy: "save it with numpy.save(file, numpy.ascontiguousarray(table, dtype=\"<f8\"))",
};

/// Returns the rows of a table of float64, each of `columns` finite numbers.
pub(crate) fn decode_table<const COLUMNS: usize>(input: Input<'_>) -> Result<Vec<[f64; COLUMNS]>, IoError> {
    let (shape, samples) = start(input, &TABLE)?;
    let [rows, columns] = shape.as_slice() else {
        return Err(input.invalid(format!("header: {} dimensions, expected {}", shape.len(), TABLE.shape)));
    };
    if *columns as usize != COLUMNS {
        return Err(input.invalid(format!("header: {columns} columns, expected {COLUMNS}")));
    }
    let numbers = samples.as_chunks::<8>().0;
    if samples.len() != numbers.len() * 8 || numbers.len() != *rows as usize * COLUMNS {
        let message =
            format!("data: {} bytes after the header, expected {rows} rows of {COLUMNS} numbers of 8; the file is damaged", samples.len());
        return Err(input.invalid(message));
    }
    let table: Vec<[f64; COLUMNS]> = numbers.as_chunks::<COLUMNS>().0.iter().map(|row| row.map(f64::from_le_bytes)).collect();
    match table.iter().position(|row| row.iter().any(|v| !v.is_finite())) {
        Some(row) => Err(input.invalid(format!("row {row} holds a number that is not finite"))),
        None => Ok(table),
    }
}

/// Numbers of depth maps: as headers state their type, and bytes of one.
const DEPTH_TYPES: [(&str, usize); 6] = [("'<f4'", 4), ("'<f8'", 8), ("'<f2'", 2), ("'<u2'", 2), ("'<u4'", 4), ("'|u1'", 1)];

/// Decodes a map of depth, `(height, width)` of float16, 32 or 64 or of unsigned integers, with
/// sides of 1 before or behind; width and height, and the values by row.
pub(crate) fn decode_depth(input: Input<'_>) -> Result<([usize; 2], Vec<f32>), IoError> {
    const REMEDY: &str = "save it with numpy.save(file, numpy.ascontiguousarray(depth, dtype=\"<f4\"))";
    let expected = |descr| Expected { descr, kind: "little-endian float32", shape: "(height, width)", remedy: REMEDY };
    let mut refused = None;
    let found = DEPTH_TYPES.iter().find_map(|&(descr, width)| match start(input, &expected(descr)) {
        Ok((shape, samples)) => Some((shape, samples, descr, width)),
        Err(error) => {
            refused.get_or_insert(error);
            None
        }
    });
    let Some((shape, samples, descr, bytes_each)) = found else {
        return Err(refused.unwrap_or_else(|| input.invalid("header: no type")));
    };
    let sides: Vec<u32> = shape.iter().copied().filter(|side| *side != 1).collect();
    let [height, width] = match (shape.as_slice(), sides.as_slice()) {
        ([h, w], _) | (_, [h, w]) => [*h, *w],
        _ => return Err(input.unsupported(format!("header: 'shape' is {}, expected (height, width); {REMEDY}", tuple(&shape)))),
    };
    input.check_size([width, height].map(u64::from))?;
    let [width, height] = [width, height].map(|side| side as usize);
    if samples.len() != width * height * bytes_each {
        let message = format!(
            "data: {} bytes after the header, expected {} for {width} x {height} numbers",
            samples.len(),
            width * height * bytes_each
        );
        return Err(input.invalid(message));
    }
    let values = match descr {
        "'<f4'" => samples.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        "'<f8'" => samples.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b) as f32).collect(),
        "'<f2'" => samples.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
        "'<u2'" => samples.as_chunks().0.iter().map(|b| f32::from(u16::from_le_bytes(*b))).collect(),
        "'<u4'" => samples.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b) as f32).collect(),
        _ => samples.iter().map(|b| f32::from(*b)).collect(),
    };
    Ok(([width, height], values))
}

/// Decodes a whole file.
pub(super) fn decode(input: Input<'_>) -> Result<DecodedImage, IoError> {
    let (size, samples) = image_start(input)?;
    input.check_size(size.map(u64::from))?;
    let [width, height] = size.map(|side| side as usize);
    let expected = width * height * size_of::<[f32; 3]>();
    if samples.len() != expected {
        let message = format!(
            "data: {} bytes after the header, expected {expected} for {width} x {height} pixels; the file is damaged, save it again",
            samples.len()
        );
        return Err(input.invalid(message));
    }
    let mut pixels = input.zeroed::<[f32; 3]>(width * height)?;
    for (value, bytes) in pixels.as_flattened_mut().iter_mut().zip(samples.as_chunks().0) {
        *value = f32::from_le_bytes(*bytes);
    }
    let image = Image { width, height, pixels };
    Ok(DecodedImage {
        image,
        alpha: None,
        is_premultiplied: false,
        color_space: None,
        chromaticities: None,
        depth: SampleDepth::Float,
        is_display_coded: false,
        warnings: Vec::new(),
    })
}

/// Returns the size from the header.
pub(super) fn size(name: &Path, file: impl Read + Seek) -> Result<[u32; 2], IoError> {
    let mut bytes = Vec::new();
    file.take(MAX_START_BYTES).read_to_end(&mut bytes).map_err(|e| IoError::system(name, "read", &e))?;
    Ok(image_start(Input::new(name, &bytes))?.0)
}

/// Returns the width and height, and what follows the header.
fn image_start(input: Input<'_>) -> Result<([u32; 2], &[u8]), IoError> {
    let (shape, samples) = start(input, &IMAGE)?;
    match shape.as_slice() {
        [height, width, 3] => Ok(([*width, *height], samples)),
        _ => Err(input.unsupported(format!("header: 'shape' is {}, expected {}; {REMEDY}", tuple(&shape), IMAGE.shape))),
    }
}

/// Formats a shape: `(400, 300)`.
fn tuple(shape: &[u32]) -> String {
    let sides: Vec<String> = shape.iter().map(u32::to_string).collect();
    if sides.len() == 1 { format!("({},)", sides.join(", ")) } else { format!("({})", sides.join(", ")) }
}

/// Returns the shape, and what follows the header.
fn start<'a>(input: Input<'a>, expected: &Expected) -> Result<(Vec<u32>, &'a [u8]), IoError> {
    let remedy = expected.remedy;
    let cut_short = || input.invalid("header: the file ends within it; the file is damaged, save it again");
    let rest = input.bytes.strip_prefix(SIGNATURE).ok_or_else(|| input.invalid("header: no signature of NumPy"))?;
    let (length, rest) = match rest {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        [1..=3, ..] | [] => return Err(cut_short()),
        [version, ..] => {
            return Err(input.unsupported(format!("header: version {version} of the format, expected 1 to 3; {remedy}")));
        }
    };
    if length > MAX_HEADER_BYTES {
        return Err(input.invalid(format!("header: {length} bytes, expected at most {MAX_HEADER_BYTES}; {remedy}")));
    }
    let (header, samples) = rest.split_at_checked(length).ok_or_else(cut_short)?;
    let header = str::from_utf8(header).map_err(|_| input.invalid("header: not text; the file is damaged, save it again"))?;
    Ok((shape(input, header, expected)?, samples))
}

/// Returns the shape of a header such as `{'descr': '<f4', 'fortran_order': False, 'shape': (400,
/// 300, 3), }`.
fn shape(input: Input<'_>, header: &str, wanted: &Expected) -> Result<Vec<u32>, IoError> {
    let value = |key: &str| {
        let (_, rest) = header.split_once(&format!("'{key}':"))?;
        let rest = rest.trim_start();
        let end = if rest.starts_with('(') { rest.find(')').map(|at| at + 1) } else { rest.find([',', '}']) };
        end.map(|end| rest[..end].trim())
    };
    let found = |key: &str| value(key).ok_or_else(|| input.invalid(format!("header: no '{key}'; the file is damaged, save it again")));
    let unsupported = |key: &str, found: &str, expected: &dyn Display| {
        let found: String = found.chars().take(40).filter(|c| !c.is_control()).collect();
        input.unsupported(format!("header: '{key}' is {found}, expected {expected}; {}", wanted.remedy))
    };
    let descr = found("descr")?;
    if descr != wanted.descr {
        return Err(unsupported("descr", descr, &format_args!("{} ({})", wanted.descr, wanted.kind)));
    }
    let order = found("fortran_order")?;
    if order != "False" {
        return Err(unsupported("fortran_order", order, &"False (rows from the top)"));
    }
    let shape = found("shape")?;
    let sides: Option<Vec<u32>> = shape.trim_matches(['(', ')']).split(',').map(|side| side.trim().parse().ok()).collect();
    sides.ok_or_else(|| unsupported("shape", shape, &wanted.shape))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::IoErrorKind;

    fn file(version: u8, header: &str, samples: &[f32]) -> Vec<u8> {
        let length = header.len() as u32;
        let length = if version == 1 { (length as u16).to_le_bytes().to_vec() } else { length.to_le_bytes().to_vec() };
        let samples: Vec<u8> = samples.iter().flat_map(|v| v.to_le_bytes()).collect();
        [SIGNATURE, &[version, 0], &length, header.as_bytes(), &samples].concat()
    }

    fn header(shape: &str) -> String {
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}   \n")
    }

    #[test]
    fn array_is_an_image_with_rows_from_the_top() {
        let samples: Vec<f32> = (0..18u8).map(|i| f32::from(i) * 1000.0 - 1.0).collect();
        for version in [1, 2, 3] {
            let image = decode(Input::new("a.npy", &file(version, &header("(2, 3, 3)"), &samples))).unwrap().image;
            assert_eq!((image.width, image.height), (3, 2));
            assert_eq!(image.at(0, 1), [8999.0, 9999.0, 10999.0]);
        }
        // The order of the keys is free.
        let other = "{'shape': (2,3,3), 'fortran_order': False, 'descr': '<f4'}";
        assert!(decode(Input::new("a.npy", &file(1, other, &samples))).is_ok());
    }

    #[test]
    fn what_is_not_expected_is_named() {
        let error = |bytes: &[u8]| decode(Input::new("a.npy", bytes)).unwrap_err();
        let with = |header: &str| error(&file(1, header, &[0.0; 18]));
        let whole = header("(2, 3, 3)");
        for (header, part) in [
            (whole.replace("<f4", "<f8"), "'descr' is '<f8'"),
            (whole.replace("<f4", ">f4"), "'descr' is '>f4'"),
            (whole.replace("'<f4'", "[('a', '<f4')]"), "'descr' is [('a'"),
            (whole.replace("False", "True"), "'fortran_order' is True"),
            (header("(6, 3)"), "'shape' is (6, 3), expected (height, width, 3)"),
            (header("(2, 3, 4)"), "'shape'"),
            (header("(2, -3, 3)"), "'shape'"),
            (header("(99999999999, 3, 3)"), "'shape'"),
        ] {
            let error = with(&header);
            assert_eq!(error.kind, IoErrorKind::Unsupported);
            assert!(error.message.contains(part) && error.message.contains("numpy.save"), "{error}");
        }
        assert!(with(&whole.replace("'descr'", "'type'")).message.contains("no 'descr'"));
        assert!(with("{'shape': (2, 3").message.contains("no 'descr'"));
        assert!(with(&header("(0, 3, 3)")).message.contains("size 3 x 0"));
        assert!(with(&header("(60000, 60000, 3)")).message.contains("claims"));
        assert!(with(&header("(2, 2, 3)")).message.contains("72 bytes after the header, expected 48"));
        assert!(error(&file(9, &whole, &[])).message.contains("version 9"));
        assert!(error(&file(2, &" ".repeat(20_000), &[])).message.contains("at most 10000"));
        assert!(error(b"\x93NUMPY\x01\x00\xff\x00{").message.contains("ends within"));
    }
}

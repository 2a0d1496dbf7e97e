//! Portable float maps: `Pf` (one channel) or `PF` (three, of which the first counts), width,
//! height and a scale whose sign is the byte order (negative: little-endian), then rows from the
//! bottom.

use crate::IoError;
use crate::input::Input;

/// First bytes of a file.
pub(super) fn is_pfm(bytes: &[u8]) -> bool {
    bytes.starts_with(b"Pf") || bytes.starts_with(b"PF")
}

/// Decodes a file: width and height, and the values by row from the top.
pub(super) fn decode(input: Input<'_>) -> Result<([usize; 2], Vec<f32>), IoError> {
    let invalid = |message: String| input.invalid(format!("PFM: {message}"));
    let mut rest = input.bytes;
    let mut word = |what: &str| {
        // Words stand between single or several spaces; one follows the last.
        while let [first, more @ ..] = rest
            && first.is_ascii_whitespace()
        {
            rest = more;
        }
        let end = rest.iter().take(64).position(u8::is_ascii_whitespace);
        let end = end.ok_or_else(|| invalid(format!("the header ends, expected {what}; the file is damaged")))?;
        let (word, more) = rest.split_at(end);
        rest = &more[1..];
        str::from_utf8(word).map_err(|_| invalid(format!("the header is not text, expected {what}")))
    };
    let channels = if word("Pf")? == "PF" { 3 } else { 1 };
    let mut side = |what: &str| {
        let text = word(what)?;
        text.parse::<u32>().map_err(|_| invalid(format!("{text:?}, expected {what}")))
    };
    let size = [side("a width")?, side("a height")?];
    let scale = word("a scale")?;
    let scale: f32 = scale
        .parse()
        .ok()
        .filter(|v: &f32| v.is_finite() && *v != 0.0)
        .ok_or_else(|| invalid(format!("scale {scale:?}, expected a number other than 0, negative for little-endian samples")))?;
    input.check_size(size.map(u64::from))?;
    let [width, height] = size.map(|side| side as usize);
    let expected = width * height * channels * size_of::<f32>();
    if rest.len() != expected {
        let found = rest.len();
        return Err(invalid(format!(
            "{found} bytes behind the header, expected {expected} for {width} x {height} pixels; the file is damaged"
        )));
    }
    let read = if scale < 0.0 { f32::from_le_bytes } else { f32::from_be_bytes };
    let row = |y: usize| {
        let start = y * width * channels * size_of::<f32>();
        let samples = rest[start..start + width * channels * size_of::<f32>()].as_chunks().0;
        samples.iter().step_by(channels).map(move |sample| read(*sample))
    };
    Ok(([width, height], (0..height).rev().flat_map(row).collect()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn file(header: &str, values: &[f32], little: bool) -> Vec<u8> {
        let bytes = values.iter().flat_map(|v| if little { v.to_le_bytes() } else { v.to_be_bytes() });
        header.bytes().chain(bytes).collect()
    }

    #[test]
    fn rows_come_from_the_bottom_in_either_byte_order() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let expected = ([3, 2], vec![4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
        assert_eq!(decode(Input::new("a.pfm", &file("Pf\n3 2\n-1.0\n", &values, true))).unwrap(), expected);
        assert_eq!(decode(Input::new("a.pfm", &file("Pf\n3 2\n1.0\n", &values, false))).unwrap(), expected);
        let colour = decode(Input::new("a.pfm", &file("PF 2 1 -1\n", &values, true))).unwrap();
        assert_eq!(colour, ([2, 1], vec![1.0, 4.0]));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let message = |header: &str| decode(Input::new("a.pfm", &file(header, &[0.0; 6], true))).unwrap_err().message;
        assert!(message("Pf\n3 x\n-1\n").contains("\"x\", expected a height"));
        assert!(message("Pf\n3 2\n0\n").contains("scale \"0\""));
        assert!(message("Pf\n3 3\n-1\n").contains("24 bytes behind the header, expected 36"));
        assert!(message("Pf\n0 2\n-1\n").contains("size 0 x 2"));
        assert!(message("Pf\n99999 99999\n-1\n").contains("99999"));
        assert!(decode(Input::new("a.pfm", b"Pf\n3")).unwrap_err().message.contains("the header ends, expected a width"));
    }

    proptest! {
        #[test]
        fn damage_gives_a_map_or_an_error(at: prop::sample::Index, byte: u8) {
            let mut bytes = file("Pf\n3 2\n-1.0\n", &[1.0; 6], true);
            let at = at.index(bytes.len());
            bytes[at] = byte;
            let _ = decode(Input::new("a.pfm", &bytes));
        }
    }
}

//! Records of edits as comments of a header.
//!
//! Headers are ASCII: readers of other programs stop at anything else. So a backslash is written as
//! two, and characters beyond ASCII as `\u{HEX}`. Records are single lines without control
//! characters.

/// Bytes that the records of a scene may take: well below the longest header that is read.
const MAX_BYTES: usize = 1 << 19;
/// Bytes of the rest of their lines.
const LINE_BYTES: usize = 32;

/// Checks that all of `edits` can be written and read back.
pub(crate) fn check(edits: &[String]) -> Result<(), String> {
    let is_line = |text: &str| !text.is_empty() && text.trim() == text && !text.contains(char::is_control);
    if let Some(edit) = edits.iter().find(|text| !is_line(text)) {
        return Err(format!("record of an edit {edit:?}, expected one line of text"));
    }
    let bytes: usize = edits.iter().map(|edit| escaped(edit).len() + LINE_BYTES).sum();
    if bytes > MAX_BYTES {
        let (found, limit) = (bytes.div_ceil(1024), MAX_BYTES / 1024);
        return Err(format!("records of {} edits take {found} KiB, expected {limit} at most; use fewer or shorter edits", edits.len()));
    }
    Ok(())
}

/// Returns a text as ASCII.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' => out.push_str("\\\\"),
            c if c.is_ascii() => out.push(c),
            c => out.extend(c.escape_unicode()),
        }
    }
    out
}

/// Undoes [`escaped`]; `None` for text that it does not write.
pub(super) fn unescaped(mut text: &str) -> Option<String> {
    let mut out = String::with_capacity(text.len());
    while let Some((before, escape)) = text.split_once('\\') {
        out.push_str(before);
        text = match escape.strip_prefix('\\') {
            Some(rest) => {
                out.push('\\');
                rest
            }
            None => {
                let (hex, rest) = escape.strip_prefix("u{")?.split_once('}')?;
                out.push(char::from_u32(u32::from_str_radix(hex, 16).ok()?)?);
                rest
            }
        };
    }
    out.push_str(text);
    Some(out)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn records_that_a_header_cannot_hold_are_refused() {
        for bad in ["", " gain 2", "gain 2\nproperty float x", "\u{1b}[31m"] {
            assert!(check(&["gain 2".to_owned(), bad.to_owned()]).unwrap_err().contains("expected one line of text"), "{bad:?}");
        }
        let long = vec!["where L < 1; gain 2".to_owned(); 20_000];
        assert_eq!(check(&long[..9_000]), Ok(()));
        assert!(check(&long).unwrap_err().starts_with("records of 20000 edits take 997 KiB, expected 512 at most"));
    }

    #[test]
    fn what_is_not_escaped_as_written_is_refused() {
        for text in ["\\", "a\\n", "\\u{", "\\u{}", "\\u{110000}", "\\u{d800}", "\\u{zz}", "\\u0041"] {
            assert_eq!(unescaped(text), None, "{text}");
        }
        assert_eq!(escaped("C:\\gemälde.png"), "C:\\\\gem\\u{e4}lde.png");
    }

    proptest! {
        #[test]
        fn records_are_ascii_and_read_back(text in "\\PC{0,20}(\\\\|u\\{)?\\PC{0,20}") {
            let record = escaped(&text);
            prop_assert!(record.is_ascii());
            prop_assert_eq!(unescaped(&record), Some(text));
        }
    }
}

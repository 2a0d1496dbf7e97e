//! The attributes of an OpenEXR file's header: those of a written one put in order, and one of a read
//! one hidden.
//!
//! The library that writes holds further attributes in a hash map and writes them in its order,
//! which differs from one process to the next: equal images would be unequal files. So the header
//! of a finished file is sorted by name. Its length stays, and with it every offset in the file.
//!
//! In: bytes of a single-part file. Out: the same bytes, attributes by name. A header that is not
//! understood is left as it is.

use std::borrow::Cow;

/// Bytes before the first attribute: magic number and version.
const START: usize = 8;

/// Sorts the attributes by name.
pub(super) fn sort_attributes(file: &mut [u8]) {
    let Some(mut attributes) = attributes(file) else { return };
    attributes.sort_unstable();
    let sorted: Vec<u8> = attributes.concat();
    if let Some(header) = file.get_mut(START..START + sorted.len()) {
        header.copy_from_slice(&sorted);
    }
}

/// Returns a file without the attribute `type` where it has no meaning: in files of one part that is
/// not deep the bits of the version say what it is, and OpenEXR ignores the attribute, which the
/// library takes for a contradiction.
pub(super) fn without_idle_type(file: &[u8]) -> Cow<'_, [u8]> {
    const DEEP_OR_PARTS: u8 = 0x18;
    let is_plain = file.get(5).is_some_and(|flags| flags & DEEP_OR_PARTS == 0);
    let mut at = START;
    for attribute in attributes(file).filter(|_| is_plain).unwrap_or_default() {
        if attribute.starts_with(b"type\0") {
            let mut hidden = file.to_vec();
            // Any other name is one of an attribute that is nobody's.
            hidden[at] = b'T';
            return hidden.into();
        }
        at += attribute.len();
    }
    file.into()
}

/// Returns each attribute's bytes: name, 0, type, 0, length of the value, value. An empty name ends
/// them.
fn attributes(file: &[u8]) -> Option<Vec<&[u8]>> {
    let mut rest = file.get(START..)?;
    let mut found = Vec::new();
    while *rest.first()? != 0 {
        let name = text_bytes(rest)?;
        let kind = text_bytes(rest.get(name..)?)?;
        let (length, _) = rest.get(name + kind..)?.split_first_chunk()?;
        let size = name + kind + length.len() + usize::try_from(i32::from_le_bytes(*length)).ok()?;
        found.push(rest.get(..size)?);
        rest = rest.get(size..)?;
    }
    Some(found)
}

/// Returns the length of a text with the 0 that ends it.
fn text_bytes(bytes: &[u8]) -> Option<usize> {
    bytes.iter().position(|byte| *byte == 0).map(|end| end + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_sorted_by_name_and_nothing_else_moves() {
        let mut file = b"v/1\x01\x02\0\0\0b\0int\0\x04\0\0\0\x01\0\0\0aa\0string\0\x01\0\0\0b\0\x07rest".to_vec();
        sort_attributes(&mut file);
        assert_eq!(file, b"v/1\x01\x02\0\0\0aa\0string\0\x01\0\0\0bb\0int\0\x04\0\0\0\x01\0\0\0\0\x07rest");
    }

    #[test]
    fn the_type_of_a_file_of_one_part_is_hidden() {
        let file = |flags: u8| [&b"v/1\x01\x02"[..], &[flags], b"\0\0b\0int\0\x04\0\0\0\x01\0\0\0type\0string\0\x01\0\0\0x\0"].concat();
        let hidden = without_idle_type(&file(0)).into_owned();
        assert!(hidden.windows(5).any(|name| name == b"Type\0") && hidden.len() == file(0).len());
        for flags in [8, 16] {
            assert_eq!(without_idle_type(&file(flags)).into_owned(), file(flags));
        }
    }

    #[test]
    fn headers_that_are_cut_or_lie_are_left_alone() {
        let whole = b"v/1\x01\x02\0\0\0b\0int\0\x04\0\0\0\x01\0\0\0a\0int\0\xff\xff\xff\xff".to_vec();
        for length in 0..=whole.len() {
            let mut cut = whole[..length].to_vec();
            sort_attributes(&mut cut);
            assert_eq!(cut, whole[..length]);
        }
    }
}

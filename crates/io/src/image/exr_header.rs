//! The attributes of a written OpenEXR file, put in order.
//!
//! The library that writes holds further attributes in a hash map and writes them in its order,
//! which differs from one process to the next: equal images would be unequal files. So the header
//! of a finished file is sorted by name. Its length stays, and with it every offset in the file.
//!
//! In: bytes of a single-part file. Out: the same bytes, attributes by name. A header that is not
//! understood is left as it is.

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
    fn headers_that_are_cut_or_lie_are_left_alone() {
        let whole = b"v/1\x01\x02\0\0\0b\0int\0\x04\0\0\0\x01\0\0\0a\0int\0\xff\xff\xff\xff".to_vec();
        for length in 0..=whole.len() {
            let mut cut = whole[..length].to_vec();
            sort_attributes(&mut cut);
            assert_eq!(cut, whole[..length]);
        }
    }
}

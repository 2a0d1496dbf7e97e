//! XML of other programs: parsed whole, without document types and their entities.

use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

use crate::IoError;
use crate::byte_order_mark::without_mark;
use crate::memory::check_memory;

/// Bytes of memory that a byte of XML may become, at most about.
const MEMORY_PER_BYTE: u64 = 40;

/// Returns the text of a file.
pub(super) fn text_of<'a>(path: &Path, bytes: &'a [u8]) -> Result<&'a str, IoError> {
    check_memory(path, bytes.len() as u64 * MEMORY_PER_BYTE)?;
    let text = str::from_utf8(bytes).map_err(|e| IoError::invalid(path, format!("byte {}: not UTF-8 text", e.valid_up_to())))?;
    // XMP packets are padded, and end in a zero byte with some programs.
    Ok(without_mark(text).trim_matches(['\0', ' ', '\n', '\r', '\t']))
}

/// Parses XML.
pub(super) fn parse_xml<'a>(path: &Path, text: &'a str) -> Result<Document<'a>, IoError> {
    let options = ParsingOptions { allow_dtd: false, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).map_err(|e| IoError::invalid(path, format!("not XML: {e}")))
}

/// Returns finite numbers between spaces; `None` if something else is among them.
pub(super) fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split_ascii_whitespace().map(|word| word.parse().ok().filter(|v: &f64| v.is_finite())).collect()
}

/// Returns the first child element of this name.
pub(super) fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

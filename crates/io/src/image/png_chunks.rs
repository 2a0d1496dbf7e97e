//! Chunks that are put into an encoded PNG, behind its header.

use flate2::Crc;

/// The end of the header chunk: signature 8, length 4, kind 4, content 13, checksum 4.
const AFTER_HEADER: usize = 33;

/// Returns a chunk.
pub(super) fn chunk(kind: [u8; 4], content: &[u8]) -> Vec<u8> {
    let mut crc = Crc::new();
    crc.update(&kind);
    crc.update(content);
    [&(content.len() as u32).to_be_bytes()[..], &kind, content, &crc.sum().to_be_bytes()].concat()
}

/// Puts chunks behind the header of an encoded PNG.
pub(super) fn insert(png: &mut Vec<u8>, chunks: Vec<u8>) {
    if png.len() > AFTER_HEADER {
        png.splice(AFTER_HEADER..AFTER_HEADER, chunks);
    }
}

//! Compressed blocks of OpenEXR whose heads claim sizes: held against the block before the decoder
//! allocates memory for them.
//!
//! Only DWA (DWAA and DWAB) has such heads. The other methods allocate what the block's rectangle
//! takes, which `check_header` bounds.

use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::compression::Compression;
use ::exr::error::Error as ExrError;
use ::exr::meta::header::Header;

use crate::IoError;
use crate::input::Input;

/// Counters at the start of a DWA block, little-endian u64 each: version, bytes of the sections,
/// and numbers of values in them, in the order of OpenEXR's `internal_dwa_compressor.h`.
const COUNTERS: usize = 11;

/// Refuses a block that claims more values than its pixels have.
pub(super) fn check_counts(input: Input<'_>, chunk: &Chunk, headers: &[Header]) -> Result<(), IoError> {
    // A damaged file may have a block of another part here; the decoder goes by what the block
    // says.
    let Some(header) = headers.get(chunk.layer_index) else { return Ok(()) };
    if !matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        return Ok(());
    }
    let bytes = match &chunk.compressed_block {
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        // The decoder refuses these.
        CompressedBlock::DeepScanLine(_) | CompressedBlock::DeepTile(_) => return Ok(()),
    };
    let damaged = |error: ExrError| input.invalid(format!("OpenEXR: {error}; the file is damaged, export it again"));
    let indices = header.get_block_data_indices(&chunk.compressed_block).map_err(damaged)?;
    let size = header.get_absolute_block_pixel_coordinates(indices).map_err(damaged)?.size;
    let raw = size.area().saturating_mul(header.channels.bytes_per_pixel) as u64;
    // A block that compression would not have made smaller is stored as it is. One that is cut
    // short is refused by the decoder.
    let (words, _) = bytes.as_chunks::<8>();
    let Some(head) = words.first_chunk::<COUNTERS>().filter(|_| bytes.len() as u64 != raw) else { return Ok(()) };
    let squares = (size.width().div_ceil(8) * size.height().div_ceil(8)) as u64;
    let coefficients = squares.saturating_mul(header.channels.list.len() as u64);
    let bounds = [
        (1, "bytes that are compressed without loss", raw),
        // Runs take a byte for their length.
        (6, "bytes of runs", raw.saturating_mul(2)),
        (7, "bytes in runs", raw),
        (8, "AC coefficients", coefficients.saturating_mul(64)),
        (9, "DC coefficients", coefficients),
    ];
    for (at, what, most) in bounds {
        let found = head.get(at).map_or(0, |word| u64::from_le_bytes(*word));
        if found > most {
            let message = format!(
                "OpenEXR: a DWA block of {} x {} pixels claims {found} {what}, expected at most {most}; the file is damaged, export it again",
                size.width(),
                size.height()
            );
            return Err(input.invalid(message));
        }
    }
    Ok(())
}

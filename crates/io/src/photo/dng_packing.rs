//! How a DNG packs samples: bits in rows, and rows and columns in fields.

/// Returns where element `i` of `length` lies among `fields` fields, one behind the other; the
/// first ones are longer by one where they are not of one length (DNG 1.7.1, RowInterleaveFactor
/// and ColumnInterleaveFactor).
pub(super) fn place_in_fields(i: usize, fields: usize, length: usize) -> usize {
    let field = i % fields;
    field * (length / fields) + field.min(length % fields) + i / fields
}

/// Returns the rows of packed samples, each row from a full byte on; 16-bit samples in the file's
/// byte order.
pub(super) fn unpack(bytes: &[u8], row: usize, rows: usize, bits: usize, is_big_endian: bool) -> Option<Vec<u16>> {
    let row_bytes = (row * bits).div_ceil(8);
    let bytes = bytes.get(..row_bytes.checked_mul(rows)?)?;
    let mut out = Vec::with_capacity(row * rows);
    for bytes in bytes.chunks_exact(row_bytes.max(1)) {
        match bits {
            8 => out.extend(bytes.iter().map(|b| u16::from(*b))),
            16 if is_big_endian => out.extend(bytes.as_chunks().0.iter().map(|b| u16::from_be_bytes(*b))),
            16 => out.extend(bytes.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b))),
            _ => out.extend((0..row).map(|i| {
                let bit = i * bits;
                let window = (0..3).fold(0u32, |w, k| w << 8 | u32::from(bytes.get(bit / 8 + k).copied().unwrap_or(0)));
                (window >> (24 - bits - bit % 8) & ((1 << bits) - 1)) as u16
            })),
        }
    }
    Some(out)
}

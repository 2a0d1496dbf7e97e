//! Accessors: numbers of a buffer as rows of f32.

use super::document::Document;

/// Returns the bytes of an accessor's component.
fn component_bytes(kind: u32) -> Option<usize> {
    match kind {
        5120 | 5121 => Some(1),
        5122 | 5123 => Some(2),
        5126 => Some(4),
        _ => None,
    }
}

/// Decodes one component; integers are normalised if `normalized`.
fn component(bytes: &[u8], kind: u32, normalized: bool) -> f32 {
    let (value, most) = match (kind, bytes) {
        (5120, [a, ..]) => (f32::from(*a as i8), 127.0),
        (5121, [a, ..]) => (f32::from(*a), 255.0),
        (5122, [a, b, ..]) => (f32::from(i16::from_le_bytes([*a, *b])), 32767.0),
        (5123, [a, b, ..]) => (f32::from(u16::from_le_bytes([*a, *b])), 65535.0),
        (_, [a, b, c, d, ..]) => return f32::from_le_bytes([*a, *b, *c, *d]),
        _ => return 0.0,
    };
    if normalized { (value / most).max(-1.0) } else { value }
}

/// Returns all rows of accessor `index`, `width` numbers each, flattened, finite or not; the error
/// explains what is wrong.
pub(super) fn read(document: &Document, bin: &[u8], index: usize, width: usize) -> Result<Vec<f32>, String> {
    let accessor = document.accessors.get(index).ok_or_else(|| format!("accessor {index} does not exist"))?;
    let invalid = |message: String| format!("accessor {index}: {message}");
    let found = match accessor.kind.as_str() {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        other => return Err(invalid(format!("type {other:?}, expected numbers or vectors"))),
    };
    if found != width {
        return Err(invalid(format!("{} of {found} components, expected {width}", accessor.kind)));
    }
    if accessor.sparse.is_some() {
        return Err(invalid("is sparse, which is not supported; export it dense".into()));
    }
    let kind = accessor.component_type;
    let size = component_bytes(kind).ok_or_else(|| invalid(format!("component type {kind}, expected bytes, shorts or floats")))?;
    let view = accessor.buffer_view.and_then(|view| document.buffer_views.get(view));
    let view = view.ok_or_else(|| invalid("no buffer view: compressed, or the file is damaged".into()))?;
    let buffer = document.buffers.get(view.buffer).ok_or_else(|| invalid(format!("buffer {} does not exist", view.buffer)))?;
    if view.buffer != 0 || buffer.uri.is_some() {
        return Err(invalid("lies outside of this file; export as one .glb".into()));
    }
    let end = view.byte_offset.checked_add(view.byte_length);
    let data = end.and_then(|end| bin.get(view.byte_offset..end)).and_then(|data| data.get(accessor.byte_offset..));
    let data = data.ok_or_else(|| invalid(format!("lies beyond the {} bytes of the file's buffer; the file is truncated", bin.len())))?;
    let row = size * width;
    let stride = view.byte_stride.unwrap_or(row);
    let needed = accessor.count.checked_sub(1).map_or(Some(0), |n| n.checked_mul(stride)?.checked_add(row));
    if stride < row || needed.is_none_or(|needed| needed > data.len()) {
        return Err(invalid(format!("{} rows of {row} bytes in {} bytes; the file is truncated", accessor.count, data.len())));
    }
    let values_bytes = (accessor.count as u64).saturating_mul(4 * width as u64);
    document.spend(values_bytes, bin.len() as u64).map_err(invalid)?;
    let mut values = Vec::new();
    values.try_reserve_exact(accessor.count * width).map_err(|e| invalid(format!("{} rows: {e}", accessor.count)))?;
    for row in data.chunks(stride).take(accessor.count) {
        values.extend(row.chunks_exact(size).take(width).map(|bytes| component(bytes, kind, accessor.normalized)));
    }
    Ok(values)
}

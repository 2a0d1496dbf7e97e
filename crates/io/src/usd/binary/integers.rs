//! The two compressions of crate files: LZ4 in chunks, and integers as differences.
//!
//! Integers: the most frequent difference to the integer before, two bits for each integer (that
//! difference, or one of 8, 16 or 32 bits), and the other differences, all through LZ4.

use std::collections::HashMap;

/// LZ4 at most makes one byte of 255.
const LZ4_EXPANSION: usize = 255;

/// Compresses bytes: a zero, for a single chunk, and a block of LZ4.
///
/// Tables of more than 2 GiB would need several chunks; those of splats are far from it.
pub(super) fn compressed(bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![0];
    out.extend(lz4_flex::block::compress(bytes));
    out
}

/// Decompresses what [`compressed`] makes into `length` bytes at most.
///
/// # Errors
/// Bytes that are no such compression, or hold more.
pub(super) fn decompressed(bytes: &[u8], length: usize) -> Result<Vec<u8>, String> {
    let (&chunks, mut rest) = bytes.split_first().ok_or("an empty compressed table")?;
    if length > bytes.len().saturating_mul(LZ4_EXPANSION).saturating_add(64) {
        return Err(format!("{} compressed bytes cannot hold {length}", bytes.len()));
    }
    let block = |bytes: &[u8], room: usize| lz4_flex::block::decompress(bytes, room).map_err(|e| format!("damaged compression: {e}"));
    if chunks == 0 {
        return block(rest, length);
    }
    let mut out = Vec::new();
    for _ in 0..chunks {
        let (size, behind) = rest.split_first_chunk::<4>().ok_or("a compressed chunk is truncated")?;
        let size = usize::try_from(i32::from_le_bytes(*size)).map_err(|_| "a compressed chunk has a negative size")?;
        let (chunk, behind) = behind.split_at_checked(size).ok_or("a compressed chunk is truncated")?;
        out.extend(block(chunk, length - out.len().min(length))?);
        rest = behind;
    }
    Ok(out)
}

/// Returns the code of a difference: the number of bits that hold it.
fn code(difference: i32, common: i32) -> u8 {
    match difference {
        d if d == common => 0,
        d if i8::try_from(d).is_ok() => 1,
        d if i16::try_from(d).is_ok() => 2,
        _ => 3,
    }
}

/// Compresses integers.
pub(super) fn compressed_integers(values: &[u32]) -> Vec<u8> {
    if values.is_empty() {
        return Vec::new();
    }
    let mut previous = 0u32;
    let mut differences = Vec::with_capacity(values.len());
    let mut counts: HashMap<i32, usize> = HashMap::new();
    for &value in values {
        let difference = value.wrapping_sub(previous) as i32;
        differences.push(difference);
        *counts.entry(difference).or_default() += 1;
        previous = value;
    }
    // Of equally frequent ones the largest, so that equal input makes equal files.
    let common = counts.into_iter().max_by_key(|(difference, count)| (*count, *difference)).map_or(0, |(difference, _)| difference);
    let mut bytes = common.to_le_bytes().to_vec();
    let codes = differences.chunks(4).map(|four| {
        let place = |(i, d): (usize, &i32)| code(*d, common) << (2 * i);
        four.iter().enumerate().map(place).fold(0, |byte, bits| byte | bits)
    });
    bytes.extend(codes);
    for difference in differences {
        match code(difference, common) {
            0 => {}
            1 => bytes.push(difference as u8),
            2 => bytes.extend((difference as i16).to_le_bytes()),
            _ => bytes.extend(difference.to_le_bytes()),
        }
    }
    compressed(&bytes)
}

/// Decompresses `count` integers.
///
/// # Errors
/// Bytes that hold fewer.
pub(super) fn decompressed_integers(bytes: &[u8], count: usize) -> Result<Vec<u32>, String> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let codes_len = count.div_ceil(4);
    let most =
        codes_len.checked_add(4).and_then(|length| length.checked_add(count.checked_mul(4)?)).ok_or("a count that no memory holds")?;
    // A count that the bytes can hold, before memory is taken for it.
    if codes_len > bytes.len().saturating_mul(LZ4_EXPANSION) {
        return Err(format!("{} compressed bytes cannot hold {count} integers", bytes.len()));
    }
    let room = most.min(bytes.len().saturating_mul(LZ4_EXPANSION).saturating_add(64));
    let plain = decompressed(bytes, room)?;
    let short = || format!("compressed integers end early, expected {count}");
    let (common, rest) = plain.split_first_chunk::<4>().ok_or_else(short)?;
    let common = i32::from_le_bytes(*common);
    let (codes, mut rest) = rest.split_at_checked(codes_len).ok_or_else(short)?;
    let mut values = Vec::new();
    values.try_reserve_exact(count).map_err(|e| format!("{count} integers: {e}"))?;
    let mut value = 0u32;
    for i in 0..count {
        let difference = match codes[i / 4] >> (2 * (i % 4)) & 3 {
            0 => common,
            1 => i32::from(i8::from_le_bytes(*take(&mut rest).ok_or_else(short)?)),
            2 => i32::from(i16::from_le_bytes(*take(&mut rest).ok_or_else(short)?)),
            _ => i32::from_le_bytes(*take(&mut rest).ok_or_else(short)?),
        };
        value = value.wrapping_add_signed(difference);
        values.push(value);
    }
    Ok(values)
}

fn take<'a, const N: usize>(rest: &mut &'a [u8]) -> Option<&'a [u8; N]> {
    let (bytes, behind) = rest.split_first_chunk::<N>()?;
    *rest = behind;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn integers_come_back(values in proptest::collection::vec(any::<u32>(), 0..200)) {
            prop_assert_eq!(decompressed_integers(&compressed_integers(&values), values.len()).unwrap(), values);
        }

        #[test]
        fn small_steps_come_back(steps in proptest::collection::vec(-300i32..300, 1..200)) {
            let values: Vec<u32> = steps.iter().scan(0u32, |sum, step| { *sum = sum.wrapping_add_signed(*step); Some(*sum) }).collect();
            prop_assert_eq!(decompressed_integers(&compressed_integers(&values), values.len()).unwrap(), values);
        }

        #[test]
        fn damaged_bytes_are_errors(bytes in proptest::collection::vec(any::<u8>(), 0..64), count in 0usize..1 << 40) {
            let _ = decompressed_integers(&bytes, count);
            let _ = decompressed(&bytes, count);
        }
    }

    #[test]
    fn a_count_beyond_what_bytes_hold_takes_no_memory() {
        let error = decompressed_integers(&compressed_integers(&[1, 2, 3]), usize::MAX / 8).unwrap_err();
        assert!(error.contains("cannot hold"), "{error}");
    }
}

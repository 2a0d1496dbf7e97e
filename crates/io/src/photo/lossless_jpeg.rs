//! Lossless JPEG (ITU-T T.81, annex H) as DNG holds it: 2 to 16 bits, one to four interleaved
//! components, all seven predictors.
//!
//! In: the bytes of one tile or strip. Out: samples `[H * W * components]`, u16. Bayer tiles come
//! as two or four components of half the width, which libraries for pictures refuse.
//!
//! Degenerate: data that ends early, codes that no table has, or more samples than expected are
//! errors.

use crate::image::guard::zeros;

/// Samples of a tile.
#[derive(Debug, PartialEq)]
pub(super) struct LosslessJpeg {
    /// Samples of a row: width times components.
    pub(super) row: usize,
    /// Rows.
    pub(super) rows: usize,
    /// Row by row.
    pub(super) samples: Vec<u16>,
}

struct JpegFrame {
    precision: u32,
    rows: usize,
    columns: usize,
    /// Identifiers.
    components: Vec<u8>,
}

struct Scan {
    /// Table of each component.
    tables: Vec<usize>,
    predictor: u8,
    point_transform: u32,
}

/// Returns the bits of a picture that is compressed by DCT, which lossless JPEG is not.
pub(super) fn dct_precision(bytes: &[u8]) -> Option<u8> {
    let mut rest = bytes.strip_prefix(&[0xff, 0xd8])?;
    loop {
        let [0xff, marker, high, low] = *rest.first_chunk::<4>()? else { return None };
        let segment = rest.get(4..)?;
        match marker {
            0xc0..=0xc2 => return segment.first().copied(),
            0xc3 | 0xda => return None,
            0xff => rest = rest.get(1..)?,
            _ => rest = rest.get(usize::from(u16::from_be_bytes([high, low])) + 2..)?,
        }
    }
}

/// Decodes a tile of at most `max_samples` samples.
pub(super) fn decode(bytes: &[u8], max_samples: usize) -> Result<LosslessJpeg, String> {
    let mut rest = bytes.strip_prefix(&[0xff, 0xd8]).ok_or("no start-of-image marker")?;
    let mut tables: [Option<Huffman>; 4] = [None, None, None, None];
    let mut frame: Option<JpegFrame> = None;
    let mut restart_interval = 0usize;
    loop {
        let [0xff, marker, high, low] = *rest.first_chunk::<4>().ok_or("cut short before its data")? else {
            return Err("no marker where one is expected".into());
        };
        if marker == 0xff {
            rest = rest.get(1..).unwrap_or_default();
            continue;
        }
        let length = usize::from(u16::from_be_bytes([high, low]));
        let segment = rest.get(4..length + 2).ok_or("a segment is cut short")?;
        rest = rest.get(length + 2..).ok_or("cut short after a segment")?;
        match marker {
            0xc3 => frame = Some(read_frame(segment, max_samples)?),
            0xc0..=0xc2 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => return Err("it is JPEG, but not lossless JPEG".into()),
            0xc4 => read_tables(segment, &mut tables)?,
            0xdd => restart_interval = segment.first_chunk().map_or(0, |b| usize::from(u16::from_be_bytes(*b))),
            0xda => {
                let frame = frame.ok_or("no frame header before the data")?;
                let scan = read_scan(segment, &frame)?;
                return decode_scan(rest, &frame, &scan, &tables, restart_interval);
            }
            _ => {}
        }
    }
}

fn read_frame(segment: &[u8], max_samples: usize) -> Result<JpegFrame, String> {
    let [precision, h1, h0, w1, w0, count] = *segment.first_chunk::<6>().ok_or("the frame header is cut short")?;
    let (rows, columns) = (usize::from(u16::from_be_bytes([h1, h0])), usize::from(u16::from_be_bytes([w1, w0])));
    let count = usize::from(count);
    if !(2..=16).contains(&precision) || !(1..=4).contains(&count) || rows * columns == 0 || rows * columns * count > max_samples {
        return Err(format!("{columns} x {rows} pixels of {count} components of {precision} bits, expected at most {max_samples} samples"));
    }
    let specs = segment.get(6..6 + 3 * count).ok_or("the frame header is cut short")?;
    if specs.chunks_exact(3).any(|spec| spec.get(1) != Some(&0x11)) {
        return Err("subsampled components".into());
    }
    let components = specs.chunks_exact(3).filter_map(|spec| spec.first().copied()).collect();
    Ok(JpegFrame { precision: precision.into(), rows, columns, components })
}

fn read_scan(segment: &[u8], frame: &JpegFrame) -> Result<Scan, String> {
    let count = frame.components.len();
    let (&found, specs) = segment.split_first().ok_or("the scan header is empty")?;
    let (Some(specs), Some(&[predictor, _, transform])) = (specs.get(..2 * count), specs.get(2 * count..2 * count + 3)) else {
        return Err("the scan header is cut short".into());
    };
    if usize::from(found) != count {
        return Err(format!("{found} of {count} components in a scan, expected all of them"));
    }
    let point_transform = u32::from(transform & 15);
    if !(1..=7).contains(&predictor) || point_transform >= frame.precision {
        return Err(format!("predictor {predictor} with point transform {point_transform}"));
    }
    let tables = specs.chunks_exact(2).map(|spec| usize::from(spec.get(1).copied().unwrap_or(0) >> 4)).collect();
    Ok(Scan { tables, predictor, point_transform })
}

fn read_tables(segment: &[u8], tables: &mut [Option<Huffman>; 4]) -> Result<(), String> {
    let mut rest = segment;
    while let Some((&head, after)) = rest.split_first() {
        let (lengths, after) = after.split_first_chunk::<16>().ok_or("a Huffman table is cut short")?;
        let count: usize = lengths.iter().map(|n| usize::from(*n)).sum();
        let (values, after) = after.split_at_checked(count).ok_or("a Huffman table is cut short")?;
        if let Some(table) = tables.get_mut(usize::from(head & 15)) {
            *table = Some(Huffman::new(lengths, values)?);
        }
        rest = after;
    }
    Ok(())
}

/// Bits of the longest code that is looked up at once.
const LOOKUP_BITS: u32 = 9;

/// A canonical code.
struct Huffman {
    /// By the next [`LOOKUP_BITS`] bits: length of the code and its value, length 0 if it is
    /// longer.
    lookup: Vec<(u8, u8)>,
    /// By length: first code behind those of the length, left-aligned to 16 bits, and where its
    /// values end.
    limits: [(u32, usize); 17],
    values: Vec<u8>,
}

impl Huffman {
    fn new(lengths: &[u8; 16], values: &[u8]) -> Result<Self, String> {
        let mut lookup = vec![(0u8, 0u8); 1 << LOOKUP_BITS];
        let mut limits = [(0u32, 0usize); 17];
        let (mut code, mut next) = (0u32, 0usize);
        for (length, &count) in (1u32..).zip(lengths) {
            for _ in 0..count {
                let value = values.get(next).copied().unwrap_or(0);
                if value > 16 || code >= 1 << length {
                    return Err("a Huffman table is not a code of lossless JPEG".into());
                }
                if length <= LOOKUP_BITS {
                    let first = (code << (LOOKUP_BITS - length)) as usize;
                    let span = 1usize << (LOOKUP_BITS - length);
                    lookup.iter_mut().skip(first).take(span).for_each(|slot| *slot = (length as u8, value));
                }
                code += 1;
                next += 1;
            }
            limits[length as usize] = (code << (16 - length), next);
            code <<= 1;
        }
        Ok(Self { lookup, limits, values: values.to_vec() })
    }

    fn decode(&self, bits: &mut Bits<'_>) -> Result<u32, String> {
        let ahead = bits.peek16();
        if let Some(&(length, value)) = self.lookup.get((ahead >> (16 - LOOKUP_BITS)) as usize).filter(|(length, _)| *length > 0) {
            bits.skip(length.into())?;
            return Ok(value.into());
        }
        for length in LOOKUP_BITS + 1..=16 {
            let (limit, end) = self.limits[length as usize];
            if ahead < limit {
                bits.skip(length)?;
                let back = ((limit - 1 - ahead) >> (16 - length)) as usize;
                let value = end.checked_sub(1 + back).and_then(|i| self.values.get(i));
                return value.map(|v| u32::from(*v)).ok_or_else(|| "a code that no table has".into());
            }
        }
        Err("a code that no table has".into())
    }
}

/// Bits of entropy-coded data, the most significant first.
struct Bits<'a> {
    rest: &'a [u8],
    buffer: u64,
    count: u32,
    /// Bits made up behind the end.
    beyond: u32,
}

impl<'a> Bits<'a> {
    fn new(rest: &'a [u8]) -> Self {
        Self { rest, buffer: 0, count: 0, beyond: 0 }
    }

    fn fill(&mut self) {
        while self.count <= 48 {
            let (byte, used) = match *self.rest {
                [0xff, 0x00, ..] => (0xff, 2),
                // A marker: data ends here.
                [0xff, ..] | [] => {
                    self.beyond += 8;
                    (0, 0)
                }
                [byte, ..] => (byte, 1),
            };
            self.rest = self.rest.get(used..).unwrap_or_default();
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    fn peek16(&mut self) -> u32 {
        if self.count < 16 {
            self.fill();
        }
        (self.buffer >> (self.count - 16)) as u32 & 0xffff
    }

    fn skip(&mut self, bits: u32) -> Result<(), String> {
        self.count -= bits.min(self.count);
        if self.beyond > self.count { Err("its data is cut short".into()) } else { Ok(()) }
    }

    /// Returns the difference of a category (T.81, table H.2).
    fn difference(&mut self, category: u32) -> Result<i32, String> {
        match category {
            0 => Ok(0),
            16 => Ok(32768),
            _ => {
                let raw = (self.peek16() >> (16 - category)) as i32;
                self.skip(category)?;
                Ok(if raw < 1 << (category - 1) { raw - (1 << category) + 1 } else { raw })
            }
        }
    }

    /// Continues behind the next restart marker.
    fn restart(&mut self) -> Result<(), String> {
        match *self.rest {
            [0xff, 0xd0..=0xd7, ref after @ ..] => {
                *self = Self::new(after);
                Ok(())
            }
            _ => Err("no restart marker where one is expected".into()),
        }
    }
}

fn decode_scan(
    data: &[u8],
    frame: &JpegFrame,
    scan: &Scan,
    tables: &[Option<Huffman>; 4],
    restart_interval: usize,
) -> Result<LosslessJpeg, String> {
    let count = frame.components.len();
    if !restart_interval.is_multiple_of(frame.columns) {
        return Err(format!("restarts every {restart_interval} pixels, expected whole rows of {}", frame.columns));
    }
    let tables: Vec<&Huffman> = scan
        .tables
        .iter()
        .map(|&t| tables.get(t).and_then(Option::as_ref).ok_or_else(|| format!("Huffman table {t} is missing")))
        .collect::<Result<_, _>>()?;
    let row = frame.columns * count;
    let mut samples = zeros::<u16>(row * frame.rows)?;
    let mut bits = Bits::new(data);
    let first = 1i32 << (frame.precision - scan.point_transform - 1);
    let rows_between = restart_interval / frame.columns;
    for y in 0..frame.rows {
        let is_fresh = y == 0 || (rows_between > 0 && y.is_multiple_of(rows_between));
        if is_fresh && y > 0 {
            bits.restart()?;
        }
        let (above, here) = samples.split_at_mut(y * row);
        let above = above.get(above.len().saturating_sub(row)..).unwrap_or_default();
        let up = |i: usize| above.get(i).copied().map_or(0, i32::from);
        for i in 0..row {
            let table = tables[i % count];
            let category = table.decode(&mut bits)?;
            let difference = bits.difference(category)?;
            let left = if i >= count { i32::from(here[i - count]) } else { 0 };
            let prediction = match (i < count, is_fresh) {
                (true, true) => first,
                (false, true) => left,
                (true, false) => up(i),
                (false, false) => predict(scan.predictor, left, up(i), up(i - count)),
            };
            here[i] = (prediction + difference) as u16;
        }
    }
    if scan.point_transform > 0 {
        samples.iter_mut().for_each(|s| *s <<= scan.point_transform);
    }
    Ok(LosslessJpeg { row, rows: frame.rows, samples })
}

/// Predicts a sample (T.81, table H.1).
fn predict(predictor: u8, a: i32, b: i32, c: i32) -> i32 {
    match predictor {
        1 => a,
        2 => b,
        3 => c,
        4 => a + b - c,
        5 => a + ((b - c) >> 1),
        6 => b + ((a - c) >> 1),
        _ => (a + b) >> 1,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns a lossless JPEG of any samples, for tests: each category has a code of five bits.
    pub(in crate::photo) fn encode(samples: &[u16], columns: usize, components: usize, predictor: u8) -> Vec<u8> {
        let rows = samples.len() / (columns * components);
        let mut out = vec![0xff, 0xd8, 0xff, 0xc3, 0, 8 + 3 * components as u8, 16];
        out.extend((rows as u16).to_be_bytes());
        out.extend((columns as u16).to_be_bytes());
        out.push(components as u8);
        (0..components as u8).for_each(|c| out.extend([c, 0x11, 0]));
        out.extend([0xff, 0xc4, 0, 19 + 17, 0, 0, 0, 0, 0, 17, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        out.extend(0..=16u8);
        out.extend([0xff, 0xda, 0, 6 + 2 * components as u8, components as u8]);
        (0..components as u8).for_each(|c| out.extend([c, 0]));
        out.extend([predictor, 0, 0]);
        let row = columns * components;
        let (mut buffer, mut count) = (0u64, 0u32);
        let mut put = |value: u32, bits: u32, out: &mut Vec<u8>| {
            buffer = buffer << bits | u64::from(value);
            count += bits;
            while count >= 8 {
                let byte = (buffer >> (count - 8)) as u8;
                out.push(byte);
                if byte == 0xff {
                    out.push(0);
                }
                count -= 8;
            }
        };
        for (i, &sample) in samples.iter().enumerate() {
            let (x, y) = (i % row, i / row);
            let at = |back: usize| i32::from(samples[i - back]);
            let prediction = match (x < components, y == 0) {
                (true, true) => 1 << 15,
                (false, true) => at(components),
                (true, false) => at(row),
                (false, false) => predict(predictor, at(components), at(row), at(row + components)),
            };
            let wrapped = i32::from((i32::from(sample) - prediction) as u16 as i16);
            let difference = if wrapped == -32768 { 32768 } else { wrapped };
            let category = 32 - difference.unsigned_abs().leading_zeros();
            put(category, 5, &mut out);
            if (1..16).contains(&category) {
                let raw = if difference < 0 { difference - 1 } else { difference } as u32;
                put(raw & ((1 << category) - 1), category, &mut out);
            }
        }
        put(0x7f, 7, &mut out);
        out.extend([0xff, 0xd9]);
        out
    }

    fn samples(count: usize) -> Vec<u16> {
        (0..count).map(|i| ((i * i * 2654435761) >> (i % 7)) as u16).collect()
    }

    #[test]
    fn every_predictor_and_number_of_components_comes_back() {
        for predictor in 1..=7 {
            for components in 1..=4 {
                let expected = samples(9 * 5 * components);
                let decoded = decode(&encode(&expected, 9, components, predictor), 1000).unwrap();
                assert_eq!((decoded.row, decoded.rows), (9 * components, 5));
                assert_eq!(decoded.samples, expected, "predictor {predictor}, {components} components");
            }
        }
    }

    #[test]
    fn damage_is_an_error() {
        let whole = encode(&samples(200), 10, 2, 1);
        for cut in 0..whole.len() - 4 {
            assert!(decode(&whole[..cut], 1000).is_err(), "{cut}");
        }
        assert!(decode(&whole, 199).unwrap_err().contains("expected at most 199"));
        let mut baseline = whole;
        baseline[3] = 0xc0;
        assert_eq!((dct_precision(&baseline), dct_precision(&encode(&samples(200), 10, 2, 1))), (Some(16), None));
        assert!(decode(&baseline, 1000).unwrap_err().contains("not lossless"));
    }
}

//! The rows of an element: chosen properties of every row as f32, whatever type and format they are
//! written in.
//!
//! Row counts are claims: they are checked against the length of the file before anything is
//! allocated or read.

use std::io::BufRead;

use crate::IoError;
use crate::memory::check_memory;
use crate::ply::header::{Element, Format, Header, Kind, Scalar};
use crate::ply::source::PlySource;
use crate::validity::LeftOut;

/// Bytes read at a time.
const BLOCK: usize = 1 << 20;
/// Bytes behind the last row that are not worth a word: a line feed, or padding to a word.
const MOST_BEYOND: u64 = 16;

/// Reads on to the end of the elements before `name`, and returns that element.
pub(super) fn seek_element<'h, R: BufRead>(source: &mut PlySource<'_, R>, header: &'h Header, name: &str) -> Result<&'h Element, IoError> {
    for element in &header.elements {
        if element.name == name {
            return Ok(element);
        }
        skip_element(source, element, header.format)?;
    }
    Err(source.invalid("header", format_args!("no element {name:?}, expected one with the property x")))
}

/// Rows that were left out.
#[derive(Debug, Default)]
pub(super) struct LeftOutRows {
    rows: LeftOut,
    /// The first of them.
    first: Option<IoError>,
}

impl LeftOutRows {
    /// Returns how many of `rows` rows were left out.
    ///
    /// # Errors
    /// None is left; the error describes the first.
    pub(super) fn of_rows(self, rows: u64) -> Result<LeftOut, IoError> {
        match self.first {
            Some(error) if self.rows.total() == rows => Err(error),
            _ => Ok(self.rows),
        }
    }

    /// Adds rows that hold no rotation; `first` describes the first of them.
    pub(super) fn add_unturned(&mut self, rows: u64, first: Option<IoError>) {
        self.rows.unturned += rows;
        self.first = self.first.take().or(first);
    }

    /// Returns an error about the first row that was left out, if there is one.
    ///
    /// # Errors
    /// Any row was left out.
    pub(super) fn none(self) -> Result<(), IoError> {
        self.first.map_or(Ok(()), Err)
    }
}

/// Calls `each(row, values, leading)` for every row of `element`, the values in the order of
/// `columns` (indices of properties), the first three also with all their digits. Rows with a value
/// that is not finite are left out (an infinite `opacity` is bounded).
pub(super) fn read_rows<R: BufRead>(
    source: &mut PlySource<'_, R>,
    element: &Element,
    format: Format,
    columns: &[usize],
    mut each: impl FnMut(u64, &[f32], [f64; 3]) -> Result<(), IoError>,
) -> Result<LeftOutRows, IoError> {
    let scalars = scalars(source, element)?;
    let mut values = vec![0f32; columns.len()];
    let mut leading = [0f64; 3];
    let opacity = columns.iter().position(|&c| element.properties[c].name == "opacity");
    let mut left_out = LeftOutRows::default();
    let mut is_finite = |source: &PlySource<'_, R>, row: u64, values: &[f32]| {
        let Some(at) = values.iter().position(|v| !v.is_finite()) else { return true };
        left_out.rows.unfinite += 1;
        left_out.first.get_or_insert_with(|| {
            let name = &element.properties[columns[at]].name;
            let place = format!("{} {row}", element.name);
            source.invalid(place, format_args!("property {name:?} is {}, expected a finite number", values[at]))
        });
        false
    };
    if format == Format::Ascii {
        let mut line = Vec::new();
        for row in 0..element.count {
            let text = text_row(source, element, row, &mut line)?;
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            for (value, &column) in values.iter_mut().zip(columns) {
                *value = parse_word(source, element, row, column, words.get(column).copied())?;
            }
            for (value, &column) in leading.iter_mut().zip(columns) {
                *value = parse_word(source, element, row, column, words.get(column).copied())?;
            }
            bound_opacity(&mut values, opacity);
            if is_finite(source, row, &values) {
                each(row, &values, leading)?;
            }
        }
        return Ok(left_out);
    }
    let mut offsets = Vec::with_capacity(scalars.len());
    let mut stride = 0;
    for scalar in &scalars {
        offsets.push(stride);
        stride += scalar.size();
    }
    let cells: Vec<(usize, Scalar)> = columns.iter().map(|&c| (offsets[c], scalars[c])).collect();
    let mut block = vec![0u8; (BLOCK / stride.max(1)).max(1) * stride];
    let mut row = 0;
    while row < element.count {
        let rows = (element.count - row).min((block.len() / stride.max(1)) as u64);
        let part = &mut block[..rows as usize * stride];
        source.fill(part)?;
        for bytes in part.chunks_exact(stride) {
            for (value, &(offset, scalar)) in values.iter_mut().zip(&cells) {
                *value = number(&bytes[offset..], scalar, format);
            }
            for ((wide, value), &(offset, scalar)) in leading.iter_mut().zip(&values).zip(&cells) {
                *wide = if scalar == Scalar::F64 { f64::from_le_bytes(little(&bytes[offset..], format)) } else { (*value).into() };
            }
            bound_opacity(&mut values, opacity);
            if is_finite(source, row, &values) {
                each(row, &values, leading)?;
            }
            row += 1;
        }
    }
    Ok(left_out)
}

/// Limits logits of opacities of 0 and 1, which are infinite and written so by programs that unpack
/// bytes, to the nearest ones that an engine accepts.
fn bound_opacity(values: &mut [f32], opacity: Option<usize>) {
    if let Some(value) = opacity.and_then(|at| values.get_mut(at)).filter(|v| v.is_infinite()) {
        *value = luxel_core::logit(if *value > 0.0 { 1.0 } else { 0.0 });
    }
}

/// Type of properties that are bits rather than numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Whole {
    U8,
    U32,
}

/// Reads rows of whole numbers as [`read_rows`] does, to the bit; all of `columns` must be of the
/// type.
pub(super) fn read_whole_rows<R: BufRead>(
    source: &mut PlySource<'_, R>,
    element: &Element,
    format: Format,
    columns: &[usize],
    kind: Whole,
    mut each: impl FnMut(u64, &[u32]) -> Result<(), IoError>,
) -> Result<(), IoError> {
    let scalars = scalars(source, element)?;
    let expected = match kind {
        Whole::U8 => Scalar::U8,
        Whole::U32 => Scalar::U32,
    };
    if let Some(&column) = columns.iter().find(|&&c| scalars[c] != expected) {
        let name = &element.properties[column].name;
        return Err(source.invalid("header", format_args!("property {name:?} is {:?}, expected {expected:?}", scalars[column])));
    }
    let mut values = vec![0u32; columns.len()];
    if format == Format::Ascii {
        let mut line = Vec::new();
        for row in 0..element.count {
            let text = text_row(source, element, row, &mut line)?;
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            for (value, &column) in values.iter_mut().zip(columns) {
                *value = parse_word(source, element, row, column, words.get(column).copied())?;
            }
            each(row, &values)?;
        }
        return Ok(());
    }
    let offset = |column: usize| scalars[..column].iter().map(|s| s.size()).sum::<usize>();
    let offsets: Vec<usize> = columns.iter().map(|&c| offset(c)).collect();
    let mut bytes = vec![0u8; offset(scalars.len())];
    for row in 0..element.count {
        source.fill(&mut bytes)?;
        for (value, &at) in values.iter_mut().zip(&offsets) {
            // Unsigned and of at most 32 bits.
            *value = whole(&bytes[at..], expected, format) as u32;
        }
        each(row, &values)?;
    }
    Ok(())
}

/// Returns the types of an element's properties, once its count has been checked against the rest
/// of the file.
fn scalars<R: BufRead>(source: &PlySource<'_, R>, element: &Element) -> Result<Vec<Scalar>, IoError> {
    element
        .properties
        .iter()
        .map(|p| match p.kind {
            Kind::Scalar(scalar) => Ok(scalar),
            Kind::List { .. } => {
                let message = format!("element {:?}: property {:?} is a list, expected numbers", element.name, p.name);
                Err(IoError::unsupported(source.path, message))
            }
        })
        .collect()
}

/// Checks the number of rows an element claims against the bytes that are left, and returns it as a
/// size for reserving memory.
pub(super) fn check_count<R: BufRead>(source: &PlySource<'_, R>, element: &Element, format: Format) -> Result<usize, IoError> {
    let scalars = scalars(source, element)?;
    // In text a number takes two bytes at least, but for the very last one.
    let (stride, slack) = match format {
        Format::Ascii => (2 * scalars.len() as u64, 1),
        _ => (scalars.iter().map(|s| s.size() as u64).sum(), 0),
    };
    let available = source.remaining() + slack;
    if stride == 0 || element.count.checked_mul(stride).is_none_or(|needed| needed > available) {
        let row = available.checked_div(stride).unwrap_or(0);
        return Err(source.invalid(
            format_args!("{} {row}", element.name),
            format_args!(
                "file ends at byte {}, expected {} rows of {stride} bytes from byte {} on; the file is truncated or its header wrong",
                source.length, element.count, source.position
            ),
        ));
    }
    // Every number becomes an f32.
    check_memory(source.path, element.count.saturating_mul(4 * scalars.len() as u64))?;
    usize::try_from(element.count)
        .map_err(|_| source.invalid("header", format_args!("{} rows are too many for this machine", element.count)))
}

/// Returns a warning about bytes behind the last row of a file, which its header does not explain.
/// `last` is the element that was read last.
pub(super) fn beyond_line<R: BufRead>(source: &PlySource<'_, R>, header: &Header, last: &str) -> Option<String> {
    let element = header.elements.last().filter(|element| element.name == last)?;
    let beyond = source.remaining();
    (beyond > MOST_BEYOND).then(|| {
        format!("left out, behind the {} rows of {last:?} that the header counts: {beyond} bytes; is that number right?", element.count)
    })
}

fn skip_element<R: BufRead>(source: &mut PlySource<'_, R>, element: &Element, format: Format) -> Result<(), IoError> {
    if element.properties.is_empty() {
        return Ok(());
    }
    if format == Format::Ascii {
        let mut line = Vec::new();
        for row in 0..element.count {
            text_row(source, element, row, &mut line)?;
        }
        return Ok(());
    }
    let is_fixed = element.properties.iter().all(|p| matches!(p.kind, Kind::Scalar(_)));
    if is_fixed {
        let rows = check_count(source, element, format)? as u64;
        let stride: usize = scalars(source, element)?.iter().map(|s| s.size()).sum();
        return source.skip(rows * stride as u64);
    }
    for row in 0..element.count {
        for property in &element.properties {
            match property.kind {
                Kind::Scalar(scalar) => source.skip(scalar.size() as u64)?,
                Kind::List { count, item } => {
                    let mut bytes = [0u8; 8];
                    let (head, _) = bytes.split_at_mut(count.size());
                    source.fill(head)?;
                    let items = whole(head, count, format);
                    let Ok(items) = u64::try_from(items) else {
                        let place = format!("{} {row}", element.name);
                        return Err(source.invalid(place, format_args!("list {:?} has {items} items, expected 0 or more", property.name)));
                    };
                    source.skip(items * item.size() as u64)?;
                }
            }
        }
    }
    Ok(())
}

/// Returns the next line that is not blank.
fn text_row<'b, R: BufRead>(
    source: &mut PlySource<'_, R>,
    element: &Element,
    row: u64,
    buffer: &'b mut Vec<u8>,
) -> Result<std::borrow::Cow<'b, str>, IoError> {
    loop {
        let Some(line) = source.line(buffer)? else {
            let message = format!("file ends at byte {}, expected {} rows; the file is truncated", source.length, element.count);
            return Err(source.invalid(format_args!("{} {row}", element.name), message));
        };
        if !line.trim_ascii().is_empty() {
            break;
        }
    }
    Ok(String::from_utf8_lossy(buffer))
}

fn parse_word<R: BufRead, T: std::str::FromStr>(
    source: &PlySource<'_, R>,
    element: &Element,
    row: u64,
    column: usize,
    word: Option<&str>,
) -> Result<T, IoError> {
    let found = word.map_or("nothing".to_owned(), |w| format!("{:?}", w.chars().take(40).collect::<String>()));
    word.and_then(|w| w.parse().ok()).ok_or_else(|| {
        let name = &element.properties[column].name;
        source.invalid(format_args!("{} {row}", element.name), format_args!("property {name:?} is {found}, expected a number"))
    })
}

/// Returns the first `N` bytes, least significant first.
fn little<const N: usize>(bytes: &[u8], format: Format) -> [u8; N] {
    let mut out = bytes.first_chunk().copied().unwrap_or([0; N]);
    if format == Format::BigEndian {
        out.reverse();
    }
    out
}

fn whole(bytes: &[u8], scalar: Scalar, format: Format) -> i64 {
    match scalar {
        Scalar::I8 => i8::from_le_bytes(little(bytes, format)).into(),
        Scalar::U8 => u8::from_le_bytes(little(bytes, format)).into(),
        Scalar::I16 => i16::from_le_bytes(little(bytes, format)).into(),
        Scalar::U16 => u16::from_le_bytes(little(bytes, format)).into(),
        Scalar::I32 => i32::from_le_bytes(little(bytes, format)).into(),
        Scalar::U32 => u32::from_le_bytes(little(bytes, format)).into(),
        // The header refuses lists counted by these.
        Scalar::F32 | Scalar::F64 => -1,
    }
}

fn number(bytes: &[u8], scalar: Scalar, format: Format) -> f32 {
    match scalar {
        Scalar::F32 => f32::from_le_bytes(little(bytes, format)),
        Scalar::F64 => f64::from_le_bytes(little(bytes, format)) as f32,
        _ => whole(bytes, scalar, format) as f32,
    }
}

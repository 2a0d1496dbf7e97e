//! Tags of TIFF files and of formats built like them: DNG, and the Exif blocks of JPEG and PNG.
//!
//! In: bytes. Out: [`Ifd`]s, entries by tag, whose values are slices of the file: nothing is
//! allocated by what a file claims. The library for TIFF images (`tiff`) is not used here: it stops
//! at DNG's photometric interpretations, before any tag can be read.
//!
//! Degenerate: entries that point outside of the file are left out, as if they were missing. Cycles
//! end, because readers ask for IFDs by a bounded number of offsets.

/// A file of tags.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tags<'a> {
    bytes: &'a [u8],
    is_big_endian: bool,
    first_ifd: usize,
}

/// One directory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ifd<'a> {
    entries: Vec<Entry<'a>>,
    /// Offset of the next directory, 0 for none.
    pub(crate) next: usize,
}

#[derive(Clone, Copy, Debug)]
struct Entry<'a> {
    tag: u16,
    kind: Kind,
    is_big_endian: bool,
    value: &'a [u8],
}

/// Types of TIFF 6.0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Byte,
    Ascii,
    Short,
    Long,
    Rational,
    SignedByte,
    Undefined,
    SignedShort,
    SignedLong,
    SignedRational,
    Float,
    Double,
}

impl Kind {
    fn from_code(code: u16) -> Option<Self> {
        Some(match code {
            1 => Self::Byte,
            2 => Self::Ascii,
            3 => Self::Short,
            4 | 13 => Self::Long,
            5 => Self::Rational,
            6 => Self::SignedByte,
            7 => Self::Undefined,
            8 => Self::SignedShort,
            9 => Self::SignedLong,
            10 => Self::SignedRational,
            11 => Self::Float,
            12 => Self::Double,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::Byte | Self::Ascii | Self::SignedByte | Self::Undefined => 1,
            Self::Short | Self::SignedShort => 2,
            Self::Long | Self::SignedLong | Self::Float => 4,
            Self::Rational | Self::SignedRational | Self::Double => 8,
        }
    }
}

/// The entries of the first directory of a TIFF or BigTIFF, by their places.
struct Places<'a> {
    tags: Tags<'a>,
    is_big: bool,
    start: usize,
    count: usize,
}

impl<'a> Places<'a> {
    fn new(bytes: &'a [u8]) -> Option<Self> {
        let (is_big_endian, is_big) = match bytes.get(..4)? {
            b"II*\0" => (false, false),
            b"MM\0*" => (true, false),
            b"II+\0" => (false, true),
            b"MM\0+" => (true, true),
            _ => return None,
        };
        let tags = Tags { bytes, is_big_endian, first_ifd: 0 };
        let mut places = Self { tags, is_big, start: 0, count: 0 };
        let directory = usize::try_from(places.size(if is_big { 8 } else { 4 })?).ok()?;
        let (entries, start) = match is_big {
            true => (places.size(directory)?, directory.checked_add(8)?),
            false => (tags.u16_at(directory)?.into(), directory.checked_add(2)?),
        };
        // No more entries than the file has bytes for.
        let most = bytes.len().saturating_sub(start) / places.stride();
        (places.start, places.count) = (start, most.min(usize::try_from(entries).unwrap_or(most)));
        Some(places)
    }

    fn stride(&self) -> usize {
        if self.is_big { 20 } else { 12 }
    }

    /// Returns the offset or count at a place.
    fn size(&self, at: usize) -> Option<u64> {
        if self.is_big { self.tags.u64_at(at) } else { self.tags.u32_at(at).map(u64::from) }
    }

    /// Returns the places of all entries.
    fn all(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.count).map(|i| self.start + self.stride() * i)
    }
}

/// Returns the tag of the first directory of a TIFF or BigTIFF that claims a text longer than the
/// file.
pub(crate) fn endless_text(bytes: &[u8]) -> Option<u16> {
    let places = Places::new(bytes)?;
    let endless = |at: usize| {
        let is_text = Kind::from_code(places.tags.u16_at(at + 2)?) == Some(Kind::Ascii);
        (is_text && places.size(at + 4)? > bytes.len() as u64).then(|| places.tags.u16_at(at))?
    };
    places.all().find_map(endless)
}

/// Sets the only number of an entry of the first directory, 16 or 32 bits; others stay as they are.
pub(crate) fn set_number(bytes: &mut [u8], tag: u16, value: u16) {
    let Some(places) = Places::new(bytes) else { return };
    let Some(at) = places.all().find(|at| places.tags.u16_at(*at) == Some(tag)) else { return };
    let (kind, is_big_endian) = (places.tags.u16_at(at + 2).and_then(Kind::from_code), places.tags.is_big_endian);
    let start = at + if places.is_big { 12 } else { 8 };
    let number: &[u8] = match (kind, is_big_endian) {
        (Some(Kind::Short), true) => &value.to_be_bytes(),
        (Some(Kind::Short), false) => &value.to_le_bytes(),
        (Some(Kind::Long), true) => &u32::from(value).to_be_bytes(),
        (Some(Kind::Long), false) => &u32::from(value).to_le_bytes(),
        _ => return,
    };
    if let Some(place) = bytes.get_mut(start..start + number.len()) {
        place.copy_from_slice(number);
    }
}

impl<'a> Tags<'a> {
    /// Recognises a file by its first bytes; `None` if it is not a TIFF, or is a BigTIFF.
    pub(crate) fn new(bytes: &'a [u8]) -> Option<Self> {
        let is_big_endian = match bytes.get(..4)? {
            b"II*\0" => false,
            b"MM\0*" => true,
            _ => return None,
        };
        let mut tags = Self { bytes, is_big_endian, first_ifd: 0 };
        tags.first_ifd = tags.u32_at(4)? as usize;
        Some(tags)
    }

    /// Returns the first directory.
    pub(crate) fn first(&self) -> Option<Ifd<'a>> {
        self.ifd(self.first_ifd)
    }

    /// Returns the directory at an offset.
    pub(crate) fn ifd(&self, offset: usize) -> Option<Ifd<'a>> {
        let count = usize::from(self.u16_at(offset)?);
        let start = offset.checked_add(2)?;
        let entries = (0..count).map_while(|i| self.entry(start.checked_add(12 * i)?)).flatten().collect();
        let next = start.checked_add(12 * count).and_then(|at| self.u32_at(at)).unwrap_or(0) as usize;
        Some(Ifd { entries, next })
    }

    /// Returns the bytes of a part of the file.
    pub(crate) fn slice(&self, offset: usize, length: usize) -> Option<&'a [u8]> {
        self.bytes.get(offset..offset.checked_add(length)?)
    }

    pub(crate) fn is_big_endian(&self) -> bool {
        self.is_big_endian
    }

    /// Reads an entry: `None` at the end of the file, `Some(None)` where the entry makes no sense.
    fn entry(&self, at: usize) -> Option<Option<Entry<'a>>> {
        let (tag, kind, count) = (self.u16_at(at)?, self.u16_at(at + 2)?, self.u32_at(at + 4)? as usize);
        let entry = || {
            let kind = Kind::from_code(kind)?;
            let length = count.checked_mul(kind.bytes())?;
            let offset = if length <= 4 { at + 8 } else { self.u32_at(at + 8)? as usize };
            Some(Entry { tag, kind, is_big_endian: self.is_big_endian, value: self.slice(offset, length)? })
        };
        Some(entry())
    }

    fn u16_at(&self, at: usize) -> Option<u16> {
        let bytes = self.slice(at, 2)?.first_chunk().copied()?;
        Some(if self.is_big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn u64_at(&self, at: usize) -> Option<u64> {
        let bytes = self.slice(at, 8)?.first_chunk().copied()?;
        Some(if self.is_big_endian { u64::from_be_bytes(bytes) } else { u64::from_le_bytes(bytes) })
    }

    fn u32_at(&self, at: usize) -> Option<u32> {
        let bytes = self.slice(at, 4)?.first_chunk().copied()?;
        Some(if self.is_big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }
}

impl<'a> Ifd<'a> {
    fn find(&self, tag: u16) -> Option<&Entry<'a>> {
        self.entries.iter().find(|entry| entry.tag == tag)
    }

    /// Returns whether a tag is there and not empty.
    pub(crate) fn has(&self, tag: u16) -> bool {
        self.find(tag).is_some_and(|entry| !entry.value.is_empty())
    }

    /// Returns the bytes of a tag as they are.
    pub(crate) fn bytes(&self, tag: u16) -> Option<&'a [u8]> {
        self.find(tag).map(|entry| entry.value)
    }

    /// Returns all numbers of a tag, of whatever type.
    pub(crate) fn numbers(&self, tag: u16) -> Option<Vec<f64>> {
        let entry = self.find(tag)?;
        Some(entry.value.chunks_exact(entry.kind.bytes()).map(|bytes| entry.number(bytes)).collect())
    }

    /// Returns the first number of a tag, if it is finite.
    pub(crate) fn number(&self, tag: u16) -> Option<f64> {
        let entry = self.find(tag)?;
        entry.value.chunks_exact(entry.kind.bytes()).next().map(|bytes| entry.number(bytes)).filter(|v| v.is_finite())
    }

    /// Returns the first number of a tag as an index or size.
    pub(crate) fn unsigned(&self, tag: u16) -> Option<usize> {
        self.number(tag).filter(|v| *v >= 0.0 && v.fract() == 0.0).map(|v| v as usize)
    }

    /// Returns all numbers of a tag as offsets or sizes; others are 0.
    pub(crate) fn unsigneds(&self, tag: u16) -> Option<Vec<usize>> {
        Some(self.numbers(tag)?.into_iter().map(|v| v.max(0.0) as usize).collect())
    }

    /// Returns a text without what surrounds it; `None` if it is empty.
    pub(crate) fn text(&self, tag: u16) -> Option<String> {
        let value = self.find(tag)?.value;
        let end = value.iter().position(|b| *b == 0).unwrap_or(value.len());
        let text = String::from_utf8_lossy(value.get(..end)?).trim().to_owned();
        (!text.is_empty()).then_some(text)
    }
}

impl Entry<'_> {
    /// Returns a number from exactly the bytes of one.
    fn number(&self, bytes: &[u8]) -> f64 {
        let u16_of = |b: [u8; 2]| if self.is_big_endian { u16::from_be_bytes(b) } else { u16::from_le_bytes(b) };
        let u32_of = |b: [u8; 4]| if self.is_big_endian { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) };
        let u64_of = |b: [u8; 8]| if self.is_big_endian { u64::from_be_bytes(b) } else { u64::from_le_bytes(b) };
        let halves = || Some([bytes.first_chunk().map(|b| u32_of(*b))?, bytes.last_chunk().map(|b| u32_of(*b))?]);
        let number = match self.kind {
            Kind::Byte | Kind::Ascii | Kind::Undefined => bytes.first().map(|b| f64::from(*b)),
            Kind::SignedByte => bytes.first().map(|b| f64::from(b.cast_signed())),
            Kind::Short => bytes.first_chunk().map(|b| f64::from(u16_of(*b))),
            Kind::SignedShort => bytes.first_chunk().map(|b| f64::from(u16_of(*b).cast_signed())),
            Kind::Long => bytes.first_chunk().map(|b| f64::from(u32_of(*b))),
            Kind::SignedLong => bytes.first_chunk().map(|b| f64::from(u32_of(*b).cast_signed())),
            Kind::Float => bytes.first_chunk().map(|b| f64::from(f32::from_bits(u32_of(*b)))),
            Kind::Double => bytes.first_chunk().map(|b| f64::from_bits(u64_of(*b))),
            Kind::Rational => halves().map(|[n, d]| f64::from(n) / f64::from(d)),
            Kind::SignedRational => halves().map(|[n, d]| f64::from(n.cast_signed()) / f64::from(d.cast_signed())),
        };
        number.unwrap_or(f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a file with one directory of one text of this length.
    fn file(is_big: bool, is_big_endian: bool, length: u64) -> Vec<u8> {
        let mut file = Vec::new();
        let mut put = |value: u64, bytes: usize| match is_big_endian {
            true => file.extend_from_slice(&value.to_be_bytes()[8 - bytes..]),
            false => file.extend_from_slice(&value.to_le_bytes()[..bytes]),
        };
        put(if is_big_endian { 0x4d4d } else { 0x4949 }, 2);
        let word = if is_big { 8 } else { 4 };
        match is_big {
            true => [(43, 2), (8, 2), (0, 2), (16, 8), (1, 8)].map(|(value, bytes)| put(value, bytes)),
            false => [(42, 2), (8, 4), (1, 2), (0, 0), (0, 0)].map(|(value, bytes)| put(value, bytes)),
        };
        [(270, 2), (2, 2), (length, word), (0, word), (0, word)].into_iter().for_each(|(value, bytes)| put(value, bytes));
        file
    }

    #[test]
    fn texts_longer_than_the_file_are_found_in_tiff_and_bigtiff() {
        for (is_big, is_big_endian) in [(false, false), (false, true), (true, false), (true, true)] {
            assert_eq!(endless_text(&file(is_big, is_big_endian, 3)), None);
            assert_eq!(endless_text(&file(is_big, is_big_endian, 0x7fff_ffff)), Some(270), "{is_big} {is_big_endian}");
            let whole = file(is_big, is_big_endian, 0x7fff_ffff);
            assert!((0..20).all(|length| endless_text(&whole[..length]).is_none()));
        }
        assert_eq!(endless_text(&file(true, false, u64::MAX)), Some(270));
    }
}

//! One image or mask as a file of the cache.
//!
//! In: values of at least 0, finite. Out: a file, and the values again. Layout, little-endian: 8
//! bytes [`MAGIC`]; u32 encoding, i32 exponent, u32 values a pixel, u32 zero; u64 width, height,
//! bytes of the payload; the BLAKE3 digest (32 bytes) of all that and of the payload; the payload.
//!
//! Values are half floats of `value * 2^exponent`, with the largest exponent that keeps the
//! brightest value in range. Each value then differs by at most [`MAX_RELATIVE_ERROR`] of itself.
//! Images of half floats stay exact: their exponent is not negative, and a product with a power of
//! two at least 1 loses no bit. An image for which that bound does not hold, because it spans more
//! than the 9 decades of normal half floats, is kept in single precision. A mask of zeros and ones
//! takes one bit a pixel.
//!
//! Degenerate: a file that is not whole, or whose digest is another, is an error; nothing is read
//! beyond the size that its header and the length of the file agree on.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use half::f16;
use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};
use rayon::prelude::*;

use crate::IoError;
use crate::atomic::write_cache_file;

/// First bytes of a file; the digit is the version of the layout.
const MAGIC: &[u8; 8] = b"LXVIEW1\n";
/// Bytes before the payload.
const HEADER_BYTES: usize = 8 + 16 + 24 + 32;
/// Largest difference of a value that is stored as a half float, as a fraction of the value.
pub const MAX_RELATIVE_ERROR: f32 = 1.0 / 2048.0;
/// Largest half float, and largest exponent of the scale: its reciprocal must be a normal number.
const MAX_HALF: f32 = 65504.0;
const MAX_EXPONENT: i32 = 126;
/// Values that are converted at a time.
const CHUNK: usize = 1 << 16;

/// How values are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Single = 0,
    Half = 1,
    Bits = 2,
}

/// The size of an image or mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Values a pixel: 3 of an image, 1 of a mask.
    pub(super) channels: usize,
}

impl Shape {
    /// Returns the number of values, if memory can hold them.
    fn values(self) -> Option<usize> {
        self.width.checked_mul(self.height)?.checked_mul(self.channels).filter(|n| n.checked_mul(4).is_some())
    }
}

/// A record in memory as it is in its file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Record {
    shape: Shape,
    encoding: Encoding,
    exponent: i32,
    payload: Payload,
}

#[derive(Clone, Debug, PartialEq)]
enum Payload {
    Single(Vec<f32>),
    /// Bits of half floats.
    Half(Vec<u16>),
    Bits(Vec<u8>),
}

impl Payload {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Single(values) => bytemuck::cast_slice(values),
            Self::Half(values) => bytemuck::cast_slice(values),
            Self::Bits(bytes) => bytes,
        }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Self::Single(values) => bytemuck::cast_slice_mut(values),
            Self::Half(values) => bytemuck::cast_slice_mut(values),
            Self::Bits(bytes) => bytes,
        }
    }
}

impl Record {
    /// Encodes values.
    pub(super) fn encode(shape: Shape, values: &[f32]) -> Self {
        if shape.channels == 1 && values.iter().all(|v| *v == 0.0 || *v == 1.0) {
            let bits = |chunk: &[f32]| chunk.iter().enumerate().fold(0u8, |bits, (i, v)| bits | (u8::from(*v != 0.0) << i));
            return Self { shape, encoding: Encoding::Bits, exponent: 0, payload: Payload::Bits(values.chunks(8).map(bits).collect()) };
        }
        match halves(values) {
            Some((exponent, halves)) => Self { shape, encoding: Encoding::Half, exponent, payload: Payload::Half(halves) },
            None => Self { shape, encoding: Encoding::Single, exponent: 0, payload: Payload::Single(values.to_vec()) },
        }
    }

    /// Returns the size.
    pub(super) fn shape(&self) -> Shape {
        self.shape
    }

    /// Returns the bytes that the record takes in memory.
    pub(super) fn bytes(&self) -> u64 {
        self.payload.bytes().len() as u64
    }

    /// Returns the values.
    pub(super) fn decode(&self) -> Vec<f32> {
        match &self.payload {
            Payload::Single(values) => values.clone(),
            Payload::Half(halves) => {
                let scale = power_of_two(-self.exponent);
                let mut values = vec![0.0; halves.len()];
                for (out, halves) in values.chunks_mut(CHUNK).zip(halves.chunks(CHUNK)) {
                    halves.reinterpret_cast::<f16>().convert_to_f32_slice(out);
                    out.iter_mut().for_each(|v| *v *= scale);
                }
                values
            }
            Payload::Bits(bits) => {
                let count = self.shape.values().unwrap_or(0);
                (0..count).map(|i| f32::from(bits[i / 8] >> (i % 8) & 1)).collect()
            }
        }
    }

    /// Returns the values, without a copy of those that are stored as they are.
    pub(super) fn into_values(self) -> Vec<f32> {
        match self.payload {
            Payload::Single(values) => values,
            _ => self.decode(),
        }
    }

    fn header(&self) -> [u8; HEADER_BYTES - 32] {
        let mut header = [0; HEADER_BYTES - 32];
        header[..8].copy_from_slice(MAGIC);
        header[8..12].copy_from_slice(&(self.encoding as u32).to_le_bytes());
        header[12..16].copy_from_slice(&self.exponent.to_le_bytes());
        header[16..20].copy_from_slice(&(self.shape.channels as u32).to_le_bytes());
        for (at, number) in [(24, self.shape.width as u64), (32, self.shape.height as u64), (40, self.bytes())] {
            header[at..at + 8].copy_from_slice(&number.to_le_bytes());
        }
        header
    }

    fn digest(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.header()).update(self.payload.bytes());
        hasher.finalize()
    }

    /// Writes the file, whole or not at all.
    pub(super) fn write(&self, path: &Path) -> Result<(), IoError> {
        write_cache_file(path, |out| {
            let digest = self.digest();
            let parts = [&self.header()[..], digest.as_bytes(), self.payload.bytes()];
            parts.into_iter().try_for_each(|part| out.write_all(part)).map_err(|e| IoError::system(path, "write", &e))
        })
    }

    /// Reads the file; `check` says whether its digest is checked too.
    pub(super) fn read(path: &Path, check: DigestCheck) -> Result<Self, IoError> {
        let system = |e: &std::io::Error| IoError::system(path, "read", e);
        let damaged = |what: &str| IoError::invalid(path, format!("{what}: the file of the image cache is damaged"));
        let mut file = File::open(path).map_err(|e| system(&e))?;
        let length = file.metadata().map_err(|e| system(&e))?.len();
        let mut header = [0; HEADER_BYTES];
        file.read_exact(&mut header).map_err(|_| damaged("shorter than its header"))?;
        let (mut record, payload_bytes) = Self::parse(&header).ok_or_else(|| damaged("not a header that this version writes"))?;
        if length != HEADER_BYTES as u64 + payload_bytes {
            return Err(damaged(&format!("{length} bytes, expected {}", HEADER_BYTES as u64 + payload_bytes)));
        }
        record.allocate();
        file.read_exact(record.payload.bytes_mut()).map_err(|e| system(&e))?;
        if check == DigestCheck::Yes && record.digest().as_bytes() != &header[HEADER_BYTES - 32..] {
            return Err(damaged("its content is not what its digest says"));
        }
        Ok(record)
    }

    /// Reads the size of a file without its content; fails where the file cannot be whole.
    pub(super) fn read_shape(path: &Path) -> Result<Shape, IoError> {
        let mut file = File::open(path).map_err(|e| IoError::system(path, "read", &e))?;
        let mut header = [0; HEADER_BYTES];
        file.read_exact(&mut header).map_err(|e| IoError::system(path, "read", &e))?;
        let length = file.metadata().map_err(|e| IoError::system(path, "read", &e))?.len();
        let parsed = Self::parse(&header).filter(|(_, payload)| length == HEADER_BYTES as u64 + payload);
        parsed.map(|(record, _)| record.shape).ok_or_else(|| IoError::invalid(path, "not a whole file of the image cache"))
    }

    /// Returns the record that a header describes, without a payload, and the bytes of that.
    fn parse(header: &[u8; HEADER_BYTES]) -> Option<(Self, u64)> {
        let word = |at: usize| header.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes);
        let long = |at: usize| header.get(at..at + 8)?.try_into().ok().map(u64::from_le_bytes);
        if !header.starts_with(MAGIC) || word(20)? != 0 {
            return None;
        }
        let encoding = [Encoding::Single, Encoding::Half, Encoding::Bits].into_iter().find(|e| Some(*e as u32) == word(8))?;
        let exponent = word(12)? as i32;
        let side = |at| usize::try_from(long(at)?).ok();
        let shape = Shape { width: side(24)?, height: side(32)?, channels: word(16)? as usize };
        let values = shape.values()?;
        let bytes = match encoding {
            Encoding::Single => 4 * values,
            Encoding::Half => 2 * values,
            Encoding::Bits => values.div_ceil(8),
        };
        let is_sound = matches!(shape.channels, 1 | 3) && (-MAX_EXPONENT..=MAX_EXPONENT).contains(&exponent);
        let payload = Payload::Bits(Vec::new());
        (is_sound && Some(bytes as u64) == long(40)).then_some((Self { shape, encoding, exponent, payload }, bytes as u64))
    }

    fn allocate(&mut self) {
        let values = self.shape.values().unwrap_or(0);
        self.payload = match self.encoding {
            Encoding::Single => Payload::Single(vec![0.0; values]),
            Encoding::Half => Payload::Half(vec![0; values]),
            Encoding::Bits => Payload::Bits(vec![0; values.div_ceil(8)]),
        };
    }
}

/// Whether a file's digest is checked when it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DigestCheck {
    Yes,
    No,
}

/// Returns the exponent and the bits of the half floats of `value * 2^exponent`; `None` if a value
/// would differ by more than [`MAX_RELATIVE_ERROR`].
fn halves(values: &[f32]) -> Option<(i32, Vec<u16>)> {
    let brightest = values.par_chunks(CHUNK).map(|chunk| chunk.iter().copied().fold(0.0, f32::max)).reduce(|| 0.0, f32::max);
    let exponent = exponent_for(brightest)?;
    let (scale, back) = (power_of_two(exponent), power_of_two(-exponent));
    let mut halves = vec![0; values.len()];
    let is_close = halves.par_chunks_mut(CHUNK).zip(values.par_chunks(CHUNK)).all(|(out, values)| {
        let mut scaled: Vec<f32> = values.iter().map(|v| v * scale).collect();
        let out = out.reinterpret_cast_mut::<f16>();
        out.convert_from_f32_slice(&scaled);
        out.convert_to_f32_slice(&mut scaled);
        values.iter().zip(&scaled).all(|(value, half)| (half * back - value).abs() <= MAX_RELATIVE_ERROR * value.abs())
    });
    is_close.then_some((exponent, halves))
}

/// Returns the largest exponent whose power of two keeps `brightest` among the half floats; `None`
/// for what is no radiance.
fn exponent_for(brightest: f32) -> Option<i32> {
    if brightest == 0.0 {
        return Some(0);
    }
    if !brightest.is_finite() {
        return None;
    }
    let mut exponent = (15 - brightest.log2().floor() as i32).clamp(-MAX_EXPONENT, MAX_EXPONENT);
    // The logarithm is rounded, and the largest half float is below 2^16.
    while exponent > -MAX_EXPONENT && brightest * power_of_two(exponent) > MAX_HALF {
        exponent -= 1;
    }
    Some(exponent)
}

/// Returns 2^exponent, for exponents of normal numbers.
fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127).clamp(1, 254) as u32) << 23)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn image(values: &[f32]) -> Record {
        Record::encode(Shape { width: values.len() / 3, height: 1, channels: 3 }, values)
    }

    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|v| v.to_bits()).collect()
    }

    #[test]
    fn every_half_float_stays_as_it_is() {
        let all: Vec<f32> = (0u16..0x7c00).map(|bits| f16::from_bits(bits).to_f32()).collect();
        let values = &all[..all.len() / 3 * 3];
        let record = image(values);
        assert_eq!((record.encoding, bits(&record.decode())), (Encoding::Half, bits(values)));
        // Also where the brightest is far below the largest half float.
        let dark: Vec<f32> = values.iter().copied().filter(|v| *v < 0.01).collect();
        let dark = &dark[..dark.len() / 3 * 3];
        let record = image(dark);
        assert_eq!((record.encoding, bits(&record.decode())), (Encoding::Half, bits(dark)));
        assert!(record.exponent > 0);
    }

    #[test]
    fn values_beyond_half_floats_are_scaled_and_what_spans_too_much_stays_single() {
        let sun = image(&[3e9, 1.0, 700.0]);
        assert_eq!((sun.encoding, sun.exponent < 0), (Encoding::Half, true));
        for (found, value) in sun.decode().iter().zip([3e9f32, 1.0, 700.0]) {
            assert!((found / value - 1.0).abs() <= MAX_RELATIVE_ERROR, "{found} {value}");
        }
        for wide in [[1e30, 1.0, 0.5], [1e6, 1e-6, 0.0], [f32::MAX, 1.0, 1.0], [1e-45, 1e-38, 1.0]] {
            let record = image(&wide);
            assert_eq!((record.encoding, bits(&record.decode())), (Encoding::Single, bits(&wide)), "{wide:?}");
        }
        assert_eq!(image(&[0.0; 3]).decode(), [0.0; 3]);
    }

    #[test]
    fn masks_of_zeros_and_ones_take_a_bit_a_pixel() {
        let shape = Shape { width: 7, height: 3, channels: 1 };
        let mask: Vec<f32> = (0..21).map(|i| f32::from(u8::from(i % 3 == 0))).collect();
        let record = Record::encode(shape, &mask);
        assert_eq!((record.bytes(), record.decode()), (3, mask));
        let soft: Vec<f32> = (0..21).map(|i| i as f32 / 20.0).collect();
        let found = Record::encode(shape, &soft).decode();
        assert!(found.iter().zip(&soft).all(|(a, b)| (a - b).abs() <= MAX_RELATIVE_ERROR * b), "{found:?}");
    }

    #[test]
    fn files_that_are_damaged_in_any_byte_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.image");
        let record = image(&[1.0, 2.0, 0.3, 7.5, 0.0, 1e4]);
        record.write(&path).unwrap();
        assert_eq!(Record::read(&path, DigestCheck::Yes).unwrap(), record);
        assert_eq!(Record::read_shape(&path).unwrap(), record.shape);
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x10;
            std::fs::write(&path, bytes).unwrap();
            assert!(Record::read(&path, DigestCheck::Yes).is_err(), "byte {at}");
        }
        for length in [0, 7, HEADER_BYTES, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(Record::read(&path, DigestCheck::Yes).is_err() && Record::read_shape(&path).is_err(), "{length}");
        }
        std::fs::write(&path, [&whole[..], b"x"].concat()).unwrap();
        assert!(Record::read(&path, DigestCheck::No).is_err());
    }

    proptest! {
        #[test]
        fn values_are_within_the_stated_error(values in prop::collection::vec((0.0f32..1.0, -60i32..60), 3..90)) {
            let values: Vec<f32> = values.iter().map(|(mantissa, exponent)| mantissa * power_of_two(*exponent)).collect();
            let values = &values[..values.len() / 3 * 3];
            let found = image(values).decode();
            for (found, value) in found.iter().zip(values) {
                prop_assert!((found - value).abs() <= MAX_RELATIVE_ERROR * value, "{} {}", found, value);
            }
        }
    }
}

//! Values of a crate file: what fields point to.

use half::f16;

use super::tables::{Cursor, Spec, Tables};
use super::{ValueRep, kind};

/// Floats from which on an array may be compressed.
const LEAST_COMPRESSED: usize = 16;

/// A file's tables with its bytes.
pub(super) struct CrateReader<'a> {
    bytes: &'a [u8],
    pub(super) tables: Tables,
}

impl<'a> CrateReader<'a> {
    /// Reads the tables.
    ///
    /// # Errors
    /// Damaged tables.
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, String> {
        Ok(Self { bytes, tables: Tables::read(bytes)? })
    }

    /// Returns the place of a value that is not part of its field.
    pub(super) fn cursor(&self, value: ValueRep) -> Result<Cursor<'a>, String> {
        let at = usize::try_from(value.payload()).map_err(|_| "a value beyond the file")?;
        Ok(Cursor { bytes: self.bytes, at })
    }

    /// Returns the token of a field; `None` where the spec does not have it.
    pub(super) fn token(&self, spec: &Spec, field: &str) -> Option<&str> {
        let value = self.tables.field(spec, field)?;
        (value.is_inlined() && value.kind() == kind::TOKEN).then(|| self.tables.token(value.payload() as u32)).flatten()
    }

    /// Returns whether a truth value of a spec is there and false.
    pub(super) fn is_false(&self, spec: &Spec, field: &str) -> bool {
        self.tables.field(spec, field).is_some_and(|value| value.is_inlined() && value.kind() == kind::BOOL && value.payload() == 0)
    }

    /// Returns the integer of an attribute.
    pub(super) fn int(&self, spec: &Spec) -> Option<i32> {
        let value = self.tables.field(spec, "default")?;
        (value.is_inlined() && value.kind() == kind::INT).then_some(value.payload() as u32 as i32)
    }

    /// Returns the tokens of an attribute.
    ///
    /// # Errors
    /// An array that is truncated.
    pub(super) fn tokens(&self, spec: &Spec) -> Result<Vec<&str>, String> {
        let Some(value) = self.tables.field(spec, "default") else { return Ok(Vec::new()) };
        if value.kind() != kind::TOKEN || !value.is_array() {
            return Err(format!("{}: not a list of tokens", spec.path));
        }
        if value.payload() == 0 {
            return Ok(Vec::new());
        }
        let mut at = self.cursor(value)?;
        let count = at.count()?;
        let bytes = at.take(count.checked_mul(4).ok_or("a list of tokens that no memory holds")?)?;
        let token =
            |number: &[u8; 4]| self.tables.token(u32::from_le_bytes(*number)).ok_or_else(|| "a token that there is none of".to_owned());
        bytes.as_chunks::<4>().0.iter().map(token).collect()
    }

    /// Returns the text under a key of a dictionary in a spec's field.
    ///
    /// # Errors
    /// A dictionary that is truncated.
    pub(super) fn text_in_dictionary(&self, spec: &Spec, field: &str, key: &str) -> Result<Option<&str>, String> {
        let Some(value) = self.tables.field(spec, field).filter(|value| value.kind() == kind::DICTIONARY && !value.is_inlined()) else {
            return Ok(None);
        };
        let mut at = self.cursor(value)?;
        let entries = at.count()?;
        for _ in 0..entries.min(1 << 16) {
            let name = self.tables.string(at.u32()?);
            let start = at.at;
            let distance = at.u64()? as i64;
            let place =
                i64::try_from(start).ok().and_then(|start| start.checked_add(distance)).and_then(|place| usize::try_from(place).ok());
            let mut there = Cursor { bytes: self.bytes, at: place.ok_or("a dictionary's value before the file")? };
            let value = ValueRep(there.u64()?);
            if name == Some(key) && value.kind() == kind::STRING && value.is_inlined() {
                return Ok(self.tables.string(value.payload() as u32));
            }
            at = there;
        }
        Ok(None)
    }

    /// Returns the floats of an attribute's array, entry after entry; quaternions as w, x, y, z.
    ///
    /// # Errors
    /// An array that is truncated, or not of floats.
    pub(super) fn floats(&self, spec: &Spec) -> Result<Vec<f32>, String> {
        let wrong = || format!("{}: not an array of floats", spec.path);
        let value = self.tables.field(spec, "default").ok_or_else(wrong)?;
        if value.kind() == kind::VALUE_BLOCK {
            return Ok(Vec::new());
        }
        if !value.is_array() {
            return Err(wrong());
        }
        let (width, is_half) = match value.kind() {
            kind::FLOAT => (1, false),
            kind::HALF => (1, true),
            kind::VEC3F => (3, false),
            kind::VEC3H => (3, true),
            kind::QUATF => (4, false),
            kind::QUATH => (4, true),
            _ => return Err(wrong()),
        };
        if value.payload() == 0 {
            return Ok(Vec::new());
        }
        let mut at = self.cursor(value)?;
        let count = at.count()?;
        let mut floats = if value.is_compressed() && count >= LEAST_COMPRESSED {
            if width > 1 {
                return Err(wrong());
            }
            compressed_floats(&mut at, count, is_half)?
        } else {
            let size = if is_half { 2 } else { 4 };
            let length = count.checked_mul(width * size).ok_or("an array that no memory holds")?;
            let bytes = at.take(length)?;
            let mut floats = Vec::new();
            floats.try_reserve_exact(count * width).map_err(|e| format!("{}: {e}", spec.path))?;
            if is_half {
                floats.extend(bytes.as_chunks::<2>().0.iter().map(|half| f16::from_le_bytes(*half).to_f32()));
            } else {
                floats.extend(bytes.as_chunks::<4>().0.iter().map(|float| f32::from_le_bytes(*float)));
            }
            floats
        };
        if width == 4 {
            // The file has the real part last.
            floats.as_chunks_mut::<4>().0.iter_mut().for_each(|quaternion| quaternion.rotate_right(1));
        }
        Ok(floats)
    }
}

/// Returns floats that are stored as whole numbers, or as places in a table of values.
fn compressed_floats(at: &mut Cursor<'_>, count: usize, is_half: bool) -> Result<Vec<f32>, String> {
    match at.take(1)?[0] {
        b'i' => Ok(at.integers(count)?.into_iter().map(|integer| integer as i32 as f32).collect()),
        b't' => {
            let values = at.u32()? as usize;
            let bytes = at.take(values.saturating_mul(if is_half { 2 } else { 4 }))?;
            let value = |place: u32| {
                let place = place as usize;
                let found = if is_half {
                    bytes.as_chunks::<2>().0.get(place).map(|half| f16::from_le_bytes(*half).to_f32())
                } else {
                    bytes.as_chunks::<4>().0.get(place).map(|float| f32::from_le_bytes(*float))
                };
                found.ok_or_else(|| "a compressed float beyond the table of its values".to_owned())
            };
            at.integers(count)?.into_iter().map(value).collect()
        }
        other => Err(format!("floats compressed in an unknown way ({other})")),
    }
}

//! Single numbers, tuples and matrices of a crate file, and their samples over time, in 64 bits.

use half::f16;

use super::reader::CrateReader;
use super::tables::{Cursor, Spec};
use super::{ValueRep, kind};
use crate::usd::cameras::{Sample, sorted};

/// Most samples of an attribute.
const MAX_SAMPLES: usize = 1 << 20;

impl CrateReader<'_> {
    /// Returns the number of a prim's specifier: to define, to override, or a class.
    pub(super) fn specifier(&self, spec: &Spec) -> Option<u64> {
        self.tables.field(spec, "specifier").filter(|value| value.kind() == kind::SPECIFIER).map(ValueRep::payload)
    }

    /// Returns the numbers of a field, of matrices row by row, of quaternions w, x, y, z; `None`
    /// where the spec does not have it, or where it is blocked.
    ///
    /// # Errors
    /// A value that is truncated, not finite, or of another type.
    pub(super) fn numbers(&self, spec: &Spec, field: &str) -> Result<Option<Vec<f64>>, String> {
        self.tables.field(spec, field).map_or(Ok(None), |value| self.value(spec, value))
    }

    /// Returns the samples of an attribute over time, sorted; none where it has none.
    ///
    /// # Errors
    /// Samples that are truncated, or of another type.
    pub(super) fn samples(&self, spec: &Spec) -> Result<Vec<Sample>, String> {
        let Some(value) = self.tables.field(spec, "timeSamples") else { return Ok(Vec::new()) };
        let wrong = || format!("{}: samples over time that are none", spec.path);
        if value.kind() != kind::TIME_SAMPLES || value.is_inlined() {
            return Err(wrong());
        }
        let mut at = jumped(self.cursor(value)?)?;
        let times = self.times(spec, ValueRep(at.u64()?))?;
        let mut at = jumped(at)?;
        if at.count()? != times.len() {
            return Err(format!("{}: {} times of another number of samples", spec.path, times.len()));
        }
        let mut samples = Vec::new();
        for time in times {
            if !time.is_finite() {
                return Err(wrong());
            }
            if let Some(values) = self.value(spec, ValueRep(at.u64()?))? {
                samples.push(Sample { time, values });
            }
        }
        Ok(sorted(samples))
    }

    fn times(&self, spec: &Spec, value: ValueRep) -> Result<Vec<f64>, String> {
        let is_list = value.kind() == kind::DOUBLE_VECTOR || (value.kind() == kind::DOUBLE && value.is_array() && !value.is_compressed());
        if !is_list || value.is_inlined() {
            return Err(format!("{}: times that are no list of numbers", spec.path));
        }
        let mut at = self.cursor(value)?;
        let count = at.count()?;
        if count > MAX_SAMPLES {
            return Err(format!("{}: {count} samples, expected at most {MAX_SAMPLES}", spec.path));
        }
        Ok(doubles(at.take(8 * count)?))
    }

    fn value(&self, spec: &Spec, value: ValueRep) -> Result<Option<Vec<f64>>, String> {
        if value.kind() == kind::VALUE_BLOCK {
            return Ok(None);
        }
        let wrong = || format!("{}: type {} of binary OpenUSD, expected a number, a tuple or a matrix", spec.path, value.kind());
        if value.is_array() {
            return Err(wrong());
        }
        let values = if value.is_inlined() { inlined(value) } else { self.stored(value)? };
        let values = values.ok_or_else(wrong)?;
        match values.iter().find(|v| !v.is_finite()) {
            Some(bad) => Err(format!("{}: {bad}, expected a number", spec.path)),
            None => Ok(Some(values)),
        }
    }

    /// Returns the numbers of a value that is elsewhere in the file.
    fn stored(&self, value: ValueRep) -> Result<Option<Vec<f64>>, String> {
        let (count, size) = match value.kind() {
            kind::HALF => (1, 2),
            kind::FLOAT => (1, 4),
            kind::DOUBLE => (1, 8),
            kind::MATRIX4D => (16, 8),
            kind::QUATD => (4, 8),
            kind::QUATF => (4, 4),
            kind::QUATH => (4, 2),
            kind::VEC3D => (3, 8),
            kind::VEC3F => (3, 4),
            kind::VEC3H => (3, 2),
            _ => return Ok(None),
        };
        let bytes = self.cursor(value)?.take(count * size)?;
        let mut values = match size {
            2 => bytes.as_chunks::<2>().0.iter().map(|half| f16::from_le_bytes(*half).to_f64()).collect(),
            4 => bytes.as_chunks::<4>().0.iter().map(|float| f64::from(f32::from_le_bytes(*float))).collect(),
            _ => doubles(bytes),
        };
        if count == 4 {
            // The file has the real part last.
            values.rotate_right(1);
        }
        Ok(Some(values))
    }
}

/// Returns the numbers that are part of a value: a number in 32 bits or fewer, or whole numbers of
/// eight bits, which of a matrix are its diagonal.
fn inlined(value: ValueRep) -> Option<Vec<f64>> {
    let bits = value.payload() as u32;
    let whole = bits.to_le_bytes().map(|byte| f64::from(byte as i8));
    match value.kind() {
        kind::INT => Some(vec![f64::from(bits as i32)]),
        kind::HALF => Some(vec![f16::from_bits(bits as u16).to_f64()]),
        kind::FLOAT | kind::DOUBLE => Some(vec![f64::from(f32::from_bits(bits))]),
        kind::VEC3D | kind::VEC3F | kind::VEC3H => Some(whole[..3].to_vec()),
        kind::MATRIX4D => {
            let mut matrix = vec![0.0; 16];
            whole.into_iter().enumerate().for_each(|(i, v)| matrix[5 * i] = v);
            Some(matrix)
        }
        _ => None,
    }
}

/// Goes where the distance at a place leads.
fn jumped(mut at: Cursor<'_>) -> Result<Cursor<'_>, String> {
    let start = at.at;
    let distance = at.u64()? as i64;
    let place = i64::try_from(start).ok().and_then(|start| start.checked_add(distance)).and_then(|place| usize::try_from(place).ok());
    Ok(Cursor { bytes: at.bytes, at: place.ok_or("a value before the file")? })
}

fn doubles(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks::<8>().0.iter().map(|double| f64::from_le_bytes(*double)).collect()
}

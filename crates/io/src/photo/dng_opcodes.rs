//! Opcode lists of a DNG: operations on the stored samples, the linear ones, and the colours.
//!
//! In: the bytes of a list (big endian in every file), a count, then id, version, flags and
//! length of each, and its parameters. Out: [`Opcode`]s and [`Operation`]s. Source: DNG 1.7.1,
//! chapter 7. Errors say what is wrong, without the file's name.

use luxel_core::photo::{Gain, GainMap, GainShape, SampleRegion, Warp, WarpKind, WarpPlane};

/// An entry of a list.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Opcode<'a> {
    id: u32,
    /// Whether a reader that does not know it may leave it out.
    pub(super) is_optional: bool,
    parameters: &'a [u8],
}

/// The operation of an opcode.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Operation {
    /// Replaces samples by their neighbours.
    BadPixels(BadPixels),
    /// Changes the values of samples.
    Values(ValueMap),
    /// Multiplies samples or colours.
    Gain(Gain),
    /// Moves colours.
    Warp(Warp),
}

/// Samples that the sensor does not measure.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum BadPixels {
    /// All samples of this code.
    Constant(u32),
    /// Places (x, y) and rectangles.
    List { points: Vec<[usize; 2]>, rectangles: Vec<SampleRegion> },
}

/// A map of values from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ValueMap {
    pub(super) region: SampleRegion,
    pub(super) function: ValueFunction,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum ValueFunction {
    /// Values on the scale of 16 bits, by value on that scale; the last one beyond.
    Table(Vec<u16>),
    /// Coefficients of x^0, x^1 and so on.
    Polynomial(Vec<f64>),
    /// Added to the samples of each covered row.
    RowDeltas(Vec<f32>),
    /// Added to the samples of each covered column.
    ColumnDeltas(Vec<f32>),
}

/// Highest degree of a polynomial.
const MAX_DEGREE: usize = 8;

/// Splits a list.
pub(super) fn opcodes(bytes: &[u8]) -> Result<Vec<Opcode<'_>>, String> {
    let mut fields = Fields { rest: bytes, name: "the list" };
    let count = fields.size()?;
    let mut out = Vec::new();
    for _ in 0..count {
        let [id, _version, flags] = [fields.u32()?, fields.u32()?, fields.u32()?];
        let length = fields.size()?;
        out.push(Opcode { id, is_optional: flags & 1 != 0, parameters: fields.take(length)? });
    }
    Ok(out)
}

impl Opcode<'_> {
    /// Returns the name for people.
    pub(super) fn name(&self) -> String {
        const NAMES: [&str; 14] = [
            "WarpRectilinear",
            "WarpFisheye",
            "FixVignetteRadial",
            "FixBadPixelsConstant",
            "FixBadPixelsList",
            "TrimBounds",
            "MapTable",
            "MapPolynomial",
            "GainMap",
            "DeltaPerRow",
            "DeltaPerColumn",
            "ScalePerRow",
            "ScalePerColumn",
            "WarpRectilinear2",
        ];
        let known = (self.id as usize).checked_sub(1).and_then(|i| NAMES.get(i));
        known.map_or_else(|| format!("unknown opcode {}", self.id), |name| (*name).to_owned())
    }

    /// Returns what it does; `None` if that is not known. `is_by_color` says whether planes are
    /// colours.
    pub(super) fn operation(&self, is_by_color: bool) -> Result<Option<Operation>, String> {
        let name = self.name();
        let mut fields = Fields { rest: self.parameters, name: &name };
        let gain = |region, shape| {
            let gain = Gain { region, shape, is_by_color };
            if gain.is_valid() { Ok(Operation::Gain(gain)) } else { Err(format!("{name} holds gains that are not above 0")) }
        };
        let operation = match self.id {
            1 | 2 | 14 => Operation::Warp(warp(&mut fields, self.id)?),
            3 => {
                let coefficients = fields.f64s()?;
                gain(SampleRegion::ALL, GainShape::Radial { coefficients, center: fields.f64s()? })?
            }
            4 => Operation::BadPixels(BadPixels::Constant(fields.u32()?)),
            5 => Operation::BadPixels(bad_pixels(&mut fields)?),
            7 => {
                let region = fields.region()?;
                let count = fields.size()?;
                let table = fields.take(count.saturating_mul(2))?.as_chunks().0.iter().map(|b| u16::from_be_bytes(*b)).collect();
                values(region, ValueFunction::Table(table))
            }
            8 => {
                let region = fields.region()?;
                let degree = fields.size()?;
                if degree > MAX_DEGREE {
                    return Err(format!("{name} has degree {degree}, expected 0 to {MAX_DEGREE}"));
                }
                let coefficients = (0..=degree).map(|_| Ok(fields.f64s::<1>()?[0])).collect::<Result<Vec<f64>, String>>()?;
                if !coefficients.iter().all(|k| k.is_finite()) {
                    return Err(format!("{name} holds numbers that are not finite"));
                }
                values(region, ValueFunction::Polynomial(coefficients))
            }
            9 => {
                let region = fields.region()?;
                gain(region, GainShape::Map(gain_map(&mut fields)?))?
            }
            10 | 11 => {
                let (region, deltas) = fields.lines(self.id == 10)?;
                if !deltas.iter().all(|v| v.is_finite()) {
                    return Err(format!("{name} holds numbers that are not finite"));
                }
                values(region, if self.id == 10 { ValueFunction::RowDeltas(deltas) } else { ValueFunction::ColumnDeltas(deltas) })
            }
            12 | 13 => {
                let (region, scales) = fields.lines(self.id == 12)?;
                gain(region, if self.id == 12 { GainShape::Rows(scales) } else { GainShape::Columns(scales) })?
            }
            _ => return Ok(None),
        };
        Ok(Some(operation))
    }
}

fn values(region: SampleRegion, function: ValueFunction) -> Operation {
    Operation::Values(ValueMap { region, function })
}

fn warp(fields: &mut Fields<'_, '_>, id: u32) -> Result<Warp, String> {
    let planes = fields.size()?;
    if !(1..=4).contains(&planes) {
        return Err(format!("{} is of {planes} planes, expected 1 to 4", fields.name));
    }
    let plane = |fields: &mut Fields<'_, '_>| {
        let mut numbers = WarpPlane { radial: [0.0; 15], tangential: [0.0; 2], valid: [0.0, 1.0] };
        match id {
            1 => {
                // Even powers alone.
                let even: [f64; 4] = fields.f64s()?;
                even.iter().enumerate().for_each(|(i, k)| numbers.radial[2 * i] = *k);
                numbers.tangential = fields.f64s()?;
            }
            2 => numbers.radial[..4].copy_from_slice(&fields.f64s::<4>()?),
            _ => {
                numbers.radial = fields.f64s()?;
                numbers.tangential = fields.f64s()?;
                numbers.valid = fields.f64s()?;
            }
        }
        Ok(numbers)
    };
    let planes = (0..planes).map(|_| plane(fields)).collect::<Result<Vec<_>, String>>()?;
    let center = fields.f64s()?;
    let kind = match id {
        2 => WarpKind::Fisheye,
        14 if fields.u32()? != 0 => WarpKind::Reciprocal,
        _ => WarpKind::Rectilinear,
    };
    let warp = Warp { planes, center, kind };
    if warp.is_valid() {
        Ok(warp)
    } else {
        Err(format!("{} holds numbers that are not finite, or a centre or radii outside of 0 to 1", fields.name))
    }
}

fn gain_map(fields: &mut Fields<'_, '_>) -> Result<GainMap, String> {
    // Vertical numbers come first.
    let [rows, columns] = [fields.size()?, fields.size()?];
    let [spacing_y, spacing_x] = fields.f64s()?;
    let [origin_y, origin_x]: [f64; 2] = fields.f64s()?;
    let planes = fields.size()?;
    let is_spaced = |points: usize, spacing: f64| points == 1 || (spacing.is_finite() && spacing > 0.0);
    let is_placed = origin_x.is_finite() && origin_y.is_finite() && is_spaced(rows, spacing_y) && is_spaced(columns, spacing_x);
    let count = rows.checked_mul(columns).and_then(|n| n.checked_mul(planes)).filter(|n| *n > 0 && is_placed);
    let Some(count) = count else {
        return Err(format!(
            "{} is a grid of {columns} x {rows} points for {planes} planes, {spacing_x} and {spacing_y} apart",
            fields.name
        ));
    };
    let values = fields.f32s(count)?;
    Ok(GainMap { points: [columns, rows], spacing: [spacing_x, spacing_y], origin: [origin_x, origin_y], planes, values })
}

fn bad_pixels(fields: &mut Fields<'_, '_>) -> Result<BadPixels, String> {
    let _phase = fields.u32()?;
    let [points, rectangles] = [fields.size()?, fields.size()?];
    let points = fields.take(points.saturating_mul(8))?.as_chunks::<8>().0.iter().map(|bytes| {
        let mut pair = Fields { rest: bytes, name: fields.name };
        let [y, x] = [pair.size()?, pair.size()?];
        Ok([x, y])
    });
    let points = points.collect::<Result<_, String>>()?;
    let rectangles = fields.take(rectangles.saturating_mul(16))?.as_chunks::<16>().0.iter().map(|bytes| {
        let mut sides = Fields { rest: bytes, name: fields.name };
        let [top, left, bottom, right] = [sides.size()?, sides.size()?, sides.size()?, sides.size()?];
        Ok(SampleRegion { top, left, bottom, right, ..SampleRegion::ALL })
    });
    Ok(BadPixels::List { points, rectangles: rectangles.collect::<Result<_, String>>()? })
}

/// Numbers, one after another.
struct Fields<'a, 'n> {
    rest: &'a [u8],
    /// Name of the opcode that they belong to.
    name: &'n str,
}

impl<'a> Fields<'a, '_> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.rest.split_at_checked(length).ok_or_else(|| format!("{} is cut short", self.name))?;
        self.rest = rest;
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32, String> {
        let bytes = self.take(4)?;
        Ok(bytes.first_chunk().map_or(0, |b| u32::from_be_bytes(*b)))
    }

    fn size(&mut self) -> Result<usize, String> {
        Ok(self.u32()? as usize)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let bytes = self.take(8 * N)?;
        let mut out = [0.0; N];
        out.iter_mut().zip(bytes.as_chunks().0).for_each(|(out, b)| *out = f64::from_be_bytes(*b));
        Ok(out)
    }

    fn f32s(&mut self, count: usize) -> Result<Vec<f32>, String> {
        Ok(self.take(count.saturating_mul(4))?.as_chunks().0.iter().map(|b| f32::from_be_bytes(*b)).collect())
    }

    fn region(&mut self) -> Result<SampleRegion, String> {
        let mut next = || self.size();
        let [top, left, bottom, right] = [next()?, next()?, next()?, next()?];
        let [plane, planes, row_pitch, column_pitch] = [next()?, next()?, next()?, next()?];
        if row_pitch == 0 || column_pitch == 0 || planes == 0 || bottom < top || right < left {
            let sides = format!("rows {top} to {bottom}, columns {left} to {right}");
            let steps = format!("{planes} planes in steps of {row_pitch} and {column_pitch}");
            return Err(format!("{} covers {sides}, {steps}", self.name));
        }
        Ok(SampleRegion { top, left, bottom, right, plane, planes, row_pitch, column_pitch })
    }

    /// Reads a region and a number for each of its rows or columns.
    fn lines(&mut self, is_rows: bool) -> Result<(SampleRegion, Vec<f32>), String> {
        let region = self.region()?;
        let [from, to, pitch] =
            if is_rows { [region.top, region.bottom, region.row_pitch] } else { [region.left, region.right, region.column_pitch] };
        let (count, expected) = (self.size()?, (to - from).div_ceil(pitch));
        if count != expected {
            return Err(format!("{} has {count} numbers, expected {expected}", self.name));
        }
        Ok((region, self.f32s(count)?))
    }
}

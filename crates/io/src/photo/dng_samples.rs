//! Operations of a DNG's opcode lists on single samples: bad pixels and maps of values.
//!
//! In: codes, changed in place, and where they are in the coordinates of the operations. A bad
//! sample becomes the mean of the nearest good ones of its colour within two pixels, and stays as
//! it is if there are none. Maps are for values from 0 to 1; results are rounded to codes and
//! limited to the range of the type. Saturated samples stay so.

use luxel_core::photo::SampleRegion;

use super::dng_opcodes::{BadPixels, ValueFunction, ValueMap};
use crate::IoError;
use crate::input::Input;

/// Codes, and their arrangement.
pub(super) struct Samples<'a> {
    pub(super) codes: &'a mut [u16],
    /// Width, pixels.
    pub(super) width: usize,
    /// Samples per pixel.
    pub(super) per_pixel: usize,
    /// Column and row of the first pixel.
    pub(super) origin: [usize; 2],
    /// Colours of the mosaic's cell at the first pixel.
    pub(super) cell: Option<[u8; 4]>,
}

/// The range of codes that values from 0 to 1 are.
#[derive(Clone, Copy)]
pub(super) struct ValueRange {
    /// Code of 0, by place in the cell or by channel.
    pub(super) black: [f32; 4],
    /// Code of 1.
    pub(super) white: f32,
    /// Code that stays, and larger ones too.
    pub(super) saturated: f32,
}

/// Most times that rectangles of bad pixels may cover the image.
const MAX_COVERAGE: usize = 4;

impl Samples<'_> {
    /// Replaces bad samples.
    pub(super) fn fix(&mut self, input: Input<'_>, bad: &BadPixels) -> Result<(), IoError> {
        let mut is_bad = input.zeroed::<bool>(self.codes.len())?;
        match bad {
            BadPixels::Constant(code) => {
                is_bad.iter_mut().zip(self.codes.iter()).for_each(|(is_bad, found)| *is_bad = u32::from(*found) == *code);
            }
            BadPixels::List { points, rectangles } => self.mark(input, &mut is_bad, points, rectangles)?,
        }
        // In place, because only good ones are read.
        for i in (0..is_bad.len()).filter(|i| is_bad[*i]) {
            self.codes[i] = self.mean(i, &is_bad).unwrap_or(self.codes[i]);
        }
        Ok(())
    }

    fn mark(&self, input: Input<'_>, is_bad: &mut [bool], points: &[[usize; 2]], rectangles: &[SampleRegion]) -> Result<(), IoError> {
        let height = self.codes.len() / (self.width * self.per_pixel).max(1);
        let [left, top] = self.origin;
        let mut covered = 0usize;
        let point = |&[left, top]: &[usize; 2]| {
            let (right, bottom) = (left.saturating_add(1), top.saturating_add(1));
            SampleRegion { left, top, right, bottom, ..SampleRegion::ALL }
        };
        for region in points.iter().map(point).chain(rectangles.iter().copied()) {
            let rows = region.top.saturating_sub(top)..region.bottom.saturating_sub(top).min(height);
            let columns = region.left.saturating_sub(left)..region.right.saturating_sub(left).min(self.width);
            if columns.is_empty() {
                continue;
            }
            covered = covered.saturating_add(rows.len().saturating_mul(columns.len()));
            if covered > MAX_COVERAGE * self.width * height {
                let message = format!("DNG: rectangles of bad pixels cover the image more than {MAX_COVERAGE} times; the file is damaged");
                return Err(input.invalid(message + ", copy or export it again"));
            }
            for y in rows {
                let row = (y * self.width + columns.start) * self.per_pixel;
                is_bad[row..row + columns.len() * self.per_pixel].fill(true);
            }
        }
        Ok(())
    }

    /// Returns the mean of the nearest good samples of the colour of sample `i`.
    fn mean(&self, i: usize, is_bad: &[bool]) -> Option<u16> {
        let (pixel, channel) = (i / self.per_pixel, i % self.per_pixel);
        let (x, y) = ((pixel % self.width) as isize, (pixel / self.width) as isize);
        let color = |x: isize, y: isize| self.cell.map_or(0, |cell| cell[(y & 1) as usize * 2 + (x & 1) as usize]);
        let (mut nearest, mut sum, mut count) = (isize::MAX, 0u32, 0u32);
        for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
            let (at_x, at_y, distance) = (x + dx, y + dy, dx * dx + dy * dy);
            if distance == 0
                || distance > nearest
                || at_x < 0
                || at_y < 0
                || at_x >= self.width as isize
                || color(at_x, at_y) != color(x, y)
            {
                continue;
            }
            let at = (at_y as usize * self.width + at_x as usize) * self.per_pixel + channel;
            let Some(code) = self.codes.get(at).filter(|_| !is_bad[at]) else { continue };
            if distance < nearest {
                (nearest, sum, count) = (distance, 0, 0);
            }
            (sum, count) = (sum + u32::from(*code), count + 1);
        }
        (count > 0).then(|| ((sum + count / 2) / count) as u16)
    }

    /// Maps the values of samples.
    pub(super) fn map(&mut self, map: &ValueMap, range: ValueRange) {
        let row = (self.width * self.per_pixel).max(1);
        let (region, [left, top]) = (map.region, self.origin);
        for (y, codes) in self.codes.chunks_exact_mut(row).enumerate().filter(|(y, _)| region.has_row(y + top)) {
            for (i, code) in codes.iter_mut().enumerate() {
                let (x, plane) = (i / self.per_pixel, i % self.per_pixel);
                if f32::from(*code) >= range.saturated || !region.contains([x + left, y + top], plane) {
                    continue;
                }
                let black = range.black[if self.per_pixel == 1 { (y % 2) * 2 + x % 2 } else { plane.min(3) }];
                let value = f64::from((f32::from(*code) - black) / (range.white - black));
                let line = |values: &[f32], at: usize| value + f64::from(values.get(at).copied().unwrap_or(0.0));
                let mapped = match &map.function {
                    ValueFunction::Table(table) => {
                        let at = (value * 65535.0).round().max(0.0) as usize;
                        table.get(at).or(table.last()).map_or(value, |found| f64::from(*found) / 65535.0)
                    }
                    ValueFunction::Polynomial(coefficients) => coefficients.iter().rev().fold(0.0, |sum, k| sum * value + k),
                    ValueFunction::RowDeltas(deltas) => line(deltas, (y + top - region.top) / region.row_pitch),
                    ValueFunction::ColumnDeltas(deltas) => line(deltas, (x + left - region.left) / region.column_pitch),
                };
                // Limited to the range of the type.
                *code = (mapped * f64::from(range.white - black) + f64::from(black)).round() as u16;
            }
        }
    }
}

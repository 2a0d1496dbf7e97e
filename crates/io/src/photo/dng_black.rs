//! Black levels of a DNG that vary by row and column (BlackLevelDeltaH and V, DNG 1.7).
//!
//! A pixel's black is that of its place in the repeated cell plus the deltas of its column and row,
//! which count from the active area's corner. Their means are part of the black levels; what
//! remains, patterns of single rows and columns, is subtracted from the codes, except from those of
//! saturation, which stay saturated.

use super::dng::{Dng, ReadArea};
use super::dng_tags as tag;

impl Dng<'_> {
    /// Subtracts what single rows and columns add to black, and returns what deltas add to the
    /// levels of the four places of the mosaic's cell (or to all channels). An error says which tag
    /// is wrong.
    pub(super) fn subtract_black_deltas(&self, codes: &mut [u16], area: ReadArea, white: f32) -> Result<[f32; 4], String> {
        let row = (area.width * area.per_pixel).max(1);
        let deltas = |tag: u16, skip: usize, count: usize, name: &str| -> Result<Vec<f32>, String> {
            let Some(values) = self.image.numbers(tag).or_else(|| self.first.numbers(tag)).filter(|values| !values.is_empty()) else {
                return Ok(vec![0.0; count]);
            };
            if !values.iter().all(|v| v.is_finite()) || values.len() < skip + count {
                return Err(format!("{name} has {} numbers, expected {} that are finite", values.len(), skip + count));
            }
            Ok(values[skip..skip + count].iter().map(|v| *v as f32).collect())
        };
        let columns = deltas(tag::BLACK_DELTA_H, area.shift[0], area.width, "BlackLevelDeltaH")?;
        let rows = deltas(tag::BLACK_DELTA_V, area.shift[1], codes.len() / row, "BlackLevelDeltaV")?;
        // A mosaic's rows and columns alternate between two places of its cell.
        let period = if area.per_pixel == 1 { 2 } else { 1 };
        let (of_columns, of_rows) = (means(&columns, period), means(&rows, period));
        for (y, codes) in codes.chunks_exact_mut(row).enumerate() {
            let of_row = rows[y] - of_rows[y % period];
            for (x, pixel) in codes.chunks_exact_mut(area.per_pixel.max(1)).enumerate() {
                let rest = of_row + columns[x] - of_columns[x % period];
                for code in pixel.iter_mut().filter(|code| rest != 0.0 && f32::from(**code) < white) {
                    // Limited to the range of the type.
                    *code = (f32::from(*code) - rest).round() as u16;
                }
            }
        }
        Ok([0, 1, 2, 3].map(|i| if period == 2 { of_columns[i % 2] + of_rows[i / 2] } else { of_columns[0] + of_rows[0] }))
    }
}

/// Returns the means of every first, second, ... value of `period`; of a single row that of the
/// other place is its own.
fn means(values: &[f32], period: usize) -> [f32; 2] {
    let mean = |phase: usize| {
        let own: Vec<f64> = values.iter().skip(phase).step_by(period).map(|v| f64::from(*v)).collect();
        if own.is_empty() { None } else { Some((own.iter().sum::<f64>() / own.len() as f64) as f32) }
    };
    let first = mean(0).unwrap_or(0.0);
    [first, if period == 2 { mean(1).unwrap_or(first) } else { first }]
}

//! Tables: a row per method, means and deviations over seeds, the best and the second best of each
//! column marked.
//!
//! In: results. Out: [`Table`]. Degenerate: a value that no run has is missing; equal values are
//! not marked.

use crate::text;

use super::columns::{Better, COLUMNS, Column, Placement};
use super::results::CellResult;

/// A mean over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stat {
    pub(super) mean: f64,
    /// Standard deviation of the sample (n - 1); `None` for one seed.
    pub(super) deviation: Option<f64>,
    /// Number of seeds.
    pub(super) count: usize,
}

impl Stat {
    /// Returns `None` for no values, and where one is not finite.
    pub(super) fn from_values(values: &[f64]) -> Option<Self> {
        let count = values.len();
        if count == 0 || values.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let deviation = (count > 1).then(|| (squares / (count - 1) as f64).sqrt());
        Some(Self { mean, deviation, count })
    }
}

/// Rank within a column.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mark {
    #[default]
    None,
    Best,
    Second,
}

/// A cell of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) stat: Stat,
    pub(super) mark: Mark,
}

/// The row of a method.
pub(super) struct Row {
    /// Index into the matrix's methods.
    pub(super) method: usize,
    /// One per column; `None` where nothing was measured.
    pub(super) entries: Vec<Option<Entry>>,
}

/// A table.
pub(super) struct Table {
    pub(super) columns: Vec<&'static Column>,
    pub(super) rows: Vec<Row>,
}

impl Table {
    /// Returns the table of one data set.
    pub(super) fn of_source(results: &[CellResult], source: usize, methods: &[usize]) -> Self {
        let stat = |method: usize, column: &Column| {
            let cells = results.iter().filter(|cell| cell.source == source && cell.method == method);
            Stat::from_values(&cells.filter_map(column.value).collect::<Vec<_>>())
        };
        Self::new(methods, stat)
    }

    /// Returns the means over the data sets, of the seeds that all of them have.
    pub(super) fn average(results: &[CellResult], sources: usize, methods: &[usize], seeds: &[u64]) -> Self {
        let stat = |method: usize, column: &Column| {
            let of_seed = |seed: &u64| {
                let cells = results.iter().filter(|cell| cell.method == method && cell.seed == *seed);
                let values: Vec<f64> = cells.filter_map(column.value).collect();
                (values.len() == sources).then(|| values.iter().sum::<f64>() / sources as f64)
            };
            Stat::from_values(&seeds.iter().filter_map(of_seed).collect::<Vec<_>>())
        };
        Self::new(methods, stat)
    }

    fn new(methods: &[usize], stat: impl Fn(usize, &Column) -> Option<Stat>) -> Self {
        let placed = COLUMNS.iter().filter(|column| match column.placement {
            Placement::Always => true,
            Placement::IfThere => methods.iter().any(|&method| stat(method, column).is_some()),
            Placement::InCsv => false,
        });
        let columns: Vec<&'static Column> = placed.collect();
        let mut rows: Vec<Row> = methods.iter().map(|&method| Row { method, entries: Vec::new() }).collect();
        for column in &columns {
            let stats: Vec<Option<Stat>> = methods.iter().map(|&method| stat(method, column)).collect();
            let marks = marks(column, &stats);
            for ((row, stat), mark) in rows.iter_mut().zip(stats).zip(marks) {
                row.entries.push(stat.map(|stat| Entry { stat, mark }));
            }
        }
        Self { columns, rows }
    }

    /// Returns whether any row has a value.
    pub(super) fn has_values(&self) -> bool {
        self.rows.iter().any(|row| row.entries.iter().any(Option::is_some))
    }
}

/// Ranks by printed values: equal texts are equally good. A second place needs three rows.
fn marks(column: &Column, stats: &[Option<Stat>]) -> Vec<Mark> {
    let unmarked = vec![Mark::None; stats.len()];
    let sign = match column.better {
        Better::Higher => 1.0,
        Better::Lower => -1.0,
        Better::Neither => return unmarked,
    };
    let merit = |stat: &Stat| sign * rounded(stat.mean, column.decimals);
    let mut merits: Vec<f64> = stats.iter().flatten().map(merit).collect();
    let rows = merits.len();
    merits.sort_unstable_by(|a, b| b.total_cmp(a));
    merits.dedup();
    // No mark where all are equal.
    let (Some(&best), Some(&second)) = (merits.first(), merits.get(1)) else { return unmarked };
    let mark = |stat: &Option<Stat>| match stat.as_ref().map(merit) {
        Some(merit) if merit == best => Mark::Best,
        Some(merit) if merit == second && rows > 2 => Mark::Second,
        _ => Mark::None,
    };
    stats.iter().map(mark).collect()
}

fn rounded(value: f64, decimals: usize) -> f64 {
    let factor = 10f64.powi(i32::try_from(decimals).unwrap_or(0));
    (value * factor).round() / factor
}

/// Returns a value of a column as tables print it.
pub(super) fn printed(value: f64, decimals: usize) -> String {
    let value = rounded(value, decimals);
    if decimals == 0 && value >= 0.0 { text::count(value as usize) } else { format!("{value:.decimals$}") }
}

#[cfg(test)]
mod tests {
    use super::super::columns::by_key;
    use super::*;

    fn stats(means: &[f64]) -> Vec<Option<Stat>> {
        means.iter().map(|&mean| Stat::from_values(&[mean])).collect()
    }

    #[test]
    fn best_and_second_are_marked_by_what_is_printed() {
        use Mark::{Best, None, Second};
        let psnr = by_key("psnr_scene");
        assert_eq!(marks(psnr, &stats(&[30.0, 42.689, 39.0, 42.691])), [None, Best, Second, Best]);
        assert_eq!(marks(by_key("train_minutes"), &stats(&[9.0, 14.0, 10.0, 10.001])), [Best, None, Second, Second]);
        assert_eq!(marks(by_key("splats"), &stats(&[1.0, 2.0, 3.0])), [None; 3]);
        assert_eq!(marks(psnr, &stats(&[30.0, 31.0])), [None, Best]);
        assert_eq!(marks(psnr, &stats(&[30.0, 30.001, 30.0])), [None; 3]);
        assert_eq!(
            marks(psnr, &[Option::None, Stat::from_values(&[3.0]), Stat::from_values(&[2.0]), Stat::from_values(&[1.0])]),
            [None, Best, Second, None]
        );
        assert_eq!(marks(psnr, &[]), []);
    }

    #[test]
    fn spread_is_that_of_a_sample() {
        let stat = Stat::from_values(&[1.0, 2.0, 3.0]).unwrap();
        assert_eq!((stat.mean, stat.deviation, stat.count), (2.0, Some(1.0), 3));
        assert_eq!(Stat::from_values(&[5.0]).unwrap().deviation, None);
        assert_eq!((Stat::from_values(&[]), Stat::from_values(&[1.0, f64::NAN])), (None, None));
    }

    #[test]
    fn values_are_printed_with_their_decimals() {
        assert_eq!([printed(42.689, 2), printed(1641.2, 0), printed(-0.5, 0), printed(0.98765, 4)], ["42.69", "1,641", "-1", "0.9877"]);
    }
}

//! The results of the cells: read from their folders, one [`CellResult`] each.
//!
//! In: finished cells. Out: results in the matrix's order. Degenerate: a folder that cannot be read
//! is an error.

use std::path::PathBuf;

use luxel::Result;
use luxel::error::Context;
use luxel_metrics::SplitMetrics;
use luxel_metrics::{FieldMetrics, LuminanceProfile, ViewMetrics};

use super::matrix::{Cell, Matrix};
use super::measure::{self, Measured};
use crate::run::evaluation::Metrics;
use crate::run::log;

/// A finished cell.
pub(super) struct CellResult {
    /// Index into [`Matrix::sources`].
    pub(super) source: usize,
    /// Index into [`Matrix::methods`].
    pub(super) method: usize,
    pub(super) seed: u64,
    /// Place in the output folder.
    pub(super) place: PathBuf,
    /// Metrics of the last step, by the radiance scale of the data set.
    pub(super) metrics: Metrics,
    pub(super) measured: Option<Measured>,
    /// Peak of resident memory while the process trained, before the last evaluation, bytes.
    pub(super) peak_bytes: Option<u64>,
}

impl CellResult {
    pub(super) fn read(cell: &Cell) -> Result<Self> {
        let mut metrics = cell.metrics_of_training()?;
        let log = log::read(&cell.folder.log())?;
        let peak_bytes = log.last().and_then(|record| record.peak_rss_bytes).or(metrics.peak_rss_bytes);
        let (place, measured) = (cell.place.clone(), measure::read(cell));
        if let Some(by_scale) = measured.as_ref().and_then(|measured| measured.by_scale.as_ref()) {
            by_scale.replace_in(&mut metrics);
        }
        Ok(Self { source: cell.source, method: cell.method, seed: cell.seed, place, metrics, measured, peak_bytes })
    }

    /// Returns the means over the test views.
    pub(super) fn test(&self) -> Option<&ViewMetrics> {
        self.split("test").map(|split| &split.mean)
    }

    /// Returns the means over the training views.
    pub(super) fn train(&self) -> Option<&ViewMetrics> {
        self.split("train").map(|split| &split.mean)
    }

    /// Returns the means over the test views of metrics without a mu-law.
    pub(super) fn field(&self) -> Option<&FieldMetrics> {
        self.split("test").and_then(|split| split.mean_field.as_ref())
    }

    /// Returns the error by luminance over the test views.
    pub(super) fn profile(&self) -> Option<&LuminanceProfile> {
        self.split("test").map(|split| &split.profile)
    }

    fn split(&self, name: &str) -> Option<&SplitMetrics> {
        self.metrics.splits.get(name).filter(|split| !split.views.is_empty())
    }
}

/// Reads the results of the finished cells, in the matrix's order.
pub(super) fn read(matrix: &Matrix, finished: &[usize]) -> Result<Vec<CellResult>> {
    let cells = finished.iter().filter_map(|&i| matrix.cells.get(i));
    cells.map(|cell| CellResult::read(cell).with_context(|| format!("cannot read the results of {}", cell.name(matrix)))).collect()
}

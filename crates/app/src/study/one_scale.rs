//! One radiance scale for all methods on a data set.
//!
//! Protocol `scene`, the decades and PU21 count in units of the radiance scale, which a run takes
//! from its training images. A method that trains on captured images alone takes another one than a
//! method that sees radiance, so its metrics of the same images would differ.
//!
//! In: finished cells. Out: for each data set, the scale of the first method that sees radiance;
//! the metrics of a cell by that scale. Degenerate: where no method sees radiance, or all do, every
//! cell keeps its own.

use std::collections::BTreeMap;

use luxel::Result;
use luxel_core::{RadianceScale, View};
use luxel_io::Supervision;
use luxel_metrics::SplitMetrics;
use serde::{Deserialize, Serialize};

use super::matrix::Matrix;
use crate::run::RunConfig;
use crate::run::evaluation::{Metrics, Rendering};

/// Metrics of the test views by another radiance scale than the run's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ByScale {
    /// Data-set radiance that is 1 in protocol `scene`.
    pub(super) radiance_scale: RadianceScale,
    /// Splits of test views by name.
    pub(super) splits: BTreeMap<String, SplitMetrics>,
}

impl ByScale {
    /// Measures the test views, of which `plain` are the metrics as they are, after gains too.
    pub(super) fn measure(rendering: &mut Rendering<'_>, config: &RunConfig, test: &[View], plain: Option<SplitMetrics>) -> Result<Self> {
        let radiance_scale = rendering.protocol_scale.unwrap_or(rendering.radiance_scale);
        // Metrics of captured images do not depend on the scale.
        rendering.response = None;
        let fitted = rendering.evaluate_fitted(config, test)?;
        let splits = plain.map(|split| ("test", split)).into_iter().chain(fitted);
        Ok(Self { radiance_scale, splits: splits.map(|(name, split)| (name.to_owned(), split)).collect() })
    }

    /// Puts the metrics in place of those by the run's own scale.
    pub(super) fn replace_in(&self, metrics: &mut Metrics) {
        metrics.radiance_scale = self.radiance_scale;
        metrics.splits.extend(self.splits.clone());
    }
}

/// Returns for each finished cell the scale by which it is to be measured again, `None` where its
/// own is that of its data set.
pub(super) fn due(matrix: &Matrix, finished: &[usize]) -> Result<BTreeMap<usize, RadianceScale>> {
    let mut of_source: BTreeMap<usize, RadianceScale> = BTreeMap::new();
    let mut own = Vec::with_capacity(finished.len());
    for &i in finished {
        let Some(cell) = matrix.cells.get(i) else { continue };
        let scale = cell.metrics_of_training()?.radiance_scale;
        if cell.config.load.supervision != Supervision::Ldr {
            of_source.entry(cell.source).or_insert(scale);
        }
        own.push((i, cell.source, scale));
    }
    let due = own.into_iter().filter_map(|(i, source, scale)| Some((i, *of_source.get(&source)?)).filter(|(_, of_set)| *of_set != scale));
    Ok(due.collect())
}

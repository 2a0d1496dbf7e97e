//! All tables of a study.
//!
//! In: results of the cells. Out: a table per data set, their average, and tables of activations
//! alone. Degenerate: no average of a single data set, no comparison of a single activation.

use super::matrix::Matrix;
use super::paper;
use super::results::CellResult;
use super::table::Table;

/// The tables that page and LaTeX file have.
pub(super) struct Tables {
    /// Means over the data sets; only of more than one.
    pub(super) average: Option<Table>,
    /// One per data set.
    pub(super) results: Vec<Table>,
    /// Activations of the luminance alone, one per data set; only if there are several.
    pub(super) activations: Vec<Table>,
}

impl Tables {
    pub(super) fn new(matrix: &Matrix, results: &[CellResult]) -> Self {
        let all: Vec<usize> = (0..matrix.methods.len()).collect();
        let activations: Vec<usize> = all.iter().copied().filter(|&i| paper::name_of_activation(matrix.methods[i]).is_some()).collect();
        let per_source =
            |methods: &[usize]| (0..matrix.sources.len()).map(|source| Table::of_source(results, source, methods)).collect::<Vec<_>>();
        Self {
            average: (matrix.sources.len() > 1).then(|| Table::average(results, matrix.sources.len(), &all, &matrix.seeds)),
            results: per_source(&all),
            activations: if activations.len() > 1 { per_source(&activations) } else { Vec::new() },
        }
    }
}

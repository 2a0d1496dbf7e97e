//! The metrics as CSV, unrounded: every run, means and deviations, the error by luminance, and
//! luminance editing.
//!
//! In: results. Out: text with a line of names first. Degenerate: values that are missing are
//! empty.

use luxel_metrics::LuminanceProfile;

use super::MethodProfile;
use super::columns::COLUMNS;
use super::editing::{EXPONENT, Edited};
use super::matrix::Matrix;
use super::results::CellResult;
use super::table::Stat;

/// Returns a text as a field, in quotes where it needs them. A spreadsheet would take one that
/// begins like a formula for a formula: an apostrophe in front makes it a text.
fn field(text: &str) -> String {
    let is_formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']);
    let text = if is_formula { format!("'{text}") } else { text.to_owned() };
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
}

/// Returns the shortest text of a number; empty for none.
fn number(value: Option<f64>) -> String {
    value.filter(|v| v.is_finite()).map_or_else(String::new, |v| v.to_string())
}

fn line(fields: impl IntoIterator<Item = String>) -> String {
    fields.into_iter().collect::<Vec<_>>().join(",") + "\n"
}

/// Returns a line per run.
pub(super) fn runs(matrix: &Matrix, results: &[CellResult]) -> String {
    let names = [
        "dataset",
        "method",
        "colour_parameters",
        "seed",
        "iterations",
        "radiance_scale",
        "mu",
        "threads",
        "computed_by",
        "luxel_version",
        "folder",
    ];
    let mut out = line(names.into_iter().chain(COLUMNS.iter().map(|column| column.key)).map(String::from));
    for result in results {
        let (model, metrics) = (matrix.methods[result.method], &result.metrics);
        let facts = [
            field(&matrix.sources[result.source].name),
            model.name(),
            model.color_model().map_or_else(String::new, |model| model.parameters().to_string()),
            result.seed.to_string(),
            metrics.iterations.to_string(),
            metrics.radiance_scale.to_string(),
            metrics.mu.to_string(),
            metrics.threads.to_string(),
            field(&metrics.computed_by),
            field(&metrics.luxel_version),
            field(&result.place.display().to_string()),
        ];
        out += &line(facts.into_iter().chain(COLUMNS.iter().map(|column| number((column.value)(result)))));
    }
    out
}

/// Returns mean, standard deviation and number of seeds of every metric, a line per data set and
/// method.
pub(super) fn means(matrix: &Matrix, results: &[CellResult]) -> String {
    let of_column = |key: &str| [key.to_owned(), format!("{key}_sd")];
    let names = ["dataset", "method", "seeds"].map(String::from);
    let mut out = line(names.into_iter().chain(COLUMNS.iter().flat_map(|column| of_column(column.key))));
    for (source, of_source) in matrix.sources.iter().enumerate() {
        for (method, model) in matrix.methods.iter().enumerate() {
            let cells: Vec<&CellResult> = results.iter().filter(|cell| cell.source == source && cell.method == method).collect();
            let stats = COLUMNS.iter().flat_map(|column| {
                let stat = Stat::from_values(&cells.iter().filter_map(|cell| (column.value)(cell)).collect::<Vec<_>>());
                [number(stat.map(|stat| stat.mean)), number(stat.and_then(|stat| stat.deviation))]
            });
            out += &line([field(&of_source.name), model.name(), cells.len().to_string()].into_iter().chain(stats));
        }
    }
    out
}

/// Returns the error by the ground truth's luminance over the test views of all seeds, a line per
/// bin that has pixels.
pub(super) fn profiles(matrix: &Matrix, profiles: &[MethodProfile]) -> String {
    let names = ["dataset", "method", "luminance_from", "luminance_to", "pixels", "mean_luminance", "mean_absolute_error", "rms_stops"];
    let mut out = line(names.map(String::from));
    for MethodProfile { source, method, profile } in profiles {
        for (i, bin) in profile.bins.iter().enumerate().filter(|(_, bin)| bin.count > 0) {
            let (from, to) = LuminanceProfile::edges(i);
            let values = [bin.mean_luminance(), bin.mean_absolute_error(), bin.rms_stops()].map(number);
            let facts = [
                field(&matrix.sources[*source].name),
                matrix.methods[*method].name(),
                from.to_string(),
                to.to_string(),
                bin.count.to_string(),
            ];
            out += &line(facts.into_iter().chain(values));
        }
    }
    out
}

/// Returns the errors of luminance editing, a line per way to edit a scene.
pub(super) fn editing(matrix: &Matrix, edited: &[Edited]) -> String {
    let names = [
        "dataset",
        "method",
        "map_of",
        "exponent",
        "chromaticity_error",
        "chromaticity_error_p95",
        "chromaticity_error_by_light",
        "luminance_error_stops",
        "pixels",
    ];
    let mut out = line(names.map(String::from));
    for edited in edited {
        let fidelity = &edited.fidelity;
        let of = if edited.how.is_empty() { "luminance" } else { edited.how };
        let facts = [
            field(&matrix.sources[edited.source].name),
            matrix.methods[edited.method].name(),
            of.trim_start_matches("by ").into(),
            EXPONENT.to_string(),
        ];
        let errors = [fidelity.chromaticity, fidelity.chromaticity_p95, fidelity.chromaticity_by_light, fidelity.luminance_stops];
        out += &line(facts.into_iter().chain(errors.map(|error| number(Some(error)))).chain([fidelity.pixels.to_string()]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_no_formulas_in_a_spreadsheet() {
        assert_eq!(["=1+1", "+a", "-a", "@a", "a=b"].map(field), ["'=1+1", "'+a", "'-a", "'@a", "a=b"]);
        assert_eq!(field("=cmd|' /c calc'!A1,b"), "\"'=cmd|' /c calc'!A1,b\"");
    }

    #[test]
    fn fields_with_separators_are_quoted() {
        assert_eq!(["plain", "a,b", "say \"so\""].map(field), ["plain", "\"a,b\"", "\"say \"\"so\"\"\""]);
        assert_eq!([Some(0.1), None, Some(f64::NAN)].map(number), ["0.1", "", ""]);
    }
}

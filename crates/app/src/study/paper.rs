//! The results of "High Dynamic Range 3D Gaussian Splatting via Luminance-Chromaticity
//! Decomposition" (LCD-GS), as printed there.
//!
//! They are of other data (HDR-Syn-8S at 400x400, iHDR-4S at 2016x1512), another machine (one RTX
//! 4090; memory is the GPU's) and a protocol that is not stated: they are reported for their
//! differences from row to row, not to be compared number by number.

use luxel_core::{Activation, ColorModel};

use super::method::{StudyMethod, parse_method};

/// A row of the paper's tables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PaperRow {
    pub(super) method: &'static str,
    pub(super) minutes: f64,
    pub(super) memory_mb: f64,
    pub(super) psnr: f64,
    pub(super) ssim: f64,
    pub(super) lpips: f64,
    pub(super) fps: f64,
}

/// A table of the paper, on one data set.
#[derive(Clone, Copy, Debug)]
pub(super) struct PaperTable {
    pub(super) dataset: &'static str,
    pub(super) rows: &'static [PaperRow],
}

const fn row(method: &'static str, [minutes, memory_mb, psnr, ssim, lpips, fps]: [f64; 6]) -> PaperRow {
    PaperRow { method, minutes, memory_mb, psnr, ssim, lpips, fps }
}

/// A method of the paper, and the one that stands for it here.
struct PaperMethod {
    /// Name in the paper's tables.
    name: &'static str,
    /// Name here; `None` while there is no such method.
    here: Option<&'static str>,
}

/// The methods of the paper's tables of results, one a line. Its radiance fields are networks of 8
/// layers of 256 units; ours are hash grids, and their names say so.
const METHODS: [PaperMethod; 10] = [
    PaperMethod { name: "NeRF", here: Some("nerf-grid-linear") },
    PaperMethod { name: "3DGS", here: Some("sh3") },
    PaperMethod { name: "3DGS-D4", here: Some("sh4") },
    PaperMethod { name: "3DGS-D5", here: Some("sh5") },
    PaperMethod { name: "HDR-NeRF", here: Some("hdr-nerf-grid") },
    PaperMethod { name: "HDR-GS", here: Some("hdr-gs") },
    PaperMethod { name: "Mono-HDR-GS", here: Some("mono-hdr-gs") },
    PaperMethod { name: "Mono-HDR-NeRF", here: Some("mono-hdr-nerf-grid") },
    PaperMethod { name: "GaussHDR", here: Some("gausshdr") },
    PaperMethod { name: "LCD-GS", here: Some("lcd") },
];

impl PaperMethod {
    fn method(&self) -> Option<StudyMethod> {
        parse_method(self.here?).ok()
    }
}

/// Tables of results. Methods with other kinds of input or representation are among them.
pub(super) const RESULTS: [PaperTable; 2] = [
    PaperTable {
        dataset: "HDR-Syn-8S",
        rows: &[
            row("NeRF", [264.0, 11575.0, 15.20, 0.388, 0.753, 0.42]),
            row("3DGS", [9.0, 2085.0, 33.19, 0.914, 0.095, 252.0]),
            row("3DGS-D4", [10.0, 2518.0, 34.93, 0.839, 0.075, 205.0]),
            row("3DGS-D5", [10.0, 2616.0, 35.37, 0.948, 0.067, 148.0]),
            row("HDR-NeRF", [543.0, 12373.0, 36.40, 0.936, 0.018, 0.12]),
            row("HDR-GS", [21.0, 3761.0, 38.29, 0.968, 0.014, 126.0]),
            row("Mono-HDR-GS", [44.0, 6329.0, 38.57, 0.970, 0.013, 137.0]),
            row("Mono-HDR-NeRF", [439.0, 9281.0, 32.86, 0.940, 0.068, 0.26]),
            row("GaussHDR", [31.0, 5277.0, 39.02, 0.976, 0.010, 23.0]),
            row("LCD-GS", [14.0, 1641.0, 42.69, 0.989, 0.004, 227.0]),
        ],
    },
    PaperTable {
        dataset: "iHDR-4S",
        rows: &[
            row("NeRF", [2147.0, 14160.0, 12.58, 0.372, 0.793, 0.02]),
            row("3DGS", [27.0, 4008.0, 23.39, 0.699, 0.502, 155.0]),
            row("3DGS-D4", [26.0, 4726.0, 26.69, 0.741, 0.317, 138.0]),
            row("3DGS-D5", [28.0, 4774.0, 26.82, 0.742, 0.317, 141.0]),
            row("Mono-HDR-GS", [156.0, 16127.0, 16.63, 0.668, 0.337, 61.0]),
            row("Mono-HDR-NeRF", [570.0, 19165.0, 14.49, 0.493, 0.842, 0.02]),
            row("LCD-GS", [26.0, 4879.0, 27.74, 0.749, 0.295, 214.0]),
        ],
    },
];

/// Tables of activations of the luminance.
pub(super) const ACTIVATIONS: [PaperTable; 2] = [
    PaperTable {
        dataset: "HDR-Syn-8S",
        rows: &[
            row("Exponential", [11.0, 2094.0, 41.14, 0.980, 0.007, 250.0]),
            row("ReLU", [11.0, 1334.0, 3.77, 0.001, 0.800, 237.0]),
            row("Softplus", [14.0, 1641.0, 42.69, 0.989, 0.004, 227.0]),
        ],
    },
    PaperTable {
        dataset: "iHDR-4S",
        rows: &[
            row("Exponential", [23.0, 4927.0, 27.56, 0.746, 0.303, 257.0]),
            row("ReLU", [15.0, 3478.0, 3.32, 0.001, 0.665, 274.0]),
            row("Softplus", [26.0, 4879.0, 27.74, 0.749, 0.295, 214.0]),
        ],
    },
];

/// The paper's baseline, from which gains are counted.
pub(super) const BASELINE: StudyMethod = StudyMethod::Splats(ColorModel::Sh { degree: 3 });

/// The paper's method.
pub(super) const LCD_GS: StudyMethod =
    StudyMethod::Splats(ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus });

/// Reads the methods that a name stands for: one, or with `table1` and `table2` those of the
/// paper's tables of results on synthetic and on real data, in their order, as far as they exist
/// here.
///
/// ```
/// use luxel_app::study::parse_methods;
///
/// assert_eq!(parse_methods("lcd")?.len(), 1);
/// let first = parse_methods("table1")?;
/// assert_eq!((first[0].name(), first[1].name()), ("nerf-grid-linear".into(), "sh3".into()));
/// # Ok::<(), String>(())
/// ```
///
/// # Errors
/// As [`parse_method`].
pub fn parse_methods(text: &str) -> Result<Vec<StudyMethod>, String> {
    match text {
        "table1" => Ok(RESULTS[0].methods().collect()),
        "table2" => Ok(RESULTS[1].methods().collect()),
        _ => Ok(vec![parse_method(text)?]),
    }
}

/// Returns the paper's name of a method in its tables of results.
pub(super) fn name_in_results(method: StudyMethod) -> Option<&'static str> {
    METHODS.iter().find(|row| row.method() == Some(method)).map(|row| row.name)
}

/// Returns the paper's name of a method in its tables of activations.
pub(super) fn name_of_activation(method: StudyMethod) -> Option<&'static str> {
    match method.color_model()? {
        ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation } => Some(match activation {
            Activation::Softplus => "Softplus",
            Activation::Exp => "Exponential",
            Activation::Relu => "ReLU",
        }),
        _ => None,
    }
}

impl PaperTable {
    /// Returns the methods that stand for the table's here, in its order.
    pub(super) fn methods(&self) -> impl Iterator<Item = StudyMethod> {
        self.rows.iter().filter_map(|row| Self::method(row.method))
    }

    /// Returns the method that stands for one of the paper's.
    pub(super) fn method(name: &str) -> Option<StudyMethod> {
        METHODS.iter().find(|row| row.name == name)?.method()
    }

    /// Returns the row of a method.
    pub(super) fn row(&self, method: &str) -> Option<&PaperRow> {
        self.rows.iter().find(|row| row.method == method)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_gain_is_nine_and_a_half_decibels() {
        let [synthetic, real] = RESULTS;
        let psnr = |table: PaperTable, name: &str| table.row(name).unwrap().psnr;
        assert!((psnr(synthetic, "LCD-GS") - psnr(synthetic, "3DGS") - 9.50).abs() < 1e-9);
        assert!((psnr(real, "LCD-GS") - psnr(real, "3DGS") - 4.35).abs() < 1e-9);
    }

    #[test]
    fn the_papers_tables_are_lists_of_methods_in_its_order() {
        let names = |list: &str| parse_methods(list).unwrap().into_iter().map(StudyMethod::name).collect::<Vec<_>>();
        let [first, second] = ["table1", "table2"].map(names);
        assert_eq!((first.first().map(String::as_str), first.last().map(String::as_str)), (Some("nerf-grid-linear"), Some("lcd")));
        assert!(second.iter().all(|name| first.contains(name)), "{second:?}");
        assert_eq!(names("sh4"), ["sh4"]);
    }

    #[test]
    fn models_have_the_papers_names() {
        let lcd = |activation| StudyMethod::Splats(ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation });
        assert_eq!(name_in_results(lcd(Activation::Softplus)), Some("LCD-GS"));
        assert_eq!((name_in_results(lcd(Activation::Relu)), name_of_activation(lcd(Activation::Relu))), (None, Some("ReLU")));
        assert_eq!((name_in_results(BASELINE), name_of_activation(BASELINE)), (Some("3DGS"), None));
        let brighter = StudyMethod::Splats(ColorModel::Lcd { chroma_degree: 3, luminance_degree: 1, activation: Activation::Softplus });
        assert!(RESULTS.iter().flat_map(|table| table.rows).all(|row| METHODS.iter().any(|method| method.name == row.method)));
        assert_eq!((name_in_results(brighter), name_of_activation(brighter)), (None, None));
    }
}

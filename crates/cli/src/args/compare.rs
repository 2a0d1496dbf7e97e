//! Arguments of `luxel compare`.

use std::path::PathBuf;

use clap::Args;
use luxel_metrics::FieldOptions;

use super::values::{ColorSpaceArg, TransferArg, parse_positive};
use super::{ConsoleArgs, MetricsArgs};

/// `luxel compare`.
#[derive(Debug, Args)]
#[command(
    mut_arg("metrics", |arg| arg.default_value("all")),
    after_help = "Images of two folders are matched by their names without extension. What the metrics mean: docs/src/reference/metrics.md.\n\n\
    luxel compare reference.exr render.exr --heatmap flip.png\n\
    luxel compare run/eval/step_8000/gt run/eval/step_8000/renders --json\n\
    luxel compare sh3-run lcd-run -o sh3-and-lcd"
)]
pub(crate) struct CompareArgs {
    /// Reference, an image or a folder of images; with --reference, the test; or the first of two
    /// runs, which are compared on the test views that both have.
    #[arg(value_name = "REFERENCE")]
    pub(crate) first: PathBuf,
    /// Test, an image or a folder like the reference; or the second run.
    #[arg(value_name = "TEST", required_unless_present = "reference", conflicts_with = "reference")]
    pub(crate) second: Option<PathBuf>,
    /// Reference, in place of the first of two paths.
    #[arg(long, value_name = "PATH")]
    pub(crate) reference: Option<PathBuf>,
    /// Radiance that is 1 in protocol scene, in the decades and on the display of PU21, above 0
    /// [default: the radiance scale that Luxel's EXR files state; else the 99.9th percentile of the
    /// luminance of all references].
    #[arg(long, value_parser = parse_positive, value_name = "RADIANCE")]
    pub(crate) scale: Option<f32>,
    /// Luminance in cd/m2 at which the display of PU21 shows that radiance, above 0.
    #[arg(long, default_value_t = FieldOptions::DEFAULT_PEAK_LUMINANCE, value_parser = parse_positive, value_name = "CD/M2")]
    pub(crate) peak_luminance: f32,
    /// mu of the mu-law, above 0.
    #[arg(long, default_value_t = luxel_core::tone::MU, value_parser = parse_positive)]
    pub(crate) mu: f32,
    /// Metrics to compute.
    #[command(flatten)]
    pub(crate) metrics: MetricsArgs,
    /// Mask, black where pixels are left out; with folders one for all, or a folder of masks named
    /// like the references. Images without a mask are compared whole and reported.
    #[arg(long, value_name = "PATH", help_heading = "Images")]
    pub(crate) mask: Option<PathBuf>,
    /// Transfer function of integer images that do not state theirs, or the curve and primaries of
    /// a camera's plates, whatever their files state, floating-point ones too.
    #[arg(long, value_enum, value_name = "CURVE", help_heading = "Images")]
    pub(crate) transfer: Option<TransferArg>,
    /// Primaries of images that do not state theirs [default: linear-rec709].
    #[arg(long = "input-color-space", value_enum, value_name = "SPACE", help_heading = "Images")]
    pub(crate) color_space: Option<ColorSpaceArg>,
    /// Part, layer or view to read of OpenEXR files that have several, names separated by /
    /// [default: the beauty pass of the first view].
    #[arg(long, value_name = "NAMES", help_heading = "Images")]
    pub(crate) layer: Option<String>,
    /// Write an error map of HDR-FLIP, black for 0 to yellow for 1 (magma): a PNG; with folders, a
    /// folder of them.
    #[arg(long, value_name = "PATH", help_heading = "Output")]
    pub(crate) heatmap: Option<PathBuf>,
    /// For two runs, a new folder for runs.json and a picture of each view: above the ground truth
    /// and both renders, below where the second run's error is larger (orange) or smaller (blue),
    /// and both errors.
    #[arg(long, short, value_name = "DIR", conflicts_with_all = ["heatmap", "reference"], help_heading = "Output")]
    pub(crate) output: Option<PathBuf>,
    /// Replace error maps that are there.
    #[arg(long, requires = "heatmap", help_heading = "Output")]
    pub(crate) overwrite: bool,
    /// Print one JSON object on stdout in place of a table.
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

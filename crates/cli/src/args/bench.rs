//! Arguments of `luxel bench`.

use std::path::PathBuf;

use clap::Args;
use luxel_train::{CutoffPreset, Method, NamedChoice};

use super::train_options::choice_parser;

use super::{ConsoleArgs, DeviceArgs};
use crate::args::values::{InstructionSetArg, OrderArg, TransferArg, parse_positive, parse_size};

/// Options of measuring, which --save excludes. --overwrite excludes them too, as clap does not
/// require an option that another one excludes.
const OF_MEASURING: [&str; 15] = [
    "workload",
    "camera",
    "size",
    "target",
    "transfer",
    "layer",
    "mu",
    "order",
    "count",
    "steps",
    "warmup",
    "json",
    "instruction_set",
    "device",
    "threads",
];

/// `luxel bench`.
#[derive(Debug, Args)]
#[command(after_help = "A render and a training step are measured in turn, so that noise of the machine affects both. A step is render, \
    mu-law loss (0.8 L1 + 0.2 (1 - SSIM)), gradients of all parameters with densification statistics, and Adam with learning rates \
    of 1e-9, so that the scene stays where it is. Leave the machine otherwise idle.\n\n\
    Cost against splats:  for n in 10000 100000 1000000; do luxel bench --generate $n --json; done\n\
    Cost against pixels:  for s in 200x200 400x400 800x800; do luxel bench --generate 100000 --size $s --json; done")]
pub(crate) struct BenchArgs {
    /// Scene to measure on, plain 3DGS files too.
    #[arg(
        long,
        value_name = "SCENE.ply",
        required_unless_present = "generate",
        conflicts_with = "generate",
        requires = "camera",
        help_heading = "Workload"
    )]
    pub(crate) workload: Option<PathBuf>,
    /// Measure on a synthetic room of N splats, 1 to 100000000.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000_000), help_heading = "Workload")]
    pub(crate) generate: Option<u32>,
    /// Write the room as a scene file in the colour model of --method, and measure nothing.
    #[arg(long, value_name = "SCENE.ply", requires = "generate", conflicts_with_all = OF_MEASURING, help_heading = "Workload")]
    pub(crate) save: Option<PathBuf>,
    /// Replace an existing scene file.
    #[arg(long, requires = "save", conflicts_with_all = OF_MEASURING, help_heading = "Workload")]
    pub(crate) overwrite: bool,
    /// Camera as JSON: width, height, fx, fy, cx, cy (pixels) and world_to_camera (4 rows of 4,
    /// OpenCV axes) [default for --generate: the room's own].
    #[arg(long, value_name = "FILE", help_heading = "Workload")]
    pub(crate) camera: Option<PathBuf>,
    /// Image size of the room's own camera, 75 degrees wide [default: 400x400].
    #[arg(
        long,
        value_name = "WxH",
        value_parser = parse_size,
        requires = "generate",
        conflicts_with_all = ["camera", "workload"],
        help_heading = "Workload"
    )]
    pub(crate) size: Option<[u32; 2]>,
    /// Target image of the loss in the units of the scene: .npy (float32, height x width x 3),
    /// OpenEXR or another image format of data sets [default: a render of the workload, whose
    /// parameters are then perturbed so that there are gradients].
    #[arg(long, value_name = "FILE", help_heading = "Workload")]
    pub(crate) target: Option<PathBuf>,
    /// Transfer function of an integer target that does not state its own.
    #[arg(long, value_enum, value_name = "CURVE", requires = "target", help_heading = "Workload")]
    pub(crate) transfer: Option<TransferArg>,
    /// Part, layer or view to read of an OpenEXR target that has several, names separated by
    /// / [default: the beauty pass of the first view].
    #[arg(long, value_name = "NAMES", requires = "target", help_heading = "Workload")]
    pub(crate) layer: Option<String>,
    /// Seed of the room and of the perturbation.
    #[arg(long, default_value_t = 42, value_name = "N", help_heading = "Workload")]
    pub(crate) seed: u64,
    /// Colour model to convert the workload's harmonics to [default: the workload's own; sh3 for
    /// --generate].
    #[arg(long, value_parser = choice_parser::<Method>(), help_heading = "Method")]
    pub(crate) method: Option<Method>,
    /// Cut-offs of the rasteriser; both presets have the near plane at 0.01.
    #[arg(long, value_parser = choice_parser::<CutoffPreset>(), default_value = CutoffPreset::Parity.name(), help_heading = "Method")]
    pub(crate) cutoffs: CutoffPreset,
    /// mu of the mu-law in the loss, above 0; 1e-3 makes the loss linear.
    #[arg(long, default_value_t = luxel_core::tone::MU, value_parser = parse_positive, help_heading = "Method")]
    pub(crate) mu: f32,
    /// Order of the splats in memory.
    #[arg(long, value_enum, default_value_t, help_heading = "Method")]
    pub(crate) order: OrderArg,
    /// Renders and steps to measure, 1 to 1000000.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1_000_000), value_name = "N", help_heading = "Measurement")]
    pub(crate) steps: u32,
    /// Renders and steps before the measured ones, at most 1000000.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(..=1_000_000), value_name = "K", help_heading = "Measurement")]
    pub(crate) warmup: u32,
    /// Count the work of a training step on the GPU engine, software renderers too, and measure no
    /// times: entries, pairs, steps of the passes over pixels, keys, bytes, kernels.
    #[arg(long, conflicts_with_all = ["steps", "warmup", "instruction_set"], help_heading = "Measurement")]
    pub(crate) count: bool,
    /// Print one JSON object on stdout in place of a table.
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
    /// Vector instructions that the CPU engine may use.
    #[arg(long, value_enum, default_value_t, value_name = "SET", help_heading = "Machine")]
    pub(crate) instruction_set: InstructionSetArg,
    /// Device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

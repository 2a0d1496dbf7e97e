//! `luxel bench` as text.

use std::path::PathBuf;

use clap::Args;
use luxel_train::{CutoffPreset, Method};

use super::DeviceArgs;
use crate::args::values::{InstructionSetArg, OrderArg, TransferArg, parse_positive, parse_size};

/// What --save, which measures nothing, has no use for. --overwrite names it once more: clap does not insist on an option that another one excludes.
const OF_MEASURING: [&str; 13] =
    ["workload", "camera", "size", "target", "transfer", "mu", "order", "steps", "warmup", "json", "instruction_set", "device", "threads"];

/// `luxel bench`.
#[derive(Debug, Args)]
#[command(after_help = "A render and a training step are measured in turn, so that noise of the machine hits both. A step is render, \
    mu-law loss (0.8 L1 + 0.2 (1 - SSIM)), gradients of all parameters with densification statistics, and Adam with learning rates \
    of 1e-9, so that the scene stays where it is. Leave the machine otherwise idle.\n\n\
    Cost against splats:  for n in 10000 100000 1000000; do luxel bench --generate $n --json; done\n\
    Cost against pixels:  for s in 200x200 400x400 800x800; do luxel bench --generate 100000 --size $s --json; done")]
pub(crate) struct BenchArgs {
    /// Scene to measure on; plain 3DGS files too.
    #[arg(
        long,
        value_name = "SCENE.ply",
        required_unless_present = "generate",
        conflicts_with = "generate",
        requires = "camera",
        help_heading = "Workload"
    )]
    pub(crate) workload: Option<PathBuf>,
    /// Measure on a synthetic room of N splats instead.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000_000), help_heading = "Workload")]
    pub(crate) generate: Option<u32>,
    /// Write the room as a scene file (in the colour model of --method) instead of measuring.
    #[arg(long, value_name = "SCENE.ply", requires = "generate", conflicts_with_all = OF_MEASURING, help_heading = "Workload")]
    pub(crate) save: Option<PathBuf>,
    /// Replace the scene file that is there.
    #[arg(long, requires = "save", conflicts_with_all = OF_MEASURING, help_heading = "Workload")]
    pub(crate) overwrite: bool,
    /// Camera: JSON with width, height, fx, fy, cx, cy (pixels) and world_to_camera (4 rows of 4, OpenCV axes) [default for --generate:
    /// the room's own].
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
    /// Image for the loss to compare with, in the units of the scene: .npy (float32, height x width x 3), OpenEXR or another
    /// format that data sets have [default: a render of the workload; the parameters are then shaken, so that there are gradients].
    #[arg(long, value_name = "FILE", help_heading = "Workload")]
    pub(crate) target: Option<PathBuf>,
    /// Transfer function of a target of integers, where the file does not say it.
    #[arg(long, value_enum, value_name = "CURVE", requires = "target", help_heading = "Workload")]
    pub(crate) transfer: Option<TransferArg>,
    /// Seed of the room and of the shaking.
    #[arg(long, default_value_t = 42, value_name = "N", help_heading = "Workload")]
    pub(crate) seed: u64,
    /// Colour model; the workload's harmonics are converted [default: the workload's own, sh3 for --generate].
    #[arg(long, value_enum, help_heading = "Method")]
    pub(crate) method: Option<Method>,
    /// Where the rasteriser stops looking; both presets with the near plane at 0.01.
    #[arg(long, value_enum, default_value_t = CutoffPreset::Parity, help_heading = "Method")]
    pub(crate) cutoffs: CutoffPreset,
    /// mu of the mu-law in the loss, above 0; 1e-3 is as good as a linear loss.
    #[arg(long, default_value_t = luxel_core::tone::MU, value_parser = parse_positive, help_heading = "Method")]
    pub(crate) mu: f32,
    /// Order of the splats in memory.
    #[arg(long, value_enum, default_value_t, help_heading = "Method")]
    pub(crate) order: OrderArg,
    /// Renders and steps that are measured.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1_000_000), value_name = "N", help_heading = "Measurement")]
    pub(crate) steps: u32,
    /// Renders and steps made before.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(..=1_000_000), value_name = "K", help_heading = "Measurement")]
    pub(crate) warmup: u32,
    /// One JSON object on stdout instead of a table.
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
    /// What the engine may use of the processor.
    #[arg(long, value_enum, default_value_t, value_name = "SET", help_heading = "Machine")]
    pub(crate) instruction_set: InstructionSetArg,
    /// Where the work is done.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
}

//! Groups of options that several commands share.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use luxel::{Device, DeviceOptions, Downscale, LoadOptions};
use luxel_app::run::{ExplicitArgs, PlotLog, RunOptions, TimeLimit};
use luxel_io::{Exposures, ImageMemory, MaskSource};

use super::flag;
use super::values::{ColorSpaceArg, FormatArg, MetricsArg, SupervisionArg, TransferArg, parse_masks};
use crate::output::console::LogFormat;

/// Options of reading a data set.
#[derive(Clone, Debug, Args)]
pub(crate) struct LoadArgs {
    /// Layout of the data set [default: recognised].
    #[arg(long, value_enum, value_name = "FORMAT", help_heading = "Data set")]
    pub(crate) format: Option<FormatArg>,
    /// Transfer function of integer images that do not state theirs, or the curve and primaries of
    /// a camera's plates, whatever their files state, floating-point ones too.
    #[arg(long, value_enum, value_name = "CURVE", help_heading = "Data set")]
    pub(crate) transfer: Option<TransferArg>,
    /// Primaries of images that do not state theirs [default: linear-rec709].
    #[arg(long = "input-color-space", value_enum, value_name = "SPACE", help_heading = "Data set")]
    pub(crate) color_space: Option<ColorSpaceArg>,
    /// Reduce images by this factor along each side, by area average in linear light: a whole
    /// number from 1 to 16, or auto, the smallest with which the longer side of the largest
    /// training image has at most 1600 pixels. 1 takes large images in full size.
    #[arg(long, default_value_t = Downscale::Auto, value_name = "auto|N", help_heading = "Data set")]
    pub(crate) downscale: Downscale,
    /// Train on radiance, on captured LDR images with their exposures, or on both; methods that
    /// train on both imply it.
    #[arg(long, value_enum, default_value_t, value_name = "KIND", help_heading = "Data set")]
    pub(crate) supervision: SupervisionArg,
    /// Exposures of each pose to train on with --supervision ldr or both: all, single (one a pose,
    /// in turn), middle, or numbers counted from the shortest, such as 0,2,4.
    #[arg(long, default_value_t, value_name = "WHICH", help_heading = "Data set")]
    pub(crate) exposures: Exposures,
    /// Masks, white where pixels count and black where they do not: auto (mask_path of
    /// transforms.json, or masks/IMAGE.png beside the data set), off, alpha (of the images), or a
    /// folder of masks named like the images.
    #[arg(long, default_value_t, value_parser = parse_masks, value_name = "SOURCE", help_heading = "Data set")]
    pub(crate) masks: MaskSource,
    /// Part, layer or view to read of OpenEXR files that have several, names separated by /,
    /// such as ViewLayer.Combined or rgba/left [default: the beauty pass of the first view].
    #[arg(long, value_name = "NAMES", help_heading = "Data set")]
    pub(crate) layer: Option<String>,
}

impl LoadArgs {
    /// Returns the library's form of these options.
    pub(crate) fn options(&self) -> LoadOptions {
        LoadOptions {
            format: self.format.map(Into::into),
            transfer: self.transfer.map(Into::into),
            color_space: self.color_space.map(Into::into),
            downscale: self.downscale,
            supervision: self.supervision.into(),
            exposures: self.exposures.clone(),
            masks: self.masks.clone(),
            layer: self.layer.clone(),
        }
    }

    /// Refuses explicit options of reading a data set, but for those that are `used` all the same.
    /// `why` continues the sentence with the reason and the remedy.
    pub(crate) fn refuse(explicit: &ExplicitArgs, used: &[&str], why: &str) -> Result<()> {
        let options = Self::augment_args(clap::Command::new("load"));
        let is_refused = |id: &str| !used.contains(&id) && options.get_arguments().any(|arg| arg.get_id() == id);
        match explicit.iter().find(|id| is_refused(id)) {
            Some(id) => bail!("{} sets how a data set is read, {why}", flag(id)),
            None => Ok(()),
        }
    }
}

/// The scene that a command works on, and the data set that goes with it.
#[derive(Clone, Debug, Args)]
pub(crate) struct SceneDataArgs {
    /// Folder of a run (its newest scene), or a scene file: PLY (plain and compressed 3DGS files
    /// too), USD, GLB, SPZ.
    #[arg(value_name = "RUN|SCENE")]
    pub(crate) scene: PathBuf,
    /// Data set [default for a run: its own].
    #[arg(long, value_name = "DATASET", help_heading = "Data set")]
    pub(crate) data: Option<PathBuf>,
    /// Reading the data set.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

/// Metrics beyond those that every evaluation has.
#[derive(Clone, Debug, Args)]
pub(crate) struct MetricsArgs {
    /// Metrics to compute.
    #[arg(long, value_enum, default_value_t = MetricsArg::Fast, help_heading = "Metrics")]
    pub(crate) metrics: MetricsArg,
    /// Weights of LPIPS: the state dict of lpips.LPIPS(net='alex' or 'vgg') as a safetensors file.
    #[arg(long, value_name = "FILE", help_heading = "Metrics")]
    pub(crate) lpips_weights: Option<PathBuf>,
}

/// Options of the device. The result is the same for any number of threads; the CPU and a GPU
/// agree to rounding.
#[derive(Clone, Debug, Args)]
pub(crate) struct DeviceArgs {
    /// Device that computes: auto takes a real GPU if there is one, else the CPU; gpu requires one;
    /// gpu:NAME takes the GPU whose name contains NAME, a software renderer too. luxel info
    /// --devices lists them.
    #[arg(long, default_value_t, value_name = "auto|cpu|gpu|gpu:NAME", help_heading = "Machine")]
    pub(crate) device: Device,
    /// Number of threads, 1 to 4096 [default: all cores]. The result does not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(luxel::MAX_THREADS)), value_name = "N", help_heading = "Machine")]
    pub(crate) threads: Option<u32>,
}

impl DeviceArgs {
    /// Returns the library's form of these options.
    pub(crate) fn options(&self) -> DeviceOptions {
        DeviceOptions { device: self.device.clone(), threads: self.threads }
    }
}

/// Options of saving and evaluating during training.
#[derive(Clone, Debug, Args)]
pub(crate) struct RunArgs {
    /// Train for this long, such as 90s, 10min or 1h30min: as many steps as fit, on reduced images
    /// where whole ones leave too few. Evaluations and the files after the last step come on top.
    #[arg(long, value_name = "TIME", conflicts_with = "iterations", help_heading = "Run")]
    pub(crate) time: Option<TimeLimit>,
    /// Save a checkpoint every N steps; 0 saves one at the end only.
    #[arg(long, default_value_t = 5000, value_name = "N", help_heading = "Run")]
    pub(crate) checkpoint_every: u32,
    /// Number of newest checkpoints to keep, at least 1; the next is written before one is deleted,
    /// so there must be room for one more.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..), value_name = "K", help_heading = "Run")]
    pub(crate) keep_checkpoints: u32,
    /// Steps after which to evaluate the test views and write the scene; the last step always is.
    #[arg(long, value_delimiter = ',', default_values_t = [7000, 30000], value_name = "STEPS", help_heading = "Run")]
    pub(crate) eval_at: Vec<u32>,
    /// Steps of refining the display colours of the last point_cloud.ply, which splat viewers show,
    /// on at most 64 views of at most a megapixel; 0 leaves it out. The radiance stays as it is.
    #[arg(long, default_value_t = luxel::export::DEFAULT_REFINE_STEPS, value_parser = clap::value_parser!(u32).range(..=100_000), value_name = "N", help_heading = "Run")]
    pub(crate) refine_display: u32,
    /// Memory that the images of the data set may take, such as 4GiB or 512MiB; auto is half of
    /// what the system allows. Images that have no room are stored beside the run as half floats,
    /// in RUN.images, and read while training.
    #[arg(long, default_value_t, value_name = "SIZE", help_heading = "Machine")]
    pub(crate) image_memory: ImageMemory,
    /// Write the log in these forms too: csv as RUN/log.csv, tensorboard for tensorboard --logdir
    /// RUN/tensorboard.
    #[arg(long, value_delimiter = ',', value_parser = PossibleValuesParser::new(PlotLog::ALL.map(PlotLog::name)).try_map(|name| name.parse::<PlotLog>()), value_name = "FORM", help_heading = "Run")]
    pub(crate) log: Vec<PlotLog>,
    /// Evaluate every N steps in place of --eval-at, at least 1.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..), value_name = "N", conflicts_with = "eval_at", help_heading = "Run")]
    pub(crate) eval_every: Option<u32>,
}

impl RunArgs {
    /// Returns the library's form of these options.
    pub(crate) fn options(&self) -> RunOptions {
        RunOptions {
            checkpoint_every: self.checkpoint_every,
            keep_checkpoints: self.keep_checkpoints,
            eval_at: self.eval_at.clone(),
            eval_every: self.eval_every,
            refine_display: self.refine_display,
            image_memory: self.image_memory,
            time: self.time,
            from: None,
            log: self.log.clone(),
        }
    }
}

/// Options of terminal output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Args)]
pub(crate) struct ConsoleArgs {
    /// Report progress as text on stderr, or for programs as one JSON object a line on stdout.
    #[arg(long, value_enum, default_value_t, value_name = "FORMAT", help_heading = "Output")]
    pub(crate) log_format: LogFormat,
    /// Print warnings, errors and results only.
    #[arg(long, short, conflicts_with = "log_format", help_heading = "Output")]
    pub(crate) quiet: bool,
}

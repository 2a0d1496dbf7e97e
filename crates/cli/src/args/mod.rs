//! The arguments of the program: one struct a command, shared groups of options, and the values
//! they take.

mod bench;
mod edit;
mod export;
mod prepare;
mod probe;
mod render;
mod reproduce;
pub(crate) mod run_config;
pub(crate) mod values;

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::error::ErrorKind;
use clap::{Arg, Args, CommandFactory, Parser, Subcommand};
use luxel::run::{ExplicitArgs, RunOptions};
use luxel::{Device, DeviceOptions, LoadOptions};
use luxel_core::metrics::FieldOptions;
use luxel_io::{Exposures, MaskSource};
use luxel_train::{Method, TrainConfig};

pub(crate) use self::bench::BenchArgs;
pub(crate) use self::edit::{EditArgs, EditText, ShMapArg};
pub(crate) use self::export::{BakeArg, ExportArgs};
pub(crate) use self::prepare::{CameraModelArg, MatchingArg, PrepareArgs, ResponseArg, SfmArg, WhiteBalanceArg};
pub(crate) use self::probe::ProbeArgs;
pub(crate) use self::render::RenderArgs;
pub(crate) use self::reproduce::ReproduceArgs;
use self::values::{ColorSpaceArg, FormatArg, MetricsArg, SupervisionArg, TransferArg, parse_downscale, parse_masks, parse_positive};
use crate::output::console::LogFormat;

/// Returns an option as it is typed: `--max-splats` for `max_splats`.
pub(crate) fn flag(option: &str) -> String {
    format!("--{}", option.replace('_', "-"))
}

/// High dynamic range 3D Gaussian splatting: posed HDR images in, a scene of linear radiance out.
#[derive(Debug, Parser)]
#[command(name = "luxel", version, propagate_version = true, max_term_width = 120, after_help = "New here? Type: luxel demo")]
pub(crate) struct Cli {
    /// The command.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Returns the program's arguments.
pub(crate) fn command() -> clap::Command {
    let command = Cli::command().mut_subcommand("reproduce", |reproduce| reproduce.mut_args(reproduce::adapted));
    command.mut_subcommands(|subcommand| subcommand.mut_args(with_negative_numbers))
}

/// Lets an option take -1 for its value, so that an error is about the value and not about an
/// unknown option `-1`.
fn with_negative_numbers(arg: Arg) -> Arg {
    let is_with_value = !arg.is_positional() && arg.get_action().takes_values();
    if is_with_value { arg.allow_negative_numbers(true) } else { arg }
}

/// Checks what the arguments' own rules cannot express; `explicit` names the options that were
/// given.
pub(crate) fn check(cli: &Cli, explicit: &ExplicitArgs) -> Result<(), clap::Error> {
    let checked = match &cli.command {
        Command::Reproduce(_) => reproduce::check(explicit),
        Command::Info(args) if args.devices => {
            LoadArgs::refuse(explicit, &[], "and --devices reads none; leave it out").map_err(|error| error.to_string())
        }
        _ => Ok(()),
    };
    checked.map_err(|message| command().error(ErrorKind::ArgumentConflict, message))
}

/// The commands of the program.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train, evaluate and render a small HDR scene that comes with the program: no files, no
    /// network, minutes.
    Demo(DemoArgs),
    /// Make a data set from a folder of photographs: RAW, exposure brackets or OpenEXR to posed
    /// radiance.
    Prepare(Box<PrepareArgs>),
    /// Reconstruct a scene from posed HDR images.
    Train(Box<TrainArgs>),
    /// Measure a run's scene against its images: a table, metrics.json and report.html.
    Eval(EvalArgs),
    /// Compare two images, or two folders of images, by every metric.
    Compare(CompareArgs),
    /// Render a scene to OpenEXR images in the units of the data set.
    Render(RenderArgs),
    /// Change the light of a scene: map the luminance of all or selected splats and keep their
    /// colours.
    Edit(Box<EditArgs>),
    /// Write a scene for other programs: PLY, USD, glTF, SPZ; as radiance or as a display bake.
    Export(Box<ExportArgs>),
    /// Render the light that arrives at a point of the scene as an environment map.
    Probe(Box<ProbeArgs>),
    /// Describe a scene, run, checkpoint, data set or image, or list the devices.
    Info(InfoArgs),
    /// Measure the time of rendering and of training steps on a scene, pass by pass.
    Bench(Box<BenchArgs>),
    /// Train methods side by side on data sets and seeds, and write the paper's tables and
    /// pictures.
    Reproduce(Box<ReproduceArgs>),
}

/// Options of reading a data set.
#[derive(Clone, Debug, Args)]
pub(crate) struct LoadArgs {
    /// Layout of the data set [default: recognised].
    #[arg(long, value_enum, value_name = "FORMAT", help_heading = "Data set")]
    pub(crate) format: Option<FormatArg>,
    /// Transfer function of integer images that do not state theirs.
    #[arg(long, value_enum, value_name = "CURVE", help_heading = "Data set")]
    pub(crate) transfer: Option<TransferArg>,
    /// Primaries of images that do not state theirs [default: linear-rec709].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "Data set")]
    pub(crate) color_space: Option<ColorSpaceArg>,
    /// Reduce images by this factor along each side, by area average in linear light.
    #[arg(long, default_value = "1", value_parser = parse_downscale, value_name = "1|2|4|8", help_heading = "Data set")]
    pub(crate) downscale: u32,
    /// Train on radiance, or on captured LDR images with their exposures.
    #[arg(long, value_enum, default_value_t, value_name = "KIND", help_heading = "Data set")]
    pub(crate) supervision: SupervisionArg,
    /// Exposures of each pose to train on with --supervision ldr: all, single (one a pose, in
    /// turn), or numbers counted from the shortest, such as 0,2,4.
    #[arg(long, default_value_t, value_name = "WHICH", help_heading = "Data set")]
    pub(crate) exposures: Exposures,
    /// Masks, white where pixels count and black where they do not: auto (mask_path of
    /// transforms.json, or masks/IMAGE.png beside the data set), off, alpha (of the images), or a
    /// folder of masks named like the images.
    #[arg(long, default_value_t, value_parser = parse_masks, value_name = "SOURCE", help_heading = "Data set")]
    pub(crate) masks: MaskSource,
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
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4096), value_name = "N", help_heading = "Machine")]
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
    /// Save a checkpoint every N steps; 0 saves one at the end only.
    #[arg(long, default_value_t = 5000, value_name = "N", help_heading = "Run")]
    pub(crate) checkpoint_every: u32,
    /// Number of newest checkpoints to keep, at least 1.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..), value_name = "K", help_heading = "Run")]
    pub(crate) keep_checkpoints: u32,
    /// Steps after which to evaluate the test views and write the scene; the last step always is.
    #[arg(long, value_delimiter = ',', default_values_t = [7000, 30000], value_name = "STEPS", help_heading = "Run")]
    pub(crate) eval_at: Vec<u32>,
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

/// `luxel train`.
#[derive(Debug, Args)]
#[command(after_help = "Ctrl-C saves the state and exits with code 130; --resume continues from there, bit for bit.")]
pub(crate) struct TrainArgs {
    /// Folder of the data set: transforms.json, COLMAP's sparse/0, or the layouts of HDR-NeRF,
    /// HDR-GS and GaussHDR. Optional with --resume and --config, which name one.
    #[arg(required_unless_present_any = ["resume", "config"])]
    pub(crate) dataset: Option<PathBuf>,
    /// Folder of the run.
    #[arg(long, short, value_name = "RUN")]
    pub(crate) output: PathBuf,
    /// Take settings from a run's config.toml; options given here take precedence.
    #[arg(long, value_name = "FILE", conflicts_with = "resume")]
    pub(crate) config: Option<PathBuf>,
    /// Delete the run in the output folder and start anew.
    #[arg(long, conflicts_with = "resume")]
    pub(crate) overwrite: bool,
    /// Continue the run in the output folder from its newest readable checkpoint.
    #[arg(long)]
    pub(crate) resume: bool,
    /// Stop as at Ctrl-C when standard input ends, for programs that start this one and hold its
    /// input open.
    #[arg(long, help_heading = "Run")]
    pub(crate) stop_at_end_of_input: bool,
    /// Print the time spent in each pass at the end.
    #[arg(long, help_heading = "Output")]
    pub(crate) profile: bool,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
    /// Reading the data set.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// Saving and evaluating.
    #[command(flatten)]
    pub(crate) run: RunArgs,
    /// The method.
    #[command(flatten)]
    pub(crate) train: TrainConfig,
}

/// `luxel eval`.
#[derive(Debug, Args)]
pub(crate) struct EvalArgs {
    /// Folder of the run.
    pub(crate) run: PathBuf,
    /// Data set to measure against [default: that of the run, read as the run did but for options
    /// given here].
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// Metrics to compute.
    #[arg(long, value_enum, default_value_t = MetricsArg::Fast)]
    pub(crate) metrics: MetricsArg,
    /// Luminance in cd/m2 at which the display of PU21 shows the scene's radiance scale, above 0.
    #[arg(long, default_value_t = FieldOptions::DEFAULT_PEAK_LUMINANCE, value_parser = parse_positive, value_name = "CD/M2")]
    pub(crate) peak_luminance: f32,
    /// Weights of LPIPS: the state dict of lpips.LPIPS(net='alex' or 'vgg') as a safetensors file.
    #[arg(long, value_name = "FILE")]
    pub(crate) lpips_weights: Option<PathBuf>,
    /// Reading the data set.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
}

/// `luxel compare`.
#[derive(Debug, Args)]
#[command(
    after_help = "Images of two folders are matched by their names without extension. What the metrics mean: docs/src/reference/metrics.md.\n\n\
    luxel compare reference.exr render.exr --heatmap flip.png\n\
    luxel compare run/eval/step_9000/gt run/eval/step_9000/renders --json"
)]
pub(crate) struct CompareArgs {
    /// Reference, an image or a folder of images; with --reference, the test.
    #[arg(value_name = "REFERENCE")]
    pub(crate) first: PathBuf,
    /// Test, an image or a folder like the reference.
    #[arg(value_name = "TEST", required_unless_present = "reference", conflicts_with = "reference")]
    pub(crate) second: Option<PathBuf>,
    /// Reference, in place of the first of two paths.
    #[arg(long, value_name = "PATH")]
    pub(crate) reference: Option<PathBuf>,
    /// Radiance that is 1 in protocol scene, in the decades and on the display of PU21, above 0
    /// [default: the 99.9th percentile of the luminance of all references].
    #[arg(long, value_parser = parse_positive, value_name = "RADIANCE")]
    pub(crate) scale: Option<f32>,
    /// Luminance in cd/m2 at which the display of PU21 shows that radiance, above 0.
    #[arg(long, default_value_t = FieldOptions::DEFAULT_PEAK_LUMINANCE, value_parser = parse_positive, value_name = "CD/M2")]
    pub(crate) peak_luminance: f32,
    /// mu of the mu-law, above 0.
    #[arg(long, default_value_t = luxel_core::tone::MU, value_parser = parse_positive)]
    pub(crate) mu: f32,
    /// Metrics to compute.
    #[arg(long, value_enum, default_value_t = MetricsArg::All)]
    pub(crate) metrics: MetricsArg,
    /// Weights of LPIPS: the state dict of lpips.LPIPS(net='alex' or 'vgg') as a safetensors file.
    #[arg(long, value_name = "FILE")]
    pub(crate) lpips_weights: Option<PathBuf>,
    /// Mask, black where pixels are left out; with folders one for all, or a folder of masks named
    /// like the references. Images without a mask are compared whole and reported.
    #[arg(long, value_name = "PATH", help_heading = "Images")]
    pub(crate) mask: Option<PathBuf>,
    /// Transfer function of integer images that do not state theirs.
    #[arg(long, value_enum, value_name = "CURVE", help_heading = "Images")]
    pub(crate) transfer: Option<TransferArg>,
    /// Primaries of images that do not state theirs [default: linear-rec709].
    #[arg(long, value_enum, value_name = "SPACE", help_heading = "Images")]
    pub(crate) color_space: Option<ColorSpaceArg>,
    /// Write an error map of HDR-FLIP, black for 0 to yellow for 1 (magma): a PNG; with folders, a
    /// folder of them.
    #[arg(long, value_name = "PATH", help_heading = "Output")]
    pub(crate) heatmap: Option<PathBuf>,
    /// Replace error maps that are there.
    #[arg(long, requires = "heatmap", help_heading = "Output")]
    pub(crate) overwrite: bool,
    /// Print one JSON object on stdout in place of a table.
    #[arg(long, help_heading = "Output")]
    pub(crate) json: bool,
}

/// `luxel info`.
#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// Scene (.ply, .usda, .usd, .glb, .spz), run, checkpoint, data set (its folder or
    /// transforms.json) or image.
    #[arg(required_unless_present = "devices")]
    pub(crate) path: Option<PathBuf>,
    /// List the devices, and which of them --device auto takes.
    #[arg(long, conflicts_with = "path")]
    pub(crate) devices: bool,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// Reading a data set; for an image, --transfer and --color-space.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
}

/// Steps of the demo: minutes on two cores with everything around them.
const DEMO_ITERATIONS: u32 = 3000;

/// `luxel demo`.
#[derive(Debug, Args)]
pub(crate) struct DemoArgs {
    /// Folder for the results.
    #[arg(long, short, default_value = "luxel-demo", value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Steps of training, at least 1.
    #[arg(long, default_value_t = DEMO_ITERATIONS, value_parser = clap::value_parser!(u32).range(1..), value_name = "N")]
    pub(crate) iterations: u32,
    /// Colour model.
    #[arg(long, value_enum, default_value_t)]
    pub(crate) method: Method,
    /// Device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(args: &[&str]) -> Option<ErrorKind> {
        command().try_get_matches_from(["luxel"].iter().chain(args)).err().map(|error| error.kind())
    }

    #[test]
    fn what_goes_with_an_option_is_refused_where_that_is_excluded() {
        let bench = ["bench", "--generate", "10", "--save", "q.ply"];
        let render = ["render", "run", "-o", "x", "--shard", "0/9"];
        for more in [&["--hdr10", "1000"][..], &["--overwrite"], &["--fps", "30"], &["--ffmpeg", "other"], &["--video", "a.mp4"]] {
            assert_eq!(kind(&[&render[..], more].concat()), Some(ErrorKind::ArgumentConflict), "{more:?}");
        }
        for more in [&["--fps", "30"][..], &["--ffmpeg", "other"], &["--hdr10"], &["--overwrite"]] {
            assert_eq!(kind(&[&["render", "run", "-o", "x"], more].concat()), Some(ErrorKind::MissingRequiredArgument), "{more:?}");
        }
        assert_eq!(kind(&[&render[..], &["--exposure", "1"]].concat()), Some(ErrorKind::MissingRequiredArgument));
        assert_eq!(kind(&["edit", "a.ply", "--against", "b.ply", "-o", "x", "--view", "001"]), Some(ErrorKind::ArgumentConflict));
        for more in [
            &["--transfer", "srgb"][..],
            &["--target", "a.exr"],
            &["--steps", "5"],
            &["--warmup", "5"],
            &["--mu", "5"],
            &["--order", "spatial"],
            &["--size", "4x4"],
            &["--camera", "c.json"],
            &["--device", "cpu"],
            &["--threads", "1"],
            &["--instruction-set", "best"],
            &["--json"],
        ] {
            for flag in [&[][..], &["--overwrite"]] {
                assert_eq!(kind(&[&bench[..], more, flag].concat()), Some(ErrorKind::ArgumentConflict), "{more:?}");
            }
            let overwrite = [&["bench", "--generate", "10", "--overwrite"], more].concat();
            assert_eq!(kind(&overwrite), Some(ErrorKind::ArgumentConflict), "{more:?}");
        }
        assert_eq!(kind(&[&bench[..], &["--overwrite", "--method", "lcd", "--cutoffs", "hdr", "--seed", "1"]].concat()), None);
        let both = ["bench", "--workload", "a.ply", "--camera", "c.json", "--save", "q.ply"];
        assert_eq!(kind(&both), Some(ErrorKind::ArgumentConflict));
    }

    #[test]
    fn a_negative_number_is_taken_for_a_value() {
        let mut command = command();
        command.build();
        for subcommand in command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help") {
            for arg in subcommand.get_arguments().filter(|arg| !arg.is_positional() && arg.get_action().takes_values()) {
                let option = format!("--{}", arg.get_long().unwrap());
                let found = kind(&[subcommand.get_name(), &option, "-1"]);
                assert_ne!(found, Some(ErrorKind::UnknownArgument), "{} {option} -1", subcommand.get_name());
            }
        }
    }

    #[test]
    fn the_help_of_reproduce_says_whose_defaults_it_names() {
        let mut command = command();
        let help = command.find_subcommand_mut("reproduce").unwrap().render_long_help().to_string();
        assert!(help.contains("are those of fast") && help.contains("[default: paper]"), "{help}");
    }
}

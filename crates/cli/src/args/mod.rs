//! The arguments of the program: one struct a command, shared groups of options, and the values
//! they take.

mod bench;
mod blocks;
pub(crate) mod channels;
mod compare;
mod completions;
mod edit;
mod export;
mod help;
mod lights;
pub(crate) mod look;
mod mesh;
mod mix;
pub(crate) mod photograph;
mod pick;
mod prepare;
mod probe;
mod render;
mod reproduce;
pub(crate) mod run_config;
mod shared;
pub(crate) mod train_options;
pub(crate) mod values;
#[cfg(feature = "view")]
mod view;

use std::path::PathBuf;

use anyhow::Result;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, Args, CommandFactory, Parser, Subcommand, ValueEnum};
use luxel_app::run::ExplicitArgs;
use luxel_metrics::FieldOptions;
use luxel_train::{Method, NamedChoice};

pub(crate) use self::bench::BenchArgs;
pub(crate) use self::blocks::{MergeArgs, SplitArgs};
pub(crate) use self::compare::CompareArgs;
pub(crate) use self::completions::{CompletionsArgs, ManArgs};
pub(crate) use self::edit::{EditArgs, EditText, ShMapArg};
pub(crate) use self::export::ExportArgs;
pub(crate) use self::lights::LightsArgs;
pub(crate) use self::mesh::MeshArgs;
pub(crate) use self::mix::MixArgs;
pub(crate) use self::pick::PickArgs;
pub(crate) use self::prepare::PrepareArgs;
pub(crate) use self::probe::ProbeArgs;
pub(crate) use self::render::RenderArgs;
pub(crate) use self::reproduce::ReproduceArgs;
pub(crate) use self::shared::{ConsoleArgs, DeviceArgs, LoadArgs, MetricsArgs, RunArgs, SceneDataArgs};
use self::train_options::{FirstTrainOptions, TrainOptions};
use self::values::parse_positive;
#[cfg(feature = "view")]
pub(crate) use self::view::ViewArgs;

/// Options whose flag is not their library name with dashes: the command line tells the colour
/// space of input from that of output.
const FLAGS: [(&str, &str); 3] = [("edit_file", "edits"), ("color_space", INPUT_SPACE), ("input_space", INPUT_SPACE)];

/// Flags of earlier versions, and the ones that replace them, for commands in which
/// [`with_earlier_name`] leaves the earlier one out: there it could mean the other space.
const RENAMED: [(&str, &str); 2] = [
    (
        "--color-space",
        "the colour space of images that are read is --input-color-space, that of files that are written --output-color-space",
    ),
    ("--colorspace", "the colour space of images that are read is --input-color-space; this command has no --output-color-space"),
];

/// Returns an option as it is typed: `--max-splats` for `max_splats`.
pub(crate) fn flag(option: &str) -> String {
    match FLAGS.iter().find(|(name, _)| *name == option) {
        Some((_, flag)) => format!("--{flag}"),
        None => format!("--{}", option.replace('_', "-")),
    }
}

/// Returns the error, with the new name where an option of an earlier version was given.
pub(crate) fn with_new_names(error: clap::Error) -> clap::Error {
    let unknown = (error.kind() == ErrorKind::UnknownArgument).then(|| error.get(ContextKind::InvalidArg)).flatten();
    let Some(ContextValue::String(given)) = unknown else { return error };
    match RENAMED.iter().find(|(old, _)| given == old) {
        Some((old, new)) => command().error(ErrorKind::UnknownArgument, format!("unexpected argument '{old}' found: {new}")),
        None => error,
    }
}

/// High dynamic range 3D Gaussian splatting: posed HDR images in, a scene of linear radiance out.
#[derive(Debug, Parser)]
#[command(name = "luxel", version, propagate_version = true, max_term_width = 120, after_help = "New here? Type: luxel demo")]
pub(crate) struct Cli {
    /// The command.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Returns the cargo features of the program that change what it can do.
pub(crate) fn features() -> Vec<&'static str> {
    let mut features = luxel_app::build_info::features();
    features.extend(cfg!(feature = "view").then_some("view"));
    features.extend(cfg!(feature = "mpi").then_some("mpi"));
    features
}

/// Returns the program's arguments.
pub(crate) fn command() -> clap::Command {
    let command = Cli::command()
        .long_version(luxel_app::build_info::long_version_with(&features()))
        .mut_subcommand("reproduce", |reproduce| reproduce.mut_args(reproduce::adapted));
    command.mut_subcommands(|subcommand| {
        let is_prepare = subcommand.get_name() == "prepare";
        let has_output = subcommand.get_arguments().any(|arg| arg.get_long() == Some(OUTPUT_SPACE));
        let subcommand = subcommand.mut_args(|arg| with_earlier_name(arg, has_output, is_prepare));
        help::with_short_help(with_memory(subcommand).mut_args(with_negative_numbers))
    })
}

/// Flags of the colour spaces.
const INPUT_SPACE: &str = "input-color-space";
const OUTPUT_SPACE: &str = "output-color-space";

/// Lets a colour space be given by its earlier flag too, where that cannot mean the other one.
/// `has_output` is whether the command has both.
fn with_earlier_name(arg: Arg, has_output: bool, is_prepare: bool) -> Arg {
    match (arg.get_long(), is_prepare) {
        (Some(INPUT_SPACE), true) => arg.visible_alias("input-space"),
        (Some(OUTPUT_SPACE), true) => arg.visible_alias("color-space"),
        (Some(OUTPUT_SPACE), false) => arg.visible_alias("colorspace"),
        (Some(INPUT_SPACE), false) if !has_output => arg.visible_alias("color-space"),
        _ => arg,
    }
}

/// Name of the option that [`with_memory`] adds.
pub(crate) const MEMORY: &str = "memory";

/// Adds the limit of memory to a command that reads files. `prepare` has one of its own, for views
/// that are processed at the same time.
fn with_memory(subcommand: clap::Command) -> clap::Command {
    if ["prepare", "doctor", "completions", "man"].contains(&subcommand.get_name()) {
        return subcommand;
    }
    let help = "Memory that reading one file may take, GiB, at least 1 [default: three quarters of what the system allows]. \
                A file that needs more is refused";
    let memory = Arg::new(MEMORY).long(MEMORY).value_name("GIB").help(help).help_heading("Machine");
    subcommand.arg(memory.value_parser(clap::value_parser!(u64).range(1..=1 << 20)))
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
        Command::Export(args) => export::check(args),
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
    /// Measure the scene of a run or file against images: a table; for a run, metrics.json and
    /// report.html.
    Eval(EvalArgs),
    /// Compare two images, folders of images, or runs, by every metric.
    Compare(CompareArgs),
    /// Render a scene to OpenEXR images in the units of the data set.
    Render(Box<RenderArgs>),
    /// Change the light of a scene: map the luminance of all or selected splats and keep their
    /// colours.
    Edit(Box<EditArgs>),
    /// Add the light of scenes that have the same geometry: lamps on and off, key and fill.
    Mix(MixArgs),
    /// Write a scene for other programs, as radiance or as a display bake: PLY, USD, glTF, SPZ, SOG
    /// or a web page.
    Export(Box<ExportArgs>),
    /// Render the light that arrives at a point of the scene as an environment map.
    Probe(Box<ProbeArgs>),
    /// Find the lamps of a scene, and write them with the rest of its light for other programs.
    Lights(Box<LightsArgs>),
    /// Make a triangle mesh of what the cameras saw, for shadow catchers, holdouts and colliders:
    /// USD, glTF, PLY, OBJ.
    Mesh(Box<MeshArgs>),
    /// Show what a pixel of a view is made of: radiance, depth, the point in the world, splats.
    Pick(Box<PickArgs>),
    /// Look at a scene in the browser, in radiance: exposure, false colour, probe, ground truth.
    #[cfg(feature = "view")]
    View(Box<ViewArgs>),
    /// Describe a scene, run, checkpoint, data set or image, or list the devices.
    Info(InfoArgs),
    /// Check this machine for GPUs, memory, COLMAP and FFmpeg, and say how to get what is missing.
    Doctor(DoctorArgs),
    /// Measure the time of rendering and of training steps on a scene, pass by pass.
    Bench(Box<BenchArgs>),
    /// Train methods side by side on data sets and seeds, and write the paper's tables and
    /// pictures.
    Reproduce(Box<ReproduceArgs>),
    /// Divide a large data set into blocks of the ground, each a data set to train on by itself.
    Split(Box<SplitArgs>),
    /// Join the scenes of all blocks of luxel split to one.
    Merge(MergeArgs),
    /// Print the completion script for a shell.
    Completions(CompletionsArgs),
    /// Write the man pages of the program and of each command.
    Man(ManArgs),
}

/// `luxel train`.
#[derive(Debug, Args)]
#[command(
    after_help = "Ctrl-C and SIGTERM save the state and exit with code 130, or SIGTERM with that of --requeue-code; --resume continues from there, bit for bit."
)]
pub(crate) struct TrainArgs {
    /// Folder of the data set, in any of the layouts that --format lists. Optional with --resume
    /// and --config, which name one.
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
    /// The options of training that come first in the help.
    #[command(flatten)]
    pub(crate) first: FirstTrainOptions,
    /// Reading the data set.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Saving and evaluating.
    #[command(flatten)]
    pub(crate) run: RunArgs,
    /// Stop as at Ctrl-C when standard input ends, for programs that start this one and hold its
    /// input open.
    #[arg(long, help_heading = "Run")]
    pub(crate) stop_at_end_of_input: bool,
    /// Exit code after SIGTERM, when the state is saved, 3 to 255: one that makes the job system
    /// put the job back into its queue [default: 130, as after Ctrl-C].
    #[arg(long, value_name = "CODE", value_parser = clap::value_parser!(u8).range(3..), help_heading = "Run")]
    pub(crate) requeue_code: Option<u8>,
    /// Share each step's batch out to the processes that `mpirun` or `srun` started with this
    /// command. Without --batch, a step has one view for each process.
    #[arg(long, value_name = "BY", help_heading = "Machine")]
    pub(crate) distributed: Option<DistributedArg>,
    /// Print the time spent in each pass at the end.
    #[arg(long, help_heading = "Output")]
    pub(crate) profile: bool,
    /// Show the training in the browser at this address: the scene as it grows, plots, pause, save
    /// and stop [default address: 127.0.0.1:7007].
    #[cfg(feature = "view")]
    #[arg(long, num_args = 0..=1, value_parser = view::training_address, default_missing_value = luxel_view::DEFAULT_ADDRESS, value_name = "ADDR:PORT", help_heading = "Output")]
    pub(crate) view: Option<std::net::SocketAddr>,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
    /// Device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// The method.
    #[command(flatten)]
    pub(crate) train: TrainOptions,
    /// Start from the splats of a run's newest scene or of a scene file, in place of new ones; with
    /// --freeze geometry only their colours are trained, for other light on the same geometry.
    #[arg(long, value_name = "RUN|SCENE.ply", conflicts_with = "resume", help_heading = "Splats")]
    pub(crate) from: Option<PathBuf>,
}

/// How processes that train together exchange data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum DistributedArg {
    /// Through MPI; the program must be built with its feature mpi.
    Mpi,
}

/// `luxel eval`.
#[derive(Debug, Args)]
pub(crate) struct EvalArgs {
    /// Folder of a run (its newest scene), or a scene file, which needs --data.
    #[arg(value_name = "RUN|SCENE")]
    pub(crate) scene: PathBuf,
    /// Data set to measure against [default for a run: its own, read as the run did but for options
    /// given here].
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// For a scene file, a new folder for metrics.json, and the test views and their ground truth
    /// in renders and gt.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    /// Print the metrics as one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
    /// Metrics to compute.
    #[command(flatten)]
    pub(crate) metrics: MetricsArgs,
    /// Radiance that is 1 in protocol scene, in the decades and on the display of PU21, above 0
    /// [default: the scene's radiance scale].
    #[arg(long, value_parser = parse_positive, value_name = "RADIANCE")]
    pub(crate) scale: Option<f32>,
    /// Luminance in cd/m2 at which the display of PU21 shows that radiance, above 0.
    #[arg(long, default_value_t = FieldOptions::DEFAULT_PEAK_LUMINANCE, value_parser = parse_positive, value_name = "CD/M2")]
    pub(crate) peak_luminance: f32,
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

/// `luxel info`.
#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// Scene (.ply, .usda, .usdc, .usdz, .usd, .glb, .spz), run, checkpoint, data set (its folder
    /// or transforms.json) or image.
    #[arg(required_unless_present = "devices")]
    pub(crate) path: Option<PathBuf>,
    /// List the devices, and which of them --device auto takes.
    #[arg(long, conflicts_with = "path")]
    pub(crate) devices: bool,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// Reading a data set; for an image, --transfer, --input-color-space and --layer.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
}

/// `luxel doctor`.
#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// Terminal output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
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
    #[arg(long, value_parser = train_options::choice_parser::<Method>(), default_value = Method::default().name())]
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
    use clap::FromArgMatches;
    use luxel_train::{OPTIONS, Preset, TrainConfig};

    use super::*;

    fn kind(args: &[&str]) -> Option<ErrorKind> {
        command().try_get_matches_from(["luxel"].iter().chain(args)).err().map(|error| error.kind())
    }

    #[test]
    fn what_goes_with_an_option_is_refused_where_that_is_excluded() {
        let bench = ["bench", "--generate", "10", "--save", "q.ply"];
        let render = ["render", "run", "-o", "x", "--shard", "0/9"];
        for more in [&["--hdr10", "1000"][..], &["--fps", "30"], &["--ffmpeg", "other"], &["--video", "a.mp4"]] {
            assert_eq!(kind(&[&render[..], more].concat()), Some(ErrorKind::ArgumentConflict), "{more:?}");
        }
        for more in [&["--fps", "30"][..], &["--ffmpeg", "other"], &["--hdr10"]] {
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
                let joined = format!("{option}=-1");
                let words = if arg.is_require_equals_set() { vec![joined.as_str()] } else { vec![option.as_str(), "-1"] };
                let found = kind(&[&[subcommand.get_name()], &words[..]].concat());
                assert_ne!(found, Some(ErrorKind::UnknownArgument), "{} {option} -1", subcommand.get_name());
            }
        }
    }

    #[test]
    fn earlier_names_of_colour_spaces_are_taken_where_they_are_clear() {
        for (command, old) in [
            (&["train", "data", "-o", "run"][..], "--color-space"),
            (&["probe", "run", "--at", "0,0,0", "-o", "a.exr"], "--colorspace"),
            (&["export", "run", "-o", "a.usda"], "--colorspace"),
            (&["prepare", "photos", "-o", "set"], "--color-space"),
            (&["prepare", "photos", "-o", "set"], "--input-space"),
        ] {
            let args = ["luxel"].iter().chain(command).copied().chain([old, "acescg"]);
            assert!(super::command().try_get_matches_from(args).is_ok(), "{command:?} {old}");
        }
        for (command, old, new) in [
            (&["render", "run", "-o", "out"][..], "--color-space", "--output-color-space"),
            (&["train", "data", "-o", "run"], "--colorspace", "--input-color-space"),
        ] {
            let args = ["luxel"].iter().chain(command).copied().chain([old, "acescg"]);
            let error = with_new_names(super::command().try_get_matches_from(args).unwrap_err());
            assert_eq!((error.kind(), error.exit_code()), (ErrorKind::UnknownArgument, 2));
            assert!(error.to_string().contains(new), "{error}");
        }
        assert_eq!((flag("color_space"), flag("max_splats")), ("--input-color-space".into(), "--max-splats".into()));
    }

    #[test]
    fn every_flag_is_the_name_of_its_option_or_in_the_table() {
        let mut command = command();
        command.build();
        for subcommand in command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help") {
            for arg in subcommand.get_arguments().filter(|arg| !arg.is_positional()) {
                assert_eq!(flag(arg.get_id().as_str()), format!("--{}", arg.get_long().unwrap()), "{}", subcommand.get_name());
            }
        }
    }

    #[test]
    fn the_defaults_in_the_help_of_reproduce_are_in_force() {
        let args = ["luxel", "reproduce", "data", "-o", "study"];
        let matches = command().try_get_matches_from(args).unwrap();
        let Command::Reproduce(parsed) = Cli::from_arg_matches(&matches).unwrap().command else { unreachable!("reproduce was given") };
        let in_force = parsed.train.config.clone().with_preset(|_| false);
        assert_eq!(in_force, TrainConfig::from_preset(Preset::Paper));
        let command = command();
        let reproduce = command.find_subcommand("reproduce").unwrap();
        for option in OPTIONS.iter().filter(|option| !option.is_switch()) {
            let arg = reproduce.get_arguments().find(|arg| arg.get_id() == option.name).unwrap();
            let shown = arg.get_default_values().first().map(|value| value.to_string_lossy().into_owned());
            assert_eq!(shown, option.get(&in_force), "{}", option.name);
        }
        // Another preset brings its own.
        let matches = super::command().try_get_matches_from(args.iter().chain(&["--preset", "fast", "--turnover", "0.3"])).unwrap();
        let explicit = run_config::explicit_args(matches.subcommand().unwrap().1);
        let Command::Reproduce(parsed) = Cli::from_arg_matches(&matches).unwrap().command else { unreachable!("reproduce was given") };
        let fast = TrainConfig { turnover: 0.3, ..TrainConfig::from_preset(Preset::Fast) };
        assert_eq!(parsed.train.config.clone().with_preset(|id| explicit.contains(id)), fast);
    }
}

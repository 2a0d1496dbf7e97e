//! `luxel reproduce` as text.

use std::path::PathBuf;

use clap::builder::{OsStringValueParser, Resettable, TypedValueParser};
use clap::{Arg, Args};
use luxel_app::run::ExplicitArgs;
use luxel_app::study::{METHOD_OPTIONS, StudyDataset, StudyMethod, StudyShare, parse_dataset, parse_methods, parse_share};
use luxel_train::{MAX_SEED, NamedChoice, OptionSpec, Preset, TrainConfig};

use super::train_options::TrainOptions;
use super::{ConsoleArgs, DeviceArgs, LoadArgs, MetricsArgs};

/// `luxel reproduce`.
#[derive(Debug, Args)]
#[command(
    after_help = "Methods: sh0 to sh5 (spherical harmonics of RGB radiance; sh3 is 3D Gaussian splatting), logsh3 (of log radiance), lcd (LCD-GS); after lcd, -exp or -relu \
    for the activation of the luminance, -l1 to -l3 for a luminance that varies with the view, -c0 to -c5 for the degree of chromaticity: lcd-c2-l1; \
    nerf-grid (a radiance field on a hash grid), nerf-grid-linear with the loss of linear radiance; hdr-nerf-grid (needs captured images), \
    mono-hdr-nerf-grid (needs them beside radiance); nerf-8x256 and the like for a network of so many layers and units without a grid; hdr-gs and \
    mono-hdr-gs (need captured images beside radiance; the mono methods read one exposure of each pose, the middle one unless --exposures names another); \
    gausshdr (needs captured images of several exposures); lcd-anchors and gausshdr-anchors, whose splats networks decode from \
    anchors for each view. table1 and table2 stand for the rows of the paper's \
    tables of results on synthetic and on real data, as far as they exist here.\n\n\
    Every run is a folder below DIR/runs. Finished runs are kept, interrupted ones are continued; the same command again writes the report anew. \
    Methods, data sets and seeds can be added: the report covers them and all finished runs of earlier commands. Other options need another folder. Ctrl-C and SIGTERM save all runs and exit with code 130, or SIGTERM with that of --requeue-code.\n\n\
    luxel reproduce desk-lamp bathroom -o paper --iterations 7000\n\
    luxel reproduce desk-lamp bathroom -o paper --iterations 7000 --only 1/4\n\
    luxel reproduce desk=captures/1102/data lab=captures/1103/data -o places\n\
    luxel reproduce my-scene -o ablation --methods sh3,lcd,lcd-l1 --seeds 1,2 --jobs 2 --downscale 2"
)]
pub(crate) struct ReproduceArgs {
    /// Folders of data sets, each with the name that tables and the folders of runs give it
    /// [default name: that of the folder].
    #[arg(required = true, value_name = "[NAME=]DATASET", value_parser = OsStringValueParser::new().try_map(parse_dataset))]
    pub(crate) datasets: Vec<StudyDataset>,
    /// Folder for runs and report.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Methods, in the order of the tables; table1 and table2 for those of the paper's tables.
    #[arg(
        long,
        value_delimiter = ',',
        value_parser = method_names,
        default_value = "sh3,sh4,sh5,lcd,lcd-exp,lcd-relu",
        value_name = "NAMES",
        help_heading = "Matrix"
    )]
    pub(crate) methods: Vec<MethodNames>,
    /// Seeds; each method is trained once per seed on each data set.
    #[arg(
        long,
        value_delimiter = ',',
        value_parser = clap::value_parser!(u64).range(..=MAX_SEED),
        default_value = "42,43,44",
        value_name = "SEEDS",
        help_heading = "Matrix"
    )]
    pub(crate) seeds: Vec<u64>,
    /// Number of runs side by side, 1 to 1024, each with its share of the cores or with --threads;
    /// only times depend on it.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024), value_name = "N", help_heading = "Matrix")]
    pub(crate) jobs: u32,
    /// Train nothing; report how many runs are finished and how many are left, with an estimate of
    /// the time.
    #[arg(long, help_heading = "Matrix")]
    pub(crate) dry_run: bool,
    /// Print the runs as jobs and train nothing: a line each, the command that trains that run, in
    /// an order that depends on the options alone.
    #[arg(long, conflicts_with_all = ["dry_run", "only", "report"], help_heading = "Matrix")]
    pub(crate) list: bool,
    /// Train the K-th of N shares of the runs, 1/N to N/N; 0 is the last. Shares may be trained at
    /// the same time, also by several machines in a shared folder; the last one to end writes the
    /// report.
    #[arg(long, value_name = "K/N", value_parser = parse_share, help_heading = "Matrix")]
    pub(crate) only: Option<StudyShare>,
    /// Train nothing; write the report of the finished runs, which names those that are missing.
    #[arg(long, conflicts_with_all = ["dry_run", "only"], help_heading = "Matrix")]
    pub(crate) report: bool,
    /// Steps between checkpoints of each run; 0 for the end only.
    #[arg(long, default_value_t = 1000, value_name = "N", help_heading = "Matrix")]
    pub(crate) checkpoint_every: u32,
    /// Exit code after SIGTERM, when all runs are saved, 3 to 255: one that makes the job system
    /// put the job back into its queue [default: 130, as after Ctrl-C].
    #[arg(long, value_name = "CODE", value_parser = clap::value_parser!(u8).range(3..), help_heading = "Matrix")]
    pub(crate) requeue_code: Option<u8>,
    /// Metrics to compute.
    #[command(flatten)]
    pub(crate) metrics: MetricsArgs,
    /// Options of reading data sets.
    #[command(flatten)]
    pub(crate) load: LoadArgs,
    /// Options of the device.
    #[command(flatten)]
    pub(crate) device: DeviceArgs,
    /// Options of output.
    #[command(flatten)]
    pub(crate) console: ConsoleArgs,
    /// Options of training for all runs.
    #[command(flatten)]
    pub(crate) train: TrainOptions,
}

/// The methods that one name stands for.
#[derive(Clone, Debug)]
pub(crate) struct MethodNames(pub(crate) Vec<StudyMethod>);

fn method_names(text: &str) -> Result<MethodNames, String> {
    parse_methods(text).map(MethodNames)
}

/// The option that would end runs after different numbers of steps.
const EARLY_END: &str = "early_end";

/// Returns whether an option of training is decided for each run.
fn is_of_the_matrix(id: &str) -> bool {
    id == "seed" || METHOD_OPTIONS.contains(&id)
}

/// Returns an option of training as this command has it: options that [`check`] refuses are hidden,
/// and defaults are those of the published preset.
pub(super) fn adapted(arg: Arg) -> Arg {
    let is_refused = is_of_the_matrix(arg.get_id().as_str()) || arg.get_id() == EARLY_END;
    let arg = match arg.get_id().as_str() {
        id if is_of_the_matrix(id) => arg,
        "preset" => arg.default_value(Preset::Paper.name()),
        id => match OptionSpec::find(id).filter(|option| !option.is_switch()) {
            Some(option) => with_default(arg, option.get(&TrainConfig::from_preset(Preset::Paper)), option),
            None => arg,
        },
    };
    if is_refused { arg.hide(true) } else { arg }
}

/// Returns an option with another default.
fn with_default(arg: Arg, default: Option<String>, option: &OptionSpec) -> Arg {
    match default {
        Some(default) => arg.default_value(default),
        None if option.default_text().is_some() => {
            let help = arg.get_help().map_or_else(String::new, ToString::to_string);
            arg.default_value(Resettable::Reset).help(help + " [default: unset]")
        }
        None => arg,
    }
}

/// Refuses options that this command replaces with others.
pub(super) fn check(explicit: &ExplicitArgs) -> Result<(), String> {
    if explicit.contains(EARLY_END) {
        return Err("--early-end: methods are compared after equal numbers of steps; leave it out".to_owned());
    }
    let Some(id) = explicit.iter().find(|id| is_of_the_matrix(id)) else { return Ok(()) };
    let instead = if id == "seed" { "--seeds" } else { "--methods" };
    Err(format!("--{} differs from run to run; give {instead}", id.replace('_', "-")))
}

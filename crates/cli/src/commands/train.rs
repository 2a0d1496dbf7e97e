//! `luxel train`: from a data set to a run folder.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use luxel::Remedy;
use luxel_app::run::{
    ExplicitArgs, Launch, MadeBy, NonSplatKind, Outcome, PathContents, RunConfig, RunFolder, RunLock, TrainedRun, follow, fresh_over,
    resume_over,
};
use luxel_app::{output, text};
use luxel_core::{CameraProjection, Dataset, Exchange, SingleProcess, View};
use luxel_train::{MAX_BATCH, Method};
use serde_json::json;

use super::demo;
#[cfg(feature = "view")]
use super::view;
use crate::args::{DistributedArg, TrainArgs, run_config};
use crate::inputs::data;
use crate::inputs::engine::training_engine;
use crate::interrupt;
use crate::output::console::Console;
use crate::output::profile;

/// The treatment of the output folder's content.
#[derive(Debug)]
enum Start {
    /// Nothing is there.
    Fresh(RunConfig),
    /// A run is there, to be deleted; with the command that made it.
    Replace(RunConfig, MadeBy),
    /// A run is there, to be continued.
    Resume(RunConfig),
}

impl Start {
    fn config(&self) -> &RunConfig {
        let (Self::Fresh(config) | Self::Replace(config, _) | Self::Resume(config)) = self;
        config
    }
}

/// Trains; `explicit` names the options that were given.
pub(crate) fn run(args: &TrainArgs, explicit: &ExplicitArgs) -> Result<Outcome> {
    match args.distributed {
        None => lead(args, explicit, Box::new(SingleProcess)),
        Some(DistributedArg::Mpi) => run_over_mpi(args, explicit),
    }
}

/// Trains as one of the ranks that MPI started. An error of one rank ends all.
fn run_over_mpi(args: &TrainArgs, explicit: &ExplicitArgs) -> Result<Outcome> {
    let connection = luxel_mpi::connect().context("--distributed mpi")?;
    let exchange = connection.exchange();
    let (rank, ranks) = (exchange.rank(), exchange.ranks());
    let outcome =
        if rank == 0 { lead(args, explicit, exchange) } else { follow(exchange, open_as_told, interrupt::stop()).map_err(Into::into) };
    if matches!(outcome, Ok(Outcome::Interrupted)) {
        interrupt::stopped_with_other_ranks();
    }
    outcome.or_else(|error| {
        let failed = crate::fail(&error.context(format!("rank {rank} of {ranks}, which ends the others")));
        connection.abort(failed)
    })
}

/// Opens the engine of a rank other than 0.
fn open_as_told(config: &RunConfig) -> luxel::Result<luxel::SelectedEngine> {
    training_engine(config).map_err(|error| luxel::Error::new(format!("{error:#}")))
}

/// Trains alone, or as rank 0, which has the run's folder.
fn lead(args: &TrainArgs, explicit: &ExplicitArgs, exchange: Box<dyn Exchange>) -> Result<Outcome> {
    output::check_folder_name(&args.output, &output::RESULT_EXTENSIONS)?;
    let folder = RunFolder::at(&args.output);
    // A run is read under its lock: another luxel at work in the folder may be about to change it.
    let lock = match folder.contents()? {
        PathContents::Run(_) if args.resume => Some(folder.lock()?),
        _ => None,
    };
    let start = resolve(args, explicit, folder.contents()?, exchange.ranks())?;
    let method = start.config().train.method;
    if !method.stores_splats() {
        check_non_splat(args, method)?;
    }
    if args.stop_at_end_of_input {
        interrupt::at_end_of_input();
    }
    let console = Console::new(args.console.log_format, args.console.quiet);
    #[cfg(feature = "view")]
    let live = args.view.map(|address| view::live(address, &args.output, &start.config().dataset, &console)).transpose()?;
    #[cfg(feature = "view")]
    let observer: &dyn luxel::Observer = live.as_ref().map_or(&console, |live| live);
    #[cfg(not(feature = "view"))]
    let observer = &console;
    let launch = Launch { folder: &folder, observer, stop: interrupt::stop() };
    let TrainedRun { outcome, config, mut trainer, steps, .. } = match start {
        Start::Fresh(config) => {
            let (engine, given) = (training_engine(&config)?, config.clone());
            fresh_over(exchange, config, engine, launch, |dataset| {
                check_used(dataset, &given, explicit, &console)?;
                lock_free(&folder)
            })?
        }
        Start::Replace(config, replaced) => {
            let (engine, given) = (training_engine(&config)?, config.clone());
            fresh_over(exchange, config, engine, launch, |dataset| {
                check_used(dataset, &given, explicit, &console)?;
                clear_run(&folder, replaced)
            })?
        }
        Start::Resume(config) => {
            let lock = lock.map_or_else(|| folder.lock(), Ok)?;
            let engine = training_engine(&config)?;
            resume_over(exchange, config, engine, launch, lock)?
        }
    };
    if args.profile {
        let timings = trainer.engine().timings();
        console.result(&profile::event(steps, timings), &profile::table(steps, timings))?;
    }
    finish(outcome, &folder, config.train.method, trainer.iteration(), &console)?;
    Ok(outcome)
}

/// Refuses what the training of a radiance field, or of anchors, does not do.
fn check_non_splat(args: &TrainArgs, method: Method) -> Result<()> {
    let trained = method.spec().representation.noun();
    let refused = [
        ("--profile", args.profile),
        ("--distributed", args.distributed.is_some()),
        #[cfg(feature = "view")]
        ("--view", args.view.is_some()),
    ];
    match refused.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => bail!("{option}: is for splats, and --method trains {trained}; leave one of them out"),
        None => Ok(()),
    }
}

/// Locks the folder of a run that is replaced, and deletes the run.
fn clear_run(folder: &RunFolder, replaced: MadeBy) -> luxel::Result<RunLock> {
    let lock = folder.lock()?;
    if replaced == MadeBy::Demo {
        demo::remove_pictures(folder)?;
    }
    folder.clear()?;
    Ok(lock)
}

/// Returns the configuration, by the command line and the content of the output folder.
fn resolve(args: &TrainArgs, explicit: &ExplicitArgs, contents: PathContents, ranks: usize) -> Result<Start> {
    let output = args.output.display();
    if args.resume {
        let PathContents::Run(stored) = contents else { bail!("{output}: no run to resume; leave --resume out to start one") };
        let dataset = args.dataset.as_deref().map_or(Ok(stored.dataset.clone()), absolute)?;
        let given = run_config::from_args(args, dataset.clone(), explicit);
        let mut config = run_config::resumed(&stored, &given, explicit)?;
        prefer_steps(&mut config, explicit);
        run_config::reject_inapplicable(&config, explicit)?;
        // A demo that is trained further is the user's work, which the next demo must not replace.
        let is_same = config.train.iterations == stored.train.iterations;
        let made_by = if is_same { stored.made_by } else { MadeBy::Train };
        return Ok(Start::Resume(RunConfig { dataset, made_by, ..config }));
    }
    let mut config = from_command_line(args, explicit)?;
    prefer_steps(&mut config, explicit);
    config.imply_supervision(explicit);
    if config.train.batch == 1 && !explicit.contains("batch") {
        config.train.batch = u32::try_from(ranks).unwrap_or(MAX_BATCH);
    }
    config.run.from = config.run.from.take().map(|from| scene_to_start_from(&from, &args.output)).transpose()?;
    run_config::reject_inapplicable(&config, explicit)?;
    match contents {
        PathContents::Nothing => Ok(Start::Fresh(config)),
        PathContents::Run(replaced) if args.overwrite => Ok(Start::Replace(config, replaced.made_by)),
        PathContents::Run(_) => {
            bail!("{output}: already holds a run; continue it with --resume, replace it with --overwrite, or choose another")
        }
        PathContents::Foreign if args.overwrite => {
            bail!("{output}: is not empty and not a luxel run, so --overwrite does not delete it; choose another output folder")
        }
        PathContents::Foreign => {
            bail!("{output}: is not empty and not a luxel run (which --resume and --overwrite are for); choose another output folder")
        }
    }
}

/// Leaves a limit of time out where a number of steps is given over a file that has one.
fn prefer_steps(config: &mut RunConfig, explicit: &ExplicitArgs) {
    if explicit.contains("iterations") && !explicit.contains("time") {
        config.run.time = None;
    }
}

/// Returns the configuration of a new run.
fn from_command_line(args: &TrainArgs, explicit: &ExplicitArgs) -> Result<RunConfig> {
    let base = match &args.config {
        Some(path) => Some((path, RunConfig::read(path)?)),
        None => None,
    };
    let dataset = match (&args.dataset, &base) {
        (Some(dataset), _) => dataset.clone(),
        (None, Some((path, base))) => {
            let remedy = Remedy::advice("name its new folder: luxel train DATASET --config FILE -o RUN");
            base.find_dataset(path.parent().unwrap_or(Path::new(".")), remedy)?
        }
        (None, None) => bail!("no data set given"),
    };
    let given = run_config::from_args(args, absolute(&dataset)?, explicit);
    match base {
        Some((_, base)) => Ok(RunConfig {
            luxel_version: given.luxel_version.clone(),
            made_by: given.made_by,
            dataset: given.dataset.clone(),
            ..base.overlaid(&given, explicit)?
        }),
        None => Ok(given),
    }
}

/// Returns the path without `.` and links, so that the run finds its data from anywhere.
fn absolute(dataset: &Path) -> Result<PathBuf> {
    std::fs::canonicalize(dataset).with_context(|| format!("{}: cannot open the data set", dataset.display()))
}

/// Returns the path of the scene to start from without `.` and links, if it is not in the folder
/// that the run would replace.
fn scene_to_start_from(from: &Path, output: &Path) -> Result<PathBuf> {
    let from = std::fs::canonicalize(from).with_context(|| format!("{}: cannot open the scene to start from", from.display()))?;
    if std::fs::canonicalize(output).is_ok_and(|output| from.starts_with(output)) {
        bail!("{}: the scene to start from is in the output folder; choose another output folder", from.display());
    }
    Ok(from)
}

/// Refuses a colour space, and warns of numbers of points and of a crop, that only the data set
/// shows to be unused: points in it leave no splats to make up, stereo knows no fisheyes, and small
/// views are not cut.
fn check_used(dataset: &Dataset, config: &RunConfig, explicit: &ExplicitArgs, console: &Console) -> luxel::Result<()> {
    data::check_color_space(dataset, &config.load, explicit).map_err(|error| luxel::Error::new(error.to_string()))?;
    if explicit.contains("init_points") && !dataset.points.is_empty() {
        let points = text::plural(dataset.points.len(), "point");
        console.warn(&format!("--init-points changes nothing: the data set has {points} to start from"));
    }
    if explicit.contains("stereo_points") && config.train.stereo_points != Some(0) {
        let is_pinhole = |view: &View| view.camera.projection == CameraProjection::Pinhole;
        if !dataset.train.iter().all(is_pinhole) {
            console.warn("--stereo-points finds nothing: stereo compares pinhole cameras only, and some views are fisheyes or panoramas");
        }
    }
    let sides = dataset.train.iter().flat_map(|view| view.camera.size_px);
    if let (Some(crop), Some(longest)) = (config.train.crop, sides.max())
        && crop >= longest
    {
        console.warn(&format!("--crop {crop} changes nothing: no view has more than {longest} pixels a side"));
    }
    Ok(())
}

/// Locks a folder in which nothing was found: another luxel may have put a run there while the data
/// set was read.
fn lock_free(folder: &RunFolder) -> luxel::Result<RunLock> {
    let lock = folder.lock()?;
    match folder.contents()? {
        PathContents::Nothing => Ok(lock),
        PathContents::Run(_) | PathContents::Foreign => {
            Err(luxel::Error::new(format!("{}: was empty and no longer is; choose another output folder", folder.root().display())))
        }
    }
}

/// Reports where the results are, or how to continue.
fn finish(outcome: Outcome, folder: &RunFolder, method: Method, step: u32, console: &Console) -> Result<()> {
    let root = folder.root().display();
    if outcome == Outcome::Interrupted {
        console.interrupted(&format!("saved; continue with: luxel train --resume -o {root}"));
        return Ok(());
    }
    // As text: JSON has no form for a name that is not UTF-8.
    let kind = NonSplatKind::of(method);
    let [scene, metrics, report] = [folder.result(method, step), folder.metrics(), folder.report()].map(|path| path.display().to_string());
    let name = kind.map_or("scene", NonSplatKind::name);
    let text = format!("{name:7} {scene}\nmetrics {metrics}\nreport  {report}");
    console.finish_with_note(json!({ name: scene, "metrics": metrics, "report": report }), &text);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_filled_up_meanwhile_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let folder = RunFolder::at(&place.path().join("run"));
        drop(lock_free(&folder).unwrap());
        std::fs::write(folder.root().join("log.jsonl"), "another's").unwrap();
        let error = lock_free(&folder).unwrap_err().to_string();
        assert!(error.contains("no longer is"), "{error}");
    }
}

//! `luxel train`: from a data set to a run folder.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use luxel::SelectedEngine;
use luxel_core::{Dataset, Pass};
use luxel_train::Trainer;
use serde_json::json;

use super::demo;
use crate::cli::TrainArgs;
use crate::config::{MadeBy, RunConfig};
use crate::console::Console;
use crate::run_folder::{Occupant, RunFolder, RunLock};
use crate::session::{Outcome, Session};
use crate::{data, engine, interrupt, run_state, text};

/// What to do about what is in the output folder.
#[derive(Debug)]
enum Start {
    /// Nothing is there.
    Fresh(RunConfig),
    /// A run is there, to be deleted: who made it.
    Replace(RunConfig, MadeBy),
    /// A run is there, to be continued.
    Resume(RunConfig),
}

/// Trains; `said` are the ids of the options on the command line.
pub(crate) fn run(args: &TrainArgs, said: &[String]) -> Result<Outcome> {
    let folder = RunFolder::at(&args.output);
    // A run is read under its lock: another luxel that is at it may be about to change it.
    let lock = match folder.occupant()? {
        Occupant::Run(_) if args.resume => Some(folder.lock()?),
        _ => None,
    };
    let start = resolve(args, said, folder.occupant()?)?;
    if args.stop_at_end_of_input {
        interrupt::at_end_of_input();
    }
    let mut console = Console::new(args.console.log_format, args.console.quiet);
    let TrainedRun { outcome, config, mut trainer, steps, .. } = match start {
        Start::Fresh(config) => {
            let chosen = engine::training_engine(&config)?;
            fresh(config, chosen, &folder, &mut console, |dataset, console| {
                tell_unused_points(dataset, said, console);
                lock_free(&folder)
            })?
        }
        Start::Replace(config, replaced) => {
            let chosen = engine::training_engine(&config)?;
            fresh(config, chosen, &folder, &mut console, |dataset, console| {
                tell_unused_points(dataset, said, console);
                let lock = folder.lock()?;
                if replaced == MadeBy::Demo {
                    demo::remove_pictures(&folder)?;
                }
                folder.clear()?;
                Ok(lock)
            })?
        }
        Start::Resume(config) => resume(config, &folder, &mut console, lock)?,
    };
    if args.profile {
        let timings = trainer.engine().timings();
        console.result(&profile_event(steps, timings), &profile(steps, timings))?;
    }
    finish(outcome, &folder, &config, &console)?;
    Ok(outcome)
}

/// What is left when training ends.
pub(crate) struct TrainedRun {
    /// Whether all steps are made.
    pub(crate) outcome: Outcome,
    /// How it was made.
    pub(crate) config: RunConfig,
    /// Holds the scene.
    pub(crate) trainer: Trainer,
    /// What it was trained on.
    pub(crate) dataset: Dataset,
    /// Steps made by this process.
    pub(crate) steps: u32,
}

/// The configuration, from the command line and what is in the output folder.
fn resolve(args: &TrainArgs, said: &[String], occupant: Occupant) -> Result<Start> {
    let output = args.output.display();
    if args.resume {
        let Occupant::Run(stored) = occupant else { bail!("{output}: no run to resume; leave --resume out to start one") };
        let dataset = args.dataset.as_deref().map_or(Ok(stored.dataset.clone()), absolute)?;
        let command_line = RunConfig::from_args(args, dataset.clone(), said);
        let config = stored.resumed(&command_line, said)?;
        config.check_said(said)?;
        // A demo that is trained further is somebody's work, which the next demo must not replace.
        let is_same = config.train.iterations == stored.train.iterations;
        let made_by = if is_same { stored.made_by } else { MadeBy::Train };
        return Ok(Start::Resume(RunConfig { dataset, made_by, ..config }));
    }
    let config = from_command_line(args, said)?;
    config.check_said(said)?;
    match occupant {
        Occupant::Nothing => Ok(Start::Fresh(config)),
        Occupant::Run(replaced) if args.overwrite => Ok(Start::Replace(config, replaced.made_by)),
        Occupant::Run(_) => {
            bail!("{output}: already holds a run; continue it with --resume, replace it with --overwrite, or choose another")
        }
        Occupant::Foreign if args.overwrite => {
            bail!("{output}: is not empty and not a luxel run, so --overwrite does not delete it; choose another output folder")
        }
        Occupant::Foreign => {
            bail!("{output}: is not empty and not a luxel run (which --resume and --overwrite are for); choose another output folder")
        }
    }
}

/// The configuration of a new run.
fn from_command_line(args: &TrainArgs, said: &[String]) -> Result<RunConfig> {
    let base = match &args.config {
        Some(path) => Some((path, RunConfig::read(path)?)),
        None => None,
    };
    let dataset = match (&args.dataset, &base) {
        (Some(dataset), _) => dataset.clone(),
        (None, Some((path, base))) => base.dataset_path(path.parent().unwrap_or(Path::new("."))),
        (None, None) => bail!("no data set given"),
    };
    let command_line = RunConfig::from_args(args, absolute(&dataset)?, said);
    match base {
        Some((_, base)) => Ok(RunConfig {
            luxel_version: command_line.luxel_version.clone(),
            made_by: command_line.made_by,
            dataset: command_line.dataset.clone(),
            ..base.overlaid(&command_line, said)?
        }),
        None => Ok(command_line),
    }
}

/// The path without `.` and links, so that the run finds its data from anywhere.
fn absolute(dataset: &Path) -> Result<PathBuf> {
    std::fs::canonicalize(dataset).with_context(|| format!("{}: cannot open the data set", dataset.display()))
}

/// Only the data set tells whether splats are to be made up.
fn tell_unused_points(dataset: &Dataset, said: &[String], console: &Console) {
    if said.iter().any(|id| id == "init_points") && !dataset.points.is_empty() {
        let points = text::plural(dataset.points.len(), "point");
        console.warn(&format!("--init-points changes nothing: the data set has {points} to start from"));
    }
}

/// Locks a folder in which nothing was found: another luxel may have put a run there while the data set was read.
fn lock_free(folder: &RunFolder) -> Result<RunLock> {
    let lock = folder.lock()?;
    match folder.occupant()? {
        Occupant::Nothing => Ok(lock),
        Occupant::Run(_) | Occupant::Foreign => {
            bail!("{}: was empty and no longer is; choose another output folder", folder.root().display())
        }
    }
}

/// A run from its first step. `make_room` is called once the data set has been read and the settings are accepted.
pub(crate) fn fresh(
    config: RunConfig,
    chosen: SelectedEngine,
    folder: &RunFolder,
    console: &mut Console,
    make_room: impl FnOnce(&Dataset, &Console) -> Result<RunLock>,
) -> Result<TrainedRun> {
    let SelectedEngine { engine, threads, machine, computed_by, .. } = chosen;
    // What has no text form must not cost the run that is to be replaced.
    config.to_toml().with_context(|| format!("{}: config.toml cannot hold these settings", config.dataset.display()))?;
    let dataset = data::load(&config.dataset_path(folder.root()), &config.load, console)?;
    let trainer = Trainer::new(&dataset, config.train.clone(), engine).context("cannot start training")?;
    let lock = make_room(&dataset, console)?;
    folder.write_config(&config)?;
    train(config, folder, console, Ready { dataset, trainer, threads, machine, computed_by, lock })
}

/// A run from its newest checkpoint, under the folder's lock.
fn resume(config: RunConfig, folder: &RunFolder, console: &mut Console, lock: Option<RunLock>) -> Result<TrainedRun> {
    let lock = lock.map_or_else(|| folder.lock(), Ok)?;
    let SelectedEngine { engine, threads, machine, computed_by, .. } = engine::training_engine(&config)?;
    let dataset = data::load(&config.dataset_path(folder.root()), &config.load, console)?;
    let trainer = match run_state::take_checkpoint(folder, console)? {
        Some((path, snapshot)) => {
            let mut trainer = Trainer::resume(&dataset, snapshot, engine).with_context(|| format!("{}: cannot resume", path.display()))?;
            continue_with(&config, &mut trainer)?;
            console.note(&format!("resuming after step {} from {}", trainer.iteration(), path.display()));
            trainer
        }
        None if folder.scene_iterations().is_empty() => {
            console.note("the run ended before its first checkpoint; starting from the first step");
            Trainer::new(&dataset, config.train.clone(), engine).context("cannot start training")?
        }
        None => bail!(
            "{}: has scenes, but no checkpoint in checkpoints/ to go on from; put that folder back, or start anew with --overwrite",
            folder.root().display()
        ),
    };
    folder.write_config(&config)?;
    train(config, folder, console, Ready { dataset, trainer, threads, machine, computed_by, lock })
}

/// Gives a resumed trainer the number of steps of `config`; everything else must be as the checkpoint has it.
fn continue_with(config: &RunConfig, trainer: &mut Trainer) -> Result<()> {
    let (wanted, made) = (config.train.iterations, trainer.iteration());
    if wanted < made {
        bail!("--iterations {wanted}: the run has made {made} steps already; give at least as many");
    }
    trainer.set_iterations(wanted);
    if *trainer.config() != config.train {
        bail!(
            "config.toml has other training options than the checkpoint; undo the change, or start anew with --config and another output folder"
        );
    }
    Ok(())
}

/// All that the loop needs.
struct Ready {
    dataset: Dataset,
    trainer: Trainer,
    threads: usize,
    /// Where the engine runs, for people.
    machine: String,
    /// The same without why it is not elsewhere, for the figures.
    computed_by: String,
    lock: RunLock,
}

fn train(config: RunConfig, folder: &RunFolder, console: &mut Console, ready: Ready) -> Result<TrainedRun> {
    let Ready { dataset, trainer, threads, machine, computed_by, lock: _lock } = ready;
    console.note(&format!("starting with {} on {}", text::plural(trainer.splats_len(), "splat"), machine));
    let first = trainer.iteration();
    let session = Session { dataset: &dataset, folder, config: &config, threads, computed_by, console, trainer };
    let (outcome, trainer) = session.run()?;
    let steps = trainer.iteration().saturating_sub(first);
    Ok(TrainedRun { outcome, config, trainer, dataset, steps })
}

/// What the user is told at the end.
fn finish(outcome: Outcome, folder: &RunFolder, config: &RunConfig, console: &Console) -> Result<()> {
    let root = folder.root().display();
    if outcome == Outcome::Interrupted {
        console.note(&format!("saved; continue with: luxel train --resume -o {root}"));
        return Ok(());
    }
    let scene = folder.scene(config.train.iterations);
    let event = json!({ "event": "finished", "scene": scene, "metrics": folder.metrics(), "report": folder.report() });
    console.event(
        &event,
        &format!("scene   {}\nfigures {}\nreport  {}", scene.display(), folder.metrics().display(), folder.report().display()),
    );
    Ok(())
}

/// Time spent in each pass: milliseconds a step of this process, and the share.
fn profile(steps: u32, timings: &[(Pass, Duration)]) -> String {
    let total: f64 = timings.iter().map(|(_, time)| time.as_secs_f64()).sum();
    let mut out = format!("pass               ms a step   share, over {}\n", text::plural(steps as usize, "step"));
    for (pass, time) in timings {
        let seconds = time.as_secs_f64();
        let share = if total > 0.0 { 100.0 * seconds / total } else { 0.0 };
        out += &format!("{:17}  {:9.3}  {share:5.1} %\n", pass.name(), 1e3 * seconds / f64::from(steps.max(1)));
    }
    out + &format!("{:17}  {:9.3}", "all", 1e3 * total / f64::from(steps.max(1)))
}

/// The same for programs.
fn profile_event(steps: u32, timings: &[(Pass, Duration)]) -> serde_json::Value {
    let ms = |time: &Duration| 1e3 * time.as_secs_f64() / f64::from(steps.max(1));
    let passes: serde_json::Map<_, _> = timings.iter().map(|(pass, time)| (pass.name().to_owned(), ms(time).into())).collect();
    json!({ "event": "profile", "steps": steps, "ms_a_step": passes })
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

//! The loop of a run, from its first (or next) step to its report: steps, log, checkpoints and
//! evaluations.
//!
//! Order at a step that is evaluated: log line, checkpoint, scene, images, metrics. A process that
//! dies during the evaluation is thus resumed at that very step, and evaluates then.
//! [`RunFolder::evaluated_iterations`] lists complete evaluations by the metrics that only the
//! session writes there.

mod measure;
mod taken_apart;

use std::path::Path;
use std::time::{Duration, Instant};

use luxel::error::Context;
use luxel::{Event, LiveRun, Observer, Result, StopFlag, VisitAction};
use luxel_core::{Dataset, StepReport};
use luxel_train::{Reconstruction, SavedRun};

use super::checkpoints::save_checkpoint;
use super::clock::Clock;
use super::folder::LockIdentity;
use super::log::{LOG_EVERY, LogRecord, RunLog};
use super::test_curve::TestCurve;
use super::time_budget::{LEAST_STEPS, TimeBudget};
use super::{RunConfig, RunFolder, state};
use crate::{files, process, text};

/// Exit code of the program when an interruption ended it: 128 + SIGINT.
pub const EXIT_INTERRUPTED: u8 = 130;

/// The step after which a run says how long it will take.
const TELLS_AT: u32 = 20;
/// Time that is worth a line.
const WORTH_TELLING: Duration = Duration::from_secs(60);

/// The end of a training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps are made.
    Finished,
    /// A stop was requested; the state is saved.
    Interrupted,
}

/// A run in progress.
pub struct Session<'a> {
    /// The views.
    pub dataset: &'a Dataset,
    /// The folder of the run.
    pub folder: &'a RunFolder,
    /// The settings.
    pub config: &'a RunConfig,
    /// Threads in use.
    pub threads: usize,
    /// Place where the engine runs.
    pub computed_by: String,
    /// Receives the events.
    pub observer: &'a dyn Observer,
    /// Asks the run to save its state and end.
    pub stop: &'a StopFlag,
    /// The reconstruction in progress.
    pub trainer: Box<dyn Reconstruction>,
    /// The moment at which this process began with the run.
    pub since: Instant,
}

/// The state of the loop besides the trainer.
struct LoopState {
    log: RunLog,
    log_failed: bool,
    /// The lock that this process holds; `None` where there are no locks.
    lock: Option<LockIdentity>,
    clock: Clock,
    peak_before: Option<u64>,
    psnr_test: Option<f64>,
    psnr_test_sample: Option<f64>,
    sums: LogSums,
    budget: Option<TimeBudget>,
}

/// Sums since the last line of the log.
#[derive(Default)]
struct LogSums {
    steps: u32,
    seconds: f64,
    loss: f64,
    l1: f64,
    ssim: f64,
    visible: u32,
}

impl Session<'_> {
    /// Trains to the end, or until a stop is requested.
    ///
    /// # Errors
    /// A step that fails; a checkpoint, scene or image that cannot be written.
    pub fn run(mut self) -> Result<(Outcome, Box<dyn Reconstruction>)> {
        let start = self.trainer.iteration();
        let (log, last) = RunLog::open(&self.folder.log(), start, &self.config.run.log)?;
        if start > 0 && last.as_ref().is_none_or(|record| record.iteration < start) {
            self.observer.warn(&format!(
                "{}: no line for step {start}; the duration of the steps without one is not counted",
                self.folder.log().display()
            ));
        }
        let spent_s = last.as_ref().map_or(0.0, |record| record.elapsed_s);
        let mut state = LoopState {
            log,
            log_failed: false,
            lock: self.folder.lock_identity(),
            clock: Clock::resumed(spent_s, last.as_ref().map_or(Some(0.0), |record| record.cpu_s)),
            peak_before: last.as_ref().and_then(|record| record.peak_rss_bytes),
            psnr_test: last.as_ref().and_then(|record| record.psnr_test),
            psnr_test_sample: last.and_then(|record| record.psnr_test_sample),
            sums: LogSums::default(),
            budget: self.config.run.time.map(|limit| TimeBudget::new(limit, self.since, start, spent_s)),
        };
        let listening = self.stop.listen();
        self.observer.event(Event::StepsBegin { done: start, total: self.trainer.config().iterations });
        let outcome = self.train(&mut state);
        self.observer.event(Event::StepsEnd);
        drop(listening);
        let outcome = outcome?;
        if outcome == Outcome::Finished {
            let took = text::training_time(state.clock.seconds(), state.clock.processor_seconds());
            let has_trained = self.trainer.iteration() > start;
            self.observer.note(&if has_trained { took } else { format!("all {start} steps were made before, {took}") });
        }
        Ok((outcome, self.trainer))
    }

    fn train(&mut self, state: &mut LoopState) -> Result<Outcome> {
        // A resumed run that has all its steps ends with the mean of the parameters averaged so
        // far.
        let is_averaged = self.trainer.finish_average()?;
        if is_averaged {
            self.save(state)?;
        }
        // A run that died between a checkpoint and the end of its evaluation does the evaluation
        // first.
        let is_stale = is_averaged || !self.folder.evaluated_iterations().contains(&self.trainer.iteration());
        if is_stale && self.evaluation_is_due() {
            self.evaluate(state)?;
        }
        let mut downscale = 1;
        while !self.trainer.is_finished() {
            if self.trainer.downscale() != downscale {
                downscale = self.trainer.downscale();
                self.report_resolution(downscale);
            }
            if self.trainer.agrees_to_stop(self.stop.is_requested()) {
                self.check_folder(state)?;
                self.log(state)?;
                self.save(state)?;
                return Ok(Outcome::Interrupted);
            }
            let before = state.clock.seconds();
            let planned = self.trainer.config().iterations;
            let report = self.trainer.step().with_context(|| format!("training step {}", self.trainer.iteration() + 1))?;
            state.sums.add(&report, state.clock.seconds() - before);
            let iteration = self.trainer.iteration();
            self.observer.event(Event::Step { done: iteration });
            let end = self.trainer.config().iterations;
            if end != planned {
                self.observer.event(Event::StepsBegin { done: iteration, total: end });
                self.observer.note(&format!(
                    "step {iteration}: the run ends after {end} steps, since more would gain little on views that it does not train on"
                ));
            }
            self.plan(state)?;

            let save = state.clock.paused(|| self.visit()) == Some(VisitAction::Save) || self.checkpoint_is_due();
            let evaluate = self.evaluation_is_due();
            if save || evaluate || iteration.is_multiple_of(LOG_EVERY) {
                self.check_folder(state)?;
                self.log(state)?;
            }
            if save || evaluate {
                self.save(state)?;
            }
            if evaluate {
                self.evaluate(state).with_context(|| format!("the state of step {iteration} is saved"))?;
            }
        }
        Ok(Outcome::Finished)
    }

    /// Plans a run within a given time anew where that is due, and keeps the plan in config.toml.
    /// Without one, says once how long the run will take.
    fn plan(&mut self, state: &mut LoopState) -> Result<()> {
        let (seconds, made) = (state.clock.seconds(), state.sums.steps);
        let Some(budget) = &mut state.budget else {
            if self.trainer.iteration() == TELLS_AT {
                let steps_left = self.trainer.steps_left_at_pace(made);
                steps_left.into_iter().for_each(|left| self.tell_duration(left * state.sums.seconds / f64::from(made.max(1))));
            }
            return Ok(());
        };
        let Some(splats) = self.trainer.as_splats() else { return Ok(()) };
        let (before, is_first) = (splats.config().iterations, !budget.is_planned());
        if !budget.plan(splats, seconds) {
            return Ok(());
        }
        let too_short = (is_first && splats.config().iterations < LEAST_STEPS).then(|| budget.start_s());
        let (config, size) = (splats.config().clone(), self.dataset.train.first().map_or([0; 2], |view| view.camera.size_px));
        let (iterations, factor) = (config.iterations, splats.downscale());
        self.folder.write_config(&RunConfig { train: config, ..self.config.clone() })?;
        self.observer.event(Event::StepsBegin { done: self.trainer.iteration(), total: iterations });
        // A plan that is nearly the last one is not worth a line.
        if f64::from(iterations.abs_diff(before)) > 0.1 * f64::from(before) {
            let [width, height] = size.map(|side| side / factor);
            self.observer
                .note(&format!("step {}: {iterations} steps fit into the time, now on {width}x{height} pixels", self.trainer.iteration()));
        }
        if let Some(start_s) = too_short {
            let start = text::duration(Duration::try_from_secs_f64(start_s).unwrap_or_default());
            self.observer
                .warn(&format!("the time is short: {start} went by before the first step, and the steps that are left give a rough scene"));
        }
        Ok(())
    }

    /// Says how long the run will take, where that is long enough to matter.
    fn tell_duration(&self, left_s: f64) {
        let left = Duration::try_from_secs_f64(left_s).unwrap_or_default();
        if left >= WORTH_TELLING {
            let advice = "less with fewer steps, smaller images, or a limit of time";
            self.observer.note(&format!("about {} to the last step at this pace; {advice}", text::duration(left)));
        }
    }

    /// Shows the observer the splats between two steps.
    fn visit(&mut self) -> Option<VisitAction> {
        let splats = self.trainer.as_splats()?;
        Some(self.observer.visit(&mut LiveRun::new(splats, self.dataset)))
    }

    /// Reports a change of resolution, from which losses and speeds do not compare with those
    /// before.
    fn report_resolution(&self, downscale: u32) {
        let (iteration, size) = (self.trainer.iteration(), self.dataset.train.first().map(|view| view.camera.size_px));
        let [width, height] = size.map_or([0; 2], |size| size.map(|side| side / downscale));
        self.observer.note(&format!("step {iteration}: training on {width}x{height} pixels from here on"));
    }

    fn checkpoint_is_due(&self) -> bool {
        self.config.run.saves_after(self.trainer.iteration(), self.trainer.is_finished())
    }

    fn evaluation_is_due(&self) -> bool {
        self.config.run.measures_after(self.trainer.iteration(), self.trainer.is_finished())
    }

    /// Writes a line of the log and reports it. A log that cannot be written costs a warning, not
    /// the run.
    fn log(&mut self, state: &mut LoopState) -> Result<()> {
        if state.sums.steps == 0 {
            return Ok(());
        }
        let iteration = self.trainer.iteration();
        let schedule = TestCurve::new(self.trainer.config().iterations, self.dataset.test.len());
        let is_due = schedule.is_due(iteration);
        let psnr_train = if is_due || !self.trainer.renders_slowly() { state.clock.paused(|| self.probe())? } else { None };
        if is_due {
            let sampled = state.clock.paused(|| self.sample_test_views(schedule))?;
            state.psnr_test_sample = sampled.or(state.psnr_test_sample);
        }
        let sums = std::mem::take(&mut state.sums);
        let mean = |sum: f64| sum / f64::from(sums.steps);
        let record = LogRecord {
            iteration,
            loss: mean(sums.loss),
            l1: self.trainer.compares_images().then(|| mean(sums.l1)),
            ssim: self.trainer.compares_images().then(|| mean(sums.ssim)),
            psnr_train,
            psnr_test: state.psnr_test,
            psnr_test_sample: state.psnr_test_sample,
            poses: self.trainer.pose_report(),
            vignetting_corner_ev: self.trainer.vignetting().unwrap_or_default().iter().map(|lens| lens.corner_ev).collect(),
            splats: self.trainer.size().splats(),
            visible: sums.visible,
            iterations_per_second: if sums.seconds > 0.0 { f64::from(sums.steps) / sums.seconds } else { 0.0 },
            steps_left_at_pace: self.trainer.steps_left_at_pace(sums.steps),
            elapsed_s: state.clock.seconds(),
            cpu_s: state.clock.processor_seconds(),
            rss_bytes: process::resident_bytes(),
            peak_rss_bytes: state.peak_rss(),
        };
        self.observer.event(Event::Progress { record: record.clone(), total: self.trainer.config().iterations });
        let appended = state.log.append(&record);
        self.report_log(appended, state);
        Ok(())
    }

    /// Warns once of a log that cannot be written.
    fn report_log(&self, result: Result<()>, state: &mut LoopState) {
        if let Err(error) = result
            && !std::mem::replace(&mut state.log_failed, true)
        {
            self.observer.warn(&format!("{error:#}; training continues without the log"));
        }
    }

    /// Writes a checkpoint, after the log's lines up to it. If the disk is full, older ones are
    /// removed, but never the newest.
    fn save(&mut self, state: &mut LoopState) -> Result<()> {
        let saved = self.save_state(state);
        if saved.is_err() { self.check_exists().and(saved) } else { saved }
    }

    fn save_state(&mut self, state: &mut LoopState) -> Result<()> {
        let synced = state.log.sync();
        self.report_log(synced, state);
        let iteration = self.trainer.iteration();
        let mut saved = self.trainer.saved()?;
        let write = |path: &Path| match &mut saved {
            SavedRun::Splats(state) => luxel_io::write_checkpoint(path, &mut **state),
            SavedRun::Arrays(file) => files::write_arrays(path, file),
        };
        let path = save_checkpoint(self.folder, &self.config.run, iteration, write)?;
        self.restore_log(state);
        self.observer.event(Event::Saved { path });
        Ok(())
    }
}

impl LoopState {
    fn peak_rss(&self) -> Option<u64> {
        process::peak_resident_bytes().max(self.peak_before)
    }
}

impl LogSums {
    fn add(&mut self, report: &StepReport, seconds: f64) {
        self.steps += 1;
        self.seconds += seconds;
        self.loss += f64::from(report.loss);
        self.l1 += f64::from(report.l1);
        self.ssim += f64::from(report.ssim);
        self.visible = report.visible;
    }
}

//! The loop of a run without stored splats, from its first (or next) step to its report: steps,
//! log, checkpoints and evaluations, in the order and at the steps of any run
//! ([`crate::run::Session`]).

use std::collections::BTreeMap;

use luxel_core::{Dataset, Engine, RenderOptions, Scene};
use luxel_metrics::{FieldOptions, FlipChoice, GainFit};

use super::files;
use super::kept_renders::KeptRenders;
use super::trainer::{StepLoss, Trainer};
use crate::error::{Context, bail};
use crate::run::checkpoints::save_checkpoint;
use crate::run::clock::Clock;
use crate::run::evaluation::{Metrics, Rendering};
use crate::run::log::{LOG_EVERY, LogRecord, RunLog};
use crate::run::test_curve::TestCurve;
use crate::run::{Captures, Launch, Outcome, RunConfig, RunFolder, report};
use crate::{Device, DeviceOptions, Error, Event, Result, SelectedEngine, build_info, files as text_files, memory, schema, text};

/// A run in progress.
pub(super) struct ImplicitSession<'a> {
    pub(super) dataset: &'a Dataset,
    pub(super) config: &'a RunConfig,
    pub(super) launch: Launch<'a>,
    pub(super) threads: usize,
    /// Place where it is computed.
    pub(super) computed_by: String,
    pub(super) trainer: Trainer,
}

/// The state of the loop besides the trainer.
struct LoopState {
    log: RunLog,
    clock: Clock,
    peak_before: Option<u64>,
    psnr_test: Option<f64>,
    psnr_test_sample: Option<f64>,
    steps: u32,
    seconds: f64,
    loss: StepLoss,
}

impl ImplicitSession<'_> {
    /// Trains to the end, or until a stop is requested.
    pub(super) fn run(mut self) -> Result<Outcome> {
        let (start, observer) = (self.iteration(), self.launch.observer);
        let (log, last) = RunLog::open(&self.launch.folder.log(), start, &self.config.run.log)?;
        let mut state = LoopState {
            log,
            clock: Clock::resumed(
                last.as_ref().map_or(0.0, |record| record.elapsed_s),
                last.as_ref().map_or(Some(0.0), |record| record.cpu_s),
            ),
            peak_before: last.as_ref().and_then(|record| record.peak_rss_bytes),
            psnr_test: last.as_ref().and_then(|record| record.psnr_test),
            psnr_test_sample: last.and_then(|record| record.psnr_test_sample),
            steps: 0,
            seconds: 0.0,
            loss: StepLoss::default(),
        };
        let listening = self.launch.stop.listen();
        observer.event(Event::StepsBegin { done: start, total: self.config.train.iterations });
        let outcome = self.train(&mut state);
        observer.event(Event::StepsEnd);
        drop(listening);
        if outcome.as_ref().is_ok_and(|outcome| *outcome == Outcome::Finished) {
            observer.note(&text::training_time(state.clock.seconds(), state.clock.processor_seconds()));
        }
        outcome
    }

    fn iteration(&self) -> u32 {
        self.trainer.iteration()
    }

    fn train(&mut self, state: &mut LoopState) -> Result<Outcome> {
        // A run that died between a checkpoint and the end of its evaluation does the evaluation
        // first.
        if self.evaluation_is_due() && !self.launch.folder.evaluated_iterations().contains(&self.iteration()) {
            self.evaluate(state)?;
        }
        while !self.trainer.is_finished() {
            if self.launch.stop.is_requested() {
                self.log(state)?;
                self.save(state)?;
                return Ok(Outcome::Interrupted);
            }
            let before = state.clock.seconds();
            let loss = self.trainer.step()?;
            state.steps += 1;
            state.seconds += state.clock.seconds() - before;
            state.loss.add(loss);
            let iteration = self.iteration();
            self.launch.observer.event(Event::Step { done: iteration });
            let save = self.config.run.saves_after(iteration, self.trainer.is_finished());
            let evaluate = self.evaluation_is_due();
            if save || evaluate || iteration.is_multiple_of(LOG_EVERY) {
                self.check_folder()?;
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

    fn evaluation_is_due(&self) -> bool {
        self.config.run.measures_after(self.iteration(), self.trainer.is_finished())
    }

    /// Ends a run whose folder another program removed or took apart meanwhile.
    fn check_folder(&self) -> Result<()> {
        let folder = self.launch.folder;
        if !RunFolder::is_run(folder.root()) {
            let (root, iteration) = (folder.root().display(), self.iteration());
            let message =
                format!("{root}: the folder or its config.toml was removed while the run was at work; it ends at step {iteration}");
            return Err(Error::new(message).with_remedy(luxel_core::Remedy::advice("train again, into a folder that stays")));
        }
        Ok(())
    }

    /// Writes a line of the log and reports it. A log that cannot be written costs a warning.
    fn log(&mut self, state: &mut LoopState) -> Result<()> {
        if state.steps == 0 {
            return Ok(());
        }
        let iteration = self.iteration();
        let schedule = TestCurve::new(self.config.train.iterations, self.dataset.test.len());
        let mut psnr_train = None;
        if schedule.is_due(iteration) {
            let (train, test) = state.clock.paused(|| self.look(schedule))?;
            psnr_train = train;
            state.psnr_test_sample = test.or(state.psnr_test_sample);
        }
        let steps = f64::from(std::mem::take(&mut state.steps));
        let (seconds, loss) = (std::mem::take(&mut state.seconds), std::mem::take(&mut state.loss));
        let record = LogRecord {
            iteration,
            loss: loss.total / steps,
            l1: loss.parts.map(|[l1, _]| l1 / steps),
            ssim: loss.parts.map(|[_, ssim]| ssim / steps),
            psnr_train,
            psnr_test: state.psnr_test,
            psnr_test_sample: state.psnr_test_sample,
            poses: None,
            vignetting_corner_ev: Vec::new(),
            splats: self.trainer.splats(),
            visible: 0,
            steps_left_at_pace: None,
            iterations_per_second: if seconds > 0.0 { steps / seconds } else { 0.0 },
            elapsed_s: state.clock.seconds(),
            cpu_s: state.clock.processor_seconds(),
            rss_bytes: memory::resident_bytes(),
            peak_rss_bytes: memory::peak_resident_bytes().max(state.peak_before),
        };
        self.launch.observer.event(Event::Progress { record: record.clone(), total: self.config.train.iterations });
        if let Err(error) = state.log.append(&record) {
            self.launch.observer.warn(&format!("{error:#}; training continues without this line of the log"));
        }
        Ok(())
    }

    /// Returns the PSNR of a training view in turn, and the mean of a few test views.
    fn look(&self, schedule: TestCurve) -> Result<(Option<f64>, Option<f64>)> {
        let mut engine = self.engine()?;
        let place = self.trainer.place(self.dataset);
        let mut rendering = self.rendering(&mut *engine, &place);
        let turn = (self.iteration() / LOG_EVERY) as usize % self.dataset.train.len().max(1);
        let train = self.dataset.train.get(turn).map(|view| rendering.probe(view)).transpose()?.flatten();
        let views = schedule.views().filter_map(|i| self.dataset.test.get(i));
        let found: Vec<Option<f64>> = views.map(|view| rendering.probe(view)).collect::<Result<_>>()?;
        let found: Vec<f64> = found.into_iter().flatten().collect();
        Ok((train, (!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64)))
    }

    /// Returns the scene as it is now, in an engine of its own.
    fn engine(&self) -> Result<Box<dyn Engine>> {
        let options = DeviceOptions { device: Device::Cpu, threads: u32::try_from(self.threads).ok() };
        self.trainer.engine(self.dataset, SelectedEngine::open(&options)?)
    }

    fn rendering<'e>(&self, engine: &'e mut dyn Engine, place: &Scene) -> Rendering<'e> {
        Rendering {
            engine,
            options: RenderOptions { background: self.config.background(place.radiance_scale), ..place.render_options() },
            radiance_scale: place.radiance_scale,
            protocol_scale: None,
            mu: self.config.train.mu,
            color_space: self.dataset.color_space,
            peak_luminance: FieldOptions::DEFAULT_PEAK_LUMINANCE,
            flip: FlipChoice::Skip,
            lpips: None,
            response: self.trainer.response(),
            log_gains: BTreeMap::new(),
            progress: None,
        }
    }

    /// Writes a checkpoint, after the log's lines up to it.
    fn save(&mut self, state: &mut LoopState) -> Result<()> {
        if let Err(error) = state.log.sync() {
            self.launch.observer.warn(&format!("{error:#}"));
        }
        let (iteration, folder) = (self.iteration(), self.launch.folder.root());
        if !folder.is_dir() {
            bail!("{}: the folder was removed while the run was at work; it ends at step {iteration}", folder.display());
        }
        let write = self.trainer.checkpoint(self.dataset, &self.config.train)?;
        let path = save_checkpoint(self.launch.folder, &self.config.run, iteration, write)?;
        self.launch.observer.event(Event::Saved { path });
        Ok(())
    }

    /// Writes scene, images, metrics and report of this step, with the clock stopped.
    fn evaluate(&mut self, state: &mut LoopState) -> Result<()> {
        let (seconds, processor) = (state.clock.seconds(), state.clock.processor_seconds());
        let peak = memory::peak_resident_bytes().max(state.peak_before);
        let psnr = state.clock.paused(|| self.evaluate_at(seconds, processor, peak))?;
        state.psnr_test = psnr.or(state.psnr_test);
        Ok(())
    }

    fn evaluate_at(&self, train_seconds: f64, train_cpu_seconds: Option<f64>, peak_before: Option<u64>) -> Result<Option<f64>> {
        let (iteration, folder, config) = (self.iteration(), self.launch.folder, self.config);
        let path = folder.implicit(self.trainer.kind(), iteration);
        let scene = self.trainer.scene(self.dataset);
        files::write(&path, &scene)?;
        let place = scene.place;
        self.launch.observer.event(Event::Saved { path });
        let images = folder.evaluation(iteration);
        let mut engine = KeptRenders::new(self.engine()?);
        let mut rendering = self.rendering(&mut engine, &place);
        let test = rendering.evaluate(&self.dataset.test, Some(&images), GainFit::None)?;
        let finished = self.trainer.is_finished();
        let train = if finished { rendering.evaluate(&self.dataset.train, None, GainFit::None)? } else { None };
        let fitted = rendering.evaluate_fitted(config, &self.dataset.test)?;
        if let Some(knots) = rendering.response {
            Captures::of_response(iteration, knots).write(folder)?;
        }
        let measured = [("test", test), ("train", train)].into_iter().filter_map(|(name, split)| Some((name, split?)));
        let splits = measured.chain(fitted).map(|(name, split)| (name.to_owned(), split)).collect();
        let metrics = Metrics {
            method: config.method_name(),
            iterations: iteration,
            splats: self.trainer.splats(),
            field_parameters: self.trainer.field_parameters(),
            train_seconds,
            train_cpu_seconds,
            peak_rss_bytes: peak_before.max(memory::peak_resident_bytes()),
            radiance_scale: place.radiance_scale,
            mu: config.train.mu,
            seed: config.train.seed,
            threads: self.threads,
            computed_by: self.computed_by.clone(),
            luxel_version: crate::VERSION.into(),
            revision: build_info::REVISION.map(Into::into),
            features: build_info::features().into_iter().map(Into::into).collect(),
            dataset: config.dataset_path(folder.root()).display().to_string(),
            poses: None,
            test_alignment: None,
            vignetting: Vec::new(),
            splits,
        };
        text_files::write_json(&folder.metrics(), schema::METRICS, &metrics)?;
        if finished {
            report::write(folder, config, self.dataset, report::Evaluated { metrics: &metrics, images: &images })?;
        }
        // Last: it marks the evaluation as complete.
        text_files::write_json(&images.join("metrics.json"), schema::METRICS, &metrics)?;
        for (name, split) in &metrics.splits {
            let (mean, views) = (split.mean, split.views.len());
            self.launch.observer.event(Event::Evaluation { step: iteration, split: name.clone(), mean, views });
        }
        Ok(metrics.splits.get("test").map(|split| split.mean.psnr_scene))
    }
}

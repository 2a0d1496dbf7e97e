//! A viewer of a run that is being trained: an [`Observer`]'s visits between steps.
//!
//! In: a run between two steps, its events, and what the page asks for; out: pictures of the scene
//! as it stands, the newest state, the history, and wishes of saving and stopping. Training waits
//! for at most [`JOBS_PER_STEP`] pictures a step, and while it is paused.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use luxel::{Error, Event, LiveRun, LogRecord, Observer, RadianceLayers, Result, StopFlag, VisitAction};

use crate::jobs::{Stage, Wanted};
use crate::server_context::ServerContext;
use crate::solids;
use crate::stage::{LastPicture, without_layers};
use crate::status::{Record, Shared, Status, TrainingStatus};
use crate::variant::Variant;
use crate::{Subject, Viewer};

/// Pictures that are rendered between two steps.
const JOBS_PER_STEP: usize = 1;
/// Time between looks at the wishes while a run is paused.
const PATIENCE: Duration = Duration::from_millis(100);
/// Least time between states that pages receive.
const TELL_EVERY: Duration = Duration::from_secs(1);

/// An observer that shows a run in the browser, and passes its events on.
pub struct Live<'a> {
    name: String,
    stop: &'a StopFlag,
    next: &'a dyn Observer,
    cd_m2_per_unit: Option<f64>,
    state: Mutex<LiveState>,
}

struct LiveState {
    /// The address, until the first visit.
    viewer: Option<Viewer>,
    context: Option<Arc<ServerContext>>,
    last: LastPicture,
    told_at: Instant,
}

impl<'a> Live<'a> {
    /// Creates a viewer for the training run `name`. Events are forwarded to `next`; the page's
    /// Stop button sets `stop`.
    pub fn new(viewer: Viewer, name: impl Into<String>, stop: &'a StopFlag, next: &'a dyn Observer) -> Self {
        let state = LiveState { viewer: Some(viewer), context: None, last: LastPicture::default(), told_at: Instant::now() };
        Self { name: name.into(), stop, next, cd_m2_per_unit: None, state: Mutex::new(state) }
    }

    /// Sets the luminance of one unit of the data set, cd/m2; `None` where it is not calibrated.
    #[must_use]
    pub fn with_cd_m2_per_unit(mut self, cd_m2_per_unit: Option<f64>) -> Self {
        self.cd_m2_per_unit = cd_m2_per_unit;
        self
    }

    /// Returns what the server has, which it is started with at the first visit.
    fn context(&self, state: &mut LiveState, run: &mut LiveRun<'_>) -> Result<Arc<ServerContext>> {
        if let Some(context) = &state.context {
            return Ok(Arc::clone(context));
        }
        let scene = run.scene()?;
        let subject = Subject::new(self.name.clone(), &scene, Some(run.dataset()))?.with_cd_m2_per_unit(self.cd_m2_per_unit);
        if let Some(cameras) = run.refined_cameras() {
            subject.move_views(&cameras);
        }
        let context = Arc::new(ServerContext::new(subject, scene.color_space, status_of(run), None));
        let viewer = state.viewer.take().ok_or_else(|| Error::new("the viewer could not be started"))?;
        viewer.start(Arc::clone(&context))?;
        state.context = Some(Arc::clone(&context));
        Ok(context)
    }

    /// Answers what waits; longer while the run is paused.
    fn serve(&self, context: &ServerContext, state: &mut LiveState, run: &mut LiveRun<'_>) -> VisitAction {
        let wishes = &context.shared.wishes;
        let newest = status_of(run);
        if state.told_at.elapsed() >= TELL_EVERY {
            state.told_at = Instant::now();
            tell(context, run, &newest);
        }
        for _ in 0..JOBS_PER_STEP {
            let Some(job) = context.jobs.next(Duration::ZERO) else { break };
            state.last.answer(job, &mut LiveStage { run });
        }
        let mut action = VisitAction::Continue;
        loop {
            if Shared::take(&wishes.stop) {
                self.stop.request();
            }
            if Shared::take(&wishes.save) {
                action = VisitAction::Save;
            }
            let is_paused = wishes.pause.load(Ordering::SeqCst) && !self.stop.is_requested();
            // Whoever sees that the run is paused sees where.
            if is_paused && context.shared.status().training.is_some_and(|training| !training.is_paused) {
                tell(context, run, &newest);
            }
            context.shared.update_if(|training| std::mem::replace(&mut training.is_paused, is_paused) != is_paused);
            // What is saved is saved at once, also while the run is paused.
            if !is_paused || action == VisitAction::Save {
                return action;
            }
            if let Some(job) = context.jobs.next(PATIENCE) {
                state.last.answer(job, &mut LiveStage { run });
            }
        }
    }
}

impl Observer for Live<'_> {
    fn event(&self, event: Event) {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(context) = &state.context {
            match &event {
                Event::Progress { record, .. } => context.shared.record(Record::from(record)),
                Event::StepsEnd => {
                    context.shared.update_if(|training| !std::mem::replace(&mut training.is_finished, true));
                    context.jobs.close();
                }
                _ => {}
            }
        }
        drop(state);
        self.next.event(event);
    }

    fn visit(&self, run: &mut LiveRun<'_>) -> VisitAction {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.viewer.is_none() && state.context.is_none() {
            return VisitAction::Continue;
        }
        match self.context(&mut state, run) {
            Ok(context) => self.serve(&context, &mut state, run),
            Err(error) => {
                drop(state);
                self.next.warn(&format!("training continues without the viewer: {error:#}"));
                VisitAction::Continue
            }
        }
    }
}

impl From<&LogRecord> for Record {
    fn from(record: &LogRecord) -> Self {
        Self {
            iteration: record.iteration,
            loss: record.loss,
            psnr_train: record.psnr_train,
            psnr_test: record.psnr_test,
            splats: record.splats,
            iterations_per_second: record.iterations_per_second,
            elapsed_s: record.elapsed_s,
        }
    }
}

/// Returns the state of a run between two steps.
fn status_of(run: &LiveRun<'_>) -> Status {
    let training = TrainingStatus { done: run.steps_made(), total: run.steps(), ..TrainingStatus::default() };
    Status { version: run.steps_made().into(), splats: run.splats_len(), cameras: 0, training: Some(training) }
}

/// Tells the pages where the run is, and its cameras with it.
fn tell(context: &ServerContext, run: &LiveRun<'_>, newest: &Status) {
    let has_moved = run.refined_cameras().is_some_and(|cameras| context.subject.move_views(&cameras));
    context.shared.update(|status| {
        status.advance(newest.clone());
        status.cameras += u64::from(has_moved);
    });
}

/// A run between two steps.
struct LiveStage<'r, 'a> {
    run: &'r mut LiveRun<'a>,
}

impl Stage for LiveStage<'_, '_> {
    fn render(&mut self, wanted: &Wanted) -> Result<RadianceLayers> {
        if !wanted.edit.is_empty() {
            return Err(Error::new("a scene that is being trained cannot be edited"));
        }
        if wanted.lens.is_some() {
            return Err(Error::new("a scene that is being trained is seen through a pinhole"));
        }
        if wanted.variant != Variant::default() {
            return self.variant(wanted);
        }
        if wanted.layers
            && let Ok(layers) = self.run.render_layers(&wanted.camera)
        {
            return Ok(layers);
        }
        Ok(without_layers(self.run.render(&wanted.camera)?))
    }

    fn version(&self) -> u64 {
        self.run.steps_made().into()
    }
}

impl LiveStage<'_, '_> {
    /// Draws splats as bodies, from a copy of the scene.
    fn variant(&mut self, wanted: &Wanted) -> Result<RadianceLayers> {
        let Some(solids) = wanted.variant.solids else {
            return Err(Error::new("a scene that is being trained has no clip planes; draw its splats as ellipsoids or centres for them"));
        };
        let scene = self.run.scene()?;
        match wanted.variant.clip {
            Some(clip) => solids::render(&clip.apply(&scene, &wanted.camera), &wanted.camera, solids),
            None => solids::render(&scene, &wanted.camera, solids),
        }
    }
}

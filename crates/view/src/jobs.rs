//! Work that waits for the engine: a bounded queue in which a viewer's newest wish replaces its
//! older ones.
//!
//! In: [`Job`]s from any thread; out: the same, one by one, to the thread that owns the engine. A
//! job is a picture, or any other work with the scene ([`Jobs::run`]), which should be short:
//! nobody sees a picture while it lasts. A picture of a viewer takes the place of that viewer's
//! waiting one, whose sender learns that it was superseded; so a viewer that moves fast delays
//! nobody. What is quickly done overtakes what is not, which in turn is next: nobody waits for more
//! than one long job at a time, and no job waits for ever. A full queue refuses.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use luxel::{Error, RadianceLayers, Renderer, Scene};
use luxel_core::Camera;
use tokio::sync::oneshot;

use crate::lens::LensRequest;
use crate::variant::Variant;

/// Jobs that may wait.
const MAX_WAITING: usize = 64;

/// Pixels up to which pictures count as equally quick.
const QUICK_PX: u64 = 1 << 16;

/// The picture that a job asks for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Wanted {
    /// Camera, valid and undistorted, in the local coordinates of the scene.
    pub(crate) camera: Camera,
    /// Edits applied before rendering, in their text form; empty for the scene as it is.
    pub(crate) edit: String,
    /// Whether coverage and depth are needed.
    pub(crate) layers: bool,
    /// The scene, and how its splats are drawn.
    pub(crate) variant: Variant,
    /// The lens; `None` for a pinhole.
    pub(crate) lens: Option<LensRequest>,
}

/// A finished render.
#[derive(Clone, Debug)]
pub(crate) struct Rendered {
    /// The picture. Coverage and depth are empty where the job did not need them, or where the
    /// engine has none.
    pub(crate) picture: Arc<RadianceLayers>,
    /// Version of the scene that was rendered: steps of a training, 0 otherwise.
    pub(crate) version: u64,
    /// Time that the engine took, seconds; 0 for a picture that was there already.
    pub(crate) seconds: f64,
}

/// The answer to a job.
#[derive(Clone, Debug)]
pub(crate) enum Reply {
    /// It is done.
    Done(Rendered),
    /// A newer job of the same viewer took its place.
    Superseded,
    /// It cannot be done, for the reason given.
    Failed(String),
}

/// A scene and the renderer that has loaded it.
pub(crate) struct Loaded<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) renderer: &'a mut Renderer,
}

/// A source of pictures.
pub(crate) trait Stage {
    /// Renders a picture.
    fn render(&mut self, wanted: &Wanted) -> luxel::Result<RadianceLayers>;

    /// Returns the scene under edits in their text form, with its renderer. Work that changes the
    /// renderer's options restores them.
    ///
    /// # Errors
    /// A scene that is being trained; an edit that does not go with the scene.
    fn loaded(&mut self, _edit: &str) -> luxel::Result<Loaded<'_>> {
        Err(Error::new("the scene is being trained: end the training, and open the run with luxel view"))
    }

    /// Returns the version of the scene.
    fn version(&self) -> u64;
}

/// Work that waits.
pub(crate) enum Job {
    /// A picture.
    Picture(Box<PictureJob>),
    /// Other work.
    Task(Box<dyn Task>),
}

impl Job {
    fn is_wanted(&self) -> bool {
        match self {
            Self::Picture(job) => !job.reply.is_closed(),
            Self::Task(task) => task.is_wanted(),
        }
    }

    /// Returns how long the job lasts, in classes that are a factor of four apart.
    fn duration_class(&self) -> u32 {
        match self {
            Self::Picture(job) => {
                let [width, height] = job.wanted.camera.size_px;
                let renders = job.wanted.lens.map_or(1, LensRequest::renders);
                (u64::from(width) * u64::from(height) * u64::from(renders)).max(QUICK_PX).ilog2() / 2
            }
            Self::Task(_) => u32::MAX,
        }
    }
}

/// Work with the scene on the thread that owns the engine.
pub(crate) trait Task: Send {
    /// Returns whether somebody still waits for the result.
    fn is_wanted(&self) -> bool;

    /// Does the work, and sends the result.
    fn run(self: Box<Self>, stage: &mut dyn Stage);
}

/// A function as a task.
struct FunctionTask<T, F> {
    work: F,
    reply: oneshot::Sender<luxel::Result<T>>,
}

impl<T: Send, F: FnOnce(&mut dyn Stage) -> luxel::Result<T> + Send> Task for FunctionTask<T, F> {
    fn is_wanted(&self) -> bool {
        !self.reply.is_closed()
    }

    fn run(self: Box<Self>, stage: &mut dyn Stage) {
        let result = (self.work)(stage);
        // A receiver that left needs no answer.
        let _ = self.reply.send(result);
    }
}

/// A picture that waits.
pub(crate) struct PictureJob {
    /// The picture.
    pub(crate) wanted: Wanted,
    /// The viewer that it is for; `None` for a job that nothing replaces.
    pub(crate) viewer: Option<String>,
    /// Receives the answer.
    pub(crate) reply: oneshot::Sender<Reply>,
}

/// Explains why a job was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// Too many wait already.
    Full,
    /// Nothing renders any more.
    Closed,
}

#[derive(Default)]
struct Inner {
    waiting: VecDeque<Job>,
    /// Whether the oldest job is next, since another has overtaken it.
    is_oldest_next: bool,
    is_closed: bool,
}

impl Inner {
    /// Takes the next job out: the oldest of the quickest, or after that has overtaken others, the
    /// oldest.
    fn pop(&mut self) -> Option<Job> {
        let quickest = self.waiting.iter().enumerate().min_by_key(|(_, job)| job.duration_class())?.0;
        let index = if self.is_oldest_next { 0 } else { quickest };
        self.is_oldest_next = index != 0;
        self.waiting.remove(index)
    }
}

/// The queue.
#[derive(Default)]
pub(crate) struct Jobs {
    inner: Mutex<Inner>,
    arrived: Condvar,
}

impl Jobs {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a picture, and returns the receiver of its answer.
    pub(crate) fn submit(&self, wanted: Wanted, viewer: Option<String>) -> Result<oneshot::Receiver<Reply>, Refusal> {
        let (reply, answer) = oneshot::channel();
        let job = Box::new(PictureJob { wanted, viewer, reply });
        let mut inner = self.lock();
        if inner.is_closed {
            return Err(Refusal::Closed);
        }
        let same = inner.waiting.iter_mut().find_map(|waiting| match waiting {
            Job::Picture(waiting) if waiting.viewer.is_some() && waiting.viewer == job.viewer => Some(waiting),
            _ => None,
        });
        if let Some(waiting) = same {
            let older = std::mem::replace(waiting, job);
            // A receiver that left needs no answer.
            let _ = older.reply.send(Reply::Superseded);
            return Ok(answer);
        }
        self.push(inner, Job::Picture(job))?;
        Ok(answer)
    }

    /// Adds work that is done on the thread that owns the engine, and returns the receiver of its
    /// result. Work whose receiver is dropped before it begins is not done.
    pub(crate) fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Stage) -> luxel::Result<T> + Send + 'static,
    ) -> Result<oneshot::Receiver<luxel::Result<T>>, Refusal> {
        let (reply, answer) = oneshot::channel();
        self.push(self.lock(), Job::Task(Box::new(FunctionTask { work, reply })))?;
        Ok(answer)
    }

    fn push(&self, mut inner: MutexGuard<'_, Inner>, job: Job) -> Result<(), Refusal> {
        if inner.is_closed {
            return Err(Refusal::Closed);
        }
        // Those whose receiver left make room.
        inner.waiting.retain(Job::is_wanted);
        if inner.waiting.len() >= MAX_WAITING {
            return Err(Refusal::Full);
        }
        inner.waiting.push_back(job);
        drop(inner);
        self.arrived.notify_one();
        Ok(())
    }

    /// Returns the next job that somebody still waits for, and waits for one as long as `patience`
    /// allows; `None` after that, and once the queue is closed.
    pub(crate) fn next(&self, patience: Duration) -> Option<Job> {
        let until = Instant::now() + patience;
        let mut inner = self.lock();
        loop {
            inner.waiting.retain(Job::is_wanted);
            if let Some(job) = inner.pop() {
                return Some(job);
            }
            let left = until.saturating_duration_since(Instant::now());
            if inner.is_closed || left.is_zero() {
                return None;
            }
            inner = self.arrived.wait_timeout(inner, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Returns whether jobs are refused for good.
    pub(crate) fn is_closed(&self) -> bool {
        self.lock().is_closed
    }

    /// Refuses jobs from now on; those that wait are dropped.
    pub(crate) fn close(&self) {
        let mut inner = self.lock();
        inner.is_closed = true;
        inner.waiting.clear();
        drop(inner);
        self.arrived.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(width: u32) -> Wanted {
        let camera = luxel::synthetic::room_camera([width, 4]);
        Wanted { camera, edit: String::new(), layers: false, variant: Variant::default(), lens: None }
    }

    fn widths(jobs: &Jobs) -> Vec<u32> {
        let width = |job| match job {
            Job::Picture(job) => job.wanted.camera.size_px[0],
            Job::Task(_) => 0,
        };
        std::iter::from_fn(|| jobs.next(Duration::ZERO)).map(width).collect()
    }

    #[test]
    fn the_newest_wish_of_a_viewer_takes_the_place_of_its_older_one() {
        let jobs = Jobs::default();
        let mut first = jobs.submit(wanted(1), Some("a".into())).unwrap();
        let _other = jobs.submit(wanted(2), Some("b".into())).unwrap();
        let _lasting = jobs.submit(wanted(3), None).unwrap();
        let _newest = jobs.submit(wanted(4), Some("a".into())).unwrap();
        assert!(matches!(first.try_recv(), Ok(Reply::Superseded)));
        let _another = jobs.submit(wanted(5), None).unwrap();
        assert_eq!(widths(&jobs), [4, 2, 3, 5]);
    }

    #[test]
    fn quick_pictures_overtake_one_long_job_each() {
        let jobs = Jobs::default();
        let picture = |width: u32| {
            let camera = luxel::synthetic::room_camera([width, 1000]);
            jobs.submit(Wanted { camera, ..wanted(1) }, None).unwrap()
        };
        let _answers = [picture(3000), picture(3001), picture(3002), picture(200), picture(201), picture(202)];
        let _work = jobs.run(|_| Ok(())).unwrap();
        assert_eq!(widths(&jobs), [200, 3000, 201, 3001, 202, 3002, 0]);
    }

    #[test]
    fn a_full_queue_refuses_and_those_who_left_make_room() {
        let jobs = Jobs::default();
        let mut answers: Vec<_> = (0..MAX_WAITING).map(|_| jobs.submit(wanted(1), None).unwrap()).collect();
        assert_eq!(jobs.submit(wanted(1), None).unwrap_err(), Refusal::Full);
        answers.pop();
        assert!(jobs.submit(wanted(9), None).is_ok());
    }

    #[test]
    fn work_keeps_its_place_and_is_dropped_with_its_receiver() {
        let jobs = Jobs::default();
        let _picture = jobs.submit(wanted(1), Some("a".into())).unwrap();
        let _work = jobs.run(|_| Ok(1)).unwrap();
        let _newer = jobs.submit(wanted(3), Some("a".into())).unwrap();
        drop(jobs.run(|_| Ok(2)).unwrap());
        assert_eq!(widths(&jobs), [3, 0]);
    }

    #[test]
    fn a_closed_queue_hands_out_nothing() {
        let jobs = Jobs::default();
        let answer = jobs.submit(wanted(1), None).unwrap();
        jobs.close();
        assert!(jobs.next(Duration::from_secs(60)).is_none());
        assert!(answer.blocking_recv().is_err());
        assert_eq!(jobs.submit(wanted(1), None).unwrap_err(), Refusal::Closed);
        assert_eq!(jobs.run(|_| Ok(1)).unwrap_err(), Refusal::Closed);
    }
}

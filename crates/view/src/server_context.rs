//! Everything that answers are made from, and the wait for the thread that owns the engine.

use std::sync::Arc;

use bytes::Bytes;
use hyper::StatusCode;
use luxel::Scene;
use luxel_core::ColorSpace;
use tokio::sync::{OnceCell, Semaphore};

use crate::answer::Failure;
use crate::edit_session::EditSession;
use crate::folder::Folder;
use crate::frame_status::FrameRender;
use crate::jobs::{Jobs, Refusal, Rendered, Reply, Stage, Wanted};
use crate::probe_map::{LastLamps, LastProbe};
use crate::response_permits::ResponsePermits;
use crate::status::{Shared, Status};
use crate::subject::Subject;

/// Bodies of requests that are received at once.
const MAX_BODIES: usize = 4;
/// Copies of a scene that are on their way, at most.
const MAX_DOWNLOADS: usize = 4;
/// Requests of edits that are worked on at once.
const MAX_EDITING: usize = 4;

/// Everything that answers are made from.
pub(crate) struct ServerContext {
    pub(crate) subject: Subject,
    pub(crate) color_space: ColorSpace,
    pub(crate) jobs: Jobs,
    pub(crate) shared: Shared,
    /// The scene as it was opened; `None` for one that is being trained.
    pub(crate) scene: Option<Arc<Scene>>,
    /// Copies of the scene for pages that render by themselves.
    pub(crate) downloads: Downloads,
    /// Places for bodies of requests.
    pub(crate) bodies: Semaphore,
    /// The camera path that is rendered.
    pub(crate) frames: FrameRender,
    /// The light probe that was made last.
    pub(crate) environment: LastProbe,
    /// The lamps that were found last.
    pub(crate) lamps: LastLamps,
    /// Permits of large answers.
    pub(crate) permits: ResponsePermits,
    /// Tools for edits; `None` for a scene that is being trained.
    pub(crate) edit_session: Option<Arc<EditSession>>,
    /// Places for requests of edits.
    pub(crate) editing: Semaphore,
}

impl ServerContext {
    /// Returns a context without jobs.
    pub(crate) fn new(subject: Subject, color_space: ColorSpace, status: Status, scene: Option<Arc<Scene>>) -> Self {
        let (jobs, shared, bodies) = (Jobs::default(), Shared::new(status), Semaphore::new(MAX_BODIES));
        let (frames, environment, permits) = (FrameRender::default(), LastProbe::default(), ResponsePermits::default());
        let (downloads, editing) = (Downloads::default(), Semaphore::new(MAX_EDITING));
        Self {
            subject,
            color_space,
            jobs,
            shared,
            scene,
            downloads,
            bodies,
            frames,
            environment,
            lamps: LastLamps::default(),
            permits,
            edit_session: None,
            editing,
        }
    }

    /// Returns where new files are made.
    pub(crate) fn folder(&self) -> Result<Folder, Failure> {
        let folder = self.subject.folder.clone();
        folder.ok_or_else(|| Failure::new(StatusCode::CONFLICT, "this viewer has no folder to save into"))
    }
}

/// The copies of a scene.
pub(crate) struct Downloads {
    /// The scene without edits, unless it is large.
    pub(crate) kept: OnceCell<Bytes>,
    /// Places for all others that are on their way.
    pub(crate) places: Arc<Semaphore>,
}

impl Default for Downloads {
    fn default() -> Self {
        Self { kept: OnceCell::new(), places: Arc::new(Semaphore::new(MAX_DOWNLOADS)) }
    }
}

/// Says why work is not taken.
pub(crate) fn refused(refusal: Refusal) -> Failure {
    let reason = match refusal {
        Refusal::Full => "too many pictures are waited for",
        Refusal::Closed => "the viewer is closing",
    };
    Failure::new(StatusCode::SERVICE_UNAVAILABLE, reason)
}

/// Waits for a picture; `None` if a newer wish of the same viewer took its place.
pub(crate) async fn render(context: &ServerContext, wanted: Wanted, viewer: Option<String>) -> Result<Option<Rendered>, Failure> {
    let answer = context.jobs.submit(wanted, viewer).map_err(refused)?;
    match answer.await {
        Ok(Reply::Done(rendered)) => Ok(Some(rendered)),
        Ok(Reply::Superseded) => Ok(None),
        Ok(Reply::Failed(message)) => Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message)),
        Err(_) => Err(refused(Refusal::Closed)),
    }
}

/// Does work on the thread that owns the engine.
pub(crate) async fn on_stage<T: Send + 'static>(
    context: &ServerContext,
    work: impl FnOnce(&mut dyn Stage) -> luxel::Result<T> + Send + 'static,
) -> Result<T, Failure> {
    let answer = context.jobs.run(work).map_err(refused)?;
    Ok(answer.await.map_err(|_| refused(Refusal::Closed))??)
}

/// Waits for a picture that nothing takes the place of.
pub(crate) async fn render_surely(context: &ServerContext, wanted: Wanted) -> Result<Rendered, Failure> {
    let rendered = render(context, wanted, None).await?;
    rendered.ok_or_else(|| Failure::new(StatusCode::SERVICE_UNAVAILABLE, "the picture was given up"))
}

/// Runs work of the processor beside the server's thread.
pub(crate) async fn beside<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Failure> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Failure::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}

/// Runs work of the processor that can fail beside the server's thread.
pub(crate) async fn try_beside<T: Send + 'static>(work: impl FnOnce() -> luxel::Result<T> + Send + 'static) -> Result<T, Failure> {
    Ok(beside(work).await??)
}

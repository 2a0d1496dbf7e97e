//! Paths and what answers them. `GET` reads, `POST` changes something, and alone has a body.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use hyper::{Method, StatusCode};
use luxel::{Scene, schema};
use luxel_core::ColorSpace;
use serde::Serialize;
use serde_json::Value;
use tokio::sync::Semaphore;

use crate::downloads::{self, Downloads};
use crate::environment::LastEnvironment;
use crate::frame::Frame;
use crate::frame_render::FrameRender;
use crate::jobs::{Jobs, Refusal, Rendered, Reply, Stage, Wanted};
use crate::large::{Place, Room};
use crate::query::Query;
use crate::server::MAX_BODIES;
use crate::splats::{Precision, body_bytes};
use crate::status::{Shared, Status};
use crate::subject::Subject;
use crate::workshop::Workshop;
use crate::{assets, environment, paths, pictures, stills, thumbnail};

/// Requests of edits that are worked on at once.
const MAX_EDITING: usize = 4;

/// Everything that answers are made from.
pub(crate) struct House {
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
    pub(crate) environment: LastEnvironment,
    /// Room for large answers.
    pub(crate) room: Room,
    /// Tools for edits; `None` for a scene that is being trained.
    pub(crate) workshop: Option<Arc<Workshop>>,
    /// Places for requests of edits.
    pub(crate) editing: Semaphore,
}

impl House {
    /// Returns a house without jobs.
    pub(crate) fn new(subject: Subject, color_space: ColorSpace, status: Status, scene: Option<Arc<Scene>>) -> Self {
        let (jobs, shared, bodies) = (Jobs::default(), Shared::new(status), Semaphore::new(MAX_BODIES));
        let (frames, environment, room) = (FrameRender::default(), LastEnvironment::default(), Room::default());
        let (downloads, editing) = (Downloads::default(), Semaphore::new(MAX_EDITING));
        Self { subject, color_space, jobs, shared, scene, downloads, bodies, frames, environment, room, workshop: None, editing }
    }
}

/// An answer without its headers of safety.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) media_type: &'static str,
    /// Value of the header `Luxel-Frame`.
    pub(crate) frame_head: Option<String>,
    /// Name of the file that it is saved as.
    pub(crate) file_name: Option<&'static str>,
    pub(crate) body: Bytes,
}

/// Why there is no answer.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) status: StatusCode,
    pub(crate) message: String,
}

impl From<luxel::Error> for Failure {
    fn from(error: luxel::Error) -> Self {
        Self { status: StatusCode::UNPROCESSABLE_ENTITY, message: format!("{error:#}") }
    }
}

impl From<String> for Failure {
    fn from(message: String) -> Self {
        Self { status: StatusCode::BAD_REQUEST, message }
    }
}

impl Failure {
    pub(crate) fn new(status: StatusCode, message: impl Into<String>) -> Self {
        Self { status, message: message.into() }
    }
}

impl Answer {
    pub(crate) fn new(media_type: &'static str, body: impl Into<Bytes>) -> Self {
        Self { status: StatusCode::OK, media_type, frame_head: None, file_name: None, body: body.into() }
    }

    pub(crate) fn json(content: &impl Serialize) -> Result<Self, Failure> {
        let body = serde_json::to_vec(content).map_err(|error| Failure::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
        Ok(Self::new("application/json", body))
    }

    pub(crate) fn frame(frame: Frame, place: Place) -> Result<Self, Failure> {
        let head =
            serde_json::to_string(&frame.head).map_err(|error| Failure::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
        Ok(Self { frame_head: Some(head), ..Self::new("application/octet-stream", place.fill(frame.body)) })
    }
}

/// Answers a request.
pub(crate) async fn answer(house: &Arc<House>, method: &Method, path: &str, mut query: Query, body: Bytes) -> Result<Answer, Failure> {
    // The address with the token opens the page.
    query.take("token");
    if path.starts_with("/api/path") {
        let answer = paths::answer(house, method, path, body).await?;
        query.finish()?;
        return Ok(answer);
    }
    if let Some(rest) = path.strip_prefix("/api/edit/") {
        let answer = crate::edits::answer(house, method, rest, &mut query, body).await?;
        query.finish()?;
        return Ok(answer);
    }
    if !body.is_empty() {
        return Err(Failure::new(StatusCode::PAYLOAD_TOO_LARGE, "this path takes no body"));
    }
    let is_get = *method == Method::GET;
    let answer = match path {
        "/" if is_get => Ok(Answer::new("text/html; charset=utf-8", assets::index(&house.subject.facts.name))),
        "/api/scene" if is_get => scene(house),
        "/api/history" if is_get => {
            let from = query.number("from")?.unwrap_or(0);
            Answer::json(&house.shared.history(from))
        }
        "/api/frame" if is_get => pictures::frame(house, &mut query).await,
        "/api/frame.exr" if is_get => pictures::exr(house, &mut query).await,
        "/api/probe" if is_get => pictures::probe(house, &mut query).await,
        "/api/splats" if is_get => downloads::splats(house, &mut query).await,
        "/api/still.png" if is_get => stills::answer(house, &mut query).await,
        _ if path.starts_with("/api/environment") => environment::answer(house, method, path, &mut query).await,
        "/api/truth" if is_get => pictures::truth(house, &mut query).await,
        "/api/thumbnail" if is_get => thumbnail::answer(house, &mut query).await,
        _ => match (path.strip_prefix("/page/"), path.strip_prefix("/api/training/")) {
            (Some(name), _) if is_get => {
                let asset = assets::asset(name).ok_or_else(|| Failure::new(StatusCode::NOT_FOUND, "no such file"))?;
                Ok(Answer::new(asset.media_type, asset.content))
            }
            (_, Some(wish)) if *method == Method::POST => steer(house, wish),
            _ => Err(not_here(path, is_get)),
        },
    }?;
    query.finish()?;
    Ok(answer)
}

fn not_here(path: &str, is_get: bool) -> Failure {
    let is_known = path == "/" || path.starts_with("/api/") || path.starts_with("/page/");
    match is_known && !is_get {
        true => Failure::new(StatusCode::METHOD_NOT_ALLOWED, "this path answers GET; POST is for what changes something"),
        false => Failure::new(StatusCode::NOT_FOUND, "no such path"),
    }
}

fn scene(house: &House) -> Result<Answer, Failure> {
    let mut content = serde_json::to_value(&house.subject.facts).unwrap_or_default();
    let status = house.shared.status();
    if let Value::Object(fields) = &mut content {
        fields.insert("splats".into(), status.splats.into());
        fields.insert("version".into(), status.version.into());
        fields.insert("training".into(), serde_json::to_value(&status.training).unwrap_or_default());
        fields.insert("cameras".into(), serde_json::to_value(house.subject.cameras()).unwrap_or_default());
        let bytes = house.scene.as_ref().map(|scene| body_bytes(&scene.splats, Precision::Half));
        fields.insert("download_bytes".into(), bytes.into());
        fields.insert("luxel_version".into(), luxel::VERSION.into());
    }
    Answer::json(&schema::VIEW.versioned(content))
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
pub(crate) async fn render(house: &House, wanted: Wanted, viewer: Option<String>) -> Result<Option<Rendered>, Failure> {
    let answer = house.jobs.submit(wanted, viewer).map_err(refused)?;
    match answer.await {
        Ok(Reply::Done(rendered)) => Ok(Some(rendered)),
        Ok(Reply::Superseded) => Ok(None),
        Ok(Reply::Failed(message)) => Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message)),
        Err(_) => Err(refused(Refusal::Closed)),
    }
}

/// Does work on the thread that owns the engine.
pub(crate) async fn on_stage<T: Send + 'static>(
    house: &House,
    work: impl FnOnce(&mut dyn Stage) -> luxel::Result<T> + Send + 'static,
) -> Result<T, Failure> {
    let answer = house.jobs.run(work).map_err(refused)?;
    Ok(answer.await.map_err(|_| refused(Refusal::Closed))??)
}

/// Waits for a picture that nothing takes the place of.
pub(crate) async fn render_surely(house: &House, wanted: Wanted) -> Result<Rendered, Failure> {
    let rendered = render(house, wanted, None).await?;
    rendered.ok_or_else(|| Failure::new(StatusCode::SERVICE_UNAVAILABLE, "the picture was given up"))
}

/// Runs work of the processor beside the server's thread.
pub(crate) async fn beside<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Failure> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Failure::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}

/// Notes what the page asks of the training.
fn steer(house: &House, wish: &str) -> Result<Answer, Failure> {
    if house.shared.status().training.is_none() {
        return Err(Failure::new(StatusCode::NOT_FOUND, "nothing is trained here"));
    }
    let wishes = &house.shared.wishes;
    match wish {
        "pause" => wishes.pause.store(true, Ordering::SeqCst),
        "continue" => wishes.pause.store(false, Ordering::SeqCst),
        "save" => wishes.save.store(true, Ordering::SeqCst),
        "stop" => wishes.stop.store(true, Ordering::SeqCst),
        _ => return Err(Failure::new(StatusCode::NOT_FOUND, "expected pause, continue, save or stop")),
    }
    Answer::json(&house.shared.status())
}

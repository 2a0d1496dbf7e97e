//! Paths and what answers them. `GET` reads, `POST` changes something, and alone has a body.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use hyper::{Method, StatusCode};
use luxel::{Scene, schema};
use luxel_core::{Camera, ColorSpace};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::Semaphore;

use crate::downloads::{self, Downloads};
use crate::environment::LastEnvironment;
use crate::frame::{Frame, Planes};
use crate::frame_render::FrameRender;
use crate::jobs::{Jobs, Refusal, Rendered, Reply, Wanted};
use crate::query::Query;
use crate::server::MAX_BODIES;
use crate::splats::{Precision, body_bytes};
use crate::stage::{Stage, check_edits};
use crate::status::{Shared, Status};
use crate::subject::Subject;
use crate::variant::Variant;
use crate::{assets, environment, paths, stills, thumbnail};

/// Pixels of a picture for the page, at most.
const MAX_FRAME_PX: u64 = 1 << 25;

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
}

impl House {
    /// Returns a house without jobs.
    pub(crate) fn new(subject: Subject, color_space: ColorSpace, status: Status, scene: Option<Arc<Scene>>) -> Self {
        let (jobs, shared, bodies) = (Jobs::default(), Shared::new(status), Semaphore::new(MAX_BODIES));
        let (frames, environment) = (FrameRender::default(), LastEnvironment::default());
        Self { subject, color_space, jobs, shared, scene, downloads: Downloads::default(), bodies, frames, environment }
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

    pub(crate) fn frame(frame: Frame) -> Result<Self, Failure> {
        let head =
            serde_json::to_string(&frame.head).map_err(|error| Failure::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
        Ok(Self { frame_head: Some(head), ..Self::new("application/octet-stream", frame.body) })
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
        "/api/frame" if is_get => frame(house, &mut query).await,
        "/api/frame.exr" if is_get => exr(house, &mut query).await,
        "/api/probe" if is_get => probe(house, &mut query).await,
        "/api/splats" if is_get => downloads::splats(house, &mut query).await,
        "/api/still.png" if is_get => stills::answer(house, &mut query).await,
        _ if path.starts_with("/api/environment") => environment::answer(house, method, path, &mut query).await,
        "/api/truth" if is_get => truth(house, &mut query),
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

/// Takes camera, size and edits out of a query.
pub(crate) fn wanted(house: &House, query: &mut Query) -> Result<Wanted, Failure> {
    let size: [Option<u32>; 2] = [query.number("width")?, query.number("height")?];
    let edit = query.take("edit").unwrap_or_default();
    check_edits(&edit)?;
    let variant = Variant::take(query, house.subject.scenes())?;
    let camera = match (query.take("view"), query.take("camera")) {
        (Some(name), None) => {
            let camera = &house.subject.view(&name).map_err(|message| Failure::new(StatusCode::NOT_FOUND, message))?.camera;
            match size {
                [None, None] => house.subject.to_scene(camera, variant.scene),
                [width, height] => {
                    let size = [width.unwrap_or(camera.size_px[0]), height.unwrap_or(camera.size_px[1])];
                    house.subject.to_scene(&resized(camera, size), variant.scene)
                }
            }
        }
        (None, Some(text)) => house.subject.from_world(&camera_of(&text, size)?, variant.scene),
        _ => {
            return Err(String::from(
                "expected one of \"view\" (a name of /api/scene) and \"camera\" (JSON as a frame of transforms.json)",
            )
            .into());
        }
    };
    camera.validate().map_err(|error| format!("camera: {error}"))?;
    Ok(Wanted { camera, edit, layers: false, variant })
}

/// Returns a camera with the same field of view and another number of pixels.
fn resized(camera: &Camera, size_px: [u32; 2]) -> Camera {
    let factor =
        glam::DVec2::new(f64::from(size_px[0]) / f64::from(camera.size_px[0]), f64::from(size_px[1]) / f64::from(camera.size_px[1]));
    Camera { focal_px: camera.focal_px * factor, center_px: camera.center_px * factor, size_px, ..camera.clone() }
}

/// Reads a camera as a frame of `transforms.json` has it.
fn camera_of(text: &str, size: [Option<u32>; 2]) -> Result<Camera, Failure> {
    let mut frame: Value = serde_json::from_str(text).map_err(|error| format!("\"camera\" is not JSON: {error}"))?;
    let Value::Object(fields) = &mut frame else { return Err(String::from("\"camera\" is not a JSON object").into()) };
    for (name, side) in ["w", "h"].into_iter().zip(size) {
        if let Some(side) = side {
            fields.insert(name.into(), side.into());
        }
    }
    let cameras = luxel::decode_cameras("camera", json!({ "frames": [frame] }).to_string().as_bytes());
    let mut cameras = cameras.map_err(|error| format!("{error:#}"))?;
    Ok(cameras.remove(0).camera)
}

/// The planes that a request asks for.
#[derive(Clone, Copy, Debug)]
struct Channels {
    rgb: bool,
    alpha: bool,
    depth: bool,
}

/// Takes the names of channels out of a query.
fn channels(query: &mut Query) -> Result<Channels, Failure> {
    let text = query.take("channels").unwrap_or_else(|| "rgb".into());
    let mut channels = Channels { rgb: false, alpha: false, depth: false };
    for name in text.split(',') {
        match name {
            "rgb" => channels.rgb = true,
            "alpha" => channels.alpha = true,
            "depth" => channels.depth = true,
            other => return Err(format!("unknown channel \"{}\", expected rgb, depth, alpha", other.escape_default()).into()),
        }
    }
    Ok(channels)
}

/// Waits for a picture; `None` if a newer wish of the same viewer took its place.
async fn render(house: &House, wanted: Wanted, viewer: Option<String>) -> Result<Option<Rendered>, Failure> {
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

async fn frame(house: &House, query: &mut Query) -> Result<Answer, Failure> {
    let Channels { rgb, alpha, depth } = channels(query)?;
    let viewer = query.take("viewer").filter(|viewer| !viewer.is_empty());
    let wanted = Wanted { layers: alpha || depth, ..wanted(house, query)? };
    let [width, height] = wanted.camera.size_px;
    if u64::from(width) * u64::from(height) > MAX_FRAME_PX {
        return Err(format!("{width} x {height} pixels, expected at most {MAX_FRAME_PX} in all").into());
    }
    let Some(Rendered { picture, version, seconds }) = render(house, wanted, viewer).await? else {
        return Ok(Answer { status: StatusCode::NO_CONTENT, ..Answer::new("application/octet-stream", Bytes::new()) });
    };
    let frame = beside(move || {
        let size = [picture.radiance.width(), picture.radiance.height()];
        let planes = Planes {
            pixels: if rgb { picture.radiance.pixels() } else { &[] },
            alpha: if alpha { &picture.alpha } else { &[] },
            depth: if depth { &picture.depth } else { &[] },
        };
        planes.encode(size, version, seconds)
    });
    Answer::frame(frame.await?)
}

async fn exr(house: &House, query: &mut Query) -> Result<Answer, Failure> {
    let Channels { alpha, depth, .. } = channels(query)?;
    let wanted = Wanted { layers: alpha || depth, ..wanted(house, query)? };
    let Rendered { picture, .. } = render_surely(house, wanted).await?;
    if (alpha || depth) && picture.alpha.is_empty() {
        return Err(Failure::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            "this engine renders no depth and alpha; start the viewer with the CPU's",
        ));
    }
    let file = beside(move || picture.encode_exr(alpha, depth)).await?;
    let file = file.map_err(|error| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, format!("{error:#}")))?;
    Ok(Answer { file_name: Some("view.exr"), ..Answer::new("image/x-exr", file) })
}

async fn probe(house: &House, query: &mut Query) -> Result<Answer, Failure> {
    let mut place =
        |name: &str| query.number::<u32>(name).and_then(|at| at.ok_or_else(|| format!("\"{name}\" is missing, expected a column or row")));
    let [x, y] = [place("x")?, place("y")?];
    let wanted = Wanted { layers: true, ..wanted(house, query)? };
    let camera = house.subject.to_world(&wanted.camera, wanted.variant.scene);
    let weights = house.subject.luminance_weights(wanted.variant.scene);
    let [width, height] = camera.size_px;
    if x >= width || y >= height {
        return Err(format!("pixel {x}, {y} is outside of {width} x {height}").into());
    }
    let Rendered { picture, version, .. } = render_surely(house, wanted).await?;
    let Some(radiance) = picture.radiance.pixel(x as usize, y as usize) else { return Err(String::from("the pixel is missing").into()) };
    let luminance: f64 = radiance.iter().zip(weights).map(|(value, weight)| f64::from(*value) * weight).sum();
    let index = (y * width + x) as usize;
    let depth = picture.depth.get(index).copied().filter(|depth| depth.is_finite());
    let position = depth.map(|depth| world_of(&camera, [x, y], depth.into()).to_array());
    Answer::json(&schema::VIEW.versioned(json!({
        "radiance": radiance, "luminance": luminance, "depth": depth, "position": position,
        "alpha": picture.alpha.get(index), "x": x, "y": y, "version": version,
    })))
}

/// Returns the point in the world that a pixel shows at a depth along the viewing axis.
fn world_of(camera: &Camera, [x, y]: [u32; 2], depth: f64) -> glam::DVec3 {
    let pixel = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let on_plane = (pixel - camera.center_px) / camera.focal_px;
    camera.eye() + camera.camera_from_world.matrix3.transpose() * (glam::DVec3::new(on_plane.x, on_plane.y, 1.0) * depth)
}

fn truth(house: &House, query: &mut Query) -> Result<Answer, Failure> {
    let name = query.take("view").ok_or_else(|| String::from("\"view\" is missing, expected a name of /api/scene"))?;
    let view = house.subject.view(&name).map_err(|message| Failure::new(StatusCode::NOT_FOUND, message))?;
    let Some(image) = &view.truth else {
        return Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, "the images of this data set are captured LDR values, not radiance"));
    };
    let weights = view.mask.as_ref().map_or(&[][..], |mask| &mask.weights);
    let frame = Planes::of_image(image, weights).encode([image.width, image.height], 0, 0.0);
    Answer::frame(frame)
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

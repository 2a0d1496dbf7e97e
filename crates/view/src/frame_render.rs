//! The frames of a camera path, rendered into the folder of what is shown, one path at a time.
//!
//! In: a path, a name, edits, samples and a number format. Out: `paths/NAME/frame_00000.exr` and so
//! on, byte for byte what `luxel render --cameras paths/NAME/cameras.json` writes there, and that
//! file. Each frame is a job of its own, so that pages see pictures in between; it is encoded and
//! written beside the engine. What is there when a render is cancelled or fails stays, and
//! `luxel render` makes the rest of it.

use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use hyper::StatusCode;
use luxel::output::ExrType;
use luxel::{Camera, Error, PathCamera, Radiance, Result};
use luxel_app::output::{FrameForm, Recipe};
use serde::Deserialize;

use crate::answer::Failure;
use crate::folder::Folder;
use crate::frame_status::{RenderState, RenderStatus};
use crate::jobs::{Loaded, Stage};
use crate::path_file::{PathFile, PathJson};
use crate::server_context::{ServerContext, beside, on_stage};
use crate::stage::check_edits;

/// Time before a frame is asked for again when too many pictures wait.
const AGAIN: Duration = Duration::from_millis(100);

/// A render that the page asks for.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RenderJson {
    path: PathJson,
    /// Name of the folder of the frames.
    name: String,
    #[serde(default)]
    edit: String,
    /// Samples along a pixel's side; by default those of the scene.
    samples: Option<u8>,
    #[serde(default)]
    exr_type: ExrTypeJson,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ExrTypeJson {
    #[default]
    Auto,
    Half,
    Float,
}

/// Everything that the frames of a render share.
struct Frames {
    folder: Folder,
    edit: String,
    samples: Option<u8>,
    exr_type: ExrType,
    recipe: OnceLock<Recipe>,
}

/// Starts a render.
///
/// # Errors
/// One is in progress; nothing can be rendered or saved here; a path, name or edit that cannot be
/// used; a name that is taken.
pub(crate) async fn start(context: &Arc<ServerContext>, wish: RenderJson) -> Result<(), Failure> {
    let RenderJson { path, name, edit, samples, exr_type } = wish;
    check_edits(context.edit_session.as_deref(), &edit)?;
    let conflict = |message: &str| Failure::new(StatusCode::CONFLICT, message);
    if context.scene.is_none() {
        return Err(conflict("the scene is being trained: end the training, and open the run with luxel view"));
    }
    let folder = context.folder()?;
    if samples.is_some_and(|samples| !(1..=luxel_core::MAX_SAMPLES).contains(&samples)) {
        return Err(format!("\"samples\" is {}, expected 1 to {}", samples.unwrap_or(0), luxel_core::MAX_SAMPLES).into());
    }
    {
        let mut status = context.frames.lock();
        if status.state == RenderState::Running {
            return Err(conflict("a path is being rendered already: wait for it, or cancel it"));
        }
        *status = RenderStatus { state: RenderState::Running, name: name.clone(), ..RenderStatus::default() };
        context.frames.is_cancelled.store(false, Ordering::SeqCst);
    }
    let prepared = beside(move || prepare(&path, &name, &folder)).await.and_then(|prepared| Ok(prepared?));
    let (folder, cameras) = match prepared {
        Ok(prepared) => prepared,
        Err(failure) => {
            *context.frames.lock() = RenderStatus::default();
            return Err(failure);
        }
    };
    {
        let mut status = context.frames.lock();
        (status.total, status.folder) = (cameras.len(), folder.path().display().to_string());
    }
    let exr_type = match exr_type {
        ExrTypeJson::Auto => ExrType::Auto,
        ExrTypeJson::Half => ExrType::Half,
        ExrTypeJson::Float => ExrType::Float,
    };
    let frames = Arc::new(Frames { folder, edit, samples, exr_type, recipe: OnceLock::new() });
    let context = Arc::clone(context);
    tokio::spawn(async move {
        let end = render(&context, &frames, cameras).await;
        let mut status = context.frames.lock();
        (status.state, status.error) = match end {
            Ok(state) => (state, None),
            Err(failure) => (RenderState::Failed, Some(failure.message)),
        };
    });
    Ok(())
}

/// Makes the cameras and the folder, and writes the cameras into it.
fn prepare(path: &PathJson, name: &str, folder: &Folder) -> Result<(Folder, Vec<PathCamera>)> {
    crate::folder::check_name(name)?;
    let PathFile { cameras, text } = path.file()?;
    if let Some(first) = cameras.first() {
        luxel::memory::check_render(first.camera.size_px, 1)?;
    }
    let folder = folder.new_folder("paths", name)?;
    folder.new_file("", "cameras", "json", text.as_bytes())?;
    Ok((folder, cameras))
}

async fn render(context: &ServerContext, frames: &Arc<Frames>, cameras: Vec<PathCamera>) -> Result<RenderState, Failure> {
    let start = Instant::now();
    for PathCamera { name, camera, .. } in cameras {
        let (radiance, made_by) = loop {
            if context.frames.is_cancelled.load(Ordering::SeqCst) {
                return Ok(RenderState::Cancelled);
            }
            let (shared, camera) = (Arc::clone(frames), camera.clone());
            match on_stage(context, move |stage| shared.render(stage, &camera)).await {
                Err(failure) if failure.status == StatusCode::SERVICE_UNAVAILABLE && !context.jobs.is_closed() => {
                    tokio::time::sleep(AGAIN).await;
                }
                result => break result?,
            }
        };
        let shared = Arc::clone(frames);
        beside(move || {
            let file = radiance.encode_frame(shared.exr_type, &made_by)?;
            shared.folder.new_file("", &name, "exr", &file)
        })
        .await??;
        let mut status = context.frames.lock();
        (status.done, status.seconds) = (status.done + 1, start.elapsed().as_secs_f64());
    }
    Ok(RenderState::Finished)
}

impl Frames {
    /// Renders a frame of a camera in the world, and returns the digest of what made it, too.
    fn render(&self, stage: &mut dyn Stage, camera: &Camera) -> Result<(Radiance, String)> {
        let Loaded { scene, renderer } = stage.loaded(&self.edit)?;
        let usual = renderer.options().raster.samples;
        renderer.set_samples(self.samples.unwrap_or(usual))?;
        let local = scene.local_camera(camera);
        let form = FrameForm { color_space: scene.color_space, exr_type: self.exr_type, alpha: false, depth: false, normals: false };
        let recipe = self.recipe.get_or_init(|| Recipe::of_frames(scene, renderer.options(), form));
        let made_by = recipe.clone().with_camera(&local).digest();
        let radiance = renderer.render(&local);
        renderer.set_samples(usual)?;
        Ok((radiance.map_err(|error| Error::new(format!("{error:#}")))?, made_by))
    }
}

//! Paths and what answers them. `GET` reads, `POST` changes something, and alone has a body.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use hyper::{Method, StatusCode};
use luxel_app::schema;
use serde_json::Value;

use crate::answer::{Answer, Failure};
use crate::query::Query;
use crate::server_context::ServerContext;
use crate::splats::{Precision, body_bytes};
use crate::{assets, downloads, environment, lamps, paths, pictures, stills, thumbnail};

/// Answers a request.
pub(crate) async fn answer(
    context: &Arc<ServerContext>,
    method: &Method,
    path: &str,
    mut query: Query,
    body: Bytes,
) -> Result<Answer, Failure> {
    // The address with the token opens the page.
    query.take("token");
    if path.starts_with("/api/path") {
        let answer = paths::answer(context, method, path, body).await?;
        query.finish()?;
        return Ok(answer);
    }
    if let Some(rest) = path.strip_prefix("/api/edit/") {
        let answer = crate::edits::answer(context, method, rest, &mut query, body).await?;
        query.finish()?;
        return Ok(answer);
    }
    if !body.is_empty() {
        return Err(Failure::new(StatusCode::PAYLOAD_TOO_LARGE, "this path takes no body"));
    }
    let is_get = *method == Method::GET;
    let answer = match path {
        "/" if is_get => Ok(Answer::new("text/html; charset=utf-8", assets::index(&context.subject.facts.name))),
        "/api/scene" if is_get => scene(context),
        "/api/cameras" if is_get => Answer::json(&context.subject.cameras()),
        "/api/history" if is_get => {
            let from = query.number("from")?.unwrap_or(0);
            Answer::json(&context.shared.history(from))
        }
        "/api/frame" if is_get => pictures::frame(context, &mut query).await,
        "/api/frame.exr" if is_get => pictures::exr(context, &mut query).await,
        "/api/probe" if is_get => pictures::probe(context, &mut query).await,
        "/api/splats" if is_get => downloads::splats(context, &mut query).await,
        "/api/splats/changes" if is_get => downloads::changes(context, &mut query).await,
        "/api/still.png" if is_get => stills::answer(context, &mut query).await,
        _ if path.starts_with("/api/environment") => environment::answer(context, method, path, &mut query).await,
        "/api/lamps" => lamps::answer(context, method, &mut query).await,
        "/api/display" if is_get => display(context),
        "/api/mesh" if is_get => mesh(context),
        "/api/truth" if is_get => pictures::truth(context, &mut query).await,
        "/api/thumbnail" if is_get => thumbnail::answer(context, &mut query).await,
        _ => match (path.strip_prefix("/page/"), path.strip_prefix("/api/training/")) {
            (Some(name), _) if is_get => {
                let asset = assets::asset(name).ok_or_else(|| Failure::new(StatusCode::NOT_FOUND, "no such file"))?;
                Ok(Answer::new(asset.media_type, asset.content))
            }
            (_, Some(wish)) if *method == Method::POST => steer(context, wish),
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

fn scene(context: &ServerContext) -> Result<Answer, Failure> {
    let mut content = serde_json::to_value(&context.subject.facts).unwrap_or_default();
    let status = context.shared.status();
    if let Value::Object(fields) = &mut content {
        fields.insert("splats".into(), status.splats.into());
        fields.insert("version".into(), status.version.into());
        fields.insert("cameras_version".into(), status.cameras.into());
        fields.insert("training".into(), serde_json::to_value(&status.training).unwrap_or_default());
        fields.insert("cameras".into(), serde_json::to_value(context.subject.cameras()).unwrap_or_default());
        let lights = context.scene.as_ref().map_or(1, |scene| scene.splats.color_model.lights());
        // No page renders a mix.
        let bytes = context.scene.as_ref().filter(|_| lights == 1).map(|scene| body_bytes(&scene.splats, Precision::Half));
        fields.insert("lights".into(), lights.into());
        fields.insert("download_bytes".into(), bytes.into());
        fields.insert("luxel_version".into(), luxel::VERSION.into());
    }
    Answer::json(&schema::VIEW.versioned(content))
}

/// Answers with the table of a display.
fn display(context: &ServerContext) -> Result<Answer, Failure> {
    let missing = || Failure::new(StatusCode::NOT_FOUND, "this viewer has no display of OpenColorIO");
    let display = context.subject.display.as_ref().ok_or_else(missing)?;
    Ok(Answer::new("application/octet-stream", display.body.clone()))
}

/// Answers with the proxy mesh.
fn mesh(context: &ServerContext) -> Result<Answer, Failure> {
    let missing = || Failure::new(StatusCode::NOT_FOUND, "this viewer has no proxy mesh");
    Ok(Answer::new("model/gltf-binary", context.subject.mesh.clone().ok_or_else(missing)?))
}

/// Notes what the page asks of the training.
fn steer(context: &ServerContext, wish: &str) -> Result<Answer, Failure> {
    if context.shared.status().training.is_none() {
        return Err(Failure::new(StatusCode::NOT_FOUND, "nothing is trained here"));
    }
    let wishes = &context.shared.wishes;
    match wish {
        "pause" => wishes.pause.store(true, Ordering::SeqCst),
        "continue" => wishes.pause.store(false, Ordering::SeqCst),
        "save" => wishes.save.store(true, Ordering::SeqCst),
        "stop" => wishes.stop.store(true, Ordering::SeqCst),
        _ => return Err(Failure::new(StatusCode::NOT_FOUND, "expected pause, continue, save or stop")),
    }
    Answer::json(&context.shared.status())
}

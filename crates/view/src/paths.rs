//! Answers to requests of camera paths ([`crate::path_file`]) and their frames
//! ([`crate::frame_render`]).

use std::sync::Arc;

use bytes::Bytes;
use hyper::{Method, StatusCode};
use serde::Deserialize;

use crate::answer::{Answer, Failure};
use crate::frame_render::{self, RenderJson};
use crate::path_file::PathJson;
use crate::server_context::{ServerContext, beside};

/// Bytes of a path or a camera file.
const MAX_BYTES: usize = 16 << 20;

/// Reads a body of JSON.
fn parsed<T: for<'a> Deserialize<'a>>(body: &[u8]) -> Result<T, Failure> {
    serde_json::from_slice(body).map_err(|error| format!("the body: {error}").into())
}

/// Answers requests below `/api/path`.
pub(crate) async fn answer(context: &Arc<ServerContext>, method: &Method, path: &str, body: Bytes) -> Result<Answer, Failure> {
    if body.len() > MAX_BYTES {
        let message = format!("a body of {} bytes, expected at most {MAX_BYTES}", body.len());
        return Err(Failure::new(StatusCode::PAYLOAD_TOO_LARGE, message));
    }
    match (method, path) {
        (&Method::GET, "/api/path/render") => Answer::json(&context.frames.status()),
        (&Method::POST, "/api/path") => {
            let file = beside(move || Ok::<_, Failure>(parsed::<PathJson>(&body)?.file()?)).await??;
            Ok(Answer::new("application/json", file.text))
        }
        (&Method::POST, "/api/path/read") => Answer::json(&beside(move || PathJson::read(&body)).await??),
        (&Method::POST, "/api/path/render") => {
            let wish = parsed::<RenderJson>(&body)?;
            frame_render::start(context, wish).await?;
            Answer::json(&context.frames.status())
        }
        (&Method::POST, "/api/path/cancel") => {
            context.frames.cancel();
            Answer::json(&context.frames.status())
        }
        (_, "/api/path" | "/api/path/read" | "/api/path/render" | "/api/path/cancel") => {
            Err(Failure::new(StatusCode::METHOD_NOT_ALLOWED, "this path answers POST; /api/path/render GET, too"))
        }
        _ => Err(Failure::new(StatusCode::NOT_FOUND, "no such path")),
    }
}

//! Answers to requests: content of a media type, or a failure in words.

use bytes::Bytes;
use hyper::StatusCode;
use serde::Serialize;

use crate::folder::is_taken;
use crate::frame::FrameHead;

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
        let status = if is_taken(&error) { StatusCode::CONFLICT } else { StatusCode::UNPROCESSABLE_ENTITY };
        Self { status, message: format!("{error:#}") }
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

    /// Returns a picture for the page, whose planes are `body`.
    pub(crate) fn frame(head: &FrameHead, body: Bytes) -> Result<Self, Failure> {
        let head = serde_json::to_string(head).map_err(|error| Failure::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
        Ok(Self { frame_head: Some(head), ..Self::new("application/octet-stream", body) })
    }
}

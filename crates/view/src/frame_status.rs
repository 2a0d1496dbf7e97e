//! How far the frames of a camera path are ([`crate::frame_render`]).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Serialize;

/// The state of the render that was started last.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct RenderStatus {
    pub(crate) state: RenderState,
    pub(crate) name: String,
    /// The folder of the frames.
    pub(crate) folder: String,
    pub(crate) done: usize,
    pub(crate) total: usize,
    pub(crate) seconds: f64,
    /// The reason of a failure.
    pub(crate) error: Option<String>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
/// How far a render is.
pub(crate) enum RenderState {
    #[default]
    Idle,
    Running,
    Finished,
    Cancelled,
    Failed,
}

/// The render of a path, of which there is one at a time.
#[derive(Debug, Default)]
pub(crate) struct FrameRender {
    status: Mutex<RenderStatus>,
    pub(crate) is_cancelled: AtomicBool,
}

impl FrameRender {
    /// Returns the state.
    pub(crate) fn status(&self) -> RenderStatus {
        self.lock().clone()
    }

    /// Ends the render after the frame in progress.
    pub(crate) fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::SeqCst);
    }

    /// Locks the state.
    pub(crate) fn lock(&self) -> MutexGuard<'_, RenderStatus> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

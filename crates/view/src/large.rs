//! Large answers that wait to be taken: their bytes are counted, so that clients that never read
//! cannot fill the memory.
//!
//! In: the bytes of an answer; out: the same, whose room is free again when the last of them has
//! gone. Small answers are bounded by the number of connections.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use hyper::StatusCode;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::answer::Failure;

/// Bytes from which an answer is large.
const LARGE_BYTES: usize = 4 << 20;
/// Bytes of large answers at once.
const ROOM_BYTES: usize = 256 << 20;
/// Time that an answer waits for room.
const PATIENCE: Duration = Duration::from_secs(5);

/// Room for large answers.
#[derive(Debug)]
pub(crate) struct Room {
    free_bytes: Arc<Semaphore>,
    patience: Duration,
}

/// A part of the room; `None` for a small answer.
#[derive(Debug)]
pub(crate) struct Place(Option<OwnedSemaphorePermit>);

struct Placed<T> {
    content: T,
    _place: OwnedSemaphorePermit,
}

impl<T: AsRef<[u8]>> AsRef<[u8]> for Placed<T> {
    fn as_ref(&self) -> &[u8] {
        self.content.as_ref()
    }
}

impl Default for Room {
    fn default() -> Self {
        Self { free_bytes: Arc::new(Semaphore::new(ROOM_BYTES)), patience: PATIENCE }
    }
}

impl Room {
    /// Waits for room for an answer of about this many bytes.
    pub(crate) async fn place(&self, bytes: usize) -> Result<Place, Failure> {
        if bytes < LARGE_BYTES {
            return Ok(Place(None));
        }
        let bytes = u32::try_from(bytes.min(ROOM_BYTES)).unwrap_or(u32::MAX);
        match tokio::time::timeout(self.patience, Arc::clone(&self.free_bytes).acquire_many_owned(bytes)).await {
            Ok(Ok(place)) => Ok(Place(Some(place))),
            _ => Err(Failure::new(StatusCode::SERVICE_UNAVAILABLE, "too many large answers wait to be taken, try again")),
        }
    }
}

impl Place {
    /// Returns the answer's bytes, which keep their room until they have gone.
    pub(crate) fn fill(self, content: impl AsRef<[u8]> + Into<Bytes> + Send + 'static) -> Bytes {
        match self.0 {
            Some(place) => Bytes::from_owner(Placed { content, _place: place }),
            None => content.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_answers_wait_for_others_to_go() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let room = Room { patience: Duration::from_millis(5), ..Room::default() };
        let place = |bytes| runtime.block_on(room.place(bytes));
        let half = ROOM_BYTES / 2;
        let first = place(half).unwrap().fill(vec![1; 8]);
        let second = place(half).unwrap().fill(vec![2; 8]);
        assert_eq!(place(half).unwrap_err().status, StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(place(1000).unwrap().fill(vec![3; 8]).len(), 8);
        let part = first.slice(2..4);
        drop(first);
        assert!(place(half).is_err());
        drop(part);
        assert!(place(half).is_ok());
        assert_eq!(second[0], 2);
    }
}

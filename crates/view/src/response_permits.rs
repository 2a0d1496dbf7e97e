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

/// Permits for the bytes of large answers.
#[derive(Debug)]
pub(crate) struct ResponsePermits {
    free_bytes: Arc<Semaphore>,
    patience: Duration,
}

/// The permit of an answer; `None` for a small one.
#[derive(Debug)]
pub(crate) struct ResponsePermit(Option<OwnedSemaphorePermit>);

struct Permitted<T> {
    content: T,
    _permit: OwnedSemaphorePermit,
}

impl<T: AsRef<[u8]>> AsRef<[u8]> for Permitted<T> {
    fn as_ref(&self) -> &[u8] {
        self.content.as_ref()
    }
}

impl Default for ResponsePermits {
    fn default() -> Self {
        Self { free_bytes: Arc::new(Semaphore::new(ROOM_BYTES)), patience: PATIENCE }
    }
}

impl ResponsePermits {
    /// Waits for room for an answer of about this many bytes.
    pub(crate) async fn acquire(&self, bytes: usize) -> Result<ResponsePermit, Failure> {
        if bytes < LARGE_BYTES {
            return Ok(ResponsePermit(None));
        }
        let bytes = u32::try_from(bytes.min(ROOM_BYTES)).unwrap_or(u32::MAX);
        match tokio::time::timeout(self.patience, Arc::clone(&self.free_bytes).acquire_many_owned(bytes)).await {
            Ok(Ok(permit)) => Ok(ResponsePermit(Some(permit))),
            _ => Err(Failure::new(StatusCode::SERVICE_UNAVAILABLE, "too many large answers wait to be taken, try again")),
        }
    }
}

impl ResponsePermit {
    /// Returns the answer's bytes, which keep their room until they have gone.
    pub(crate) fn fill(self, content: impl AsRef<[u8]> + Into<Bytes> + Send + 'static) -> Bytes {
        match self.0 {
            Some(permit) => Bytes::from_owner(Permitted { content, _permit: permit }),
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
        let permits = ResponsePermits { patience: Duration::from_millis(5), ..ResponsePermits::default() };
        let acquire = |bytes| runtime.block_on(permits.acquire(bytes));
        let half = ROOM_BYTES / 2;
        let first = acquire(half).unwrap().fill(vec![1; 8]);
        let second = acquire(half).unwrap().fill(vec![2; 8]);
        assert_eq!(acquire(half).unwrap_err().status, StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(acquire(1000).unwrap().fill(vec![3; 8]).len(), 8);
        let part = first.slice(2..4);
        drop(first);
        assert!(acquire(half).is_err());
        drop(part);
        assert!(acquire(half).is_ok());
        assert_eq!(second[0], 2);
    }
}

//! Buffers that wait for their next use: handles outlive the call that made them, so their memory
//! comes back when they are dropped.

use std::sync::{Mutex, PoisonError};

/// Buffers that nobody uses.
#[derive(Default)]
pub(super) struct Spare<T>(Mutex<Vec<T>>);

/// Most buffers that wait: a program has few handles at a time.
const MOST: usize = 4;

impl<T: Default> Spare<T> {
    /// Returns a buffer, whose contents are arbitrary.
    pub(super) fn take(&self) -> T {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    /// Keeps a buffer for later.
    pub(super) fn give_back(&self, buffer: T) {
        let mut buffers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if buffers.len() < MOST {
            buffers.push(buffer);
        }
    }
}

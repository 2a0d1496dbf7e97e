//! Time of two passes that run together, chunk by chunk, on many threads.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Sums over all chunks, nanoseconds.
#[derive(Default)]
pub(crate) struct Shares([AtomicU64; 2]);

impl Shares {
    /// Adds a chunk's: from `start` to `middle` the first pass's, from `middle` until now the second's.
    pub(crate) fn add(&self, start: Instant, middle: Instant) {
        for (sum, time) in self.0.iter().zip([middle - start, middle.elapsed()]) {
            sum.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
        }
    }

    /// Of the first pass and of the second.
    pub(crate) fn totals(self) -> [Duration; 2] {
        self.0.map(|sum| Duration::from_nanos(sum.into_inner()))
    }
}

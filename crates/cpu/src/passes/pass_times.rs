//! Times of passes that run together, chunk by chunk, on many threads.
//!
//! In: the start of each pass for each chunk. Out: durations, summed over chunks and so over
//! threads.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Sums over all chunks of the times of N passes, nanoseconds.
pub(crate) struct PassTimes<const N: usize>([AtomicU64; N]);

impl<const N: usize> Default for PassTimes<N> {
    fn default() -> Self {
        Self([const { AtomicU64::new(0) }; N])
    }
}

impl<const N: usize> PassTimes<N> {
    /// Adds the times of a chunk: each pass lasts from its start to the start of the next, and the
    /// last pass until now.
    pub(crate) fn add(&self, starts: [Instant; N]) {
        let ends = starts[1..].iter().copied().chain([Instant::now()]);
        for (sum, (start, end)) in self.0.iter().zip(starts.iter().zip(ends)) {
            sum.fetch_add((end - *start).as_nanos() as u64, Ordering::Relaxed);
        }
    }

    /// Returns the total time of each pass, in the order of the passes.
    pub(crate) fn totals(self) -> [Duration; N] {
        self.0.map(|sum| Duration::from_nanos(sum.into_inner()))
    }
}

//! Time of passes that run together, chunk by chunk, on many threads.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Sums over all chunks, nanoseconds, of N passes.
pub(crate) struct Shares<const N: usize>([AtomicU64; N]);

impl<const N: usize> Default for Shares<N> {
    fn default() -> Self {
        Self([const { AtomicU64::new(0) }; N])
    }
}

impl<const N: usize> Shares<N> {
    /// Adds a chunk's: each pass's from its start to that of the next, the last one's until now.
    pub(crate) fn add(&self, starts: [Instant; N]) {
        let ends = starts[1..].iter().copied().chain([Instant::now()]);
        for (sum, (start, end)) in self.0.iter().zip(starts.iter().zip(ends)) {
            sum.fetch_add((end - *start).as_nanos() as u64, Ordering::Relaxed);
        }
    }

    /// Of the passes, in their order.
    pub(crate) fn totals(self) -> [Duration; N] {
        self.0.map(|sum| Duration::from_nanos(sum.into_inner()))
    }
}

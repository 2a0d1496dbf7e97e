//! Time spent training: it runs during steps, stops during evaluation, and carries over from
//! interrupted parts of the run.

use std::time::{Duration, Instant};

/// A stopwatch.
pub(super) struct Clock {
    before: Duration,
    since: Option<Instant>,
}

impl Clock {
    /// Starts a clock with the seconds spent before.
    pub(super) fn resumed(seconds_before: f64) -> Self {
        let before = Duration::try_from_secs_f64(seconds_before).unwrap_or_default();
        Self { before, since: Some(Instant::now()) }
    }

    /// Returns the seconds so far.
    pub(super) fn seconds(&self) -> f64 {
        (self.before + self.since.map_or(Duration::ZERO, |since| since.elapsed())).as_secs_f64()
    }

    /// Does `work` while the clock is stopped.
    pub(super) fn paused<T>(&mut self, work: impl FnOnce() -> T) -> T {
        self.before += self.since.take().map_or(Duration::ZERO, |since| since.elapsed());
        let result = work();
        self.since = Some(Instant::now());
        result
    }
}

//! Time spent training, on the clock and by processors: it runs during steps, stops during
//! evaluation, and carries over from interrupted parts of the run.

use std::time::{Duration, Instant};

use crate::process::processor_seconds;

/// A stopwatch.
pub(crate) struct Clock {
    before: Duration,
    since: Option<Instant>,
    /// Seconds of processors before `since`; `None` where the system does not tell, or an earlier
    /// part of the run did not note them.
    processor_before: Option<f64>,
    processor_since: Option<f64>,
}

impl Clock {
    /// Starts a clock with the seconds spent before, on the clock and by processors.
    pub(crate) fn resumed(seconds_before: f64, processor_before: Option<f64>) -> Self {
        let before = Duration::try_from_secs_f64(seconds_before).unwrap_or_default();
        Self { before, since: Some(Instant::now()), processor_before, processor_since: processor_seconds() }
    }

    /// Returns the seconds so far.
    pub(crate) fn seconds(&self) -> f64 {
        (self.before + self.since.map_or(Duration::ZERO, |since| since.elapsed())).as_secs_f64()
    }

    /// Returns the seconds of processors so far, of all threads together.
    pub(crate) fn processor_seconds(&self) -> Option<f64> {
        let now = self.processor_since.and_then(|since| Some(processor_seconds()? - since));
        let running = if self.since.is_some() { now? } else { 0.0 };
        Some(self.processor_before? + running)
    }

    /// Does `work` while the clock is stopped.
    pub(crate) fn paused<T>(&mut self, work: impl FnOnce() -> T) -> T {
        self.processor_before = self.processor_seconds();
        self.before += self.since.take().map_or(Duration::ZERO, |since| since.elapsed());
        let result = work();
        self.since = Some(Instant::now());
        self.processor_since = processor_seconds();
        result
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn processor_time_carries_over_and_stops_with_the_clock() {
        let mut clock = Clock::resumed(5.0, Some(20.0));
        let spin = || {
            let start = processor_seconds().unwrap();
            while processor_seconds().unwrap() < start + 0.02 {}
        };
        spin();
        let before = clock.processor_seconds().unwrap();
        assert!(before >= 20.02 && clock.seconds() >= 5.0, "{before}");
        let inside = clock.paused(|| {
            let start = processor_seconds().unwrap();
            spin();
            processor_seconds().unwrap() - start
        });
        // Threads of other tests spend time too, but not less than none. Sums are rounded.
        let [after, least] = [clock.processor_seconds().unwrap(), before - 1e-9];
        assert!(inside >= 0.02 - 1e-9 && after >= least, "{inside} s in the pause, {before} s before it, {after} s after it");
        // Of parts that did not note it, no sum is known.
        assert_eq!(Clock::resumed(5.0, None).processor_seconds(), None);
    }
}

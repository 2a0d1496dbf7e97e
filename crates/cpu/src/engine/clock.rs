//! Measures the time of each pass, summed over steps.

use std::time::{Duration, Instant};

use luxel_core::Pass;

/// The time spent in each pass.
pub(super) type Timings = [(Pass, Duration); Pass::ALL.len()];

/// A clock that adds the time since its last lap to a pass.
pub(super) struct Clock<'a> {
    timings: &'a mut Timings,
    last: Instant,
}

impl<'a> Clock<'a> {
    /// Starts the clock.
    pub(super) fn new(timings: &'a mut Timings) -> Self {
        Self { timings, last: Instant::now() }
    }

    /// Adds the time since the last lap to a pass.
    pub(super) fn lap(&mut self, pass: Pass) {
        self.lap_shared(&[(pass, Duration::from_nanos(1))]);
    }

    /// Divides the time since the last lap between passes that ran together, in proportion to their
    /// times summed over threads.
    pub(super) fn lap_shared(&mut self, shares: &[(Pass, Duration)]) {
        let now = Instant::now();
        let total: Duration = shares.iter().map(|(_, share)| *share).sum();
        for (pass, share) in shares {
            let part = share.as_secs_f64() / total.as_secs_f64().max(f64::MIN_POSITIVE);
            self.timings[*pass as usize].1 += (now - self.last).mul_f64(part);
        }
        self.last = now;
    }
}

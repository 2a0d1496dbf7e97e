//! Measures the time of each pass, summed over steps.

use std::time::{Duration, Instant};

use luxel_core::{Pass, PassTime};

/// The time spent in each pass.
pub(super) type Timings = [PassTime; Pass::ALL.len()];

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
        self.lap_shared(&[PassTime { pass, time: Duration::from_nanos(1) }]);
    }

    /// Divides the time since the last lap between passes that ran together, in proportion to their
    /// times summed over threads.
    pub(super) fn lap_shared(&mut self, shares: &[PassTime]) {
        let now = Instant::now();
        let total: Duration = shares.iter().map(|share| share.time).sum();
        for PassTime { pass, time } in shares {
            let part = time.as_secs_f64() / total.as_secs_f64().max(f64::MIN_POSITIVE);
            self.timings[*pass as usize].time += (now - self.last).mul_f64(part);
        }
        self.last = now;
    }
}

//! Training within a given time.
//!
//! In: the time, and how fast the steps go. Out: plans of the run ([`Trainer::plan`]): as many
//! steps as fit, at most those of the longest recipe, on images that are reduced if fewer than
//! [`LEAST_STEPS`] would fit. The first plan follows a few steps; later ones correct it until the
//! last states are averaged. Reading the data set counts, evaluations and the files after the last
//! step do not.
//!
//! Degenerate: a time that is over at the first plan leaves one more step. Runs in a given time are
//! not repeatable to the bit, for plans depend on the machine; the steps that were made are in
//! config.toml.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::{Duration, Instant};

use luxel_train::{Preset, ResolutionSchedule, Stage, TrainConfig, Trainer};
use serde::{Deserialize, Serialize};

/// Steps after which the first plan is made.
const FIRST_PLAN: u32 = 20;
/// Steps from one plan to the next.
const PLAN_EVERY: u32 = 100;
/// Steps below which images are reduced rather than steps left out, and the user is warned if the
/// smallest images do not help.
pub(super) const LEAST_STEPS: u32 = 400;
/// Smallest side of reduced images, pixels.
const LEAST_SIDE_PX: u32 = 128;
/// Factors by which images are reduced.
const FACTORS: [u32; 3] = [2, 4, 8];
/// Part by which steps become slower until densification ends, since there are more splats.
const GROWTH: f64 = 0.4;

/// A length of time: `90s`, `10min`, `1h30min`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct TimeLimit(Duration);

impl TimeLimit {
    /// Returns the limit in seconds.
    pub fn seconds(self) -> f64 {
        self.0.as_secs_f64()
    }
}

/// Units of a time limit, longest first, in seconds.
const UNITS: [(&str, u64); 3] = [("h", 3600), ("min", 60), ("s", 1)];

impl FromStr for TimeLimit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected a time such as 90s, 10min or 1h30min, got \"{text}\"");
        let (mut rest, mut seconds, mut longest) = (text.trim(), 0.0, f64::INFINITY);
        while !rest.is_empty() {
            let digits = rest.find(|c: char| !c.is_ascii_digit() && c != '.').ok_or_else(wrong)?;
            let number: f64 = rest[..digits].parse().map_err(|_| wrong())?;
            let (unit, length) = UNITS.into_iter().find(|(unit, _)| rest[digits..].starts_with(unit)).ok_or_else(wrong)?;
            if length as f64 >= longest {
                return Err(wrong());
            }
            longest = length as f64;
            seconds += number * longest;
            rest = rest[digits + unit.len()..].trim_start();
        }
        let limit = Duration::try_from_secs_f64(seconds).ok().filter(|limit| *limit >= Duration::from_secs(1));
        limit.map(|limit| Self(Duration::from_secs(limit.as_secs()))).ok_or_else(wrong)
    }
}

impl fmt::Display for TimeLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut left = self.0.as_secs();
        for (unit, length) in UNITS {
            if left >= length {
                write!(f, "{}{unit}", left / length)?;
                left %= length;
            }
        }
        Ok(())
    }
}

impl From<TimeLimit> for String {
    fn from(limit: TimeLimit) -> Self {
        limit.to_string()
    }
}

impl TryFrom<String> for TimeLimit {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// The time of a run, and what is known of its pace.
pub(super) struct TimeBudget {
    limit: TimeLimit,
    /// Time that this process took before its first step.
    start_s: f64,
    /// Steps and seconds at the last plan.
    at: (u32, f64),
    is_planned: bool,
}

impl TimeBudget {
    /// Returns the budget of a run of which a trainer has made `iteration` steps in `seconds`; this
    /// process began at `since`.
    pub(super) fn new(limit: TimeLimit, since: Instant, iteration: u32, seconds: f64) -> Self {
        Self { limit, start_s: since.elapsed().as_secs_f64(), at: (iteration, seconds), is_planned: iteration > 0 }
    }

    /// Returns whether there is a plan.
    pub(super) fn is_planned(&self) -> bool {
        self.is_planned
    }

    /// Returns the time that this process took before its first step, seconds.
    pub(super) fn start_s(&self) -> f64 {
        self.start_s
    }

    /// Makes a new plan if one is due, where `seconds` were spent on steps so far. Returns whether
    /// the plan differs.
    pub(super) fn plan(&mut self, trainer: &mut Trainer, seconds: f64) -> bool {
        let (step, (from, before)) = (trainer.iteration(), self.at);
        let made = step.saturating_sub(from);
        if made < if self.is_planned { PLAN_EVERY } else { FIRST_PLAN } {
            return false;
        }
        let pace = Pace { made, seconds: (seconds - before) / f64::from(made), left_s: self.limit.seconds() - self.start_s - seconds };
        let before = (trainer.config().iterations, trainer.config().resolution_schedule.clone());
        let (iterations, resolution) = if self.is_planned {
            (pace.steps_that_fit(trainer, &before.1), before.1.clone())
        } else {
            first_plan(&pace, trainer, &before.1)
        };
        (self.at, self.is_planned) = ((step, seconds), true);
        if (iterations, &resolution) == (before.0, &before.1) {
            return false;
        }
        trainer.plan(iterations, resolution);
        true
    }
}

/// How fast steps go, and the time that is left for them.
struct Pace {
    /// Steps that were measured.
    made: u32,
    /// Seconds of one of them.
    seconds: f64,
    left_s: f64,
}

impl Pace {
    /// Returns the number of steps in all that fit into the time on images of this resolution.
    fn steps_that_fit(&self, trainer: &Trainer, resolution: &ResolutionSchedule) -> u32 {
        let possible = trainer.possible_plans();
        let step = f64::from(trainer.iteration());
        let longest = TrainConfig::from_preset(Preset::Full).iterations.max(*possible.start());
        let fits = |iterations: u32| {
            let growing = 1.0 - (2.0 * step / f64::from(iterations)).min(1.0);
            trainer.steps_left_by(iterations, resolution, self.made) * self.seconds * (1.0 + GROWTH * growing) <= self.left_s
        };
        last_that(*possible.start()..=longest.min(*possible.end()), fits)
    }
}

/// Returns steps and resolution of the first plan: reduced images where the whole ones would leave
/// too few steps.
fn first_plan(pace: &Pace, trainer: &Trainer, resolution: &ResolutionSchedule) -> (u32, ResolutionSchedule) {
    let mut best = (pace.steps_that_fit(trainer, resolution), resolution.clone());
    for factor in FACTORS.into_iter().filter(|factor| trainer.smallest_side_px() / factor >= LEAST_SIDE_PX) {
        if best.0 >= LEAST_STEPS {
            break;
        }
        let reduced = ResolutionSchedule::Stages(vec![Stage { factor, after_step: 0 }]);
        best = (pace.steps_that_fit(trainer, &reduced), reduced);
    }
    best
}

/// Returns the last number of a range for which `is` holds, if it holds up to one of them; else the
/// first.
fn last_that(range: RangeInclusive<u32>, is: impl Fn(u32) -> bool) -> u32 {
    let (mut low, mut high) = range.into_inner();
    while low < high {
        let middle = low + (high - low).div_ceil(2);
        if is(middle) { low = middle } else { high = middle - 1 }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_and_written() {
        for (text, seconds, written) in
            [("90s", 90.0, "1min30s"), ("10min", 600.0, "10min"), ("1h 30min", 5400.0, "1h30min"), ("0.5h", 1800.0, "30min")]
        {
            let limit: TimeLimit = text.parse().unwrap();
            assert_eq!((limit.seconds(), limit.to_string().as_str()), (seconds, written));
            assert_eq!(limit.to_string().parse::<TimeLimit>().unwrap(), limit);
        }
        for bad in ["", "10", "min", "0s", "-1s", "5s1min", "1min1min", "1e9h", "10 m"] {
            assert!(bad.parse::<TimeLimit>().is_err(), "{bad}");
        }
    }

    #[test]
    fn the_last_number_is_found() {
        assert_eq!([last_that(3..=100, |n| n * n <= 50), last_that(3..=5, |_| false), last_that(3..=5, |_| true)], [7, 3, 5]);
    }
}

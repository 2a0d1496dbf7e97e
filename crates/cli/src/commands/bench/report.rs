//! The measurement as JSON for programs and as a table for people.

use luxel_app::{schema, text};
use luxel_core::Pass;
use luxel_core::engine::Evaluations;
use serde::{Serialize, Serializer};

use crate::args::values::OrderArg;

/// The result of a measurement; field names are those of the JSON.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) workload: String,
    pub(super) method: String,
    pub(super) splats: usize,
    pub(super) visible: u32,
    /// Pairs of a splat and a pixel, if the engine counts them.
    pub(super) evaluations: Option<Evaluations>,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) threads: usize,
    /// The GPU, if it is what was measured.
    pub(super) gpu: Option<String>,
    /// The processor's, if that was.
    pub(super) instruction_set: Option<String>,
    pub(super) cutoffs: String,
    pub(super) order: OrderArg,
    pub(super) mu: f32,
    pub(super) target: String,
    pub(super) warmup: u32,
    pub(super) steps: u32,
    pub(super) forward_ms: Spread,
    pub(super) step_ms: Spread,
    /// Mean over steps that were handed in without waiting for any but the last, as in training: a
    /// GPU works ahead of the host, and the CPU engine joins a step's update to the next one's
    /// projection.
    pub(super) step_in_a_row_ms: f64,
    /// Medians over the steps.
    #[serde(serialize_with = "by_name")]
    pub(super) passes_ms: Vec<PassMedian>,
    pub(super) peak_rss_bytes: Option<u64>,
    pub(super) first_loss: f32,
    pub(super) luxel_version: &'static str,
}

/// The spread of times in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    pub(super) median: f64,
    pub(super) min: f64,
    pub(super) q1: f64,
    pub(super) q3: f64,
}

impl Spread {
    /// Returns the spread of one or more times; quantiles between two of them are interpolated
    /// linearly.
    pub(super) fn from_times(times: &[f64]) -> Self {
        let mut sorted = times.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |part: f64| {
            let place = part * sorted.len().saturating_sub(1) as f64;
            let value = |i: usize| sorted.get(i).or(sorted.last()).copied().unwrap_or(0.0);
            let (low, high) = (value(place.floor() as usize), value(place.ceil() as usize));
            // To 100 nanoseconds: below is the clock.
            ((low + (high - low) * place.fract()) * 1e4).round() / 1e4
        };
        Self { median: at(0.5), min: at(0.0), q1: at(0.25), q3: at(0.75) }
    }
}

/// The median time of a pass.
#[derive(Clone, Copy, Debug)]
pub(super) struct PassMedian {
    pub(super) pass: Pass,
    pub(super) ms: f64,
}

fn by_name<S: Serializer>(passes: &[PassMedian], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(passes.iter().map(|time| (time.pass.name(), time.ms)))
}

impl Report {
    /// One line.
    pub(super) fn json(&self) -> anyhow::Result<String> {
        Ok(serde_json::to_string(&schema::BENCH.versioned(self))?)
    }

    fn machine(&self) -> String {
        match (&self.gpu, &self.instruction_set) {
            (Some(gpu), _) => gpu.clone(),
            (None, Some(set)) => format!("{}, {set}", text::plural(self.threads, "thread")),
            (None, None) => text::plural(self.threads, "thread"),
        }
    }

    /// Returns the facts, then the times, as a table.
    pub(super) fn table(&self) -> String {
        let order = match self.order {
            OrderArg::Spatial => "spatial (Z-order, as training keeps it)",
            OrderArg::File => "file",
        };
        let evaluations = self.evaluations.map_or("not counted".into(), |found| {
            let [touched, alive] = [found.touched, found.alive].map(|count| text::count(count as usize));
            format!("{touched} pixels of blocks that splats touch, {alive} alive")
        });
        let facts = [
            ("workload", self.workload.clone()),
            ("method", self.method.clone()),
            ("splats", format!("{}, {} visible", text::count(self.splats), text::count(self.visible as usize))),
            ("evaluations", evaluations),
            ("image", format!("{}x{}", self.width, self.height)),
            ("machine", self.machine()),
            ("cut-offs", self.cutoffs.clone()),
            ("order", order.into()),
            ("target", self.target.clone()),
            ("first loss", format!("{:.5} (mu {})", self.first_loss, text::number(self.mu.into()))),
            ("peak memory", self.peak_rss_bytes.map_or("unknown".into(), text::bytes)),
            ("measured", format!("{} after {} of warm-up", text::plural(self.steps as usize, "step"), text::count(self.warmup as usize))),
        ];
        let mut out = String::new();
        for (name, value) in facts {
            out += &format!("{name:<20} {value}\n");
        }
        out += &format!("\n{:<20} {:>9} {:>9} {:>9} {:>9}\n", "milliseconds", "median", "min", "q1", "q3");
        for (name, Spread { median, min, q1, q3 }) in [("forward", self.forward_ms), ("step", self.step_ms)] {
            out += &format!("{name:<20} {median:>9.2} {min:>9.2} {q1:>9.2} {q3:>9.2}\n");
        }
        out += &format!("{:<20} {:>9.2} (mean)\n", "step in a row", self.step_in_a_row_ms);
        for PassMedian { pass, ms } in &self.passes_ms {
            out += &format!("  {:<18} {ms:>9.2}\n", pass.name());
        }
        out.trim_end().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_lie_between_the_times() {
        let spread = Spread::from_times(&[4.0, 1.0, 3.0, 2.0, 5.0]);
        assert_eq!(spread, Spread { median: 3.0, min: 1.0, q1: 2.0, q3: 4.0 });
        assert_eq!(Spread::from_times(&[1.0, 2.0]), Spread { median: 1.5, min: 1.0, q1: 1.25, q3: 1.75 });
        assert_eq!(Spread::from_times(&[7.0]), Spread { median: 7.0, min: 7.0, q1: 7.0, q3: 7.0 });
    }
}

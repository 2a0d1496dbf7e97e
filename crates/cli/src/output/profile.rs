//! The time that each pass of training took, as a table for people and as an event for programs.

use std::time::Duration;

use luxel_app::text;
use luxel_core::PassTime;
use serde_json::json;

/// Returns milliseconds a step, and the share, of each pass over `steps` steps.
pub(crate) fn table(steps: u32, timings: &[PassTime]) -> String {
    let total: f64 = timings.iter().map(|timed| timed.time.as_secs_f64()).sum();
    let mut out = format!("pass               ms a step   share, over {}\n", text::plural(steps as usize, "step"));
    for PassTime { pass, time } in timings {
        let seconds = time.as_secs_f64();
        let share = if total > 0.0 { 100.0 * seconds / total } else { 0.0 };
        out += &format!("{:17}  {:9.3}  {share:5.1} %\n", pass.name(), 1e3 * seconds / f64::from(steps.max(1)));
    }
    out + &format!("{:17}  {:9.3}", "all", 1e3 * total / f64::from(steps.max(1)))
}

/// Returns the same as an event.
pub(crate) fn event(steps: u32, timings: &[PassTime]) -> serde_json::Value {
    let ms = |time: &Duration| 1e3 * time.as_secs_f64() / f64::from(steps.max(1));
    let passes: serde_json::Map<_, _> = timings.iter().map(|timed| (timed.pass.name().to_owned(), ms(&timed.time).into())).collect();
    json!({ "event": "profile", "steps": steps, "ms_a_step": passes })
}

//! Texts for people of what commands do: what training took, words for a shell, decades of
//! luminance.

use std::time::Duration;

pub use luxel_core::text::{alternatives, bytes, count, duration, number, one_line, origin_line, plural, printable};

/// Returns what training took: `trained in 39 s, 1 min 15 s of processor time`.
pub fn training_time(seconds: f64, processor_seconds: Option<f64>) -> String {
    let of = |seconds: f64| duration(Duration::try_from_secs_f64(seconds).unwrap_or_default());
    let processors = processor_seconds.map_or_else(String::new, |seconds| format!(", {} of processor time", of(seconds)));
    format!("trained in {}{processors}", of(seconds))
}

/// Returns a word as a shell reads it: quoted where it has to be.
pub fn shell_word(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) }
}

/// Returns the range of a decade of luminance (see [`luxel_metrics::DecadeError`]): `0.1 to
/// 1`.
pub fn decade(decade: i32) -> String {
    let edge = |power: i32| if (-3..=3).contains(&power) { format!("{}", 10f64.powi(power)) } else { format!("1e{power}") };
    match decade {
        ..=-5 => "below 1e-4".into(),
        4.. => "from 1e4".into(),
        decade => format!("{} to {}", edge(decade), edge(decade + 1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(shell_word("a/b-c.db"), "a/b-c.db");
        assert_eq!(shell_word("my photos"), "'my photos'");
        assert_eq!(shell_word("it's"), "'it'\\''s'");
    }

    #[test]
    fn decades_are_ranges_open_at_the_ends() {
        assert_eq!([-5, -4, -1, 0, 3, 4].map(decade), ["below 1e-4", "1e-4 to 0.001", "0.1 to 1", "1 to 10", "1000 to 1e4", "from 1e4"]);
    }
}

//! Numbers in text for people.

use std::time::Duration;

pub use luxel_core::text::{count, one_line, plural, printable};

/// Returns a size of memory: `512 B`, `3.4 MiB`.
pub fn bytes(n: u64) -> String {
    const UNITS: [&str; 4] = ["KiB", "MiB", "GiB", "TiB"];
    if n < 1024 {
        return format!("{n} B");
    }
    let mut value = n as f64 / 1024.0;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    format!("{value:.1} {}", UNITS[unit])
}

/// Returns a duration: `42 s`, `3 min 05 s`, `2 h 07 min`.
pub fn duration(d: Duration) -> String {
    let s = d.as_secs();
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{} h {:02} min", s / 3600, s % 3600 / 60),
    }
}

/// Returns a number with three to four significant digits, without an exponent where that is short.
pub fn number(v: f64) -> String {
    let a = v.abs();
    if v == 0.0 {
        "0".into()
    } else if !(1e-3..1e5).contains(&a) {
        format!("{v:.3e}")
    } else if a >= 100.0 {
        format!("{v:.1}")
    } else {
        // Four significant digits: 0.01234, 1.234, 12.34.
        let decimals = (3 - a.log10().floor() as i32).clamp(0, 6) as usize;
        format!("{v:.decimals$}")
    }
}

/// Returns alternatives as a list: `a`, `a or b`, `a, b or c`.
pub fn alternatives(names: impl IntoIterator<Item = String>) -> String {
    let mut names: Vec<String> = names.into_iter().collect();
    match names.pop() {
        None => String::new(),
        Some(last) if names.is_empty() => last,
        Some(last) => format!("{} or {last}", names.join(", ")),
    }
}

/// Returns a line about local coordinates whose origin is not that of the world; `None` for others.
pub fn origin_line(world_from_local: &luxel_core::Similarity) -> Option<String> {
    let origin = world_from_local.translation();
    let line = || format!("far from the origin of its coordinates: held relative to {}, {}, {}", origin.x, origin.y, origin.z);
    (origin.length() > 0.0).then(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_durations_have_the_unit_that_keeps_them_short() {
        assert_eq!([512, 1536, 5 << 20, 3 << 30].map(bytes), ["512 B", "1.5 KiB", "5.0 MiB", "3.0 GiB"]);
        let seconds = |s| duration(Duration::from_secs(s));
        assert_eq!([seconds(42), seconds(185), seconds(7620)], ["42 s", "3 min 05 s", "2 h 07 min"]);
    }

    #[test]
    fn alternatives_are_joined_as_people_do() {
        let list = |names: &[&str]| alternatives(names.iter().map(|name| (*name).to_owned()));
        assert_eq!([list(&[]), list(&["a"]), list(&["a", "b"]), list(&["a", "b", "c"])], ["", "a", "a or b", "a, b or c"]);
    }

    #[test]
    fn numbers_keep_four_digits() {
        assert_eq!(
            [0.0, 0.012345, 1.23456, 12.3456, 332.04, 2.5e-5, 1e7].map(number),
            ["0", "0.01235", "1.235", "12.35", "332.0", "2.500e-5", "1.000e7"]
        );
    }
}

//! Numbers and names in messages, formatted for people.

use std::borrow::Cow;
use std::time::Duration;

/// Returns a number with separators of thousands.
///
/// ```
/// assert_eq!(luxel_core::text::count(1_234_567), "1,234,567");
/// ```
pub fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// Returns a number and its noun, in the plural unless the number is 1.
///
/// ```
/// use luxel_core::text::plural;
///
/// assert_eq!((plural(1, "image"), plural(2, "image")), ("1 image".into(), "2 images".into()));
/// ```
pub fn plural(n: usize, noun: &str) -> String {
    format!("{} {noun}{}", count(n), if n == 1 { "" } else { "s" })
}

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
pub fn origin_line(world_from_local: &crate::Similarity) -> Option<String> {
    let origin = world_from_local.translation();
    let line = || format!("far from the origin of its coordinates: held relative to {}, {}, {}", origin.x, origin.y, origin.z);
    (origin.length() > 0.0).then(line)
}

/// Returns a text in which nothing acts on a terminal: control characters, other than line feeds
/// and tabs, and those that change the direction of writing are written as escapes. File names and
/// texts in files may hold any.
///
/// ```
/// assert_eq!(luxel_core::text::printable("a\u{1b}]0;b\u{7}.exr\n"), "a\\u{1b}]0;b\\u{7}.exr\n");
/// ```
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, |c| acts_on_a_terminal(c) && c != '\n' && c != '\t')
}

/// Returns a text on one line in which nothing acts on a terminal, as [`printable`]; line feeds and
/// tabs are written as escapes, too. For names in tables.
///
/// ```
/// assert_eq!(luxel_core::text::one_line("a\nb\u{202e}.exr"), "a\\nb\\u{202e}.exr");
/// ```
pub fn one_line(text: &str) -> Cow<'_, str> {
    escaped(text, acts_on_a_terminal)
}

/// Returns whether a character is a control character (C0, C1, delete), a separator of lines, or
/// one that changes the direction of writing.
fn acts_on_a_terminal(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_escaped(c) { out.extend(c.escape_default()) } else { out.push(c) }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_separators_of_thousands() {
        assert_eq!([0, 999, 1000, 1234567].map(count), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!((plural(1, "view"), plural(17, "view")), ("1 view".into(), "17 views".into()));
    }

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

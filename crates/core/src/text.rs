//! Numbers and names in messages, formatted for people.

use std::borrow::Cow;

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
}

//! Numbers in messages, formatted for people.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_separators_of_thousands() {
        assert_eq!([0, 999, 1000, 1234567].map(count), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!((plural(1, "view"), plural(17, "view")), ("1 view".into(), "17 views".into()));
    }
}

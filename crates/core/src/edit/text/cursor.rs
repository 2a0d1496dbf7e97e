//! Words, numbers, names and symbols in a text, and errors with their column.
//!
//! In: a text. Out: its parts, one after another; the space after a part is consumed with it.
//! Degenerate: where a part is missing, the position stays and the error names what was found.

use super::EditTextError;
use crate::edit::EditError;

/// A position in a text.
pub(in crate::edit) struct Cursor<'t> {
    text: &'t str,
    /// Byte offset.
    pub(in crate::edit) at: usize,
}

impl<'t> Cursor<'t> {
    /// Starts at the beginning of `text`.
    pub(in crate::edit) fn new(text: &'t str) -> Self {
        Self { text, at: 0 }
    }

    /// Returns the text that is left.
    pub(in crate::edit) fn rest(&self) -> &'t str {
        self.text.get(self.at..).unwrap_or_default()
    }

    /// Returns the column of the position.
    fn column(&self) -> usize {
        self.column_of(self.at)
    }

    /// Returns the column of a byte.
    pub(in crate::edit) fn column_of(&self, at: usize) -> usize {
        self.text.get(..at).unwrap_or_default().chars().count() + 1
    }

    /// Returns the error of an invalid value that begins at byte `at`.
    pub(in crate::edit) fn refused(&self, at: usize, reason: &EditError) -> EditTextError {
        EditTextError { column: self.column_of(at), message: reason.to_string() }
    }

    /// Skips white space.
    pub(in crate::edit) fn space(&mut self) {
        self.at = self.text.len() - self.rest().trim_start().len();
    }

    /// Consumes `symbol` and the space after it; returns whether it was there.
    pub(in crate::edit) fn eat(&mut self, symbol: &str) -> bool {
        let found = self.rest().starts_with(symbol);
        if found {
            self.at += symbol.len();
            self.space();
        }
        found
    }

    /// Consumes `symbol` and the space after it, which must be there.
    pub(in crate::edit) fn need(&mut self, symbol: &str) -> Result<(), EditTextError> {
        if self.eat(symbol) { Ok(()) } else { Err(self.expected(&format!("\"{symbol}\""))) }
    }

    /// Checks that no text is left.
    pub(in crate::edit) fn end(&self) -> Result<(), EditTextError> {
        if self.rest().is_empty() { Ok(()) } else { Err(self.expected("the end")) }
    }

    /// Returns an error at the position.
    pub(in crate::edit) fn error(&self, message: impl Into<String>) -> EditTextError {
        EditTextError { column: self.column(), message: message.into() }
    }

    /// Returns an error that names what was expected at the position, and what was found.
    pub(in crate::edit) fn expected(&self, what: &str) -> EditTextError {
        /// Number of characters of the found text in a message.
        const MAX_FOUND: usize = 16;
        let found: String = self.rest().chars().take(MAX_FOUND).collect();
        self.error(if found.is_empty() { format!("expected {what}, found the end") } else { format!("expected {what}, found {found:?}") })
    }

    /// Returns the word at the position.
    pub(in crate::edit) fn peek_word(&self) -> Option<&'t str> {
        let rest = self.rest();
        let starts = rest.starts_with(|c: char| c.is_ascii_alphabetic());
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '-' || c == '_')).unwrap_or(rest.len());
        rest.get(..end).filter(|_| starts)
    }

    /// Consumes the word at the position, and the space after it.
    pub(in crate::edit) fn word(&mut self) -> Option<&'t str> {
        let word = self.peek_word()?;
        self.at += word.len();
        self.space();
        Some(word)
    }

    /// Consumes the word `wanted`; returns whether it was there.
    pub(in crate::edit) fn eat_word(&mut self, wanted: &str) -> bool {
        self.peek_word() == Some(wanted) && self.word().is_some()
    }

    /// Consumes a finite number; `what` names it in the error.
    pub(in crate::edit) fn number(&mut self, what: &str) -> Result<f32, EditTextError> {
        self.parsed(what, |value: &f32| value.is_finite())
    }

    /// Consumes a number that `is_usable`.
    fn parsed<T: std::str::FromStr>(&mut self, what: &str, is_usable: impl Fn(&T) -> bool) -> Result<T, EditTextError> {
        let bytes = self.rest().as_bytes();
        let digits = |mut at: usize| {
            while bytes.get(at).is_some_and(u8::is_ascii_digit) {
                at += 1;
            }
            at
        };
        let mut end = digits(usize::from(matches!(bytes.first(), Some(b'+' | b'-'))));
        // The first point of ".." is not a decimal point.
        if bytes.get(end) == Some(&b'.') && bytes.get(end + 1) != Some(&b'.') {
            end = digits(end + 1);
        }
        if matches!(bytes.get(end), Some(b'e' | b'E')) {
            let sign = end + 1 + usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
            if digits(sign) > sign {
                end = digits(sign);
            }
        }
        let value = self.rest().get(..end).and_then(|number| number.parse().ok()).filter(is_usable);
        let value = value.ok_or_else(|| self.expected(what))?;
        self.at += end;
        self.space();
        Ok(value)
    }

    /// Reads `count` coordinates or lengths separated by commas; none is beyond the range of f32.
    pub(in crate::edit) fn numbers<const COUNT: usize>(&mut self, names: [&str; COUNT]) -> Result<[f64; COUNT], EditTextError> {
        let mut values = [0.0; COUNT];
        for (i, (value, name)) in values.iter_mut().zip(names).enumerate() {
            if i > 0 {
                self.need(",")?;
            }
            *value = self.parsed(&format!("a number ({name})"), |value: &f64| (*value as f32).is_finite())?;
        }
        Ok(values)
    }

    /// Reads a quoted text, or a bare one up to `stop`.
    pub(in crate::edit) fn name(&mut self, stop: char, what: &str) -> Result<String, EditTextError> {
        let rest = self.rest();
        let quote = rest.chars().next().filter(|c| ['"', '\''].contains(c));
        let (inner, skip) = match quote {
            Some(quote) => (rest.get(1..).and_then(|inner| inner.split_once(quote)).map(|(name, _)| name), 2),
            None => (rest.split_once(stop).map(|(name, _)| name.trim_end()), 0),
        };
        // The name must be quotable again.
        let usable = |name: &&str| {
            let is_quotable = !(name.contains('"') && name.contains('\''));
            is_quotable && !name.is_empty() && !name.contains(char::is_control)
        };
        let usable = inner.filter(usable);
        let name = usable.ok_or_else(|| self.expected(what))?;
        self.at += name.len() + skip;
        self.space();
        Ok(name.to_owned())
    }
}

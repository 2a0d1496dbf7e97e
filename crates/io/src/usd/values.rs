//! Values of properties in OpenUSD text: lists of names, numbers and tuples, samples over time.

use std::io::BufRead;

use super::cameras::{Sample, Timed, sorted};
use super::lexer::{Lexer, Token};
use crate::IoError;

impl<R: BufRead> Lexer<'_, R> {
    /// Reads a list of names.
    pub(super) fn texts(&mut self, name: &str) -> Result<Vec<String>, IoError> {
        let opening = self.next_on()?;
        if opening != Token::Mark(b'[') {
            return Err(self.invalid(format_args!("{name:?} begins with {opening:?}, expected a list")));
        }
        let mut texts = Vec::new();
        loop {
            match self.next_on()? {
                Token::Text(text) => texts.push(text),
                Token::Mark(b',') => {}
                Token::Mark(b']') => return Ok(texts),
                other => return Err(self.invalid(format_args!("{name:?} has {other:?}, expected names in quotes"))),
            }
        }
    }

    /// Reads a value, or samples of it.
    pub(super) fn timed(&mut self, name: &str, is_timed: bool, out: &mut Timed) -> Result<(), IoError> {
        if !is_timed {
            out.default = self.values(name)?;
            return Ok(());
        }
        let opening = self.next_on()?;
        if opening != Token::Mark(b'{') {
            return Err(self.invalid(format_args!("samples of {name:?} begin with {opening:?}, expected {{")));
        }
        out.samples.clear();
        loop {
            let word = match self.next_on()? {
                Token::Mark(b'}') => break,
                Token::Mark(b',') => continue,
                Token::Word(word) => word,
                other => return Err(self.invalid(format_args!("samples of {name:?} have {other:?}, expected a time"))),
            };
            let time = word.trim_end_matches(':').parse().ok().filter(|time: &f64| time.is_finite());
            let time = time.ok_or_else(|| self.invalid(format_args!("a sample of {name:?} is at {word:?}, expected a time")))?;
            if !word.ends_with(':') && self.next_on()? != Token::Word(":".to_owned()) {
                return Err(self.invalid(format_args!("a sample of {name:?} has no colon behind its time")));
            }
            if let Some(values) = self.values(name)? {
                out.samples.push(Sample { time, values });
            }
        }
        out.samples = sorted(std::mem::take(&mut out.samples));
        Ok(())
    }

    /// Reads a number, or the numbers of a tuple in a row; `None` for `None`.
    fn values(&mut self, name: &str) -> Result<Option<Vec<f64>>, IoError> {
        /// Numbers of a matrix of 4 x 4.
        const MOST: usize = 16;
        let mut values = Vec::new();
        let mut depth = 0usize;
        loop {
            match self.next_on()? {
                Token::Mark(b'(') if depth < 2 => depth += 1,
                Token::Mark(b')') if depth > 0 => depth -= 1,
                Token::Mark(b',') if depth > 0 => {}
                Token::Word(word) if word == "None" && depth == 0 => return Ok(None),
                Token::Word(word) if values.len() < MOST => {
                    let value = word.parse().ok().filter(|v: &f64| v.is_finite());
                    values.push(value.ok_or_else(|| self.invalid(format_args!("{name:?} has {word:?}, expected a number")))?);
                }
                other => return Err(self.invalid(format_args!("{name:?} has {other:?}, expected a number or a tuple"))),
            }
            if depth == 0 {
                return Ok(Some(values));
            }
        }
    }
}

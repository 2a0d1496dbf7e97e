//! The words of OpenUSD text, read as a stream: arrays of numbers are never in memory as text.

use std::io::BufRead;
use std::path::Path;

use crate::IoError;

/// Longest name, string or number that is believed to be one, bytes.
const MAX_TOKEN: usize = 1 << 20;
/// Deepest nesting of brackets.
const MAX_DEPTH: usize = 256;

/// One word.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Token {
    /// Names, numbers, keywords: the text between spaces and punctuation.
    Word(String),
    /// Without its quotes, escapes undone.
    Text(String),
    /// An asset or a path.
    Reference,
    /// One of `()[]{}=,;`.
    Mark(u8),
    /// End of a line.
    NewLine,
    /// End of the file.
    End,
}

/// A text under way of being read.
pub(super) struct Lexer<'a, R> {
    reader: R,
    path: &'a Path,
    line: u64,
}

impl<'a, R: BufRead> Lexer<'a, R> {
    pub(super) fn new(reader: R, path: &'a Path) -> Self {
        Self { reader, path, line: 1 }
    }

    /// Returns the error that the content is wrong here.
    pub(super) fn invalid(&self, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.path, format_args!("line {}: {message}", self.line))
    }

    pub(super) fn unsupported(&self, message: impl std::fmt::Display) -> IoError {
        IoError::unsupported(self.path, format_args!("line {}: {message}", self.line))
    }

    fn peek(&mut self) -> Result<Option<u8>, IoError> {
        let buffer = self.reader.fill_buf().map_err(|e| IoError::system(self.path, "read", &e))?;
        Ok(buffer.first().copied())
    }

    fn bump(&mut self, byte: u8) {
        self.line += u64::from(byte == b'\n');
        self.reader.consume(1);
    }

    /// Reads the next word; spaces and comments are skipped.
    pub(super) fn next(&mut self) -> Result<Token, IoError> {
        loop {
            let Some(byte) = self.peek()? else { return Ok(Token::End) };
            match byte {
                b'\n' => {
                    self.bump(byte);
                    return Ok(Token::NewLine);
                }
                b' ' | b'\t' | b'\r' => self.bump(byte),
                b'#' => self.skip_line()?,
                b'(' | b')' | b'[' | b']' | b'{' | b'}' | b'=' | b',' | b';' => {
                    self.bump(byte);
                    return Ok(Token::Mark(byte));
                }
                b'"' | b'\'' => return self.text(byte),
                b'@' => return self.asset(),
                b'<' => return self.until(b'>').map(|()| Token::Reference),
                _ => return self.word(),
            }
        }
    }

    fn skip_line(&mut self) -> Result<(), IoError> {
        while let Some(byte) = self.peek()?.filter(|b| *b != b'\n') {
            self.bump(byte);
        }
        Ok(())
    }

    /// Skips everything up to and including `end`.
    fn until(&mut self, end: u8) -> Result<(), IoError> {
        while let Some(byte) = self.peek()? {
            self.bump(byte);
            if byte == end {
                return Ok(());
            }
        }
        Err(self.invalid(format_args!("file ends, expected {:?}; the file is truncated", char::from(end))))
    }

    /// Reads `@path@` or `@@@path@@@`.
    fn asset(&mut self) -> Result<Token, IoError> {
        let ticks = self.repeated(b'@', 3)?;
        let mut seen = 0;
        // An empty @@ is a whole asset.
        while ticks != 2 && seen < ticks {
            let Some(byte) = self.peek()? else { return Err(self.invalid("file ends within an asset path; the file is truncated")) };
            self.bump(byte);
            seen = if byte == b'@' { seen + 1 } else { 0 };
        }
        Ok(Token::Reference)
    }

    /// Skips up to `most` of `byte`, and counts them.
    fn repeated(&mut self, byte: u8, most: usize) -> Result<usize, IoError> {
        let mut count = 0;
        while count < most && self.peek()? == Some(byte) {
            self.bump(byte);
            count += 1;
        }
        Ok(count)
    }

    /// Reads a string in one or three quotes.
    fn text(&mut self, quote: u8) -> Result<Token, IoError> {
        let quotes = self.repeated(quote, 3)?;
        if quotes == 2 {
            return Ok(Token::Text(String::new()));
        }
        let mut bytes = Vec::new();
        loop {
            let Some(byte) = self.peek()? else { return Err(self.invalid("file ends within a text; the file is truncated")) };
            if byte == quote {
                let seen = self.repeated(quote, quotes)?;
                if seen == quotes {
                    return Ok(Token::Text(String::from_utf8_lossy(&bytes).into_owned()));
                }
                bytes.extend(std::iter::repeat_n(quote, seen));
                continue;
            }
            self.bump(byte);
            match byte {
                b'\\' => {
                    if let Some(escaped) = self.peek()? {
                        self.bump(escaped);
                        bytes.push(if escaped == b'n' { b'\n' } else { escaped });
                    }
                }
                _ => bytes.push(byte),
            }
            if bytes.len() > MAX_TOKEN {
                return Err(self.invalid("text longer than 1 MiB, expected its end"));
            }
        }
    }

    fn word(&mut self) -> Result<Token, IoError> {
        let mut bytes = Vec::new();
        while let Some(byte) = self.peek()?.filter(|b| !is_break(*b)) {
            self.bump(byte);
            bytes.push(byte);
            if bytes.len() > MAX_TOKEN {
                return Err(self.invalid("word longer than 1 MiB: not OpenUSD text"));
            }
        }
        Ok(Token::Word(String::from_utf8_lossy(&bytes).into_owned()))
    }

    /// Reads the next word that is not an end of a line.
    pub(super) fn next_on(&mut self) -> Result<Token, IoError> {
        loop {
            match self.next()? {
                Token::NewLine => {}
                token => return Ok(token),
            }
        }
    }

    /// Skips a bracketed part whose opening mark has been read.
    pub(super) fn skip_brackets(&mut self) -> Result<(), IoError> {
        let mut depth = 1usize;
        while depth > 0 {
            match self.next_on()? {
                Token::Mark(b'(' | b'[' | b'{') => depth += 1,
                Token::Mark(b')' | b']' | b'}') => depth -= 1,
                Token::End => return Err(self.invalid("file ends within brackets; the file is truncated")),
                _ => {}
            }
            if depth > MAX_DEPTH {
                return Err(self.invalid(format_args!("more than {MAX_DEPTH} brackets within one another")));
            }
        }
        Ok(())
    }

    /// Skips a value.
    pub(super) fn skip_value(&mut self) -> Result<(), IoError> {
        match self.next_on()? {
            Token::Mark(b'(' | b'[' | b'{') => self.skip_brackets(),
            Token::Reference if self.peek()? == Some(b'<') => self.until(b'>'),
            Token::Word(_) | Token::Text(_) | Token::Reference => Ok(()),
            other => Err(self.invalid(format_args!("found {other:?}, expected a value"))),
        }
    }

    /// Reads all numbers of an array, tuples in a row; `None` for `None`. A number may be NaN or
    /// infinite.
    pub(super) fn numbers(&mut self, name: &str) -> Result<Vec<f32>, IoError> {
        match self.next_on()? {
            Token::Mark(b'[') => {}
            Token::Word(word) if word == "None" => return Ok(Vec::new()),
            other => return Err(self.invalid(format_args!("{name:?} is {other:?}, expected an array of numbers"))),
        }
        let mut values = Vec::new();
        let mut digits = [0u8; 64];
        loop {
            let Some(byte) = self.peek()? else {
                return Err(self.invalid(format_args!("file ends within {name:?}; the file is truncated")));
            };
            match byte {
                b']' => {
                    self.bump(byte);
                    return Ok(values);
                }
                b' ' | b'\t' | b'\r' | b'\n' | b',' | b'(' | b')' => self.bump(byte),
                _ => {
                    let mut length = 0;
                    while let Some(byte) = self.peek()?.filter(|b| !is_break(*b)) {
                        self.bump(byte);
                        if let Some(digit) = digits.get_mut(length) {
                            *digit = byte;
                        }
                        length += 1;
                    }
                    let word = digits.get(..length).and_then(|d| std::str::from_utf8(d).ok()).filter(|_| length > 0);
                    let value = word.and_then(|w| w.parse::<f32>().ok()).ok_or_else(|| {
                        let found = String::from_utf8_lossy(&digits[..length.min(digits.len())]).into_owned();
                        self.invalid(format_args!("{name:?}: value {} is {found:?}, expected a number", values.len()))
                    })?;
                    values.push(value);
                }
            }
        }
    }
}

fn is_break(byte: u8) -> bool {
    matches!(
        byte,
        b' ' | b'\t' | b'\r' | b'\n' | b'#' | b'(' | b')' | b'[' | b']' | b'{' | b'}' | b'=' | b',' | b';' | b'"' | b'\'' | b'@' | b'<'
    )
}

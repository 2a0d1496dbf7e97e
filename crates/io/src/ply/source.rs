//! A file's bytes with their position, so that errors can name the place, and with their length, so
//! that claims can be checked against it.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use crate::IoError;
use crate::byte_order_mark::MARK;
use crate::read_file::open_regular;

/// Longest line of text that is believed to be one, bytes.
pub(super) const MAX_LINE: u64 = 1 << 20;

/// Bytes of the file `path`, read from the front.
pub(super) struct PlySource<'a, R> {
    reader: R,
    /// For errors.
    pub(super) path: &'a Path,
    /// Bytes read so far.
    pub(super) position: u64,
    /// Bytes in all.
    pub(super) length: u64,
}

impl<'a> PlySource<'a, BufReader<File>> {
    pub(super) fn open(path: &'a Path) -> Result<Self, IoError> {
        let (file, length) = open_regular(path)?;
        Ok(Self { reader: BufReader::with_capacity(1 << 20, file), path, position: 0, length })
    }
}

impl<'a> PlySource<'a, &'a [u8]> {
    pub(super) fn from_bytes(path: &'a Path, bytes: &'a [u8]) -> Self {
        Self { reader: bytes, path, position: 0, length: bytes.len() as u64 }
    }
}

impl<R: BufRead> PlySource<'_, R> {
    /// Returns the number of bytes not read yet.
    pub(super) fn remaining(&self) -> u64 {
        self.length.saturating_sub(self.position)
    }

    /// Returns the error that the content is wrong at `place`.
    pub(super) fn invalid(&self, place: impl std::fmt::Display, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.path, format_args!("{place}: {message}"))
    }

    /// Leaves out a byte order mark, if it is next.
    pub(super) fn skip_mark(&mut self) -> Result<(), IoError> {
        let head = self.reader.fill_buf().map_err(|e| IoError::system(self.path, "read", &e))?;
        if head.starts_with(MARK) {
            self.reader.consume(MARK.len());
            self.position += MARK.len() as u64;
        }
        Ok(())
    }

    /// Returns the next line without its end (`\n` or `\r\n`); `None` at the end of the file.
    pub(super) fn line<'b>(&mut self, buffer: &'b mut Vec<u8>) -> Result<Option<&'b [u8]>, IoError> {
        buffer.clear();
        let read = self.reader.by_ref().take(MAX_LINE).read_until(b'\n', buffer);
        let count = read.map_err(|e| IoError::system(self.path, "read", &e))?;
        self.position += count as u64;
        if count == 0 {
            return Ok(None);
        }
        if buffer.last() != Some(&b'\n') && count as u64 == MAX_LINE {
            return Err(self.invalid(format_args!("byte {}", self.position), "line longer than 1 MiB, expected a line of text"));
        }
        let line = buffer.strip_suffix(b"\n").unwrap_or(buffer);
        Ok(Some(line.strip_suffix(b"\r").unwrap_or(line)))
    }

    /// Fills `buffer`.
    pub(super) fn fill(&mut self, buffer: &mut [u8]) -> Result<(), IoError> {
        self.reader.read_exact(buffer).map_err(|e| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => self.invalid(
                format_args!("byte {}", self.length),
                format_args!("file ends, expected {} bytes from byte {} on; the file is truncated", buffer.len(), self.position),
            ),
            _ => IoError::system(self.path, "read", &e),
        })?;
        self.position += buffer.len() as u64;
        Ok(())
    }

    /// Leaves `count` bytes out.
    pub(super) fn skip(&mut self, mut count: u64) -> Result<(), IoError> {
        let mut scratch = [0u8; 4096];
        while count > 0 {
            let step = count.min(scratch.len() as u64) as usize;
            let (part, _) = scratch.split_at_mut(step);
            self.fill(part)?;
            count -= step as u64;
        }
        Ok(())
    }
}

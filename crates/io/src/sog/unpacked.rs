//! Files of a ZIP archive, found by its directory: stored or deflated, of at most 4 GiB.
//!
//! Sizes are claims: nothing is allocated by them, and what is inflated ends at the size that the
//! directory states, below the limit of memory.

use std::borrow::Cow;
use std::io::Read;

use flate2::read::DeflateDecoder;

use super::archive::{CRC, END, ENTRY, LOCAL};
use crate::memory::memory_limit;

/// Bytes of the end of the directory, of an entry and of a file's header, without names.
const END_BYTES: usize = 22;
const ENTRY_BYTES: usize = 46;
const LOCAL_BYTES: usize = 30;
/// Longest comment behind the directory.
const MAX_COMMENT: usize = 65_535;
/// Compression of a file.
const STORED: u16 = 0;
const DEFLATED: u16 = 8;

/// A file of an archive, not yet inflated.
#[derive(Clone, Debug)]
pub(super) struct Packed<'a> {
    name: Cow<'a, str>,
    bytes: &'a [u8],
    method: u16,
    size: u64,
    checksum: u32,
}

impl<'a> Packed<'a> {
    /// Returns its name without folders.
    pub(super) fn name(&self) -> &str {
        self.name.rsplit(['/', '\\']).next().unwrap_or_default()
    }

    /// Returns its content; the error says what is wrong with it.
    pub(super) fn content(&self) -> Result<Cow<'a, [u8]>, String> {
        let content = match self.method {
            STORED => Cow::Borrowed(self.bytes),
            DEFLATED if self.size <= memory_limit() => {
                let mut content = Vec::new();
                DeflateDecoder::new(self.bytes).take(self.size).read_to_end(&mut content).map_err(|e| format!("{}: {e}", self.name))?;
                Cow::Owned(content)
            }
            DEFLATED => return Err(format!("{}: {} bytes, more than memory has room for", self.name, self.size)),
            other => return Err(format!("{}: compressed by method {other} of ZIP, expected stored or deflated", self.name)),
        };
        match content.len() as u64 == self.size && CRC.checksum(&content) == self.checksum {
            true => Ok(content),
            false => Err(format!("{}: its checksum or size is wrong; the archive is damaged", self.name)),
        }
    }
}

/// Returns the files of an archive; the error says what is wrong with its directory.
pub(super) fn files(bytes: &[u8]) -> Result<Vec<Packed<'_>>, String> {
    let damaged = || "no directory of a ZIP archive at the end; the file is damaged or cut short".to_owned();
    let last = bytes.len().checked_sub(END_BYTES).ok_or_else(damaged)?;
    let end = (last.saturating_sub(MAX_COMMENT)..=last).rev().find(|at| u32_at(bytes, *at) == Some(END)).ok_or_else(damaged)?;
    let count = u16_at(bytes, end + 10).ok_or_else(damaged)?;
    let mut at = u32_at(bytes, end + 16).ok_or_else(damaged)? as usize;
    let mut files = Vec::new();
    for _ in 0..count {
        let (file, next) = entry(bytes, at).ok_or_else(damaged)?;
        files.push(file);
        at = next;
    }
    Ok(files)
}

/// Returns the file of the directory's entry at a place, and the place of the next entry.
fn entry(bytes: &[u8], at: usize) -> Option<(Packed<'_>, usize)> {
    if u32_at(bytes, at)? != ENTRY {
        return None;
    }
    let [name, extra, comment] = [28, 30, 32].map(|offset| u16_at(bytes, at + offset).map(usize::from));
    let (name, behind) = (name?, extra? + comment?);
    let (packed, size) = (u32_at(bytes, at + 20)?, u32_at(bytes, at + 24)?);
    let local = u32_at(bytes, at + 42)? as usize;
    if u32_at(bytes, local)? != LOCAL {
        return None;
    }
    let start = local + LOCAL_BYTES + usize::from(u16_at(bytes, local + 26)?) + usize::from(u16_at(bytes, local + 28)?);
    let file = Packed {
        name: String::from_utf8_lossy(bytes.get(at + ENTRY_BYTES..at + ENTRY_BYTES + name)?),
        bytes: bytes.get(start..start.checked_add(packed as usize)?)?,
        method: u16_at(bytes, at + 10)?,
        size: size.into(),
        checksum: u32_at(bytes, at + 16)?,
    };
    Some((file, at + ENTRY_BYTES + name + behind))
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|b| u16::from_le_bytes(*b))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|b| u32::from_le_bytes(*b))
}

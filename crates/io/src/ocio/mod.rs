//! OpenColorIO: colour spaces of a configuration, and its displays.
//!
//! In: a configuration (`.ocio`, or `ocio://NAME` for one that is built in). The way to ACES2065-1
//! is its role `aces_interchange`, or its space of that name. A configuration is a stranger's file,
//! and so are the tables that it names: panics of the library are errors; archives, and YAML that
//! expands to much more than its size, are refused.

mod display;
mod space;

use std::collections::HashSet;
use std::path::Path;

use ::ocio::Config;

pub use self::display::OcioDisplay;
pub use self::space::OcioSpace;
use crate::IoError;
use crate::read_file::read_file;

/// The names that lead to ACES2065-1.
const INTERCHANGE: [&str; 2] = ["aces_interchange", "ACES2065-1"];
/// Begins the names of configurations that are built in.
const BUILT_IN: &str = "ocio://";
/// Pixels that are converted at a time.
const CHUNK: usize = 1 << 14;
/// Repetitions by YAML's aliases: each may repeat others, so that few more could ask for all
/// memory. Programs write none.
const MAX_ALIASES: usize = 8;
/// Largest configuration: those in use have a few hundred kilobytes.
const MAX_BYTES: usize = 32 << 20;
/// Names that an error lists.
const MAX_LISTED: usize = 12;

/// The content of a configuration that was checked.
struct Content<'a> {
    path: &'a Path,
    text: &'a str,
    bytes: Vec<u8>,
}

/// Reads a configuration and refuses what would take more memory than it can be worth.
fn content(path: &Path) -> Result<Content<'_>, IoError> {
    let text = path.to_str().ok_or_else(|| IoError::unsupported(path, "expected a name in UTF-8"))?;
    let bytes = if text.starts_with(BUILT_IN) { text.as_bytes().to_vec() } else { read_file(path)? };
    check(path, &bytes)?;
    Ok(Content { path, text, bytes })
}

impl Content<'_> {
    /// Parses the configuration; also returns its name for ACES2065-1. To be called where panics
    /// are contained.
    fn parse(&self) -> Result<(Config, &'static str), IoError> {
        let parsed = Config::create_from_file(self.text).map_err(|e| IoError::invalid(self.path, e.to_string()))?;
        let interchange = INTERCHANGE.into_iter().find(|name| parsed.has_role(name) || parsed.get_color_space(name).is_some());
        let Some(interchange) = interchange else {
            let message = "no role aces_interchange and no space ACES2065-1, expected one of them, which tell the meaning of its colours";
            return Err(IoError::invalid(self.path, message));
        };
        Ok((parsed, interchange))
    }

    /// Returns the digest of the configuration and a name in it.
    fn digest(&self, name: &str) -> String {
        format!("{} {name}", blake3::hash(&self.bytes).to_hex())
    }
}

/// Refuses what would take more memory than it can be worth.
fn check(name: &Path, content: &[u8]) -> Result<(), IoError> {
    if content.starts_with(b"PK") {
        return Err(IoError::unsupported(name, "an archive; unpack it (ocioarchive --extract) and give the config.ocio that is in it"));
    }
    if content.len() > MAX_BYTES {
        return Err(IoError::unsupported(name, format!("{} bytes, expected a configuration of at most {MAX_BYTES}", content.len())));
    }
    let aliases = aliases(&String::from_utf8_lossy(content));
    if aliases > MAX_ALIASES {
        let message =
            format!("repeats parts by {aliases} aliases of YAML, expected at most {MAX_ALIASES}; write it out with ociocheck --oconfig");
        return Err(IoError::unsupported(name, message));
    }
    Ok(())
}

/// Returns how often `*name` occurs where a value may, of names that are anchors, `&name`.
fn aliases(text: &str) -> usize {
    let words = |mark: char| {
        let separators = |c: char| c.is_whitespace() || "[]{},:".contains(c);
        text.split(separators).filter_map(move |word| word.strip_prefix(mark)).filter(|name| !name.is_empty())
    };
    let anchors: HashSet<&str> = words('&').collect();
    words('*').filter(|name| anchors.contains(name)).count()
}

/// Returns names for an error, the first of many.
fn listed(count: usize, name: impl FnMut(usize) -> String) -> String {
    let names: Vec<String> = (0..count.min(MAX_LISTED)).map(name).collect();
    names.join(", ") + if count > MAX_LISTED { ", ..." } else { "" }
}

#[cfg(test)]
mod tests {
    #[test]
    fn aliases_are_words_behind_a_star_that_an_anchor_names() {
        assert_eq!(super::aliases("description: R&D and 2 * 3, *not, & so on\nx: &x 1\ny: *x"), 1);
    }
}

//! `depth.json`: what the numbers of a folder's maps are.

use std::path::Path;

use serde::Deserialize;

use super::DepthKind;
use crate::IoError;
use crate::byte_order_mark::bytes_without_mark;
use crate::read_file::read_file;

/// Name of the file.
const FILE: &str = "depth.json";

/// Statement of a folder about its maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Statement {
    pub(super) kind: Option<DepthKind>,
    /// Units of the data set for one of the file.
    pub(super) scale: Option<f64>,
    /// Distance of the plane that rays begin at, in units of the file.
    pub(super) near: Option<f64>,
}

impl Statement {
    /// Reads the file, if it is there.
    pub(super) fn read(folder: &Path) -> Result<Self, IoError> {
        let path = folder.join(FILE);
        if !path.is_file() {
            return Ok(Self::default());
        }
        Self::parse(&path, &read_file(&path)?)
    }

    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, IoError> {
        let example = "{\"kind\": \"metric\", \"scale\": 0.001}, of metric, relative, disparity or distance";
        let found: Self = serde_json::from_slice(bytes_without_mark(bytes))
            .map_err(|e| IoError::invalid(path, format!("{e}; expected an object such as {example}")))?;
        match found.scale {
            Some(scale) if !(scale.is_normal() && scale > 0.0) => {
                Err(IoError::invalid(path, format!("\"scale\" is {scale}, expected a number above 0")))
            }
            _ if found.near.is_some_and(|near| !(near.is_finite() && near >= 0.0)) => {
                Err(IoError::invalid(path, format!("\"near\" is {:?}, expected a number of 0 or more", found.near)))
            }
            _ if found.near.is_some() && found.kind != Some(DepthKind::Distance) => {
                Err(IoError::invalid(path, "\"near\" is for \"kind\": \"distance\"; leave it out, or state the kind"))
            }
            _ => Ok(found),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_stated_is_read_or_refused() {
        let parse = |text: &str| Statement::parse(Path::new("depth.json"), text.as_bytes());
        assert_eq!(parse("{}").unwrap(), Statement::default());
        let stated = parse(r#"{"kind": "disparity", "scale": 0.25}"#).unwrap();
        assert_eq!(stated, Statement { kind: Some(DepthKind::Disparity), scale: Some(0.25), near: None });
        assert_eq!(parse(r#"{"kind": "distance", "near": 0.1}"#).unwrap().near, Some(0.1));
        for (text, part) in [
            (r#"{"kind": "meters"}"#, "unknown variant `meters`"),
            (r#"{"scale": 0}"#, "\"scale\" is 0, expected a number above 0"),
            (r#"{"units": 1}"#, "unknown field `units`"),
            (r#"{"kind": "metric", "near": 1}"#, "\"near\" is for"),
            ("[]", "expected an object such as"),
        ] {
            assert!(parse(text).unwrap_err().message.contains(part), "{text}: {}", parse(text).unwrap_err());
        }
    }
}

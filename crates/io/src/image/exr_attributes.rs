//! The attributes of an OpenEXR file that the standard does not name, without its pixels.
//!
//! In: a file. Out: texts and numbers by name, of all parts. Degenerate: a file of another format
//! has none.

use std::collections::BTreeMap;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use ::exr::meta::MetaData;
use ::exr::meta::attribute::AttributeValue;

use super::{Format, HEAD_BYTES, guard, openexr};
use crate::IoError;
use crate::input::Input;
use crate::read_file::open_regular;

/// Attributes by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExrAttributes {
    /// Texts.
    pub texts: BTreeMap<String, String>,
    /// Numbers.
    pub numbers: BTreeMap<String, f32>,
}

/// Reads the attributes of a file, such as those of [`super::ExrOptions`].
///
/// ```
/// use luxel_core::Image;
/// use luxel_io::{ExrOptions, read_exr_attributes, write_exr};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("lamp.exr");
/// let numbers = vec![("luxel:radiance_scale".into(), 3.5)];
/// let options = ExrOptions { numbers, ..ExrOptions::default() };
/// write_exr(&path, &Image::filled(4, 2, [1.0; 3]), &options)?;
/// assert_eq!(read_exr_attributes(&path)?.numbers["luxel:radiance_scale"], 3.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A file that cannot be read, or whose header is damaged.
pub fn read_exr_attributes(path: &Path) -> Result<ExrAttributes, IoError> {
    let (file, _) = open_regular(path)?;
    let mut head = Vec::new();
    (&file).take(HEAD_BYTES).read_to_end(&mut head).map_err(|e| IoError::system(path, "read", &e))?;
    match Format::detect(Input::new(path, &head)) {
        Ok(Format::OpenExr) => {
            (&file).rewind().map_err(|e| IoError::system(path, "read", &e))?;
            guard::contain(path, || attributes(path, file))
        }
        _ => Ok(ExrAttributes::default()),
    }
}

fn attributes(name: &Path, file: impl Read + Seek) -> Result<ExrAttributes, IoError> {
    let meta = MetaData::read_from_buffered(BufReader::new(file), false).map_err(|error| openexr::explain(name, &error))?;
    let mut found = ExrAttributes::default();
    for (key, value) in meta.headers.iter().flat_map(|header| header.own_attributes.other.iter().chain(&header.shared_attributes.other)) {
        match value {
            AttributeValue::Text(text) => drop(found.texts.insert(key.to_string(), text.to_string())),
            AttributeValue::F32(number) => drop(found.numbers.insert(key.to_string(), *number)),
            _ => {}
        }
    }
    Ok(found)
}

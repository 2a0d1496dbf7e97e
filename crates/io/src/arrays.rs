//! Named arrays of numbers with a description, in one safetensors file: what a radiance field is
//! stored as.
//!
//! In: f32 arrays with shapes, and a text that says what they are. Out: a file whose metadata has
//! one entry, `luxel`: JSON with `format` (what is stored), `version`, `description` (the text) and
//! `blake3`, a digest over the others, names, shapes and values, which detects a damaged file.
//! Files are written whole or not at all, and equal content gives equal bytes.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use crate::error::IoError;
use crate::read_file::read_file;
use crate::tensors::{Tensors, decode_tensors};
use crate::write_atomically;

/// Version of the format.
const VERSION: u32 = 1;
/// The entry of the file's metadata.
const KEY: &str = "luxel";

/// An array to store.
#[derive(Clone, Copy, Debug)]
pub struct NamedArray<'a> {
    /// Name within the file.
    pub name: &'a str,
    /// Lengths along its axes, slowest first.
    pub shape: &'a [usize],
    /// Values, as many as the product of the lengths.
    pub values: &'a [f32],
}

/// The content of a file of arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrays {
    /// The text that says what they are.
    pub description: String,
    /// Shape and values by name.
    pub tensors: Tensors,
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    version: u32,
    description: String,
    blake3: String,
}

/// Writes a file of arrays of kind `format`, whole or not at all and synced to the disk; folders
/// are made as needed.
///
/// # Errors
/// Values that do not fill a shape; the file system's refusal. Older files are untouched.
pub fn write_arrays(path: &Path, format: &str, description: &str, arrays: &[NamedArray<'_>]) -> Result<(), IoError> {
    let bytes = encode_arrays(path, format, description, arrays)?;
    write_atomically(path, |file| file.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes the bytes that [`write_arrays`] writes; `name` is for errors.
///
/// # Errors
/// Values that do not fill a shape.
pub fn encode_arrays(name: &Path, format: &str, description: &str, arrays: &[NamedArray<'_>]) -> Result<Vec<u8>, IoError> {
    let bytes: Vec<Vec<u8>> = arrays.iter().map(|array| array.values.iter().flat_map(|value| value.to_le_bytes()).collect()).collect();
    let mut views = BTreeMap::new();
    for (array, bytes) in arrays.iter().zip(&bytes) {
        let view = TensorView::new(Dtype::F32, array.shape.to_vec(), bytes);
        let view = view.map_err(|e| IoError::invalid(name, format_args!("array {} to write: {e}", array.name)))?;
        views.insert(array.name, view);
    }
    let blake3 = digest(format, description, &views);
    let header = Header { format: format.into(), version: VERSION, description: description.into(), blake3 };
    let header = serde_json::to_string(&header).map_err(|e| IoError::invalid(name, e))?;
    // One entry: the order of several would be by chance.
    let metadata = HashMap::from([(KEY.to_owned(), header)]);
    safetensors::serialize(views, Some(metadata)).map_err(|e| IoError::invalid(name, format_args!("arrays to write: {e}")))
}

/// Reads a file of arrays of kind `format`.
///
/// # Errors
/// A file that cannot be read, is damaged, or of another kind or version.
pub fn read_arrays(path: &Path, format: &str) -> Result<Arrays, IoError> {
    decode_arrays(path, format, &read_file(path)?)
}

/// Decodes a file's bytes as [`read_arrays`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_arrays`].
pub fn decode_arrays(name: &Path, format: &str, bytes: &[u8]) -> Result<Arrays, IoError> {
    let invalid = |message: String| IoError::invalid(name, message);
    let (_, head) = SafeTensors::read_metadata(bytes).map_err(|e| invalid(format!("not a file of arrays, or truncated: {e}")))?;
    let entry = head.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
    let entry = entry.ok_or_else(|| invalid(format!("header: no \"{KEY}\": not a {format} file of luxel")))?;
    let header: Header = serde_json::from_str(entry).map_err(|e| invalid(format!("header: {e}")))?;
    if header.format != format {
        let found: String = header.format.chars().take(80).collect();
        return Err(invalid(format!("holds \"{found}\", expected \"{format}\"")));
    }
    if header.version != VERSION {
        let message = format!("{format} version {}, expected {VERSION}; use the release of luxel that wrote it", header.version);
        return Err(IoError::unsupported(name, message));
    }
    let file = SafeTensors::deserialize(bytes).map_err(|e| invalid(format!("truncated or damaged: {e}")))?;
    let found = digest(&header.format, &header.description, &file.tensors().into_iter().collect());
    if found != header.blake3 {
        return Err(invalid("the content does not match its digest: the file is damaged, use an older one".into()));
    }
    Ok(Arrays { description: header.description, tensors: decode_tensors(name, bytes)? })
}

/// Returns whether a file says that it holds arrays of kind `format`, readable or not.
pub fn holds_arrays(path: &Path, format: &str) -> bool {
    let is_of_kind = |bytes: Vec<u8>| {
        let (_, head) = SafeTensors::read_metadata(&bytes).ok()?;
        let header: Header = serde_json::from_str(head.metadata().as_ref()?.get(KEY)?).ok()?;
        Some(header.format == format)
    };
    read_file(path).ok().and_then(is_of_kind).unwrap_or(false)
}

/// Returns the digest of a content, every part preceded by its length.
fn digest<N: AsRef<str>>(format: &str, description: &str, arrays: &BTreeMap<N, TensorView<'_>>) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    part(format.as_bytes());
    part(description.as_bytes());
    for (name, view) in arrays {
        part(name.as_ref().as_bytes());
        part(&view.shape().iter().flat_map(|side| (*side as u64).to_le_bytes()).collect::<Vec<u8>>());
        part(view.data());
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes() -> Vec<u8> {
        let arrays = [NamedArray { name: "b", shape: &[2, 1], values: &[1.5, -2.0] }, NamedArray { name: "a", shape: &[0], values: &[] }];
        encode_arrays(Path::new("f"), "luxel-test", "{\"side\": 3}", &arrays).unwrap()
    }

    #[test]
    fn arrays_come_back_and_equal_ones_have_equal_bytes() {
        let found = decode_arrays(Path::new("f"), "luxel-test", &bytes()).unwrap();
        assert_eq!((found.description.as_str(), found.tensors.len()), ("{\"side\": 3}", 2));
        assert_eq!(found.tensors["b"], (vec![2, 1], vec![1.5, -2.0]));
        assert_eq!(bytes(), bytes());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/f.safetensors");
        write_arrays(&path, "luxel-test", "", &[NamedArray { name: "a", shape: &[1], values: &[f32::NAN] }]).unwrap();
        assert!(holds_arrays(&path, "luxel-test") && !holds_arrays(&path, "other"));
        assert!(read_arrays(&path, "luxel-test").unwrap().tensors["a"].1[0].is_nan());
    }

    #[test]
    fn damage_and_other_kinds_are_errors() {
        let whole = bytes();
        let error = |format: &str, bytes: &[u8]| decode_arrays(Path::new("f"), format, bytes).unwrap_err().to_string();
        assert!(error("luxel-field", &whole).contains("holds \"luxel-test\", expected \"luxel-field\""));
        for length in 0..whole.len() {
            assert!(!error("luxel-test", &whole[..length]).is_empty());
        }
        let mut flipped = whole.clone();
        *flipped.last_mut().unwrap() ^= 1;
        assert!(error("luxel-test", &flipped).contains("digest"));
        let too_few = [NamedArray { name: "a", shape: &[3], values: &[1.0] }];
        assert!(encode_arrays(Path::new("f"), "luxel-test", "", &too_few).is_err());
        let plain = safetensors::serialize([("x", TensorView::new(Dtype::F32, vec![1], &[0; 4]).unwrap())], None).unwrap();
        assert!(error("luxel-test", &plain).contains("no \"luxel\""));
    }
}

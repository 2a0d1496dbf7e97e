//! Tensors of a safetensors file that some other program has written: weights of a network.
//!
//! In: a file. Out: shape and values by name, single precision. Every length is checked against the
//! file's by the format's library; tensors of other types than f32 are refused, as nothing states
//! what their rounding is worth.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::{Dtype, SafeTensors};

use crate::error::IoError;
use crate::read_file::read_file;

/// Shape and values by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Reads all tensors of a file.
///
/// # Errors
/// A file that cannot be read, is not a safetensors file, or contains anything else than f32.
pub fn read_tensors(path: &Path) -> Result<Tensors, IoError> {
    decode_tensors(path, &read_file(path)?)
}

/// Decodes a file's bytes as [`read_tensors`] does; `name` is for messages only.
///
/// # Errors
/// The same as [`read_tensors`].
pub fn decode_tensors(name: &Path, bytes: &[u8]) -> Result<Tensors, IoError> {
    let file = SafeTensors::deserialize(bytes).map_err(|error| {
        IoError::invalid(name, format!("not a safetensors file: {error}; convert a PyTorch state dict with safetensors.torch.save_file"))
    })?;
    let mut tensors = BTreeMap::new();
    for (tensor, view) in file.tensors() {
        if view.dtype() != Dtype::F32 {
            let message = format!("tensor \"{tensor}\" is {:?}, expected F32; convert it before saving", view.dtype());
            return Err(IoError::unsupported(name, message));
        }
        // Tensors are not aligned in the file.
        let (values, _) = view.data().as_chunks::<4>();
        let values = values.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
        tensors.insert(tensor, (view.shape().to_vec(), values));
    }
    Ok(tensors)
}

#[cfg(test)]
mod tests {
    use safetensors::tensor::TensorView;

    use super::*;

    fn file(dtype: Dtype, bytes: &[u8]) -> Vec<u8> {
        let shape = vec![bytes.len() / 4, 1];
        safetensors::serialize([("net.bias", TensorView::new(dtype, shape, bytes).unwrap())], None).unwrap()
    }

    #[test]
    fn tensors_are_read_with_their_shape() {
        let bytes: Vec<u8> = [1.5f32, -2.0, 3.25].iter().flat_map(|v| v.to_le_bytes()).collect();
        let found = decode_tensors(Path::new("w.safetensors"), &file(Dtype::F32, &bytes)).unwrap();
        assert_eq!(found["net.bias"], (vec![3, 1], vec![1.5, -2.0, 3.25]));
    }

    #[test]
    fn what_is_no_float_and_no_safetensors_file_is_refused() {
        let error = |bytes: &[u8]| decode_tensors(Path::new("w.safetensors"), bytes).unwrap_err().to_string();
        assert!(error(&file(Dtype::I32, &[0; 8])).contains("\"net.bias\" is I32, expected F32"));
        let whole = file(Dtype::F32, &[0; 8]);
        for length in 0..whole.len() {
            assert!(error(&whole[..length]).contains("not a safetensors file"));
        }
    }
}

//! A bake alone to PLY: the properties that every 3D Gaussian splatting program reads, and one
//! comment that states the meaning of the numbers.

use std::io::Write;
use std::path::Path;

use crate::bake::{BakeRecord, Baked};
use crate::ply::COMMENT_TAG;
use crate::ply::scene_writer::{check, note_origin, standard_properties, write_rows};
use crate::{IoError, write_atomically};

/// Writes a bake, whole or not at all; folders are made as needed.
///
/// # Errors
/// A scene that could not be read back, or the file system's refusal.
pub fn write_baked_ply(path: &Path, baked: &Baked) -> Result<(), IoError> {
    check(path, &baked.scene)?;
    write_atomically(path, |file| write(baked, file).map_err(|e| IoError::system(path, "write", &e)))
}

/// Encodes the bytes that [`write_baked_ply`] writes; `name` is for errors.
///
/// # Errors
/// The same as [`write_baked_ply`].
pub fn encode_baked_ply(name: &Path, baked: &Baked) -> Result<Vec<u8>, IoError> {
    check(name, &baked.scene)?;
    let mut bytes = Vec::new();
    write(baked, &mut bytes).map_err(|e| IoError::system(name, "write", &e))?;
    Ok(bytes)
}

fn write<W: Write + ?Sized>(baked: &Baked, out: &mut W) -> std::io::Result<()> {
    let splats = &baked.scene.splats;
    let coefficients = splats.color_model.sh_coefficients();
    let properties = standard_properties(coefficients);
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    writeln!(out, "comment {COMMENT_TAG} baked {}", BakeRecord::from_bake(baked).json()?)?;
    note_origin(&baked.scene.world_from_local, out)?;
    writeln!(out, "comment {}", baked.description())?;
    writeln!(out, "element vertex {}", splats.len())?;
    for name in &properties {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")?;
    write_rows(splats.len(), properties.len(), out, |i, values| {
        let sh = splats.sh_of(i);
        values.extend(splats.position[i]);
        values.extend([0.0; 3]);
        values.extend_from_slice(&sh[..3]);
        for channel in 0..3 {
            values.extend(sh[3..].iter().skip(channel).step_by(3));
        }
        values.push(splats.opacity_logit[i]);
        values.extend(splats.log_scale[i]);
        values.extend(splats.rotation[i]);
    })
}

//! Triangle meshes to files: OpenUSD, binary glTF, PLY and OBJ.
//!
//! In: a [`MeshFile`]. Out: a file with positions, normals and linear radiance at the vertices, in
//! floats that are read back to the bit. Radiance is `primvars:displayColor` in OpenUSD,
//! `_RADIANCE` in glTF, `red`, `green` and `blue` in PLY, and behind the positions in OBJ; none of
//! them is clamped. Degenerate: a mesh without triangles is an error.

mod glb;
mod obj;
mod ply;
#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::Path;

use luxel_core::ColorSpace;

use crate::usd::{write_mesh_binary, write_mesh_package, write_mesh_text};
use crate::{IoError, write_atomically};

/// A mesh to write.
#[derive(Clone, Copy, Debug)]
pub struct MeshFile<'a> {
    /// Vertices, `[V,3]`.
    pub positions: &'a [[f32; 3]],
    /// Unit normals, `[V,3]`.
    pub normals: &'a [[f32; 3]],
    /// Linear radiance, `[V,3]`.
    pub radiance: &'a [[f32; 3]],
    /// Numbers of vertices, counter-clockwise, `[T,3]`.
    pub triangles: &'a [[u32; 3]],
    /// Place that positions are relative to: a transform where the format has them, else added.
    pub translation: [f64; 3],
    /// Length of a unit, metres; `None` if it is unknown.
    pub metres_per_unit: Option<f64>,
    /// Colour space of the radiance.
    pub color_space: ColorSpace,
}

/// A format of meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// `.usda` or `.usd`, text.
    Usda,
    /// `.usdc`, OpenUSD's binary form.
    Usdc,
    /// `.usdz`, a package of it.
    Usdz,
    /// `.glb`
    Glb,
    /// `.ply`, binary.
    Ply,
    /// `.obj`
    Obj,
}

impl MeshFormat {
    /// Returns the format of a path by its extension; `None` for an unknown one.
    pub fn from_path(path: &Path) -> Option<Self> {
        Some(match path.extension()?.to_string_lossy().to_lowercase().as_str() {
            "usda" | "usd" => Self::Usda,
            "usdc" => Self::Usdc,
            "usdz" => Self::Usdz,
            "glb" => Self::Glb,
            "ply" => Self::Ply,
            "obj" => Self::Obj,
            _ => return None,
        })
    }
}

/// Writes a mesh, whole or not at all; folders are made as needed.
///
/// # Errors
/// A mesh without triangles, or whose arrays do not go together; more than the 4 GiB that binary
/// glTF and packages hold; the file system's refusal.
pub fn write_mesh(path: &Path, mesh: &MeshFile<'_>, format: MeshFormat) -> Result<(), IoError> {
    mesh.check(path)?;
    let glb = if format == MeshFormat::Glb { Some(glb::GlbMesh::new(path, mesh)?) } else { None };
    let write = |file: &mut dyn Write| match (format, &glb) {
        (MeshFormat::Usda, _) => write_mesh_text(mesh, file),
        (MeshFormat::Usdc, _) => write_mesh_binary(mesh, file),
        (MeshFormat::Usdz, _) => write_mesh_package(mesh, file),
        (MeshFormat::Ply, _) => ply::write(mesh, file),
        (MeshFormat::Obj, _) => obj::write(mesh, file),
        (MeshFormat::Glb, glb) => glb.iter().try_for_each(|glb| glb.write(file)),
    };
    write_atomically(path, |file| write(file).map_err(|e| IoError::system(path, "write", &e)))
}

impl MeshFile<'_> {
    fn check(&self, path: &Path) -> Result<(), IoError> {
        let vertices = self.positions.len();
        if self.triangles.is_empty() {
            return Err(IoError::unsupported(path, "a mesh without triangles, expected at least one"));
        }
        if self.normals.len() != vertices || self.radiance.len() != vertices {
            let found = [self.normals.len(), self.radiance.len()];
            return Err(IoError::invalid(path, format_args!("normals and radiance of {found:?} vertices, expected {vertices}")));
        }
        if let Some(beyond) = self.triangles.as_flattened().iter().find(|vertex| **vertex as usize >= vertices) {
            return Err(IoError::invalid(path, format_args!("a triangle of vertex {beyond}, expected less than {vertices}")));
        }
        Ok(())
    }

    /// Returns the position of a vertex with the translation.
    fn placed(&self, vertex: usize) -> [f64; 3] {
        [0, 1, 2].map(|c| f64::from(self.positions[vertex][c]) + self.translation[c])
    }

    /// Returns whether positions are relative to another place than the origin.
    pub(crate) fn is_moved(&self) -> bool {
        self.translation != [0.0; 3]
    }

    /// Returns the lower and upper corner of the vertices.
    pub(crate) fn bounds(&self) -> [[f32; 3]; 2] {
        let join = |[low, high]: [[f32; 3]; 2], p: &[f32; 3]| [[0, 1, 2].map(|c| low[c].min(p[c])), [0, 1, 2].map(|c| high[c].max(p[c]))];
        self.positions.first().map_or([[0.0; 3]; 2], |first| self.positions.iter().fold([*first; 2], join))
    }

    /// Returns the mesh in words, with its unit.
    pub(crate) fn documentation(&self) -> String {
        let unit = match self.metres_per_unit {
            Some(metres) => format!("a unit is {metres} m"),
            None => "the scale of the data set is unknown: the length of a unit is not measured".to_owned(),
        };
        format!("proxy mesh by Luxel; vertex colours are radiance in {}, not clamped; {unit}", self.color_space.name())
    }
}

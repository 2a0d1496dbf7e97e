//! A mesh as binary PLY.

use std::io::{self, BufWriter, Write};

use super::MeshFile;

/// Writes the file. Positions are doubles where they are not relative to the origin.
pub(super) fn write(mesh: &MeshFile<'_>, out: &mut dyn Write) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    let position = if mesh.is_moved() { "double" } else { "float" };
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment {}\nelement vertex {}", mesh.documentation(), mesh.positions.len())?;
    for axis in ["x", "y", "z"] {
        writeln!(out, "property {position} {axis}")?;
    }
    for name in ["nx", "ny", "nz", "red", "green", "blue"] {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header", mesh.triangles.len())?;
    for vertex in 0..mesh.positions.len() {
        if mesh.is_moved() {
            out.write_all(&mesh.placed(vertex).map(f64::to_le_bytes).concat())?;
        } else {
            out.write_all(&mesh.positions[vertex].map(f32::to_le_bytes).concat())?;
        }
        out.write_all(
            &[mesh.normals[vertex], mesh.radiance[vertex]].as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(),
        )?;
    }
    for triangle in mesh.triangles {
        out.write_all(&[3])?;
        out.write_all(&triangle.map(u32::to_le_bytes).concat())?;
    }
    out.flush()
}

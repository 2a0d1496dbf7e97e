//! A mesh as Wavefront OBJ, with colours behind the positions, as MeshLab and Blender read them.

use std::io::{self, BufWriter, Write};

use super::MeshFile;

/// Writes the file.
pub(super) fn write(mesh: &MeshFile<'_>, out: &mut dyn Write) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    writeln!(out, "# {}\no Mesh", mesh.documentation())?;
    for vertex in 0..mesh.positions.len() {
        let [r, g, b] = mesh.radiance[vertex];
        if mesh.is_moved() {
            let [x, y, z] = mesh.placed(vertex);
            writeln!(out, "v {x} {y} {z} {r} {g} {b}")?;
        } else {
            let [x, y, z] = mesh.positions[vertex];
            writeln!(out, "v {x} {y} {z} {r} {g} {b}")?;
        }
    }
    for [x, y, z] in mesh.normals {
        writeln!(out, "vn {x} {y} {z}")?;
    }
    for triangle in mesh.triangles {
        // Vertices are counted from 1.
        let [a, b, c] = triangle.map(|vertex| u64::from(vertex) + 1);
        writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
    }
    out.flush()
}

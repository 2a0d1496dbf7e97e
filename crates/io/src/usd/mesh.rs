//! A mesh as a `Mesh` of usdGeom, as text, in the binary form, and in packages.

use std::io::{self, Write};

use super::binary::{PackagePart, write_mesh, write_package};
use super::writer::{tuple, write_array, write_array_with};
use super::{ORDER, TRANSLATE, usd_name};
use crate::mesh::MeshFile;

/// Name of the prim.
pub(super) const PRIM: &str = "Mesh";

/// Facts that a layer states about itself.
pub(super) struct MeshFacts {
    pub(super) metres: f64,
    pub(super) documentation: String,
    pub(super) color_space: &'static str,
}

impl MeshFacts {
    pub(super) fn new(mesh: &MeshFile<'_>) -> Self {
        // USD takes a unit for a centimetre where nothing is stated.
        let metres = mesh.metres_per_unit.unwrap_or(1.0);
        Self { metres, documentation: mesh.documentation(), color_space: usd_name(mesh.color_space) }
    }
}

/// Writes a mesh as OpenUSD text.
pub(crate) fn write_mesh_text(mesh: &MeshFile<'_>, out: &mut dyn Write) -> io::Result<()> {
    let MeshFacts { metres, documentation, color_space } = MeshFacts::new(mesh);
    writeln!(out, "#usda 1.0\n(\n    defaultPrim = \"{PRIM}\"\n    doc = \"{documentation}\"")?;
    writeln!(out, "    metersPerUnit = {metres}\n    upAxis = \"Y\"\n)\n")?;
    writeln!(out, "def Mesh \"{PRIM}\" (\n    prepend apiSchemas = [\"ColorSpaceAPI\"]\n)\n{{")?;
    writeln!(out, "    uniform token colorSpace:name = \"{color_space}\"")?;
    if mesh.is_moved() {
        let [x, y, z] = mesh.translation;
        writeln!(out, "    double3 {TRANSLATE} = ({x}, {y}, {z})")?;
        writeln!(out, "    uniform token[] {ORDER} = [\"{TRANSLATE}\"]")?;
    }
    writeln!(out, "    uniform bool doubleSided = 1\n    uniform token subdivisionScheme = \"none\"")?;
    write_array(out, "float3[] extent", 2, |i, text| tuple(text, &mesh.bounds()[i]))?;
    write_array(out, "int[] faceVertexCounts", mesh.triangles.len(), |_, text| text.push(b'3'))?;
    let corners = mesh.triangles.as_flattened();
    write_array(out, "int[] faceVertexIndices", corners.len(), |i, text| text.extend(corners[i].to_string().bytes()))?;
    write_array(out, "point3f[] points", mesh.positions.len(), |i, text| tuple(text, &mesh.positions[i]))?;
    for (name, rows) in [("normal3f[] normals", mesh.normals), ("color3f[] primvars:displayColor", mesh.radiance)] {
        let end = " (\n        interpolation = \"vertex\"\n    )";
        write_array_with(out, name, end, rows.len(), |i, text| tuple(text, &rows[i]))?;
    }
    writeln!(out, "}}")
}

/// Writes a mesh in OpenUSD's binary form.
pub(crate) fn write_mesh_binary(mesh: &MeshFile<'_>, out: &mut dyn Write) -> io::Result<()> {
    write_mesh(mesh, out)
}

/// Writes a mesh as an OpenUSD package.
pub(crate) fn write_mesh_package(mesh: &MeshFile<'_>, out: &mut dyn Write) -> io::Result<()> {
    write_package(out, &[PackagePart { name: "mesh.usdc", write: &|out| write_mesh(mesh, out) }])
}

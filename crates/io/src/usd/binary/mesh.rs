//! A triangle mesh in a crate file.

use std::io::{self, Write};

use super::kind;
use super::writer::{CrateWriter, FieldValue, Form};
use crate::mesh::MeshFile;
use crate::usd::mesh::{MeshFacts, PRIM};
use crate::usd::{ORDER, TRANSLATE};

/// Writes a mesh as a crate file. What is in the header depends on what is behind it, which is
/// therefore made twice.
pub(in crate::usd) fn write_mesh(mesh: &MeshFile<'_>, out: &mut dyn Write) -> io::Result<()> {
    let header = write_behind_header(mesh, CrateWriter::new(io::sink()))?;
    out.write_all(&header)?;
    write_behind_header(mesh, CrateWriter::new(out)).map(drop)
}

/// Attributes of the prim, in the order of their specs.
const NAMES: [&str; 11] = [
    "colorSpace:name",
    TRANSLATE,
    ORDER,
    "doubleSided",
    "subdivisionScheme",
    "extent",
    "faceVertexCounts",
    "faceVertexIndices",
    "points",
    "normals",
    "primvars:displayColor",
];

/// Writes values and tables; returns the header.
fn write_behind_header<W: Write>(mesh: &MeshFile<'_>, mut file: CrateWriter<W>) -> io::Result<Vec<u8>> {
    let MeshFacts { metres, documentation, color_space } = MeshFacts::new(mesh);
    let names: Vec<&str> = NAMES.iter().copied().filter(|name| mesh.is_moved() || !matches!(*name, TRANSLATE | ORDER)).collect();
    let root = [
        FieldValue::new("defaultPrim", file.token(PRIM)),
        FieldValue::new("documentation", file.string(&documentation)),
        FieldValue::new("metersPerUnit", file.double(metres)?),
        FieldValue::new("upAxis", file.token("Y")),
        FieldValue::new("primChildren", file.token_vector(&[PRIM])?),
    ];
    file.root(&root);
    let fields = [
        FieldValue::definition(),
        FieldValue::new("typeName", file.token("Mesh")),
        FieldValue::new("apiSchemas", file.prepended_tokens(&["ColorSpaceAPI"])?),
        FieldValue::new("properties", file.token_vector(&names)?),
    ];
    file.prim(PRIM, 0, &fields);
    let rows = |block: &mut Vec<u8>, row: [f32; 3]| block.extend(row.iter().flat_map(|v| v.to_le_bytes()));
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    for name in names {
        let (type_name, form, value) = match name {
            "colorSpace:name" => ("token", Form::Uniform, file.token(color_space)),
            TRANSLATE => ("double3", Form::Varying, file.vec3d(mesh.translation)?),
            ORDER => ("token[]", Form::Uniform, file.token_array(&[TRANSLATE])?),
            "doubleSided" => ("bool", Form::Uniform, file.bool(true)),
            "subdivisionScheme" => ("token", Form::Uniform, file.token("none")),
            "extent" => {
                let corners = mesh.bounds();
                ("float3[]", Form::Varying, file.floats(kind::VEC3F, 2, |i, block| rows(block, corners[i]))?)
            }
            "faceVertexCounts" => {
                ("int[]", Form::Varying, file.rows(kind::INT, [triangles, 1], |_, block| block.extend(3u32.to_le_bytes()))?)
            }
            "faceVertexIndices" => {
                let corners = |i: usize, block: &mut Vec<u8>| block.extend(mesh.triangles[i].iter().flat_map(|v| v.to_le_bytes()));
                ("int[]", Form::Varying, file.rows(kind::INT, [triangles, 3], corners)?)
            }
            "points" => ("point3f[]", Form::Varying, file.floats(kind::VEC3F, vertices, |i, block| rows(block, mesh.positions[i]))?),
            "normals" => ("normal3f[]", Form::PerVertex, file.floats(kind::VEC3F, vertices, |i, block| rows(block, mesh.normals[i]))?),
            // The colours.
            _ => ("color3f[]", Form::PerVertex, file.floats(kind::VEC3F, vertices, |i, block| rows(block, mesh.radiance[i]))?),
        };
        file.attribute(name, type_name, form, value);
    }
    file.finish()
}

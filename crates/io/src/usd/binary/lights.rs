//! Lights in a crate file.

use std::collections::HashMap;
use std::io::{self, Write};

use super::kind;
use super::writer::{CrateWriter, FieldValue, Form};
use crate::lights::{LIGHTS, LightAttribute, LightLink, LightPrim, LightValue, StageLights, light_prims, lights_documentation};

/// Writes the prim around lights, which has `depth` prims around it, and those of the lights.
pub(super) fn write_lights<W: Write>(lights: &StageLights, depth: usize, file: &mut CrateWriter<W>) -> io::Result<()> {
    let prims = light_prims(lights);
    let names: Vec<&str> = prims.iter().map(|prim| prim.name.as_str()).collect();
    let fields = [
        FieldValue::definition(),
        FieldValue::new("typeName", file.token("Xform")),
        FieldValue::new("documentation", file.string(&lights_documentation(lights))),
        FieldValue::new("primChildren", file.token_vector(&names)?),
    ];
    // An empty list of children is not written by other programs either.
    let around = file.prim(LIGHTS, depth, if names.is_empty() { &fields[..3] } else { &fields });
    let mut paths = Vec::new();
    prims.iter().for_each(|prim| list_paths(prim, "", &mut paths));
    let numbers = paths.into_iter().zip(around + 1..).collect();
    prims.iter().try_for_each(|prim| write_prim(prim, "", &numbers, depth + 1, file))
}

/// Lists the paths of a prim, its properties and the prims within it, in the order in which they
/// are written; `around` is the path of what is around it, from the prim around all lights.
fn list_paths(prim: &LightPrim, around: &str, paths: &mut Vec<String>) {
    let path = joined(around, &prim.name);
    paths.push(path.clone());
    paths.extend(property_names(prim).map(|name| format!("{path}.{name}")));
    prim.children.iter().for_each(|child| list_paths(child, &path, paths));
}

fn property_names(prim: &LightPrim) -> impl Iterator<Item = &'static str> {
    prim.attributes.iter().map(|attribute| attribute.name).chain(prim.links.iter().map(LightLink::name))
}

/// Returns the path of what is seen from another one at `target`.
fn joined(from: &str, target: &str) -> String {
    match (target.strip_prefix("../"), from) {
        (Some(beside), _) => joined(from.rsplit_once('/').map_or("", |(around, _)| around), beside),
        (None, "") => target.to_owned(),
        (None, _) => format!("{from}/{target}"),
    }
}

/// Writes a prim and those within it; `numbers` are those of all paths.
fn write_prim<W: Write>(
    prim: &LightPrim,
    around: &str,
    numbers: &HashMap<String, u32>,
    depth: usize,
    file: &mut CrateWriter<W>,
) -> io::Result<()> {
    let mut fields = vec![FieldValue::definition(), FieldValue::new("typeName", file.token(prim.type_name))];
    if !prim.schemas.is_empty() {
        fields.push(FieldValue::new("apiSchemas", file.prepended_tokens(prim.schemas)?));
    }
    fields.push(FieldValue::new("properties", file.token_vector(&property_names(prim).collect::<Vec<_>>())?));
    if !prim.children.is_empty() {
        let names: Vec<&str> = prim.children.iter().map(|child| child.name.as_str()).collect();
        fields.push(FieldValue::new("primChildren", file.token_vector(&names)?));
    }
    file.prim(&prim.name, depth, &fields);
    prim.attributes.iter().try_for_each(|attribute| write_attribute(attribute, file))?;
    let path = joined(around, &prim.name);
    let number = |target: &String| numbers.get(&joined(&path, target)).copied();
    for link in &prim.links {
        match link {
            LightLink::Relationship { name, targets } => file.relationship(name, &targets.iter().filter_map(number).collect::<Vec<_>>())?,
            LightLink::Output { name, from } => file.output(name, from.as_ref().and_then(number))?,
        }
    }
    prim.children.iter().try_for_each(|child| write_prim(child, &path, numbers, depth + 1, file))
}

fn write_attribute<W: Write>(LightAttribute { type_name, name, value }: &LightAttribute, file: &mut CrateWriter<W>) -> io::Result<()> {
    let form = match value {
        LightValue::Color(_, space) => Form::ColorOf(space),
        LightValue::UniformToken(_) | LightValue::UniformTokens(_) => Form::Uniform,
        _ => Form::Varying,
    };
    let bytes = |values: &[f64; 3]| values.map(|v| (v as f32).to_le_bytes()).concat();
    let value = match value {
        LightValue::Bool(value) => file.bool(*value),
        LightValue::Float(value) => file.float(*value as f32),
        LightValue::Int(value) => file.int(*value),
        LightValue::Color(color, _) => file.vec3f(color.map(|v| v as f32))?,
        LightValue::Extent(corners) => file.floats(kind::VEC3F, 2, |i, block| block.extend(bytes(&corners[i])))?,
        LightValue::Matrix(rows) => file.matrix4d(rows)?,
        LightValue::Ints(values) => file.floats(kind::INT, values.len(), |i, block| block.extend(values[i].to_le_bytes()))?,
        LightValue::Points(points) => file.floats(kind::VEC3F, points.len(), |i, block| block.extend(bytes(&points[i].to_array())))?,
        LightValue::Token(token) | LightValue::UniformToken(token) => file.token(token),
        LightValue::UniformTokens(tokens) => file.token_array(tokens)?,
        LightValue::Asset(path) => file.asset(path),
    };
    file.attribute(name, type_name, form, value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use luxel_core::ColorSpace;

    use super::*;
    use crate::lights::tests::mesh_lamp;
    use crate::lights::{LightShape, StageDome, StageLight, StagePortal};
    use crate::usd::binary::reader::CrateReader;

    #[test]
    fn every_light_is_a_prim_with_its_numbers() {
        let light = |shape| StageLight { middle: DVec3::new(1.0, 2.0, 3.0), shape, radiance: [4.0, 2.0, 1.0] };
        let normal = DVec3::NEG_Y;
        let lights = StageLights {
            lights: vec![
                light(LightShape::Sphere { radius: 0.5 }),
                light(LightShape::Rect { size: [2.0, 1.0], normal, along: DVec3::X }),
                mesh_lamp(),
            ],
            dome: Some(StageDome { texture: "./a.exr".into() }),
            portals: vec![StagePortal { middle: DVec3::Z, shape: LightShape::Rect { size: [2.0, 1.0], normal, along: DVec3::X } }],
            metres_per_unit: None,
            cd_m2_per_unit: None,
            color_space: ColorSpace::LinearRec709,
        };
        let mut behind = Vec::new();
        let mut file = CrateWriter::new(&mut behind);
        let children = [FieldValue::new("primChildren", file.token_vector(&[LIGHTS, "Other"]).unwrap())];
        file.root(&children);
        write_lights(&lights, 0, &mut file).unwrap();
        let other = [FieldValue::definition(), FieldValue::new("typeName", file.token("Xform"))];
        file.prim("Other", 0, &other);
        let bytes = [file.finish().unwrap(), behind].concat();
        let file = CrateReader::new(&bytes).unwrap();
        let paths: Vec<&str> = file.tables.specs.iter().filter(|s| !s.path.contains('.')).map(|s| s.path.as_str()).collect();
        let lamps = ["/Lights/Lamp_1", "/Lights/Lamp_2", "/Lights/Lamp_3", "/Lights/Lamp_3/Glow", "/Lights/Lamp_3/Glow/Surface"];
        assert_eq!(paths, [&["/", "/Lights"], &lamps[..], &["/Lights/Portal_1", "/Lights/Rest", "/Other"]].concat());
        let spec = |path: &str| file.tables.specs.iter().find(|spec| spec.path == path).unwrap();
        assert_eq!(file.token(spec("/Lights/Lamp_1"), "typeName"), Some("SphereLight"));
        assert_eq!(file.token(spec("/Lights/Lamp_1.inputs:color"), "colorSpace"), Some("lin_rec709_scene"));
        let numbers = |path: &str| file.numbers(spec(path), "default").unwrap().unwrap();
        assert_eq!(numbers("/Lights/Lamp_1.inputs:radius"), [0.5]);
        assert_eq!(numbers("/Lights/Lamp_2.inputs:width"), [2.0]);
        assert_eq!(numbers("/Lights/Portal_1.inputs:height"), [1.0]);
        assert_eq!(file.floats(spec("/Lights/Lamp_3.points")).unwrap()[..6], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(numbers("/Lights/Lamp_3/Glow/Surface.inputs:emissiveColor"), [40.0, 20.0, 10.0]);
        // The shader's output is the target of its material's.
        let from = file.tables.field(spec("/Lights/Lamp_3/Glow.outputs:surface"), "connectionPaths").unwrap();
        let mut at = file.cursor(from).unwrap();
        at.take(1).unwrap();
        assert_eq!(at.count().unwrap(), 1);
        assert_eq!(file.tables.specs[at.u32().unwrap() as usize].path, "/Lights/Lamp_3/Glow/Surface.outputs:surface");
        assert_eq!(spec("/Lights/Rest.portals").kind, crate::usd::binary::spec::RELATIONSHIP);
        assert_eq!(numbers("/Lights/Lamp_2.xformOp:transform")[12..], [1.0, 2.0, 3.0, 1.0]);
    }
}

//! Lights in a crate file.

use std::collections::HashMap;
use std::io::{self, Write};

use super::kind;
use super::writer::{CrateWriter, FieldValue, Form};
use crate::lights::{LIGHTS, LightAttribute, LightPrim, LightValue, PORTALS, StageLights, light_prims, lights_documentation};

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
    file.prim(LIGHTS, depth, if names.is_empty() { &fields[..3] } else { &fields });
    let mut numbers = HashMap::new();
    for prim in &prims {
        // Portals come before the map.
        let portals: Vec<u32> = prim.portals.iter().filter_map(|portal| numbers.get(portal).copied()).collect();
        numbers.insert(prim.name.clone(), write_light(prim, &portals, depth + 1, file)?);
    }
    Ok(())
}

/// Writes a light, whose portals are known by the numbers of their paths, and returns its own.
fn write_light<W: Write>(prim: &LightPrim, portals: &[u32], depth: usize, file: &mut CrateWriter<W>) -> io::Result<u32> {
    let relationship = (!portals.is_empty()).then_some(PORTALS);
    let names: Vec<&str> = prim.attributes.iter().map(|attribute| attribute.name).chain(relationship).collect();
    let fields = [
        FieldValue::definition(),
        FieldValue::new("typeName", file.token(prim.type_name)),
        FieldValue::new("properties", file.token_vector(&names)?),
    ];
    let number = file.prim(&prim.name, depth, &fields);
    for LightAttribute { type_name, name, value } in &prim.attributes {
        let form = match value {
            LightValue::Color(_, space) => Form::ColorOf(space),
            LightValue::UniformTokens(_) => Form::Uniform,
            _ => Form::Varying,
        };
        let single = |values: &[f64; 3]| values.map(|v| v as f32);
        let value = match value {
            LightValue::Bool(value) => file.bool(*value),
            LightValue::Float(value) => file.float(*value as f32),
            LightValue::Color(color, _) => file.vec3f(single(color))?,
            LightValue::Extent(corners) => {
                let corner = |i: usize, block: &mut Vec<u8>| block.extend(single(&corners[i]).iter().flat_map(|v| v.to_le_bytes()));
                file.floats(kind::VEC3F, 2, corner)?
            }
            LightValue::Matrix(rows) => file.matrix4d(rows)?,
            LightValue::Token(token) => file.token(token),
            LightValue::UniformTokens(tokens) => file.token_array(tokens)?,
            LightValue::Asset(path) => file.asset(path),
        };
        file.attribute(name, type_name, form, value);
    }
    if let Some(name) = relationship {
        file.relationship(name, portals)?;
    }
    Ok(number)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use luxel_core::ColorSpace;

    use super::*;
    use crate::lights::{LightShape, StageDome, StageLight, StagePortal};
    use crate::usd::binary::reader::CrateReader;

    #[test]
    fn every_light_is_a_prim_with_its_numbers() {
        let light = |shape| StageLight { middle: DVec3::new(1.0, 2.0, 3.0), shape, radiance: [4.0, 2.0, 1.0] };
        let normal = DVec3::NEG_Y;
        let lights = StageLights {
            lights: vec![light(LightShape::Sphere { radius: 0.5 }), light(LightShape::Rect { size: [2.0, 1.0], normal, along: DVec3::X })],
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
        assert_eq!(paths, ["/", "/Lights", "/Lights/Lamp_1", "/Lights/Lamp_2", "/Lights/Portal_1", "/Lights/Rest", "/Other"]);
        let spec = |path: &str| file.tables.specs.iter().find(|spec| spec.path == path).unwrap();
        assert_eq!(file.token(spec("/Lights/Lamp_1"), "typeName"), Some("SphereLight"));
        assert_eq!(file.token(spec("/Lights/Lamp_1.inputs:color"), "colorSpace"), Some("lin_rec709_scene"));
        let numbers = |path: &str| file.numbers(spec(path), "default").unwrap().unwrap();
        assert_eq!(numbers("/Lights/Lamp_1.inputs:radius"), [0.5]);
        assert_eq!(numbers("/Lights/Lamp_2.inputs:width"), [2.0]);
        assert_eq!(numbers("/Lights/Portal_1.inputs:height"), [1.0]);
        assert_eq!(spec("/Lights/Rest.portals").kind, crate::usd::binary::spec::RELATIONSHIP);
        assert_eq!(numbers("/Lights/Lamp_2.xformOp:transform")[12..], [1.0, 2.0, 3.0, 1.0]);
    }
}

//! Lamps as OpenUSD text: a layer of their own, or a part of another one.

use std::fmt::Write as _;

use super::StageLights;
use super::prims::{LIGHTS, LightAttribute, LightLink, LightPrim, LightValue, light_prims, lights_documentation};

/// Returns the text of a layer; it loads its map from beside it.
pub fn stage_lights_text(lights: &StageLights) -> String {
    let (metres, doubt) = lights.metres_per_unit.map_or((1.0, "; metersPerUnit is not measured"), |metres| (metres, ""));
    let documentation = lights_documentation(lights);
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"{LIGHTS}\"\n    doc = \"{documentation}{doubt}\"\n    metersPerUnit = {metres}\n    \
         upAxis = \"Y\"\n)\n\ndef Xform \"{LIGHTS}\"\n{{\n"
    );
    text.push_str(&prims_text(lights, "    "));
    text.push_str("}\n");
    text
}

/// Returns the text of the prim around the lights of another layer, indented by `pad`.
pub(crate) fn lights_prim_text(lights: &StageLights, pad: &str) -> String {
    let (documentation, prims) = (lights_documentation(lights), prims_text(lights, &format!("{pad}    ")));
    format!("{pad}def Xform \"{LIGHTS}\" (\n{pad}    doc = \"{documentation}\"\n{pad})\n{pad}{{\n{prims}{pad}}}\n")
}

fn prims_text(lights: &StageLights, pad: &str) -> String {
    light_prims(lights).iter().map(|prim| prim_text(prim, pad)).collect()
}

/// Returns the text of a prim and of those within it.
fn prim_text(prim: &LightPrim, pad: &str) -> String {
    let mut text = format!("{pad}def {} \"{}\"", prim.type_name, prim.name);
    if !prim.schemas.is_empty() {
        let schemas: Vec<String> = prim.schemas.iter().map(|schema| format!("\"{schema}\"")).collect();
        // Writing to a string does not fail.
        let _ = write!(text, " (\n{pad}    prepend apiSchemas = [{}]\n{pad})", schemas.join(", "));
    }
    let _ = write!(text, "\n{pad}{{\n");
    for LightAttribute { type_name, name, value } in &prim.attributes {
        let uniform = if matches!(value, LightValue::UniformToken(_) | LightValue::UniformTokens(_)) { "uniform " } else { "" };
        let _ = writeln!(text, "{pad}    {uniform}{type_name} {name} = {}", value_text(value, pad));
    }
    for link in &prim.links {
        let line = match link {
            LightLink::Relationship { name, targets } => match &targets[..] {
                [one] => format!("rel {name} = <{one}>"),
                several => format!("rel {name} = [<{}>]", several.join(">, <")),
            },
            LightLink::Output { name, from: Some(from) } => format!("token {name}.connect = <{from}>"),
            LightLink::Output { name, from: None } => format!("token {name}"),
        };
        let _ = writeln!(text, "{pad}    {line}");
    }
    text.extend(prim.children.iter().map(|child| prim_text(child, &format!("{pad}    "))));
    let _ = writeln!(text, "{pad}}}");
    text
}

fn value_text(value: &LightValue, pad: &str) -> String {
    match value {
        LightValue::Bool(value) => u8::from(*value).to_string(),
        LightValue::Float(value) => value.to_string(),
        LightValue::Int(value) => value.to_string(),
        LightValue::Ints(values) => format!("[{}]", values.iter().map(i32::to_string).collect::<Vec<_>>().join(", ")),
        LightValue::Points(points) => format!("[{}]", points.iter().map(|p| tuple(&p.to_array())).collect::<Vec<_>>().join(", ")),
        LightValue::Color(color, space) => format!("{} (\n{pad}        colorSpace = \"{space}\"\n{pad}    )", tuple(color)),
        LightValue::Extent([low, high]) => format!("[{}, {}]", tuple(low), tuple(high)),
        LightValue::Matrix(rows) => format!("( {} )", rows.each_ref().map(|row| tuple(row)).join(", ")),
        LightValue::Token(token) | LightValue::UniformToken(token) => format!("\"{token}\""),
        LightValue::UniformTokens(tokens) => {
            format!("[{}]", tokens.iter().map(|token| format!("\"{token}\"")).collect::<Vec<_>>().join(", "))
        }
        // A path between @@@ may hold @.
        LightValue::Asset(path) => format!("@@@{}@@@", path.replace("@@@", "\\@@@")),
    }
}

fn tuple(values: &[f64]) -> String {
    format!("({})", values.iter().map(f64::to_string).collect::<Vec<_>>().join(", "))
}

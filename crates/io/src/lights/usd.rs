//! Lamps as OpenUSD text: a layer of their own, or a part of another one.

use std::fmt::Write as _;

use super::StageLights;
use super::prims::{LIGHTS, LightAttribute, LightValue, PORTALS, light_prims, lights_documentation};

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
    let mut text = String::new();
    for prim in light_prims(lights) {
        // Writing to a string does not fail.
        let _ = write!(text, "{pad}def {} \"{}\"\n{pad}{{\n", prim.type_name, prim.name);
        for LightAttribute { type_name, name, value } in &prim.attributes {
            let uniform = if matches!(value, LightValue::UniformTokens(_)) { "uniform " } else { "" };
            let _ = writeln!(text, "{pad}    {uniform}{type_name} {name} = {}", value_text(value, pad));
        }
        if !prim.portals.is_empty() {
            let paths: Vec<String> = prim.portals.iter().map(|name| format!("<../{name}>")).collect();
            let _ = writeln!(text, "{pad}    rel {PORTALS} = [{}]", paths.join(", "));
        }
        let _ = writeln!(text, "{pad}}}");
    }
    text
}

fn value_text(value: &LightValue, pad: &str) -> String {
    match value {
        LightValue::Bool(value) => u8::from(*value).to_string(),
        LightValue::Float(value) => value.to_string(),
        LightValue::Color(color, space) => format!("{} (\n{pad}        colorSpace = \"{space}\"\n{pad}    )", tuple(color)),
        LightValue::Extent([low, high]) => format!("[{}, {}]", tuple(low), tuple(high)),
        LightValue::Matrix(rows) => format!("( {} )", rows.each_ref().map(|row| tuple(row)).join(", ")),
        LightValue::Token(token) => format!("\"{token}\""),
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

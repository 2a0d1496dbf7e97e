//! UsdLux: lamps whose intensity is their radiance.
//!
//! `inputs:normalize` is off, so that the intensity times the colour is radiance whatever the area
//! and the unit of lengths are; exposure is 0, and the temperature off, which could not hold a
//! measured colour. Discs and rectangles lie in the prim's xy-plane and shine along -z.

use std::fmt::Write as _;

use super::{LightShape, StageLight, StageLights, intensity_and_color};
use crate::image::color_interop_id;

/// Returns the text of a layer; it loads its map from beside it.
pub fn stage_lights_text(lights: &StageLights) -> String {
    let (metres, doubt) = lights.metres_per_unit.map_or((1.0, "; metersPerUnit is not measured"), |metres| (metres, ""));
    let space = color_interop_id(lights.color_space);
    let unit = match lights.cd_m2_per_unit {
        Some(1.0) => " in cd/m2 (nits)".to_owned(),
        Some(nits) => format!(" in units of {nits} cd/m2 (nits)"),
        None => " in the units of the data set".to_owned(),
    };
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"Lights\"\n    doc = \"Lights by Luxel: intensity times colour is radiance{unit}, {space}{doubt}\"\n    \
         metersPerUnit = {metres}\n    upAxis = \"Y\"\n)\n\ndef Xform \"Lights\"\n{{\n"
    );
    for (i, light) in lights.lights.iter().enumerate() {
        lamp(&mut text, &format!("Lamp_{}", i + 1), light, space);
    }
    if let Some(dome) = &lights.dome {
        // Writing to a string does not fail. A path between @@@ may hold @.
        let _ = write!(
            text,
            "    def DomeLight \"Rest\"\n    {{\n        float inputs:exposure = 0\n        float inputs:intensity = 1\n        \
             asset inputs:texture:file = @@@{}@@@\n        token inputs:texture:format = \"latlong\"\n    }}\n",
            dome.texture.replace("@@@", "\\@@@")
        );
    }
    text.push_str("}\n");
    text
}

fn lamp(text: &mut String, name: &str, light: &StageLight, space: &str) {
    let (intensity, [r, g, b]) = intensity_and_color(light.radiance);
    let (kind, size, extent) = match light.shape {
        LightShape::Sphere { radius } => ("SphereLight", format!("        float inputs:radius = {radius}\n"), [radius; 3]),
        LightShape::Disk { radius, .. } => ("DiskLight", format!("        float inputs:radius = {radius}\n"), [radius, radius, 0.0]),
        LightShape::Rect { size: [width, height], .. } => {
            let size = format!("        float inputs:height = {height}\n        float inputs:width = {width}\n");
            ("RectLight", size, [0.5 * width, 0.5 * height, 0.0])
        }
    };
    let rows = [light.shape.axes().x_axis, light.shape.axes().y_axis, light.shape.axes().z_axis];
    let rows = rows.map(|row| format!("({}, {}, {}, 0)", row.x, row.y, row.z)).join(", ");
    let [x, y, z] = light.middle.to_array();
    let [ex, ey, ez] = extent;
    let _ = write!(
        text,
        "    def {kind} \"{name}\"\n    {{\n        float3[] extent = [({}, {}, {}), ({ex}, {ey}, {ez})]\n        \
         color3f inputs:color = ({r}, {g}, {b}) (\n            colorSpace = \"{space}\"\n        )\n        \
         bool inputs:enableColorTemperature = 0\n        float inputs:exposure = 0\n        float inputs:intensity = {intensity}\n        \
         bool inputs:normalize = 0\n{size}        matrix4d xformOp:transform = ( {rows}, ({x}, {y}, {z}, 1) )\n        \
         uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
        -ex, -ey, -ez
    );
}

//! Lamps as JSON and as a table.

use std::fmt::Write as _;

use glam::DVec3;
use luxel_io::LightShape;
use serde_json::{Value, json};

use super::SceneLights;

/// Returns the lamps, and portals behind them, as a JSON array: lengths in world units, radiance in
/// those of the data set. Meshes have their points and triangles.
pub fn lights_json(lights: &SceneLights) -> Value {
    let entry = |light: &super::AreaLight| {
        let mut entry = json!({
            "shape": light.shape.name(), "middle": light.middle, "radiance": light.radiance, "intensity": light.intensity,
            "power": light.power, "relative_error": light.error, "cameras": light.cameras, "splats": light.splats,
        });
        add_shape(&mut entry, &light.shape, light.middle);
        entry
    };
    let portal = |portal: &super::Portal| {
        let mut entry = json!({ "shape": PORTAL, "middle": portal.middle });
        add_shape(&mut entry, &portal.shape, portal.middle);
        entry
    };
    lights.lights.iter().map(entry).chain(lights.portals.iter().map(portal)).collect()
}

/// Name of the shape of portals.
const PORTAL: &str = "portal";

fn add_shape(entry: &mut Value, shape: &LightShape, middle: [f64; 3]) {
    match shape {
        LightShape::Sphere { radius } => entry["radius"] = (*radius).into(),
        LightShape::Disk { radius, normal } => {
            entry["radius"] = (*radius).into();
            entry["normal"] = json!(normal.to_array());
        }
        LightShape::Rect { size, normal, along } => {
            entry["size"] = json!(size);
            entry["normal"] = json!(normal.to_array());
            entry["along"] = json!(along.to_array());
        }
        LightShape::Mesh(mesh) => {
            let middle = DVec3::from_array(middle);
            entry["points"] = mesh.points.iter().map(|point| json!((middle + *point).to_array())).collect();
            entry["triangles"] = json!(mesh.triangles);
            entry["mean_area"] = mesh.mean_area.into();
        }
    }
}

/// Returns the lamps, and portals behind them, as comma-separated values with a line of names.
/// Balls have no normal and no height; discs and balls have their radius as width; meshes have no
/// normal and no size, portals no light.
pub fn lights_csv(lights: &SceneLights) -> String {
    let mut text = String::from(
        "lamp,shape,x,y,z,normal_x,normal_y,normal_z,width,height,radiance_r,radiance_g,radiance_b,intensity_r,intensity_g,intensity_b,\
         power_r,power_g,power_b,relative_error,cameras,splats\n",
    );
    for (i, light) in lights.lights.iter().enumerate() {
        let [normal, size] = shape_columns(&light.shape);
        let [middle, radiance, intensity, power] = [light.middle, light.radiance, light.intensity, light.power].map(joined);
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{},{},{middle},{normal},{size},{radiance},{intensity},{power},{},{},{}",
            i + 1,
            light.shape.name(),
            light.error,
            light.cameras,
            light.splats
        );
    }
    for (i, portal) in lights.portals.iter().enumerate() {
        let [normal, size] = shape_columns(&portal.shape);
        let _ = writeln!(text, "{},{PORTAL},{},{normal},{size}{}", lights.lights.len() + i + 1, joined(portal.middle), ",".repeat(12));
    }
    text
}

/// Returns a normal, and width and height.
fn shape_columns(shape: &LightShape) -> [String; 2] {
    match shape {
        LightShape::Sphere { radius } => [",,".to_owned(), format!("{radius},")],
        LightShape::Disk { radius, normal } => [joined(normal.to_array()), format!("{radius},")],
        LightShape::Rect { size: [width, height], normal, .. } => [joined(normal.to_array()), format!("{width},{height}")],
        LightShape::Mesh(_) => [",,".to_owned(), ",".to_owned()],
    }
}

fn joined(values: [f64; 3]) -> String {
    values.map(|v| v.to_string()).join(",")
}

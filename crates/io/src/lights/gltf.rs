//! KHR_lights_punctual: lamps without size.
//!
//! A ball becomes a point light, a flat lamp a spot light whose cone is the half space. Intensities
//! are radiance times area, along the normal of a flat lamp: candela where the radiance is nits.
//! A spot light falls off by the square of the cosine, a flat lamp by the cosine.
//! The extras state shape and radiance.

use std::path::Path;

use glam::{DMat3, DQuat};
use serde_json::{Value, json};

use super::{LightShape, StageLights, intensity_and_color};
use crate::IoError;
use crate::image::color_interop_id;

const GLB_MAGIC: u32 = 0x4654_6c67;
const CHUNK_JSON: u32 = 0x4e4f_534a;

/// Encodes lamps; `name` is for errors. The map is left out: glTF has none.
///
/// # Errors
/// Lamps without end.
pub fn encode_lights_glb(name: &Path, lights: &StageLights) -> Result<Vec<u8>, IoError> {
    let punctual: Vec<Value> = lights
        .lights
        .iter()
        .enumerate()
        .map(|(i, light)| {
            let (intensity, color) = intensity_and_color(light.radiance.map(|l| l * light.shape.area()));
            let mut punctual = json!({ "name": format!("Lamp_{}", i + 1), "color": color, "intensity": intensity, "type": "point" });
            let mut extras = json!({ "shape": light.shape.name(), "radiance": light.radiance });
            match light.shape {
                LightShape::Sphere { radius } => extras["radius"] = radius.into(),
                LightShape::Disk { radius, .. } => extras["radius"] = radius.into(),
                LightShape::Rect { size, .. } => extras["size"] = json!(size),
            }
            if !matches!(light.shape, LightShape::Sphere { .. }) {
                punctual["type"] = "spot".into();
                punctual["spot"] = json!({ "innerConeAngle": 0.0, "outerConeAngle": std::f64::consts::FRAC_PI_2 });
            }
            punctual["extras"] = extras;
            punctual
        })
        .collect();
    let nodes: Vec<Value> = lights
        .lights
        .iter()
        .enumerate()
        .map(|(i, light)| {
            let turn = DQuat::from_mat3(&DMat3::from_cols(light.shape.axes().x_axis, light.shape.axes().y_axis, light.shape.axes().z_axis));
            json!({
                "name": format!("Lamp_{}", i + 1), "translation": light.middle.to_array(), "rotation": turn.to_array(),
                "extensions": { "KHR_lights_punctual": { "light": i } },
            })
        })
        .collect();
    let mut document = json!({
        "asset": { "version": "2.0", "generator": concat!("Luxel ", env!("CARGO_PKG_VERSION")) },
        "extras": { "luxel": { "colorSpace": color_interop_id(lights.color_space), "metresPerUnit": lights.metres_per_unit, "cdM2PerUnit": lights.cd_m2_per_unit } },
        "scene": 0, "scenes": [{}],
    });
    // Empty arrays are not allowed.
    if !nodes.is_empty() {
        document["extensionsUsed"] = json!(["KHR_lights_punctual"]);
        document["extensions"] = json!({ "KHR_lights_punctual": { "lights": punctual } });
        document["scenes"] = json!([{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }]);
        document["nodes"] = nodes.into();
    }
    let mut json = serde_json::to_vec(&document).map_err(|e| IoError::invalid(name, e))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = u32::try_from(json.len() + 20).map_err(|e| IoError::unsupported(name, e))?;
    let mut bytes = Vec::with_capacity(json.len() + 20);
    for word in [GLB_MAGIC, 2, length, length - 20, CHUNK_JSON] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(json);
    Ok(bytes)
}

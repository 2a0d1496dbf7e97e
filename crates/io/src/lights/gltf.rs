//! KHR_lights_punctual: lamps without size.
//!
//! A ball or a mesh becomes a point light, a flat lamp a spot light whose cone is the half space.
//! Intensities are radiance times area, along the normal of a flat lamp, of a mesh the mean of all
//! directions: candela where the radiance is nits.
//! A spot light falls off by the square of the cosine, a flat lamp by the cosine.
//! The extras state shape and radiance.

use std::path::Path;

use glam::DQuat;
use serde_json::{Value, json};

use super::{LightShape, StageLight, StageLights, intensity_and_color};
use crate::IoError;
use crate::gltf::{CHUNK_JSON, GLB_MAGIC};
use crate::image::color_interop_id;

/// Khronos' extension.
pub(crate) const PUNCTUAL: &str = "KHR_lights_punctual";

/// Returns the lamps as the extension lists them.
pub(crate) fn punctual_lights(lights: &StageLights) -> Vec<Value> {
    let punctual = |(i, light): (usize, &StageLight)| {
        let (intensity, color) = intensity_and_color(light.radiance.map(|l| l * light.shape.area()));
        let mut punctual = json!({ "name": name(i), "color": color, "intensity": intensity, "type": "point" });
        let mut extras = json!({ "shape": light.shape.name(), "radiance": light.radiance });
        match &light.shape {
            LightShape::Sphere { radius } | LightShape::Disk { radius, .. } => extras["radius"] = (*radius).into(),
            LightShape::Rect { size, .. } => extras["size"] = json!(size),
            LightShape::Mesh(mesh) => extras["bounds"] = json!(mesh.bounds().map(|corner| corner.to_array())),
        }
        if matches!(light.shape, LightShape::Disk { .. } | LightShape::Rect { .. }) {
            punctual["type"] = "spot".into();
            punctual["spot"] = json!({ "innerConeAngle": 0.0, "outerConeAngle": std::f64::consts::FRAC_PI_2 });
        }
        punctual["extras"] = extras;
        punctual
    };
    lights.lights.iter().enumerate().map(punctual).collect()
}

/// Returns the nodes that place [`punctual_lights`].
pub(crate) fn light_nodes(lights: &StageLights) -> Vec<Value> {
    let node = |(i, light): (usize, &StageLight)| {
        let turn = DQuat::from_mat3(&light.shape.axes());
        json!({
            "name": name(i), "translation": light.middle.to_array(), "rotation": turn.to_array(),
            "extensions": { PUNCTUAL: { "light": i } },
        })
    };
    lights.lights.iter().enumerate().map(node).collect()
}

/// Returns what the document says about the lamps' units.
pub(crate) fn light_extras(lights: &StageLights) -> Value {
    let space = color_interop_id(lights.color_space);
    json!({ "luxel": { "colorSpace": space, "metresPerUnit": lights.metres_per_unit, "cdM2PerUnit": lights.cd_m2_per_unit } })
}

fn name(i: usize) -> String {
    format!("Lamp_{}", i + 1)
}

/// Encodes lamps; `name` is for errors. The map is left out: glTF has none.
///
/// # Errors
/// Lamps without end.
pub fn encode_lights_glb(name: &Path, lights: &StageLights) -> Result<Vec<u8>, IoError> {
    let nodes = light_nodes(lights);
    let mut document = json!({
        "asset": { "version": "2.0", "generator": concat!("Luxel ", env!("CARGO_PKG_VERSION")) },
        "extras": light_extras(lights),
        "scene": 0, "scenes": [{}],
    });
    // Empty arrays are not allowed.
    if !nodes.is_empty() {
        document["extensionsUsed"] = json!([PUNCTUAL]);
        document["extensions"] = json!({ PUNCTUAL: { "lights": punctual_lights(lights) } });
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

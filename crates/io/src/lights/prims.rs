//! The prims of UsdLux that lamps and their map become, for text and the binary form.
//!
//! `inputs:normalize` is off, so that the intensity times the colour is radiance whatever the area
//! and the unit of lengths are; exposure is 0, and the temperature off, which could not hold a
//! measured colour. Discs, rectangles and portals lie in the prim's xy-plane and shine along -z.

use glam::DVec3;

use super::{LightShape, StageDome, StageLight, StageLights, StagePortal, intensity_and_color};
use crate::image::color_interop_id;

/// Name of the prim around them.
pub(crate) const LIGHTS: &str = "Lights";

/// A prim of a light.
pub(crate) struct LightPrim {
    pub(crate) type_name: &'static str,
    pub(crate) name: String,
    pub(crate) attributes: Vec<LightAttribute>,
    /// Names of the prims beside it that are its portals.
    pub(crate) portals: Vec<String>,
}

/// The relationship of a map to its portals.
pub(crate) const PORTALS: &str = "portals";

/// An attribute of a light.
pub(crate) struct LightAttribute {
    pub(crate) type_name: &'static str,
    pub(crate) name: &'static str,
    pub(crate) value: LightValue,
}

/// The value of an attribute; its numbers are 32-bit floats but for matrices.
pub(crate) enum LightValue {
    Bool(bool),
    Float(f64),
    /// A colour, and the name of its space.
    Color([f64; 3], &'static str),
    /// Lower and upper corner.
    Extent([[f64; 3]; 2]),
    Matrix([[f64; 4]; 4]),
    Token(&'static str),
    /// Names that do not change over time.
    UniformTokens(&'static [&'static str]),
    Asset(String),
}

impl LightAttribute {
    fn new(type_name: &'static str, name: &'static str, value: LightValue) -> Self {
        Self { type_name, name, value }
    }

    fn float(name: &'static str, value: f64) -> Self {
        Self::new("float", name, LightValue::Float(value))
    }
}

/// Returns the prims of lamps, and of the map behind its portals if there is one.
pub(crate) fn light_prims(lights: &StageLights) -> Vec<LightPrim> {
    let space = color_interop_id(lights.color_space);
    let lamp = |(i, light): (usize, &StageLight)| lamp(format!("Lamp_{}", i + 1), light, space);
    let mut prims: Vec<LightPrim> = lights.lights.iter().enumerate().map(lamp).collect();
    if let Some(map) = &lights.dome {
        let portal = |(i, portal): (usize, &StagePortal)| portal_prim(format!("Portal_{}", i + 1), portal);
        let portals: Vec<LightPrim> = lights.portals.iter().enumerate().map(portal).collect();
        let names = portals.iter().map(|portal| portal.name.clone()).collect();
        prims.extend(portals);
        prims.push(dome(map, names));
    }
    prims
}

/// Describes what the lights' numbers are.
pub(crate) fn lights_documentation(lights: &StageLights) -> String {
    let unit = match lights.cd_m2_per_unit {
        Some(1.0) => "in cd/m2 (nits)".to_owned(),
        Some(nits) => format!("in units of {nits} cd/m2 (nits)"),
        None => "in the units of the data set".to_owned(),
    };
    format!("Lights by Luxel: intensity times colour is radiance {unit}, {}", color_interop_id(lights.color_space))
}

fn lamp(name: String, light: &StageLight, space: &'static str) -> LightPrim {
    let (intensity, color) = intensity_and_color(light.radiance);
    let (type_name, sizes, corner) = match light.shape {
        LightShape::Sphere { radius } => ("SphereLight", vec![("inputs:radius", radius)], [radius; 3]),
        LightShape::Disk { radius, .. } => ("DiskLight", vec![("inputs:radius", radius)], [radius, radius, 0.0]),
        LightShape::Rect { size: [width, height], .. } => {
            ("RectLight", vec![("inputs:height", height), ("inputs:width", width)], [0.5 * width, 0.5 * height, 0.0])
        }
    };
    let mut attributes = vec![
        LightAttribute::new("float3[]", "extent", LightValue::Extent([corner.map(|v| -v), corner])),
        LightAttribute::new("color3f", "inputs:color", LightValue::Color(color, space)),
        LightAttribute::new("bool", "inputs:enableColorTemperature", LightValue::Bool(false)),
        LightAttribute::float("inputs:exposure", 0.0),
        LightAttribute::float("inputs:intensity", intensity),
        LightAttribute::new("bool", "inputs:normalize", LightValue::Bool(false)),
    ];
    attributes.extend(sizes.into_iter().map(|(name, length)| LightAttribute::float(name, length)));
    attributes.extend(transform(light.shape, light.middle));
    LightPrim { type_name, name, attributes, portals: Vec::new() }
}

/// Returns the attributes that put a shape at a place.
fn transform(shape: LightShape, middle: DVec3) -> [LightAttribute; 2] {
    let (axes, row) = (shape.axes(), |v: DVec3, w: f64| [v.x, v.y, v.z, w]);
    let matrix = [row(axes.x_axis, 0.0), row(axes.y_axis, 0.0), row(axes.z_axis, 0.0), row(middle, 1.0)];
    [
        LightAttribute::new("matrix4d", "xformOp:transform", LightValue::Matrix(matrix)),
        LightAttribute::new("token[]", "xformOpOrder", LightValue::UniformTokens(&["xformOp:transform"])),
    ]
}

fn portal_prim(name: String, portal: &StagePortal) -> LightPrim {
    let [width, height] = match portal.shape {
        LightShape::Rect { size, .. } => size,
        LightShape::Sphere { radius } | LightShape::Disk { radius, .. } => [2.0 * radius; 2],
    };
    let corner = [0.5 * width, 0.5 * height, 0.0];
    let mut attributes = vec![
        LightAttribute::new("float3[]", "extent", LightValue::Extent([corner.map(|v| -v), corner])),
        LightAttribute::float("inputs:height", height),
        LightAttribute::float("inputs:width", width),
    ];
    attributes.extend(transform(portal.shape, portal.middle));
    LightPrim { type_name: "PortalLight", name, attributes, portals: Vec::new() }
}

fn dome(dome: &StageDome, portals: Vec<String>) -> LightPrim {
    let attributes = vec![
        LightAttribute::float("inputs:exposure", 0.0),
        LightAttribute::float("inputs:intensity", 1.0),
        LightAttribute::new("asset", "inputs:texture:file", LightValue::Asset(dome.texture.clone())),
        LightAttribute::new("token", "inputs:texture:format", LightValue::Token("latlong")),
    ];
    LightPrim { type_name: "DomeLight", name: "Rest".to_owned(), attributes, portals }
}

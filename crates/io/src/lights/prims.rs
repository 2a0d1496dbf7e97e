//! The prims of UsdLux that lamps and their map become, for text and the binary form.
//!
//! `inputs:normalize` is off, so that the intensity times the colour is radiance whatever the area
//! and the unit of lengths are; exposure is 0, and the temperature off, which could not hold a
//! measured colour. Discs, rectangles and portals lie in the prim's xy-plane and shine along -z.
//! A mesh has a `MeshLightAPI`, and a material of the same radiance for programs that know none of
//! it, which `light:materialSyncMode` keeps out of the light of those that do.

use glam::DVec3;

use super::{LightMesh, LightShape, StageDome, StageLight, StageLights, StagePortal, intensity_and_color};
use crate::image::color_interop_id;

/// Name of the prim around them.
pub(crate) const LIGHTS: &str = "Lights";

/// A prim of a light, or within one.
#[derive(Default)]
pub(crate) struct LightPrim {
    pub(crate) type_name: &'static str,
    pub(crate) name: String,
    /// Schemas that are applied to it.
    pub(crate) schemas: &'static [&'static str],
    pub(crate) attributes: Vec<LightAttribute>,
    pub(crate) links: Vec<LightLink>,
    /// Prims within it.
    pub(crate) children: Vec<Self>,
}

/// A property that names others. Paths are seen from its prim.
pub(crate) enum LightLink {
    /// A relationship to prims.
    Relationship { name: &'static str, targets: Vec<String> },
    /// An output of a shader, which it takes from another one if that is given.
    Output { name: &'static str, from: Option<String> },
}

impl LightLink {
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Relationship { name, .. } | Self::Output { name, .. } => name,
        }
    }
}

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
    Int(i32),
    /// A colour, and the name of its space.
    Color([f64; 3], &'static str),
    /// Lower and upper corner.
    Extent([[f64; 3]; 2]),
    Matrix([[f64; 4]; 4]),
    /// Numbers of the corners of triangles, or of their sides.
    Ints(Vec<i32>),
    /// Points.
    Points(Vec<DVec3>),
    Token(&'static str),
    /// A name that does not change over time.
    UniformToken(&'static str),
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
    let around = |corner: [f64; 3]| [corner.map(|v| -v), corner];
    let (type_name, sizes, extent) = match &light.shape {
        LightShape::Sphere { radius } => ("SphereLight", vec![("inputs:radius", *radius)], around([*radius; 3])),
        LightShape::Disk { radius, .. } => ("DiskLight", vec![("inputs:radius", *radius)], around([*radius, *radius, 0.0])),
        LightShape::Rect { size: [width, height], .. } => {
            ("RectLight", vec![("inputs:height", *height), ("inputs:width", *width)], around([0.5 * width, 0.5 * height, 0.0]))
        }
        LightShape::Mesh(mesh) => ("Mesh", Vec::new(), mesh.bounds().map(|corner| corner.to_array())),
    };
    let mut attributes = vec![
        LightAttribute::new("float3[]", "extent", LightValue::Extent(extent)),
        LightAttribute::new("color3f", "inputs:color", LightValue::Color(color, space)),
        LightAttribute::new("bool", "inputs:enableColorTemperature", LightValue::Bool(false)),
        LightAttribute::float("inputs:exposure", 0.0),
        LightAttribute::float("inputs:intensity", intensity),
        LightAttribute::new("bool", "inputs:normalize", LightValue::Bool(false)),
    ];
    attributes.extend(sizes.into_iter().map(|(name, length)| LightAttribute::float(name, length)));
    attributes.extend(transform(&light.shape, light.middle));
    let mut prim = LightPrim { type_name, name, attributes, ..LightPrim::default() };
    if let LightShape::Mesh(mesh) = &light.shape {
        add_mesh(&mut prim, mesh, LightValue::Color(light.radiance, space));
    }
    prim
}

/// Name of the material within a lamp that is a mesh, and of its shader.
const MATERIAL: &str = "Glow";
const SHADER: &str = "Surface";
const SURFACE: &str = "outputs:surface";

/// Adds a mesh to its lamp, and a material that shines like it.
fn add_mesh(prim: &mut LightPrim, mesh: &LightMesh, radiance: LightValue) {
    let counts = LightValue::Ints(vec![3; mesh.triangles.len()]);
    let corners = LightValue::Ints(mesh.triangles.as_flattened().iter().map(|corner| *corner as i32).collect());
    prim.schemas = &["MeshLightAPI", "MaterialBindingAPI"];
    prim.attributes.extend([
        LightAttribute::new("token", "light:materialSyncMode", LightValue::UniformToken("noMaterialResponse")),
        LightAttribute::new("int[]", "faceVertexCounts", counts),
        LightAttribute::new("int[]", "faceVertexIndices", corners),
        LightAttribute::new("point3f[]", "points", LightValue::Points(mesh.points.clone())),
        LightAttribute::new("token", "subdivisionScheme", LightValue::UniformToken("none")),
    ]);
    prim.links = vec![LightLink::Relationship { name: "material:binding", targets: vec![MATERIAL.to_owned()] }];
    let black = || LightValue::Color([0.0; 3], "lin_rec709_scene");
    let shader = LightPrim {
        type_name: "Shader",
        name: SHADER.to_owned(),
        attributes: vec![
            LightAttribute::new("token", "info:id", LightValue::UniformToken("UsdPreviewSurface")),
            LightAttribute::new("color3f", "inputs:diffuseColor", black()),
            LightAttribute::new("color3f", "inputs:emissiveColor", radiance),
            LightAttribute::float("inputs:roughness", 1.0),
            LightAttribute::new("color3f", "inputs:specularColor", black()),
            LightAttribute::new("int", "inputs:useSpecularWorkflow", LightValue::Int(1)),
        ],
        links: vec![LightLink::Output { name: SURFACE, from: None }],
        ..LightPrim::default()
    };
    prim.children = vec![LightPrim {
        type_name: "Material",
        name: MATERIAL.to_owned(),
        links: vec![LightLink::Output { name: SURFACE, from: Some(format!("{SHADER}.{SURFACE}")) }],
        children: vec![shader],
        ..LightPrim::default()
    }];
}

/// Returns the attributes that put a shape at a place.
fn transform(shape: &LightShape, middle: DVec3) -> [LightAttribute; 2] {
    let (axes, row) = (shape.axes(), |v: DVec3, w: f64| [v.x, v.y, v.z, w]);
    let matrix = [row(axes.x_axis, 0.0), row(axes.y_axis, 0.0), row(axes.z_axis, 0.0), row(middle, 1.0)];
    [
        LightAttribute::new("matrix4d", "xformOp:transform", LightValue::Matrix(matrix)),
        LightAttribute::new("token[]", "xformOpOrder", LightValue::UniformTokens(&["xformOp:transform"])),
    ]
}

fn portal_prim(name: String, portal: &StagePortal) -> LightPrim {
    let [width, height] = match &portal.shape {
        LightShape::Rect { size, .. } => *size,
        LightShape::Sphere { radius } | LightShape::Disk { radius, .. } => [2.0 * radius; 2],
        LightShape::Mesh(mesh) => [mesh.mean_area.sqrt(); 2],
    };
    let corner = [0.5 * width, 0.5 * height, 0.0];
    let mut attributes = vec![
        LightAttribute::new("float3[]", "extent", LightValue::Extent([corner.map(|v| -v), corner])),
        LightAttribute::float("inputs:height", height),
        LightAttribute::float("inputs:width", width),
    ];
    attributes.extend(transform(&portal.shape, portal.middle));
    LightPrim { type_name: "PortalLight", name, attributes, ..LightPrim::default() }
}

fn dome(dome: &StageDome, portals: Vec<String>) -> LightPrim {
    let attributes = vec![
        LightAttribute::float("inputs:exposure", 0.0),
        LightAttribute::float("inputs:intensity", 1.0),
        LightAttribute::new("asset", "inputs:texture:file", LightValue::Asset(dome.texture.clone())),
        LightAttribute::new("token", "inputs:texture:format", LightValue::Token("latlong")),
    ];
    let targets: Vec<String> = portals.iter().map(|name| format!("../{name}")).collect();
    let links = if targets.is_empty() { Vec::new() } else { vec![LightLink::Relationship { name: "portals", targets }] };
    LightPrim { type_name: "DomeLight", name: "Rest".to_owned(), attributes, links, ..LightPrim::default() }
}

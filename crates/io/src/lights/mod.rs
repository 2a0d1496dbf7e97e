//! Lamps for other programs: OpenUSD's UsdLux, and glTF's KHR_lights_punctual.
//!
//! In: balls, discs, rectangles and meshes with the radiance of their surface, and the map of all
//! other light; a stage with +Y up. Out: text of an OpenUSD layer, or a binary glTF without meshes;
//! or what the writers of splats put beside these. Degenerate: without lamps both are valid and
//! hold the map, or nothing.

mod gltf;
mod mesh;
mod prims;
mod usd;

use std::path::Path;

use glam::{DMat3, DVec3};
use luxel_core::ColorSpace;

pub use self::gltf::encode_lights_glb;
pub(crate) use self::gltf::{PUNCTUAL, light_extras, light_nodes, punctual_lights};
pub use self::mesh::LightMesh;
pub(crate) use self::prims::{LIGHTS, LightAttribute, LightLink, LightPrim, LightValue, light_prims, lights_documentation};
pub(crate) use self::usd::lights_prim_text;
pub use self::usd::stage_lights_text;
use crate::{IoError, write_atomically};

/// The shape of a lamp. Flat ones shine on the side of their normal only.
#[derive(Clone, Debug, PartialEq)]
pub enum LightShape {
    /// A ball.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A disc.
    Disk {
        /// Radius.
        radius: f64,
        /// Unit normal.
        normal: DVec3,
    },
    /// A rectangle.
    Rect {
        /// Length along `along`, and across it.
        size: [f64; 2],
        /// Unit normal.
        normal: DVec3,
        /// Unit vector along the first side.
        along: DVec3,
    },
    /// A closed surface.
    Mesh(LightMesh),
}

impl LightShape {
    /// Returns the shape after a rotation.
    pub fn turned(self, rotation: DMat3) -> Self {
        match self {
            Self::Sphere { .. } => self,
            Self::Disk { radius, normal } => Self::Disk { radius, normal: rotation * normal },
            Self::Rect { size, normal, along } => Self::Rect { size, normal: rotation * normal, along: rotation * along },
            Self::Mesh(mesh) => Self::Mesh(mesh.turned(rotation)),
        }
    }

    /// Returns the shape with its lengths times a factor.
    pub fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Sphere { radius } => Self::Sphere { radius: factor * radius },
            Self::Disk { radius, normal } => Self::Disk { radius: factor * radius, normal },
            Self::Rect { size, normal, along } => Self::Rect { size: size.map(|side| factor * side), normal, along },
            Self::Mesh(mesh) => Self::Mesh(mesh.scaled(factor)),
        }
    }

    /// Returns the name that tables have.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Sphere { .. } => "sphere",
            Self::Disk { .. } => "disk",
            Self::Rect { .. } => "rectangle",
            Self::Mesh(_) => "mesh",
        }
    }

    /// Returns the area that is seen along the normal, of a ball from anywhere, of a mesh in the
    /// mean of all directions.
    pub fn area(&self) -> f64 {
        match self {
            Self::Sphere { radius } | Self::Disk { radius, .. } => std::f64::consts::PI * radius * radius,
            Self::Rect { size, .. } => size[0] * size[1],
            Self::Mesh(mesh) => mesh.mean_area,
        }
    }

    /// Returns axes x, y and z of the lamp, which shines along -z.
    fn axes(&self) -> DMat3 {
        let (normal, along) = match self {
            Self::Sphere { .. } | Self::Mesh(_) => return DMat3::IDENTITY,
            Self::Disk { normal, .. } => (*normal, normal.any_orthonormal_vector()),
            Self::Rect { normal, along, .. } => (*normal, *along),
        };
        DMat3::from_cols(along, along.cross(normal), -normal)
    }
}

/// A lamp in the coordinates of a stage.
#[derive(Clone, Debug, PartialEq)]
pub struct StageLight {
    /// Its middle.
    pub middle: DVec3,
    /// Its shape.
    pub shape: LightShape,
    /// Radiance of its surface.
    pub radiance: [f64; 3],
}

/// An opening through which light of the map falls, in the coordinates of a stage.
#[derive(Clone, Debug, PartialEq)]
pub struct StagePortal {
    /// Its middle.
    pub middle: DVec3,
    /// Its shape; the normal is where the light goes.
    pub shape: LightShape,
}

/// The map of all other light: latitude-longitude, its top at +y.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageDome {
    /// Path of the OpenEXR file from the layer's folder, with `/`.
    pub texture: String,
}

/// Lamps and the map of all other light.
#[derive(Clone, Debug, PartialEq)]
pub struct StageLights {
    /// The lamps.
    pub lights: Vec<StageLight>,
    /// The map, if there is one.
    pub dome: Option<StageDome>,
    /// Portals of the map, which OpenUSD alone has; they are left out without a map.
    pub portals: Vec<StagePortal>,
    /// Metres of a unit; `None` if nothing states it.
    pub metres_per_unit: Option<f64>,
    /// Luminance of a unit of radiance, cd/m2; `None` if nothing states it.
    pub cd_m2_per_unit: Option<f64>,
    /// Primaries of radiance, linear.
    pub color_space: ColorSpace,
}

/// Writes lamps as OpenUSD (`.usda`) or glTF (`.glb`), by the ending of the name, whole or not at
/// all; folders are made as needed.
///
/// # Errors
/// Another ending, or the file system's refusal.
pub fn write_lights(path: &Path, lights: &StageLights) -> Result<(), IoError> {
    let bytes = match path.extension().and_then(|extension| extension.to_str()) {
        Some("usda") => stage_lights_text(lights).into_bytes(),
        Some("glb") => encode_lights_glb(path, lights)?,
        _ => return Err(IoError::unsupported(path, "not a format of lamps, expected .usda or .glb")),
    };
    write_atomically(path, |out| out.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))
}

/// Returns the largest channel, and the colour that it multiplies.
fn intensity_and_color(radiance: [f64; 3]) -> (f64, [f64; 3]) {
    let most = radiance.into_iter().fold(0.0, f64::max);
    let color = radiance.map(|c| if most > 0.0 { c.max(0.0) / most } else { 1.0 });
    (most, color)
}

#[cfg(test)]
pub(crate) mod tests;

//! OpenUSD: splats as a `ParticleField3DGaussianSplat` of usdVol (OpenUSD 26.03 and later), as
//! text.
//!
//! Attributes: `point3f[] positions`, `float3[] scales` (standard deviations), `quatf[]
//! orientations` (w x y z), `float[] opacities` (0..1), `int radiance:sphericalHarmonicsDegree`,
//! `float3[] radiance:sphericalHarmonicsCoefficients` (of each splat in turn, 3D Gaussian
//! splatting's order and offset of 1/2). All floats are written so that they are read back to the
//! bit. The colour space is in `colorSpace:name` (ColorSpaceAPI), the up axis is Y, and
//! `customLayerData` has the record that Luxel needs to restore the bake.
//!
//! Reading: the first such prim of a text layer; positions and the rest may be their half-float
//! twins (`positionsh`, ...). Nothing is composed: references, variants and transforms of prims are
//! other programs' business (`usdcat --flatten`); a transform is an error, not ignored.

mod cameras;
mod field;
mod lexer;
mod reader;
mod writer;

use luxel_core::ColorSpace;

pub(crate) use cameras::UsdCamera;
pub(crate) use cameras::read_cameras;
pub use cameras::{UsdCameras, decode_usd_cameras};
pub(crate) use reader::read_scene_file;
pub use reader::{decode_usda, read_usda};
pub use writer::{encode_usda, write_usda};

/// The schema.
const PRIM_TYPE: &str = "ParticleField3DGaussianSplat";
/// Attribute of a place that a prim is moved to.
const TRANSLATE: &str = "xformOp:translate";

/// Returns the name of a colour space in OpenUSD (the interoperability forum's).
fn usd_name(space: ColorSpace) -> &'static str {
    match space {
        ColorSpace::LinearRec709 => "lin_rec709_scene",
        ColorSpace::LinearDisplayP3 => "lin_p3d65_scene",
        ColorSpace::LinearRec2020 => "lin_rec2020_scene",
        ColorSpace::Aces2065 => "lin_ap0_scene",
        ColorSpace::AcesCg => "lin_ap1_scene",
    }
}

/// Name of the colours of a display bake.
const DISPLAY_SPACE: &str = "srgb_rec709_scene";

#[cfg(test)]
mod tests;

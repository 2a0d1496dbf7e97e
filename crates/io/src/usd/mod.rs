//! OpenUSD: splats as a `ParticleField3DGaussianSplat` of usdVol (OpenUSD 26.03 and later), as
//! text, in the binary form, and in packages.
//!
//! Attributes: `point3f[] positions`, `float3[] scales` (standard deviations), `quatf[]
//! orientations` (w x y z), `float[] opacities` (0..1), `int radiance:sphericalHarmonicsDegree`,
//! `float3[] radiance:sphericalHarmonicsCoefficients` (of each splat in turn, 3D Gaussian
//! splatting's order and offset of 1/2). All floats are written so that they are read back to the
//! bit. The colour space is in `colorSpace:name` (ColorSpaceAPI), the up axis is Y, and
//! `customLayerData` has the record that Luxel needs to restore the bake. With lights, the splats'
//! prim and `Lights` are within `Scene`. Edited scenes have two
//! attributes of this program beside them: `float[] luxel:gain`, the gains of edits, and `float3[]
//! luxel:trainedCoefficients`, the harmonics before them, which cut-offs follow.
//!
//! Reading: all such prims of a layer, where the transforms of the prims around them and their own
//! put them, that are active, visible and rendered; positions and the rest may be their half-float
//! twins (`positionsh`, ...). Nothing is composed: references and variants are other programs'
//! business (`usdcat --flatten`), which a warning says.

mod binary;
mod camera_layer;
mod cameras;
mod field;
mod lexer;
mod mesh;
mod reader;
mod shown;
mod values;
mod writer;

use luxel_core::ColorSpace;

use crate::image::color_interop_id;

pub(crate) use binary::{MAGIC as BINARY_MAGIC, PACKAGE_MAGIC};
pub use camera_layer::{StageCameras, StageChoice, StageMotion, decode_stage_cameras, is_usd, stage_cameras_text, write_stage_cameras};
pub(crate) use cameras::UsdCamera;
pub(crate) use cameras::read_cameras;
pub use cameras::{UsdCameras, decode_usd_cameras};
pub(crate) use mesh::{write_mesh_binary, write_mesh_package, write_mesh_text};
pub(crate) use reader::{decode_binary_file, read_binary_file, read_scene_file};
pub use reader::{decode_usda, decode_usdc, read_usda};
pub use writer::{PackagedFile, encode_usda, encode_usdc, write_usda, write_usdc, write_usdz};

/// Name of the splats' prim.
const SPLATS: &str = "Splats";
/// Name of the prim around splats and lights.
const SCENE: &str = "Scene";
/// The schema.
const PRIM_TYPE: &str = "ParticleField3DGaussianSplat";
/// Attribute of a place that a prim is moved to.
const TRANSLATE: &str = "xformOp:translate";
/// Attribute of the order of transforms.
const ORDER: &str = "xformOpOrder";
/// Attribute of the gains of edits, one for each splat.
const GAIN: &str = "luxel:gain";
/// Attribute of the harmonics before the gains of edits, as many as of the radiance.
const TRAINED: &str = "luxel:trainedCoefficients";

/// Returns the name of a colour space in OpenUSD (the interoperability forum's).
fn usd_name(space: ColorSpace) -> &'static str {
    match space {
        ColorSpace::DisplaySrgb => DISPLAY_SPACE,
        linear => color_interop_id(linear),
    }
}

/// Name of the colours of a display bake.
const DISPLAY_SPACE: &str = "srgb_rec709_scene";
/// The name that other programs write for the same.
const OTHER_DISPLAY_SPACE: &str = "srgb_rec709_display";

/// Returns the colour space of a name of OpenUSD; the error names those that are known.
fn color_space_named(name: &str) -> Result<ColorSpace, String> {
    // Light of a display is light.
    let scene = name.strip_suffix("_display").map_or(name.to_owned(), |base| format!("{base}_scene"));
    let known = ColorSpace::ALL.into_iter().find(|space| usd_name(*space) == scene);
    known.or_else(|| (scene == DISPLAY_SPACE).then_some(ColorSpace::DisplaySrgb)).ok_or_else(|| {
        let names = ColorSpace::ALL.map(usd_name).join(", ");
        format!("colour space {name:?}, expected one of {names}, {OTHER_DISPLAY_SPACE}; convert the splats' colours")
    })
}

#[cfg(test)]
mod tests;

//! glTF: splats by KHR_gaussian_splatting, in one binary file (.glb).
//!
//! A primitive of points with attributes `POSITION`, `KHR_gaussian_splatting:ROTATION` (x y z w),
//! `:SCALE` (standard deviations), `:OPACITY` (0..1), `:SH_DEGREE_l_COEF_n` (3D Gaussian
//! splatting's order and offset of 1/2), and `COLOR_0` for viewers without splats; +Y is up. The
//! extension knows two colour spaces: `srgb_rec709_display`, a display bake, and
//! `lin_rec709_display`, which a linear bake in linear Rec.709 is written as.
//!
//! [`EXTENSION`] within that extension holds the radiance model exactly: `colorModel`,
//! `colorSpace`, `radianceScale`, `raster` as in the PLY's comments, and `attributes`, accessors of
//! f32 that viewers do not load: `SH_n` (VEC3, n from 0 to K - 1: chromaticity or radiance
//! harmonics), `RAW_LUMINANCE_n` (SCALAR), of an edited scene `GAIN` (SCALAR), and where a
//! smoothing filter makes them differ, `FILTER`, `OPACITY_LOGIT` (SCALAR) and `LOG_SCALE` (VEC3).
//!
//! Reading: every primitive of splats in the scene, transformed by its nodes (turns, uniform
//! scales, translations); floats or normalised integers. The exact model takes precedence over the
//! display bake. External buffers, sparse accessors and compression extensions are refused.

mod accessor;
mod conventions;
mod document;
mod reader;
mod writer;

pub(crate) use reader::read_scene_file;
pub use reader::{decode_glb, read_glb};
pub use writer::{encode_glb, write_glb};

/// Khronos' extension.
const KHR: &str = "KHR_gaussian_splatting";
/// Ours within it.
const EXTENSION: &str = "LUXEL_gaussian_splatting_radiance";

pub(crate) const GLB_MAGIC: u32 = 0x4654_6c67;
pub(crate) const CHUNK_JSON: u32 = 0x4e4f_534a;
pub(crate) const CHUNK_BIN: u32 = 0x004e_4942;
pub(crate) const FLOAT: u32 = 5126;

#[cfg(test)]
mod tests;

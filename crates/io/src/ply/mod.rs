//! PLY: scenes that any 3D Gaussian splatting viewer opens, and point clouds.
//!
//! A scene written here is binary little endian with one element `vertex`, N rows of f32. Two
//! layers share a row:
//! - The standard properties of 3D Gaussian splatting (`x y z nx ny nz f_dc_* f_rest_* opacity
//!   scale_* rot_*`, `f_rest_*` channel-major) hold a display bake: tone-mapped, sRGB-encoded,
//!   fitted to harmonics of degree <= 3, any 3D smoothing filter applied to scale and opacity. See
//!   [`crate::bake`].
//! - `lcd_*` properties hold the model exactly: `lcd_l_m` raw luminance, `lcd_c_{3m+channel}`
//!   chromaticity harmonics (`lcd_s_*` radiance harmonics for `ColorModel::Sh`, `lcd_g_*` those of
//!   its logarithm for `ColorModel::LogSh`, `lcd_m_*` those of all lights for `ColorModel::Mix`,
//!   whose gains are among `lcd_l_*`), the deviation of a smoothing filter `lcd_filter`, the gains
//!   of edits `lcd_gain`, and where the filter or a refined bake makes the standard ones differ,
//!   `lcd_opacity`, `lcd_log_scale_*`. Their names keep away from `f_rest_`, `scale_` and `rot`,
//!   which the original reader counts by prefix.
//!
//! Comments `luxel KEY VALUE` of the header hold version, colour space, colour model, radiance
//! scale and raster configuration, and one `edit` for each edit of light made since training; all
//! numbers are read back to the bit. Any other 3D Gaussian splatting PLY (ASCII, little or big
//! endian, any order and type of properties) is read as `ColorModel::Sh` with the cut-offs of its
//! renderer; Mip-splatting's `filter_3D` is honoured.
//!
//! A bake alone (`luxel export`) has the standard properties, and a comment `luxel baked {...}`
//! that states the meaning of its numbers; without it they are display colours. PlayCanvas'
//! compressed PLY (elements `chunk`, `vertex` with `packed_*`, `sh`) is read, too: see
//! [`compressed`].

mod baked_writer;
mod compressed;
mod header;
mod points;
mod record;
mod rows;
mod scene_reader;
mod scene_writer;
mod source;

pub use baked_writer::{encode_baked_ply, write_baked_ply};
pub use points::{PlyCloud, PlyPoint, decode_points_ply, read_points_ply};
pub(crate) use record::check as check_edits;
pub(crate) use scene_reader::read_scene_file;
pub use scene_reader::{decode_scene_ply, read_scene_ply};
pub(crate) use scene_writer::check;
pub use scene_writer::{encode_scene_ply, write_exact_ply, write_scene_ply};

/// Version of the `luxel` comments and `lcd_*` properties.
const FORMAT_VERSION: u32 = 1;

/// Version of files with gains of edits, which readers of the version before would leave out.
const GAIN_VERSION: u32 = 2;

/// First word of the header comments that belong to this program.
const COMMENT_TAG: &str = "luxel";

#[cfg(test)]
mod tests;

//! SPZ (Niantic): splats in some 16 to 64 bytes each, quantised, for the web.
//!
//! Little endian. Versions 2 and 3: one gzip stream of a 16-byte header and six attribute blocks;
//! version 4: a plain 32-byte header, a table of sizes, and each block as a zstd stream of its own.
//! Blocks, N rows each: position 3 x 24-bit fixed point; opacity u8; colour 3 x u8, (c - 128) / 128
//! / 0.15 about; log scale 3 x u8, v / 16 - 10; rotation (version 2: x y z as bytes, w >= 0; from 3
//! on the three smallest of x y z w, 10 bits each, sign and magnitude up to 1 / sqrt 2); higher
//! harmonics u8, (v - 128) / 128, coefficient-major. Axes are right, up, back; those of 3D Gaussian
//! splatting's PLY are right, down, forward, and scenes are read into and written from these.
//!
//! Of vendors' extension records that of the axes (`SPZ_ADOBE_coordinate_system`) is read, and written
//! in version 4, since programs differ about the convention; others are skipped.
//!
//! A display bake only: colours end at -0.44 and 1.44, harmonics at +-1, opacities have 255 steps.
//! Source: the format's own description and reference implementation, version 4 of 2026.

mod layout;
mod reader;
mod writer;

pub(crate) use reader::read_scene_file;
pub use reader::{decode_spz, read_spz};
pub use writer::{SpzPositions, SpzVersion, encode_spz, spz_out_of_range, spz_positions, write_spz};

#[cfg(test)]
mod tests;

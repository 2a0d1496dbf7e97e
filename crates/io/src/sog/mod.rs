//! SOG (PlayCanvas): splats as lossless WebP pictures and a `meta.json` in one ZIP archive, for the
//! web. Version 2 of the format.
//!
//! Pixel i of each picture belongs to splat i. `means_l` and `means_u`: low and high bytes of 16
//! bits per axis, between bounds, of sign(x) ln(1 + |x|). `quats`: the three smallest of w x y z
//! times sqrt 2, in 8 bits, and 252 plus the number of the largest in alpha. `scales` and `sh0`:
//! numbers in a codebook of 256 logarithms of scale and 256 constant coefficients; alpha of `sh0`
//! is the opacity. Higher harmonics are rows of a palette: `shN_labels` has the row in 16 bits,
//! `shN_centroids` 64 rows side by side, a pixel for each coefficient, in a codebook of 256
//! numbers. Axes are those of 3D Gaussian splatting's PLY.
//!
//! A display bake only. Source: PlayCanvas's description of the format, and its reader. Degenerate:
//! bakes without higher harmonics have no palette; equal coordinates have bounds without a span.

mod archive;
mod codebook;
mod palette;
mod reader;
mod unpacked;
mod writer;

pub(crate) use reader::{decode, is_sog};
pub use reader::{decode_sog, read_sog};
pub use writer::{encode_sog, sog_positions, write_sog};

#[cfg(test)]
mod tests;

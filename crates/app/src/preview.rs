//! 8-bit pictures for people. Data never takes this way.

use std::path::Path;

use anyhow::{Context, Result};
use luxel_core::tone::{Tonemap, display_rgb8};
use luxel_core::{ColorSpace, Image};

/// A tone curve and an exposure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// Curve.
    pub(crate) tonemap: Tonemap,
    /// Stops: radiance is multiplied by 2^EV.
    pub(crate) exposure_ev: f32,
}

/// Writes a PNG of an image in normalised units, whose primaries are those of `color_space`.
pub(crate) fn write(path: &Path, image: &Image, color_space: ColorSpace, look: Look) -> Result<()> {
    // Displays have the primaries of Rec.709.
    let display = ColorSpace::LinearRec709;
    let conversion = (color_space != display)
        .then(|| luxel_io::rgb_conversion(&color_space.chromaticities(), &display.chromaticities()))
        .flatten()
        .map(|matrix| matrix.as_mat3());
    let encode = |&rgb: &[f32; 3]| {
        let rgb = conversion.map_or(rgb, |matrix| (matrix * glam::Vec3::from_array(rgb)).to_array());
        display_rgb8(look.tonemap, look.exposure_ev, rgb)
    };
    let rgb8: Vec<[u8; 3]> = image.pixels.iter().map(encode).collect();
    luxel_io::write_png(path, image.width, image.height, rgb8.as_flattened()).context("cannot write a preview")
}

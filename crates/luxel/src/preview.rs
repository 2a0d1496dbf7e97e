//! 8-bit pictures for people. Data never takes this way.

use std::path::Path;

use luxel_core::tone::{Tonemap, display_rgb8, rec709_of};
use luxel_core::{ColorSpace, Image};

use crate::Result;
use crate::error::Context;

/// A tone curve and an exposure.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Curve.
    pub tonemap: Tonemap,
    /// Stops: radiance is multiplied by 2^EV.
    pub exposure_ev: f32,
}

impl Look {
    /// Returns the look that shows colours of this space: AgX for light, no curve for colours that
    /// are a display's, which then stay as they are.
    pub fn usual(color_space: ColorSpace) -> Self {
        Self { tonemap: if color_space.is_linear() { Tonemap::Agx } else { Tonemap::None }, exposure_ev: 0.0 }
    }
}

/// Writes a PNG of an image in normalised units, whose primaries are those of `color_space`.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, image: &Image, color_space: ColorSpace, look: Look) -> Result<()> {
    let encode = |&rgb: &[f32; 3]| display_rgb8(look.tonemap, look.exposure_ev, rec709_of(color_space, rgb));
    let rgb8: Vec<[u8; 3]> = image.pixels.iter().map(encode).collect();
    luxel_io::write_png(path, image.width, image.height, rgb8.as_flattened()).context("cannot write a preview")
}

/// Encodes a JPEG of linear radiance in normalised units, whose primaries are those of
/// `color_space`, at a quality from 1 to 100.
///
/// # Errors
/// An image that is empty or too large for the format.
pub fn encode_jpeg(image: &Image, color_space: ColorSpace, look: Look, quality: u8) -> Result<Vec<u8>> {
    let encode = |&rgb: &[f32; 3]| display_rgb8(look.tonemap, look.exposure_ev, rec709_of(color_space, rgb));
    let rgb8: Vec<[u8; 3]> = image.pixels.iter().map(encode).collect();
    luxel_io::encode_jpeg(image.width, image.height, rgb8.as_flattened(), quality).context("cannot encode a preview")
}

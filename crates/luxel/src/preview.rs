//! 8-bit pictures for people. Data never takes this way.

use std::path::Path;
use std::sync::Arc;

use luxel_core::tone::{Tonemap, display_rgb8, rec709_of};
use luxel_core::{ColorSpace, Image};
use luxel_io::{DisplayEncoding, OcioDisplay};

use crate::Result;
use crate::error::Context;

/// The way from light to a screen.
#[derive(Clone, Debug)]
pub enum Curve {
    /// A tone curve, and sRGB.
    Tonemap(Tonemap),
    /// A view of a display of an OpenColorIO configuration.
    Ocio(Arc<OcioDisplay>),
}

impl Curve {
    /// Returns what decides the pictures that it makes.
    pub fn recipe(&self) -> String {
        match self {
            Self::Tonemap(tonemap) => format!("{tonemap:?}"),
            Self::Ocio(display) => format!("ocio {}", display.digest()),
        }
    }

    /// Returns the display that its code values are for; `None` if that is not known.
    pub fn encoding(&self) -> Option<DisplayEncoding> {
        match self {
            Self::Tonemap(_) => Some(DisplayEncoding::default()),
            Self::Ocio(display) => display.encoding(),
        }
    }
}

impl From<Tonemap> for Curve {
    fn from(tonemap: Tonemap) -> Self {
        Self::Tonemap(tonemap)
    }
}

/// A curve and an exposure.
#[derive(Clone, Debug)]
pub struct Look {
    /// Curve.
    pub curve: Curve,
    /// Stops: radiance is multiplied by 2^EV.
    pub exposure_ev: f32,
}

impl Look {
    /// Returns the look that shows colours of this space: AgX for light, no curve for colours that
    /// are a display's, which then stay as they are.
    pub fn usual(color_space: ColorSpace) -> Self {
        let tonemap = if color_space.is_linear() { Tonemap::Agx } else { Tonemap::None };
        Self { curve: tonemap.into(), exposure_ev: 0.0 }
    }

    /// Returns code values `[H*W]` of an image in normalised units, whose primaries are those of
    /// `color_space`.
    ///
    /// # Errors
    /// OpenColorIO failed on it.
    pub fn rgb8(&self, image: &Image, color_space: ColorSpace) -> Result<Vec<[u8; 3]>> {
        match &self.curve {
            Curve::Tonemap(tonemap) => {
                let encode = |rgb: &[f32; 3]| display_rgb8(*tonemap, self.exposure_ev, rec709_of(color_space, *rgb));
                Ok(image.pixels.iter().map(encode).collect())
            }
            Curve::Ocio(display) => {
                let gain = self.exposure_ev.exp2();
                let mut shown = image.clone();
                shown.pixels.iter_mut().for_each(|rgb| *rgb = color_space.light(*rgb).map(|c| c * gain));
                display.encode(&mut shown, color_space.linear()).context("cannot make a preview")?;
                Ok(shown.pixels.iter().map(|rgb| rgb.map(|c| (c * 255.0 + 0.5) as u8)).collect())
            }
        }
    }
}

/// Writes a PNG of an image in normalised units, whose primaries are those of `color_space`. The
/// file says which display it is for, if that is known.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, image: &Image, color_space: ColorSpace, look: &Look) -> Result<()> {
    let rgb8 = look.rgb8(image, color_space)?;
    luxel_io::write_display_png(path, [image.width, image.height], rgb8.as_flattened(), look.curve.encoding())
        .context("cannot write a preview")
}

/// Encodes a JPEG of linear radiance in normalised units, whose primaries are those of
/// `color_space`, at a quality from 1 to 100.
///
/// # Errors
/// An image that is empty or too large for the format.
pub fn encode_jpeg(image: &Image, color_space: ColorSpace, look: &Look, quality: u8) -> Result<Vec<u8>> {
    let rgb8 = look.rgb8(image, color_space)?;
    luxel_io::encode_jpeg(image.width, image.height, rgb8.as_flattened(), quality).context("cannot encode a preview")
}

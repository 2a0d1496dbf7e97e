//! An image in the units of the data set. Images in normalised units stay inside of this crate.
//!
//! In: renders in normalised units with the scene's radiance scale; out: linear radiance `[H,W,3]`
//! that knows its colour space, and files of it. Values are not clamped; where half floats cannot
//! hold one, the file has 32 bits a channel.

use std::borrow::Cow;
use std::path::Path;

use luxel_core::tone::{REFERENCE_WHITE_NITS, Tonemap, display_rgb8, pq_encode, rec709_of};
use luxel_core::{Camera, ColorSpace, Conversion, Image, Layers, RadianceScale};
use luxel_io::{ExrOptions, ExrSample, LightLevels};

use crate::error::Context;
use crate::output::ExrType;
use crate::{Result, output};

/// Attribute of an OpenEXR file with the radiance of one normalised unit, which `luxel compare`
/// takes for the scale of its metrics.
pub const RADIANCE_SCALE: &str = "luxel:radiance_scale";

/// Linear RGB radiance in the units of the data set.
///
/// ```
/// use luxel::{ColorSpace, Device, Renderer, Tonemap, synthetic};
///
/// # fn main() -> luxel::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// let camera = synthetic::room_camera([16, 12]);
/// let image = Renderer::new(&synthetic::room(100, 1), Device::Cpu)?.render(&camera)?;
/// image.save_preview(folder.path().join("room.png"), Tonemap::Agx, 0.0)?;
///
/// let image = image.to_color_space(ColorSpace::AcesCg);
/// assert_eq!(image.color_space(), ColorSpace::AcesCg);
/// assert_eq!((image.pixels().len(), image.pixel(16, 0)), (16 * 12, None));
/// image.save_exr(folder.path().join("room.exr"))?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Radiance {
    image: Image,
    color_space: ColorSpace,
    radiance_scale: RadianceScale,
    camera: Option<Camera>,
}

impl Radiance {
    /// Takes a render out of normalised units.
    pub(crate) fn new(mut image: Image, radiance_scale: RadianceScale, color_space: ColorSpace, camera: &Camera) -> Self {
        radiance_scale.restore(&mut image);
        Self { image, color_space, radiance_scale, camera: Some(camera.clone()) }
    }

    /// Returns the width in pixels.
    pub fn width(&self) -> usize {
        self.image.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> usize {
        self.image.height
    }

    /// Returns the pixels `[H*W]`, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.image.pixels
    }

    /// Returns the pixels as an image, without a copy.
    pub fn into_image(self) -> Image {
        self.image
    }

    /// Returns the pixel in column `x` of row `y`; `None` outside of the image.
    pub fn pixel(&self, x: usize, y: usize) -> Option<[f32; 3]> {
        (x < self.width()).then(|| self.image.pixels.get(y * self.width() + x).copied()).flatten()
    }

    /// Returns the colour space of the pixels.
    pub fn color_space(&self) -> ColorSpace {
        self.color_space
    }

    /// Returns the image converted to another colour space; radiance outside of its gamut becomes
    /// negative.
    #[must_use]
    pub fn to_color_space(mut self, color_space: ColorSpace) -> Self {
        let conversion = Conversion::between(self.color_space, color_space);
        for pixel in &mut self.image.pixels {
            *pixel = conversion.apply(self.color_space.towards(color_space, *pixel));
        }
        Self { color_space, ..self }
    }

    /// Returns the image as light: itself, or colours of a display decoded.
    pub fn light(&self) -> Cow<'_, Self> {
        match self.color_space.is_linear() {
            true => Cow::Borrowed(self),
            false => Cow::Owned(self.clone().to_color_space(self.color_space.linear())),
        }
    }

    /// Writes an OpenEXR file with the chromaticities and the camera: half floats, or 32 bits where
    /// a value exceeds 65504.
    ///
    /// # Errors
    /// A name with another extension; the file system's refusal.
    pub fn save_exr(&self, path: impl AsRef<Path>) -> Result<()> {
        output::check_extension(path.as_ref(), &["exr"])?;
        luxel_io::write_exr(path.as_ref(), &self.image, &self.exr_options()).context("cannot write an image")?;
        Ok(())
    }

    /// Encodes the file that [`Self::save_exr`] writes, into memory.
    ///
    /// # Errors
    /// An image without pixels.
    pub fn encode_exr(&self) -> Result<Vec<u8>> {
        luxel_io::encode_exr(Path::new("radiance.exr"), &self.image, &self.exr_options()).context("cannot encode an image")
    }

    /// Encodes an HDR picture: 16-bit PNG in Rec.2020 with the perceptual quantizer (SMPTE ST
    /// 2084), named by its chunk `cICP`. The scene's radiance scale divided by 2^`exposure_ev` is
    /// reference white, 203 cd/m2; light beyond 10,000 cd/m2 and outside of Rec.2020 is clipped.
    ///
    /// # Errors
    /// An image without pixels, or with too long a side.
    pub fn encode_png_pq(&self, exposure_ev: f32) -> Result<Vec<u8>> {
        /// Largest luminance of the curve, cd/m2.
        const MAX_NITS: f32 = 10_000.0;
        let conversion = Conversion::between(self.color_space, ColorSpace::LinearRec2020);
        let gain = self.radiance_scale.normalised_value(exposure_ev.exp2()) * REFERENCE_WHITE_NITS;
        let nits =
            |rgb: &[f32; 3]| conversion.apply(self.color_space.light(*rgb)).map(|c| if c > 0.0 { (c * gain).min(MAX_NITS) } else { 0.0 });
        let (mut codes, mut levels) = (Vec::with_capacity(3 * self.pixels().len()), LightLevels::default());
        for pixel in self.pixels() {
            let light = nits(pixel);
            codes.extend(light.map(|c| (pq_encode(c) * 65535.0 + 0.5) as u16));
            let brightest = f64::from(light.into_iter().fold(0.0, f32::max));
            levels.max = levels.max.max(brightest);
            levels.mean += brightest / self.pixels().len() as f64;
        }
        luxel_io::encode_png_pq(self.width(), self.height(), &codes, levels).context("cannot encode an HDR picture")
    }

    /// Encodes a frame as `luxel render` writes it: as [`Self::encode_exr`], with the digest of the
    /// recipe that made it, in [`output::MADE_BY`].
    ///
    /// # Errors
    /// An image without pixels.
    pub fn encode_frame(&self, exr_type: ExrType, made_by: &str) -> Result<Vec<u8>> {
        let mut options = ExrOptions { sample: exr_type.sample(&self.image), ..self.exr_options() };
        options.attributes.push((output::MADE_BY.to_owned(), made_by.to_owned()));
        options.numbers.push((output::PREVIEW_EXPOSURE.into(), 0.0));
        luxel_io::encode_exr(Path::new("frame.exr"), &self.image, &options).context("cannot encode an image")
    }

    fn exr_options(&self) -> ExrOptions {
        ExrOptions {
            sample: ExrSample::smallest_for(&self.image),
            color_space: self.color_space,
            numbers: vec![(RADIANCE_SCALE.into(), self.radiance_scale.get())],
            camera: self.camera.clone(),
            ..ExrOptions::default()
        }
    }

    /// Writes an 8-bit tone-mapped preview as PNG. `exposure_ev` is in stops; 0 shows the scene's
    /// radiance scale as 1.
    ///
    /// # Errors
    /// A name with another extension; the file system's refusal.
    pub fn save_preview(&self, path: impl AsRef<Path>, tonemap: Tonemap, exposure_ev: f32) -> Result<()> {
        output::check_extension(path.as_ref(), &["png"])?;
        let encode = |rgb: &[f32; 3]| {
            let normalised = self.radiance_scale.normalised(*rgb);
            display_rgb8(tonemap, exposure_ev, rec709_of(self.color_space, normalised))
        };
        let rgb8: Vec<[u8; 3]> = self.image.pixels.iter().map(encode).collect();
        luxel_io::write_png(path.as_ref(), self.width(), self.height(), rgb8.as_flattened()).context("cannot write a preview")
    }
}

/// An image with coverage and depth, `[H*W]` each, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct RadianceLayers {
    /// The image, as [`crate::Renderer::render`] makes it.
    pub radiance: Radiance,
    /// Coverage of the pixel by splats, 0 to 1.
    pub alpha: Vec<f32>,
    /// Mean depth along the viewing axis, world units; infinite where there are no splats.
    pub depth: Vec<f32>,
}

/// Depth in files where there is nothing, as in Blender.
pub const FAR_DEPTH: f32 = 1e10;

impl RadianceLayers {
    /// Takes a picture of a scene out of normalised units. `camera`, whose picture it is, and the
    /// depths are those of the scene's world.
    pub fn from_normalised(layers: Layers, radiance_scale: RadianceScale, color_space: ColorSpace, camera: &Camera) -> Self {
        let Layers { image, alpha, depth } = layers;
        Self { radiance: Radiance::new(image, radiance_scale, color_space, camera), alpha, depth }
    }

    /// Encodes an OpenEXR file as [`Radiance::encode_exr`] does, with coverage (`A`) and depth
    /// (`Z`, [`FAR_DEPTH`] where there is nothing) as asked.
    ///
    /// # Errors
    /// An image without pixels.
    pub fn encode_exr(&self, with_alpha: bool, with_depth: bool) -> Result<Vec<u8>> {
        let options = ExrOptions {
            alpha: with_alpha.then(|| self.alpha.clone()),
            depth: with_depth.then(|| self.depth.iter().map(|z| z.min(FAR_DEPTH)).collect()),
            ..self.radiance.exr_options()
        };
        luxel_io::encode_exr(Path::new("radiance.exr"), &self.radiance.image, &options).context("cannot encode an image")
    }
}

//! Image files: bytes in, linear f32 radiance [H,W,3] out, and back.
//!
//! In: OpenEXR, Radiance HDR, TIFF, PNG, JPEG, DPX, NumPy arrays, recognised by their first bytes.
//! Out: [`DecodedImage`], scene-linear, unclamped; NaN, infinite and negative samples stay as they
//! are (the data set masks them). Rows and columns are as stored: orientation tags are not applied,
//! since structure from motion does not apply them either.
//!
//! Integer samples need a transfer curve: given by [`ReadOptions`], the file, or the format's
//! standard (JPEG), never guessed. Floating-point samples are linear by definition of their
//! formats, unless the caller says that they are a camera's plate.
//!
//! A damaged file is an error, also where a decoder would panic or where its header claims more
//! pixels than a file of its length can hold.

pub(crate) mod colorimetry;
mod display_encoding;
mod dpx;
mod exr_attributes;
mod exr_blocks;
mod exr_deep;
mod exr_header;
mod exr_layers;
mod exr_lines;
mod exr_options;
mod gain_map;
pub(crate) mod guard;
mod interop_id;
mod jpeg;
mod jpeg_markers;
pub(crate) mod npy;
pub(crate) mod openexr;
mod plate;
mod png;
mod png_chunks;
mod png_pq;
mod radiance;
mod refused;
mod resample;
mod samples;
mod straighten;
mod tiff;
mod tiff_samples;
mod transfer;
mod write;

use std::io::{Read, Seek};
use std::path::Path;

use luxel_core::photo::StatedCurve;
use luxel_core::{Chromaticities, ColorSpace, Image};

use crate::IoError;
use crate::input::Input;
use crate::read_file::{open_regular, read_file};

pub use display_encoding::{DisplayCurve, DisplayEncoding, DisplayPrimaries};
pub use exr_attributes::{ExrAttributes, read_exr_attributes};
pub use exr_deep::{encode_deep_exr, write_deep_exr};
pub use exr_options::{ExrOptions, ExrPlane, ExrSample, HALF_MAX, PlaneValues};
pub use interop_id::name as color_interop_id;
pub use png_pq::{LightLevels, encode_png_pq};
pub use resample::{downscale, downscale_masked, pinhole_within, undistort, undistort_into};
pub(crate) use straighten::{lost_field, straighten};
pub use transfer::Transfer;
pub use write::{encode_exr, encode_jpeg, encode_png, write_display_png, write_exr, write_png};

/// An image as read.
#[derive(Clone, Debug)]
pub struct DecodedImage {
    /// Linear radiance, of the display window's size.
    pub image: Image,
    /// Opacity `[H*W]` if the file has it, linear, as stored (colours are not divided or multiplied
    /// by it).
    pub alpha: Option<Vec<f32>>,
    /// Whether colours are multiplied by `alpha` as they are stored: OpenEXR's are, PNG's are not,
    /// TIFF says so.
    pub is_premultiplied: bool,
    /// Space of `image` if the file states it; `None`: it does not, linear Rec.709 is the
    /// convention.
    pub color_space: Option<ColorSpace>,
    /// CIE xy of red, green, blue and white as the file has them.
    pub chromaticities: Option<[[f32; 2]; 4]>,
    /// Precision in the file.
    pub depth: SampleDepth,
    /// Whether samples are of a display's curve, such as sRGB's: not proportional to light, nor
    /// of a camera's curve.
    pub is_display_coded: bool,
    /// Remarks that a user should read, without the file's name.
    pub warnings: Vec<String>,
}

impl DecodedImage {
    /// Composites the image over black: multiplies straight colours by the opacity beside them.
    /// This is how data sets and comparisons read an image with an alpha channel.
    pub fn composite_over_black(&mut self) {
        if self.is_premultiplied {
            return;
        }
        let Some(alpha) = &self.alpha else { return };
        for (pixel, alpha) in self.image.pixels.iter_mut().zip(alpha) {
            *pixel = pixel.map(|v| v * alpha);
        }
        self.is_premultiplied = true;
    }

    /// Turns the image by an Exif orientation of 5 to 8, which exchange width and height; others
    /// leave it as it is.
    pub(crate) fn turn(&mut self, orientation: u16) {
        let [width, height] = [self.image.width, self.image.height];
        let from = |x: usize, y: usize| match orientation {
            5 => [y, x],
            6 => [y, height - 1 - x],
            7 => [width - 1 - y, height - 1 - x],
            _ => [width - 1 - y, x],
        };
        if !(5..=8).contains(&orientation) {
            return;
        }
        // The turned image is `height` wide and `width` high.
        let order = || (0..width).flat_map(|y| (0..height).map(move |x| [x, y])).map(|[x, y]| from(x, y)).map(|[x, y]| y * width + x);
        let pixels = order().map(|i| self.image.pixels[i]).collect();
        self.alpha = self.alpha.as_ref().map(|alpha| order().map(|i| alpha[i]).collect());
        self.image = Image { width: height, height: width, pixels };
    }
}

/// Precision of the samples in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleDepth {
    /// Half, single or double precision, or shared exponent.
    Float,
    /// 9 to 16 bits, of one transfer curve.
    Integer16,
    /// 8 bits: not HDR.
    Integer8,
    /// 1 to 7 bits, as many as are named: not HDR.
    FewBits(u8),
}

impl SampleDepth {
    /// Returns the bits of integer samples; `None` for floats.
    pub fn integer_bits(self) -> Option<u8> {
        match self {
            Self::Float => None,
            Self::Integer16 => Some(16),
            Self::Integer8 => Some(8),
            Self::FewBits(bits) => Some(bits),
        }
    }

    /// Returns whether samples are integers of at most 8 bits, which hold no HDR.
    pub fn is_low(self) -> bool {
        self.integer_bits().is_some_and(|bits| bits <= 8)
    }
}

/// Options for properties that a file does not state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Curve of integer samples; takes precedence over the file's. Floating-point samples are
    /// linear and not touched by it, unless it is the curve of a plate
    /// ([`Transfer::plate_primaries`]).
    pub transfer: Option<Transfer>,
    /// Names of the part, layer or view to read of an OpenEXR file that has several, separated by
    /// slashes (`ViewLayer.Combined`, `rgba/left`); `None`: the beauty pass of the hero view.
    pub layer: Option<String>,
}

/// Formats, by their first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    OpenExr,
    Radiance,
    Tiff,
    Png,
    Jpeg,
    Npy,
    Dpx,
}

impl Format {
    fn detect(input: Input<'_>) -> Result<Self, IoError> {
        const MAGIC: [(&[u8], Format); 12] = [
            (&[0x76, 0x2f, 0x31, 0x01], Format::OpenExr),
            (b"#?RADIANCE", Format::Radiance),
            (b"#?RGBE", Format::Radiance),
            (b"II*\0", Format::Tiff),
            (b"MM\0*", Format::Tiff),
            (b"II+\0", Format::Tiff),
            (b"MM\0+", Format::Tiff),
            (png::SIGNATURE, Format::Png),
            (&[0xff, 0xd8, 0xff], Format::Jpeg),
            (npy::SIGNATURE, Format::Npy),
            (dpx::SIGNATURES[0], Format::Dpx),
            (dpx::SIGNATURES[1], Format::Dpx),
        ];
        if input.bytes.is_empty() {
            return Err(input.invalid("the file is empty, expected an image; copy or export it again"));
        }
        MAGIC.iter().find(|(magic, _)| input.bytes.starts_with(magic)).map(|&(_, format)| format).ok_or_else(|| {
            if let Some(refused) = refused::known_by_name(input) {
                return refused;
            }
            let found: Vec<_> = input.bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            input.unsupported(format!(
                "not an image of a known format: begins with bytes {}, expected OpenEXR, Radiance HDR, TIFF, PNG, JPEG, DPX or NumPy's .npy; \
                 export it as one of these",
                found.join(" ")
            ))
        })
    }
}

/// Returns what a file's first bytes say of the image or the video that it is; `None` for one that
/// is neither.
pub(crate) fn image_format(input: Input<'_>) -> Option<String> {
    let named = match Format::detect(input) {
        Ok(Format::OpenExr) => "an OpenEXR image",
        Ok(Format::Radiance) => "a Radiance HDR image",
        Ok(Format::Tiff) => "a TIFF or DNG image",
        Ok(Format::Png) => "a PNG image",
        Ok(Format::Jpeg) => "a JPEG image",
        Ok(Format::Npy) => "a NumPy array",
        Ok(Format::Dpx) => "a DPX image",
        // Only its name: what to do with it is for a scene.
        Err(_) => refused::other_picture(input.bytes)?.split([',', ';']).next()?,
    };
    Some(named.to_owned())
}

/// Reads an image file.
///
/// # Errors
/// The file can't be read, is damaged, or is of a kind that is not supported; the message names the
/// remedy.
pub fn read_image(path: &Path, options: &ReadOptions) -> Result<DecodedImage, IoError> {
    decode_image(path, &read_known(path)?, options)
}

/// Reads a file whose first bytes are those of an image.
fn read_known(path: &Path) -> Result<Vec<u8>, IoError> {
    let mut head = Vec::new();
    let (file, _) = open_regular(path)?;
    file.take(HEAD_BYTES).read_to_end(&mut head).map_err(|e| IoError::system(path, "read", &e))?;
    Format::detect(Input::new(path, &head))?;
    read_file(path)
}

/// Reads an image from memory; `name` is for messages only.
///
/// # Errors
/// The same as [`read_image`].
pub fn decode_image(name: &Path, bytes: &[u8], options: &ReadOptions) -> Result<DecodedImage, IoError> {
    let input = Input::new(name, bytes);
    let format = Format::detect(input)?;
    if let Some(transfer) = options.transfer
        && let Some(primaries) = transfer.plate_primaries()
    {
        return guard::contain(name, || plate::decode(input, format, options, transfer, &primaries));
    }
    guard::contain(name, || match format {
        Format::OpenExr => openexr::decode(input, options),
        Format::Radiance => radiance::decode(input),
        Format::Tiff => tiff::decode(input, options),
        Format::Png => png::decode(input, options),
        Format::Jpeg => jpeg::decode(input, options),
        Format::Npy => npy::decode(input),
        Format::Dpx => dpx::decode(input, options),
    })
}

/// Reads an image file as [`decode_codes`].
///
/// # Errors
/// The same as [`read_image`].
pub fn read_codes(path: &Path) -> Result<DecodedImage, IoError> {
    decode_codes(path, &read_known(path)?)
}

/// Decodes integer samples as they are, divided by the largest code, whatever curve and primaries
/// they have: for masks, and for images with a curve that is to be recovered. Floating-point
/// samples are light, as [`decode_image`] reads them.
///
/// # Errors
/// The same as [`read_image`].
pub fn decode_codes(name: &Path, bytes: &[u8]) -> Result<DecodedImage, IoError> {
    decode_codes_of(Input::new(name, bytes), None)
}

/// Decodes as [`decode_codes`], an OpenEXR file's layer by [`ReadOptions::layer`].
///
/// # Errors
/// The same as [`read_image`].
pub(crate) fn decode_codes_of(input: Input<'_>, layer: Option<&str>) -> Result<DecodedImage, IoError> {
    match Format::detect(input)? {
        Format::Png => guard::contain(input.name, || png::decode_codes(input)),
        Format::Tiff => guard::contain(input.name, || tiff::decode_codes(input)),
        _ => decode_image(input.name, input.bytes, &ReadOptions { transfer: Some(Transfer::Linear), layer: layer.map(str::to_owned) }),
    }
}

/// Returns the width and height of an image file, pixels, from its header alone (a JPEG is read
/// whole, its size comes late).
///
/// # Errors
/// The same as [`read_image`], as far as the header shows it.
pub fn image_size(path: &Path) -> Result<[u32; 2], IoError> {
    let (file, length) = open_regular(path)?;
    let mut head = Vec::new();
    file.take(HEAD_BYTES).read_to_end(&mut head).map_err(|e| IoError::system(path, "read", &e))?;
    let start = Input::new(path, &head);
    let format = Format::detect(start)?;
    let size = guard::contain(path, || match format {
        Format::Png => png::size(start),
        Format::Jpeg => jpeg::size(Input::new(path, &read_file(path)?)),
        Format::Dpx => dpx::size(start),
        _ => stream_size(path, format, open_regular(path)?.0),
    })?;
    guard::check_size(path, size.map(u64::from), length)?;
    Ok(size)
}

/// Returns the [`image_size`] of a file in memory.
pub(crate) fn image_size_of(input: Input<'_>) -> Result<[u32; 2], IoError> {
    let size = match Format::detect(input)? {
        Format::Png => png::size(input)?,
        Format::Jpeg => jpeg::size(input)?,
        Format::Dpx => dpx::size(input)?,
        format => stream_size(input.name, format, std::io::Cursor::new(input.bytes))?,
    };
    input.check_size(size.map(u64::from))?;
    Ok(size)
}

/// Returns whether a file holds radiance: floating-point samples, by its header. A file that cannot
/// be read does not.
pub fn holds_radiance(path: &Path) -> bool {
    let mut head = Vec::new();
    let Ok(mut file) = std::fs::File::open(path) else { return false };
    if file.by_ref().take(HEAD_BYTES).read_to_end(&mut head).is_err() {
        return false;
    }
    match Format::detect(Input::new(path, &head)) {
        Ok(Format::OpenExr | Format::Radiance | Format::Npy) => true,
        Ok(Format::Tiff) => file.rewind().is_ok() && guard::contain(path, || Ok(tiff_samples::is_float(file))).unwrap_or(false),
        Ok(Format::Dpx) => dpx::is_float(&head),
        Ok(Format::Png | Format::Jpeg) | Err(_) => false,
    }
}

fn stream_size(name: &Path, format: Format, file: impl Read + Seek) -> Result<[u32; 2], IoError> {
    match format {
        Format::OpenExr => openexr::size(name, file),
        Format::Radiance => radiance::size(name, file),
        Format::Tiff => tiff::size(name, file),
        Format::Npy => npy::size(name, file),
        Format::Png | Format::Jpeg | Format::Dpx => Err(IoError::unsupported(name, "its size is not read from a stream")),
    }
}

/// Returns the width, height and codes of red, green and blue of a JPEG; `None` if the file is
/// none.
pub(crate) fn jpeg_codes(input: Input<'_>) -> Result<Option<(usize, usize, Vec<u8>)>, IoError> {
    if Format::detect(input)? != Format::Jpeg {
        return Ok(None);
    }
    guard::contain(input.name, || jpeg::codes(input)).map(Some)
}

/// Returns whether a picture of integer samples holds light beyond white by the curve that it
/// states.
pub(crate) fn states_hdr_curve(input: Input<'_>) -> bool {
    matches!(Format::detect(input), Ok(Format::Png)) && png::states_hdr_curve(input)
}

/// Returns whether a picture has a gain map beside it.
pub(crate) fn has_gain_map(input: Input<'_>) -> bool {
    matches!(Format::detect(input), Ok(Format::Jpeg)) && gain_map::is_in(input.bytes)
}

/// Returns the curve between codes and light that an integer picture states.
pub(crate) fn stated_curve(input: Input<'_>) -> Result<Option<StatedCurve>, IoError> {
    if Format::detect(input)? == Format::Png { png::stated_curve(input) } else { Ok(None) }
}

/// Returns the CIE xy of red, green, blue and white that an integer picture states, itself or by
/// its ICC profile.
pub(crate) fn stated_primaries(input: Input<'_>, of_profile: Option<Chromaticities>) -> Result<Option<Chromaticities>, IoError> {
    match Format::detect(input)? {
        Format::Png => png::primaries(input, of_profile),
        Format::Tiff => Ok(of_profile.or_else(|| tiff::primaries(input.bytes))),
        _ => Ok(of_profile),
    }
}

/// Bytes at the beginning of a file that are enough for every magic number, and for the sizes of
/// PNG and DPX.
const HEAD_BYTES: u64 = dpx::HEADER_BYTES as u64;

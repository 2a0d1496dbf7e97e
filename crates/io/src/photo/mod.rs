//! Photographs: samples as the camera recorded them, and the facts it wrote about them. Camera RAW
//! as DNG, JPEG, PNG and TIFF as codes; OpenEXR, Radiance HDR, floating-point TIFF and pictures in
//! high dynamic range (PNG in PQ or HLG, JPEG with a gain map) as radiance.
//!
//! In: bytes. Out: [`PhotoInfo`] from headers alone, [`Photo`] with pixels. Codes are as stored,
//! not linear: what curve they have is for the caller to know or to find. Orientation tags are not
//! applied: structure from motion wants pixels as the lens saw them.

#[cfg(feature = "camera-raw")]
mod camera_raw;
mod dng;
mod dng_black;
mod dng_corrections;
mod dng_info;
mod dng_opcodes;
mod dng_packing;
mod dng_samples;
mod dng_tags;
mod exif;
mod jpeg_xl;
mod lossless_jpeg;
#[cfg(test)]
mod opcode_tests;
mod panorama;
#[cfg(test)]
mod tests;

use std::path::Path;

pub(crate) use exif::exif_of_file;
use luxel_core::ColorSpace;
use luxel_core::photo::{Codes, PhotoInfo, PhotoKind, RawPixels};

use crate::IoError;
use crate::icc::profile_of_file;
use crate::image::guard::contain;
use crate::image::{
    self, DecodedImage, ReadOptions, SampleDepth, decode_codes, decode_codes_of, decode_image, image_size_of, stated_primaries,
};
use crate::input::Input;
use crate::tags::Tags;

/// A photograph with its pixels.
#[derive(Clone, Debug)]
pub enum Photo {
    /// Sensor data.
    Raw(RawPixels),
    /// Integer codes of red, green and blue.
    Developed {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
        /// `[H*W*3]`.
        codes: Codes,
    },
    /// Scene-linear floats.
    Radiance(DecodedImage),
}

/// Endings of camera makers' own RAW formats.
const MAKERS_RAW: [&str; 22] = [
    "cr2", "cr3", "crw", "nef", "nrw", "arw", "srf", "sr2", "raf", "rw2", "orf", "pef", "srw", "x3f", "3fr", "fff", "iiq", "mos", "mef",
    "erf", "kdc", "dcr",
];

/// Returns whether a file of this name counts as a photograph.
pub fn is_photo_name(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
    ["dng", "jpg", "jpeg", "png", "tif", "tiff", "exr", "hdr", "pic", "dpx"].contains(&ending.as_str())
        || MAKERS_RAW.contains(&ending.as_str())
}

/// Returns the ending of a camera maker's own format, if it is one.
fn makers_ending(name: &Path) -> Option<String> {
    let ending = name.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
    MAKERS_RAW.contains(&ending.as_str()).then_some(ending)
}

#[cfg(not(feature = "camera-raw"))]
fn refuse_makers_raw(name: &Path) -> Result<(), IoError> {
    let Some(ending) = makers_ending(name) else { return Ok(()) };
    Err(IoError::unsupported(
        name,
        format!(
            "a camera maker's own RAW format (.{ending}), of which only DNG is read; convert it with a DNG converter, which loses nothing"
        ),
    ))
}

/// Reads the headers of a photograph; `name` is for messages, and its ending tells camera makers'
/// own formats.
///
/// # Errors
/// A damaged or unknown file.
pub fn photo_info(name: &Path, bytes: &[u8]) -> Result<PhotoInfo, IoError> {
    let input = Input::new(name, bytes);
    #[cfg(feature = "camera-raw")]
    if makers_ending(name).is_some() {
        return contain(name, || camera_raw::info(input));
    }
    #[cfg(not(feature = "camera-raw"))]
    refuse_makers_raw(name)?;
    contain(name, || {
        if let Some(dng) = dng::Dng::open(input) {
            let dng = dng?;
            let (size_px, exif, raw) = (dng.size()?, dng.exif(), Some(dng.info()?));
            return Ok(PhotoInfo {
                kind: PhotoKind::Raw,
                size_px,
                exif,
                raw,
                profile: None,
                primaries: None,
                curve: None,
                has_gain_map: false,
            });
        }
        let (size_px, kind) = (image_size_of(input)?, kind_of(input)?);
        let (mut profile, mut primaries, mut curve) = (None, None, None);
        if kind == PhotoKind::Developed {
            profile = profile_of_file(bytes);
            curve = image::stated_curve(input)?;
            let of_profile = profile.as_ref().and_then(|profile| profile.space).map(ColorSpace::chromaticities);
            primaries = stated_primaries(input, of_profile)?;
        }
        Ok(PhotoInfo {
            kind,
            size_px,
            exif: exif_of_file(bytes),
            raw: None,
            profile,
            primaries,
            curve,
            has_gain_map: image::has_gain_map(input),
        })
    })
}

/// Reads a photograph.
///
/// # Errors
/// A damaged or unknown file.
pub fn decode_photo(name: &Path, bytes: &[u8]) -> Result<Photo, IoError> {
    decode_photo_layer(name, bytes, None)
}

/// Reads a photograph as [`decode_photo`] does, of an OpenEXR file the `layer` that
/// [`crate::ReadOptions::layer`] describes.
///
/// # Errors
/// The same as [`decode_photo`].
pub fn decode_photo_layer(name: &Path, bytes: &[u8], layer: Option<&str>) -> Result<Photo, IoError> {
    let input = Input::new(name, bytes);
    #[cfg(feature = "camera-raw")]
    if makers_ending(name).is_some() {
        return contain(name, || camera_raw::pixels(input)).map(Photo::Raw);
    }
    #[cfg(not(feature = "camera-raw"))]
    refuse_makers_raw(name)?;
    if let Some(dng) = dng::Dng::open(input) {
        let dng = dng?;
        return contain(name, || dng.pixels()).map(Photo::Raw);
    }
    if image::states_hdr_curve(input) {
        return decode_image(name, bytes, &ReadOptions::default()).map(Photo::Radiance);
    }
    if let Some((width, height, codes)) = image::jpeg_codes(input)? {
        return Ok(Photo::Developed { width, height, codes: Codes::U8(codes) });
    }
    // Codes over the largest one, which f32 holds exactly enough to have the codes back.
    let decoded = decode_codes_of(input, layer)?;
    let flat = decoded.image.pixels.as_flattened();
    let codes = match decoded.depth {
        SampleDepth::Float => return Ok(Photo::Radiance(decoded)),
        SampleDepth::Integer8 | SampleDepth::FewBits(_) => Codes::U8(flat.iter().map(|v| (v * 255.0 + 0.5) as u8).collect()),
        SampleDepth::Integer16 => Codes::U16(flat.iter().map(|v| (v * 65535.0 + 0.5) as u16).collect()),
    };
    Ok(Photo::Developed { width: decoded.image.width, height: decoded.image.height, codes })
}

/// Returns the kind of a file that is not RAW, by its first bytes and, of TIFF, by its sample
/// format.
fn kind_of(input: Input<'_>) -> Result<PhotoKind, IoError> {
    const SAMPLE_FORMAT: u16 = 339;
    let Input { name, bytes } = input;
    if image::states_hdr_curve(input) {
        return Ok(PhotoKind::Radiance);
    }
    if bytes.starts_with(&[0xff, 0xd8]) || bytes.starts_with(b"\x89PNG") {
        return Ok(PhotoKind::Developed);
    }
    let is_float = match Tags::new(bytes).and_then(|tags| tags.first()) {
        Some(ifd) => ifd.unsigned(SAMPLE_FORMAT) == Some(3),
        // Without tags of 32 bits it is a BigTIFF, which has to be decoded to be recognised, or a
        // format of floats.
        None if bytes.starts_with(b"II+\0") || bytes.starts_with(b"MM\0+") => decode_codes(name, bytes)?.depth == SampleDepth::Float,
        None => true,
    };
    Ok(if is_float { PhotoKind::Radiance } else { PhotoKind::Developed })
}

//! Plates of cameras and of video: samples through the curve that the caller names, whatever the
//! file states about curve and primaries, also where they are floating-point.
//!
//! In: a file and a [`Transfer`] with primaries of its own. Out: light, in the space of these
//! primaries where it has a name, else in ACEScg. Channels below black, of noise or of colours
//! outside of the space, become 0: the nearest radiance there is.

use luxel_core::{Chromaticities, ColorSpace, Conversion};
use rayon::prelude::*;

use super::{DecodedImage, Format, ReadOptions, Transfer};
use super::{dpx, jpeg, npy, openexr, png, tiff};
use crate::IoError;
use crate::input::Input;

/// Decodes a plate with the curve `transfer`, whose primaries are `primaries`.
pub(super) fn decode(
    input: Input<'_>,
    format: Format,
    options: &ReadOptions,
    transfer: Transfer,
    primaries: &Chromaticities,
) -> Result<DecodedImage, IoError> {
    let codes = ReadOptions { transfer: Some(Transfer::Linear), ..options.clone() };
    let mut decoded = match format {
        Format::OpenExr => openexr::decode_stored(input, options)?,
        Format::Png => png::decode_codes(input)?,
        Format::Tiff => tiff::decode_codes(input)?,
        Format::Jpeg => jpeg::decode(input, &codes)?,
        Format::Npy => npy::decode(input)?,
        Format::Dpx => dpx::decode(input, &codes)?,
        Format::Radiance => {
            let message = format!("Radiance HDR files hold light, expected samples with the curve {transfer}; leave the curve out");
            return Err(input.unsupported(message));
        }
    };
    if decoded.is_premultiplied && decoded.alpha.as_ref().is_some_and(|alpha| alpha.iter().any(|a| *a < 1.0)) {
        let message = format!("colours multiplied by an opacity, which the curve {transfer} cannot be taken of; export it without");
        return Err(input.unsupported(message));
    }
    if let Some(bits) = decoded.depth.integer_bits().filter(|bits| *bits <= 8) {
        decoded.warnings.push(format!("{bits} bits are too few for the curve {transfer}: steps of shadows and lights show"));
    }
    let own_space = ColorSpace::from_chromaticities(primaries);
    let space = own_space.unwrap_or(ColorSpace::AcesCg);
    let conversion = Conversion::from_chromaticities(primaries, &space.chromaticities())
        .ok_or_else(|| input.unsupported(format!("the primaries of {transfer} have no way to {}", space.name())))?;
    let convert = |pixel: &mut [f32; 3]| {
        let light = pixel.map(|v| transfer.light(f64::from(v)) as f32);
        let converted = if own_space.is_some() { light } else { conversion.apply(light) };
        // NaN stays for the data set to mask.
        *pixel = converted.map(|v| if v < 0.0 { 0.0 } else { v });
        converted.iter().any(|v| *v < 0.0)
    };
    let below = decoded.image.pixels.par_iter_mut().map(convert).filter(|is_below| *is_below).count();
    if below > 0 {
        decoded
            .warnings
            .push(format!("{below} pixels have channels below black, by noise or colours outside of {}: set to 0", space.name()));
    }
    if decoded.chromaticities.is_some_and(|stated| ColorSpace::from_chromaticities(&stated) != Some(space)) {
        decoded.warnings.push(format!("the primaries that the file states are not those of {transfer}, which hold"));
    }
    (decoded.color_space, decoded.chromaticities) = (Some(space), Some(space.chromaticities()));
    Ok(decoded)
}

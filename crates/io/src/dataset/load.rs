//! One view: file -> linear radiance or recorded values, bad pixels and masks, undistorted,
//! reduced.

use glam::DVec2;
use luxel_core::photo::Exif;
use luxel_core::{BadPixels, Camera, ColorSpace, Conversion, Distortion, Image, Mask, OnDemand, PixelValues, Remedy, Target, View};

use super::masks::decode_with_remark;
use super::source::SourceFrame;
use super::split::Part;
use super::{LoadOptions, MaskSource, Supervision};
use crate::IoError;
use crate::image::colorimetry::convert;
use crate::image::{
    DecodedImage, ReadOptions, SampleDepth, decode_codes_of, decode_image, downscale, downscale_masked, lost_field, straighten, undistort,
};
use crate::input::Input;
use crate::lens::PreparedLens;
use crate::photo::exif_of_file;
use crate::read_file::read_file;

/// A view with facts about its file.
pub(super) struct LoadedView {
    /// The view.
    pub(super) view: View,
    /// The camera before undistortion and reduction.
    pub(super) photographed: Camera,
    /// Present if any pixel is masked for its value.
    pub(super) bad: Option<BadPixels>,
    /// Space that the file states, or that it was converted to.
    pub(super) color_space: Option<ColorSpace>,
    /// Warnings about this image, without its name.
    pub(super) warnings: Vec<String>,
    /// Whether every pixel of the radiance is 0.
    pub(super) is_black: bool,
    /// Whether every pixel is negative, NaN or infinite.
    pub(super) has_no_pixels: bool,
    /// Share of the pixels that the mask of a file, or alpha taken for one, hides.
    pub(super) hidden_by_mask: Option<f64>,
    /// Exposure that the camera wrote beside integer samples that are read as radiance: seconds,
    /// times ISO speed / 100, over the square of the f-number.
    pub(super) photo_exposure: Option<f64>,
    /// Whether samples of a display's curve are read as radiance.
    pub(super) is_display_coded: bool,
    /// Digest of the bytes of the image and its mask.
    pub(super) digest: blake3::Hash,
}

pub(super) fn load_view(frame: &SourceFrame, options: &LoadOptions) -> Result<LoadedView, IoError> {
    let bytes = read_file(&frame.image)?;
    let mut digest = blake3::Hasher::new();
    digest.update(&bytes);
    let (mut decoded, values) = decode(frame, &bytes, options)?;
    let exif = exif_of_file(&bytes);
    turn_to_camera(&mut decoded, frame, exif.orientation);
    let is_photo = values == PixelValues::Radiance && decoded.depth != SampleDepth::Float;
    let is_display_coded = values == PixelValues::Radiance && decoded.is_display_coded;
    let photo_exposure = if is_photo { stated_exposure(&exif) } else { None };
    drop(bytes);
    let opacity = match options.masks {
        MaskSource::Alpha => Some(take_opacity(&mut decoded, frame)?),
        MaskSource::Auto | MaskSource::Off | MaskSource::Folder(_) => None,
    };
    decoded.composite_over_black();
    // Recorded values are not linear: no matrix takes them to another space.
    let color_space = if values == PixelValues::Radiance { settle_working_space(&mut decoded) } else { None };
    let mut image = decoded.image;
    let side = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    let photographed =
        frame.intrinsics.camera(frame.camera_from_world, [side(image.width), side(image.height)]).map_err(|e| frame.origin.error(e))?;
    let (mut mask, bad) = mask_bad_pixels(&mut image, &frame.name);
    let has_no_pixels = bad.as_ref().is_some_and(|bad| bad.nan + bad.infinite + bad.negative == image.pixels.len());
    let is_black = values == PixelValues::Radiance && bad.is_none() && image.pixels.iter().all(|pixel| *pixel == [0.0; 3]);
    let mut given = opacity;
    if let Some(path) = &frame.mask {
        let bytes = read_file(path)?;
        digest.update(&bytes);
        let (mask, remark) = decode_with_remark(path, &bytes, [image.width, image.height])?;
        decoded.warnings.extend(remark);
        given = Some(both(given, mask));
    }
    let hidden_by_mask = given.as_ref().map(hidden_share);
    if let Some(given) = given {
        mask = Some(both(mask, given));
    }
    let view = View {
        name: frame.name.clone(),
        camera: photographed.clone(),
        image: image.into(),
        values,
        noise: frame.noise.filter(|_| values == PixelValues::Radiance),
        mask: mask.map(Into::into),
        recordings: Vec::new(),
        target: Target::default(),
    };
    let foreign = frame.intrinsics.foreign_lens;
    let foreign_lens = foreign.map(|lens| lens.prepared());
    decoded.warnings.extend(foreign.zip(foreign_lens).and_then(|(lens, prepared)| lost_field(&photographed, &prepared, lens.base.name())));
    let view = resample(view, frame, foreign_lens.as_ref(), options.downscale.factor())?;
    Ok(LoadedView {
        view,
        photographed,
        bad,
        color_space,
        warnings: decoded.warnings,
        is_black,
        has_no_pixels,
        hidden_by_mask,
        photo_exposure,
        is_display_coded,
        digest: digest.finalize(),
    })
}

/// Returns the exposure that a camera wrote, if it wrote a shutter time. Where it left out the
/// speed or aperture, all photographs are taken to share it.
fn stated_exposure(exif: &Exif) -> Option<f64> {
    let f_number = exif.f_number.unwrap_or(1.0);
    Some(exif.seconds? * exif.iso.unwrap_or(100.0) / 100.0 / (f_number * f_number))
        .filter(|exposure| exposure.is_finite() && *exposure > 0.0)
}

/// Returns the share of the pixels' weight that a mask takes away.
fn hidden_share(mask: &Mask) -> f64 {
    1.0 - mask.weights.iter().map(|weight| f64::from(*weight)).sum::<f64>() / mask.weights.len().max(1) as f64
}

/// Turns an image whose Exif orientation lies on its side where only the turned one has the size of
/// its camera: some programs make cameras for the stored pixels, others for the turned ones.
fn turn_to_camera(decoded: &mut DecodedImage, frame: &SourceFrame, orientation: Option<u16>) {
    let Some(orientation @ 2..=8) = orientation else { return };
    let side = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    let stored = [side(decoded.image.width), side(decoded.image.height)];
    let [is_as_stored, is_as_turned] = [stored, [stored[1], stored[0]]].map(|size| frame.intrinsics.fits(size));
    match (is_as_stored, is_as_turned) {
        (false, true) if orientation >= 5 => {
            decoded.turn(orientation);
            decoded.warnings.push(format!("turned by EXIF orientation {orientation}, as the camera's size is that of the turned image"));
        }
        // The camera is that of the stored pixels.
        (true, false) if orientation >= 5 => {}
        _ => decoded.warnings.push(format!("EXIF orientation {orientation} is not applied: pixels are read as they are stored")),
    }
}

/// Returns the image, and what its numbers are: a float format holds radiance; where captured
/// images are read, an integer format holds recorded values.
fn decode(frame: &SourceFrame, bytes: &[u8], options: &LoadOptions) -> Result<(DecodedImage, PixelValues), IoError> {
    if options.supervision != Supervision::Ldr {
        let decoded = decode_image(&frame.image, bytes, &ReadOptions { transfer: options.transfer, layer: options.layer.clone() })?;
        return Ok((decoded, PixelValues::Radiance));
    }
    // The samples as they are, over their maximum: the curve that made them is to be recovered.
    let mut decoded = decode_codes_of(Input::new(&frame.image, bytes), options.layer.as_deref())?;
    match (decoded.depth, frame.exposure_s, frame.part) {
        (SampleDepth::Float, _, Some(Part::Train)) => {
            let found = frame.image.display();
            let message = format!("{found} holds radiance, expected a captured LDR image (PNG, JPEG, TIFF) to train on");
            Err(frame.origin.error(message).with_remedy(Remedy::set("supervision", "hdr")))
        }
        (SampleDepth::Float, ..) => Ok((decoded, PixelValues::Radiance)),
        (_, Some(exposure_s), _) => {
            // These warnings concern a display image that is read as radiance.
            decoded.warnings.clear();
            Ok((decoded, PixelValues::Recorded { exposure_s }))
        }
        (_, None, _) => Err(frame.origin.error("the captured LDR image has no \"exposure\", expected seconds")),
    }
}

/// Removes lens distortion and reduces, in linear light. Pixels that recorded values make together
/// with bounds are left out.
fn resample(view: View, frame: &SourceFrame, foreign_lens: Option<&PreparedLens>, factor: u32) -> Result<View, IoError> {
    let View { name, mut camera, image, values, mut noise, mask, recordings, target } = view;
    let (mut image, mut mask) = (image.into_value(), mask.map(OnDemand::into_value));
    // What a foreign lens does not show is left out as it is removed.
    if foreign_lens.is_none()
        && let Some(field) = field_mask(&camera)
    {
        mask = Some(both(mask, field));
    }
    let is_distorted = foreign_lens.is_some() || !camera.distortion.is_none();
    let is_resampled = is_distorted || factor > 1;
    let mut bounds = is_resampled.then(|| values.bounds(&image)).flatten();
    if is_resampled {
        values.to_light(&mut image);
    }
    if is_distorted {
        let without_lens = |image: &Image| match foreign_lens {
            Some(lens) => straighten(image, mask.as_ref(), &camera, lens),
            None => {
                let (image, seen, _) = undistort(image, mask.as_ref(), &camera);
                (image, seen)
            }
        };
        let (straight, mut seen) = without_lens(&image);
        if let Some(bounds) = &mut bounds {
            *bounds = without_lens(bounds).0;
            leave_out_mixtures(bounds, &mut seen);
        }
        (image, mask) = (straight, Some(seen));
        camera.distortion = Distortion::default();
    }
    if factor > 1 {
        let [w, h] = camera.size_px;
        if w < factor || h < factor {
            return Err(frame
                .origin
                .error(format!("image of {w} x {h} pixels, expected at least {factor} x {factor} to reduce it {factor} times")));
        }
        let factor_px = factor as usize;
        let all = |image: &Image| Mask { weights: vec![1.0; image.pixels.len()] };
        match mask.take().or_else(|| bounds.as_ref().map(all)) {
            Some(before) => {
                let (reduced, mut seen) = downscale_masked(&image, &before, factor_px);
                if let Some(bounds) = &bounds {
                    leave_out_mixtures(&downscale_masked(bounds, &before, factor_px).0, &mut seen);
                }
                (image, mask) = (reduced, Some(seen));
            }
            None => image = downscale(&image, factor_px),
        }
        camera = camera.downscaled(factor);
        noise = noise.map(|model| model.averaged((factor * factor) as usize));
    }
    if is_resampled {
        values.from_light(&mut image);
    }
    let mask = mask.filter(|mask| mask.weights.iter().any(|weight| *weight < 1.0)).map(Into::into);
    Ok(View { name, camera, image: image.into(), values, noise, mask, recordings, target })
}

/// Returns the mask of the pixels in which the lens shows something; `None` if it fills the image.
pub(super) fn field_mask(camera: &Camera) -> Option<Mask> {
    let [width, height] = camera.size_px.map(|side| side as usize);
    let shows = |i: usize| camera.shows(DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5));
    let is_partial = !camera.projection.is_pinhole() && !(0..width * height).all(shows);
    is_partial.then(|| Mask::from_valid((0..width * height).map(shows)))
}

/// Takes the weight of pixels of recorded values whose resampled `bounds` show that some of what
/// they are made of was black or saturated, and some not.
fn leave_out_mixtures(bounds: &Image, mask: &mut Mask) {
    let mixed = mask.weights.iter_mut().zip(&bounds.pixels).filter(|(_, levels)| PixelValues::is_mixture(**levels));
    mixed.for_each(|(weight, _)| *weight = 0.0);
}

/// Returns the product of two masks: pixels that count in both.
pub(super) fn both(mask: Option<Mask>, other: Mask) -> Mask {
    match mask {
        None => other,
        Some(mask) => Mask { weights: mask.weights.iter().zip(&other.weights).map(|(a, b)| a * b).collect() },
    }
}

/// Returns the alpha channel as weights; colours that were multiplied by it are divided.
fn take_opacity(decoded: &mut DecodedImage, frame: &SourceFrame) -> Result<Mask, IoError> {
    let Some(alpha) = decoded.alpha.take() else {
        let message = format!("{} has no alpha channel, expected one to mask by", frame.image.display());
        return Err(frame.origin.error(message).with_remedy(Remedy::leave_out("masks")));
    };
    let weights: Vec<f32> = alpha.iter().map(|a| if *a > 0.0 { a.min(1.0) } else { 0.0 }).collect();
    if decoded.is_premultiplied {
        for (pixel, weight) in decoded.image.pixels.iter_mut().zip(&weights).filter(|(_, weight)| **weight > 0.0) {
            *pixel = pixel.map(|v| v / weight);
        }
    }
    Ok(Mask { weights })
}

/// Returns the space that a scene is trained in: linear Rec.709 and ACEScg stay, other spaces that
/// the file states are converted to linear Rec.709. A wider space for its own sake costs quality:
/// chromaticities crowd in the middle of it.
fn settle_working_space(decoded: &mut DecodedImage) -> Option<ColorSpace> {
    let stated = decoded.color_space?;
    if matches!(stated, ColorSpace::LinearRec709 | ColorSpace::AcesCg) {
        return Some(stated);
    }
    let working = ColorSpace::LinearRec709;
    convert(&mut decoded.image, &Conversion::between(stated, working), stated.name(), &mut decoded.warnings);
    Some(working)
}

/// Sets pixels that are not radiance to 0 and masks them. `None` where there are none.
pub(super) fn mask_bad_pixels(image: &mut Image, name: &str) -> (Option<Mask>, Option<BadPixels>) {
    let mut bad = BadPixels { name: name.to_owned(), nan: 0, infinite: 0, negative: 0 };
    let mut valid = Vec::new();
    let count = image.pixels.len();
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let kind = if pixel.iter().any(|v| v.is_nan()) {
            &mut bad.nan
        } else if pixel.iter().any(|v| v.is_infinite()) {
            &mut bad.infinite
        } else if pixel.iter().any(|v| *v < 0.0) {
            &mut bad.negative
        } else {
            continue;
        };
        *kind += 1;
        *pixel = [0.0; 3];
        // Most images have none: the mask is made at the first.
        valid.resize(count, true);
        valid[i] = false;
    }
    if valid.is_empty() { (None, None) } else { (Some(Mask::from_valid(valid)), Some(bad)) }
}

//! One view: file -> linear radiance, bad pixels masked, undistorted, reduced.

use luxel_core::{BadPixels, Camera, ColorSpace, Conversion, Image, Mask, View};

use super::LoadOptions;
use super::source::Frame;
use crate::IoError;
use crate::image::colorimetry::convert;
use crate::image::{DecodedImage, ReadOptions, SampleDepth, decode_image, downscale, downscale_masked, undistort};
use crate::regular::read_file;

/// A view with what is known about its file.
pub(super) struct LoadedView {
    /// The view.
    pub(super) view: View,
    /// The camera before undistortion and reduction.
    pub(super) photographed: Camera,
    /// Present if any pixel is masked for its value.
    pub(super) bad: Option<BadPixels>,
    /// As the file states it, or as it was converted to.
    pub(super) color_space: Option<ColorSpace>,
    /// Of this image, without its name.
    pub(super) warnings: Vec<String>,
    /// Of the file's bytes.
    pub(super) digest: blake3::Hash,
}

pub(super) fn load_view(frame: &Frame, options: &LoadOptions) -> Result<LoadedView, IoError> {
    let bytes = read_file(&frame.image)?;
    let digest = blake3::hash(&bytes);
    let mut decoded = decode_image(&frame.image, &bytes, &ReadOptions { transfer: options.transfer })?;
    drop(bytes);
    composite_over_black(&mut decoded);
    let color_space = settle_working_space(&mut decoded);
    let mut image = decoded.image;
    let side = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    let photographed =
        frame.intrinsics.camera(frame.camera_from_world, [side(image.width), side(image.height)]).map_err(|e| frame.origin.error(e))?;
    let (mut mask, bad) = mask_bad_pixels(&mut image, &frame.name);
    let mut camera = photographed.clone();
    if !camera.distortion.is_none() {
        let (straight, seen, pinhole) = undistort(&image, mask.as_ref(), &camera);
        (image, mask, camera) = (straight, Some(seen), pinhole);
    }
    if options.downscale > 1 {
        let [w, h] = camera.size_px;
        let factor = options.downscale;
        if w < factor || h < factor {
            return Err(frame
                .origin
                .error(format!("image of {w} x {h} pixels, expected at least {factor} x {factor} to reduce it {factor} times")));
        }
        match mask.take() {
            Some(seen) => {
                let (reduced, seen) = downscale_masked(&image, &seen, factor as usize);
                (image, mask) = (reduced, Some(seen));
            }
            None => image = downscale(&image, factor as usize),
        }
        camera = camera.downscaled(factor);
    }
    let mask = mask.filter(|mask| !mask.valid.iter().all(|v| *v)).map(std::sync::Arc::new);
    Ok(LoadedView {
        view: View { name: frame.name.clone(), camera, image: std::sync::Arc::new(image), mask },
        photographed,
        bad,
        color_space,
        warnings: decoded.warnings,
        digest,
    })
}

/// Integer formats hold straight colour beside the opacity; float formats hold colour that is multiplied already.
fn composite_over_black(decoded: &mut DecodedImage) {
    if decoded.depth == SampleDepth::Float {
        return;
    }
    let Some(alpha) = &decoded.alpha else { return };
    for (pixel, alpha) in decoded.image.pixels.iter_mut().zip(alpha) {
        *pixel = pixel.map(|v| v * alpha);
    }
}

/// The space that a scene is trained in: linear Rec.709 and ACEScg stay, other spaces that the file states are converted to linear Rec.709.
/// A wider space for its own sake costs quality: chromaticities crowd in the middle of it.
fn settle_working_space(decoded: &mut DecodedImage) -> Option<ColorSpace> {
    let stated = decoded.color_space?;
    if matches!(stated, ColorSpace::LinearRec709 | ColorSpace::AcesCg) {
        return Some(stated);
    }
    let working = ColorSpace::LinearRec709;
    convert(&mut decoded.image, &Conversion::between(stated, working));
    decoded.warnings.push(format!("colours converted to linear Rec.709 from {}", stated.name()));
    Some(working)
}

/// Sets pixels that are no radiance to 0 and masks them. `None` where there are none.
fn mask_bad_pixels(image: &mut Image, name: &str) -> (Option<Mask>, Option<BadPixels>) {
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
    if valid.is_empty() { (None, None) } else { (Some(Mask { valid }), Some(bad)) }
}

//! Pictures of the report: radiance to 8-bit PNG in a data URI.
//!
//! In: images in normalised units. Out: `data:image/png;base64,...`. Images are averaged down by a
//! whole factor in linear light first, error maps in units of the error. The exposures and the
//! error scale are chosen from all views together, so that pictures can be compared with one
//! another.

use std::io::Cursor;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use luxel::Result;
use luxel::error::Context as _;
use luxel_core::tone::{Tonemap, display_rgb8, mu_law, rec709_of};
use luxel_core::{ColorSpace, Image, Mask, luminance_rec709, mask};

/// matplotlib's inferno at eleven even places: perceptually even, dark to bright, readable without
/// colour vision.
pub(super) const INFERNO: [[u8; 3]; 11] = [
    [0x00, 0x00, 0x04],
    [0x16, 0x0b, 0x39],
    [0x42, 0x0a, 0x68],
    [0x6a, 0x17, 0x6e],
    [0x93, 0x26, 0x67],
    [0xbc, 0x37, 0x54],
    [0xdd, 0x51, 0x3a],
    [0xf3, 0x78, 0x19],
    [0xfc, 0xa5, 0x0a],
    [0xf6, 0xd7, 0x46],
    [0xfc, 0xff, 0xa4],
];

/// Colour of masked pixels in an error map.
const MASKED: [u8; 3] = [0x60, 0x68, 0x70];

/// The conversion of radiance for display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Display {
    /// Curve from radiance to display values.
    pub tonemap: Tonemap,
    /// Stops: radiance is multiplied by 2^EV.
    pub exposure_ev: f32,
    /// Colour space of the radiance.
    pub color_space: ColorSpace,
    /// Longer sides are reduced to at most this, pixels.
    pub max_side_px: usize,
}

/// A picture ready for the page.
pub struct Picture {
    /// The PNG as a data URI.
    pub uri: String,
    /// Side, pixels.
    pub width: usize,
    /// Side, pixels.
    pub height: usize,
}

/// Returns radiance as a picture.
///
/// # Errors
/// The image cannot be encoded.
pub fn radiance(image: &Image, display: &Display) -> Result<Picture> {
    let small = reduce(image, reduction(image, display.max_side_px));
    let pixels = small.pixels.iter().map(|&p| {
        // Outside of Rec.709 a channel is negative: the curves take it as 0.
        display_rgb8(display.tonemap, display.exposure_ev, rec709_of(display.color_space, p))
    });
    encode(small.width, small.height, pixels.collect())
}

/// Returns |T(prediction) - T(target)|, mean of the channels, nothing clipped, on `INFERNO` from 0
/// to `full_scale`.
pub(super) fn error_map(
    prediction: &Image,
    target: &Image,
    mask: Option<&Mask>,
    mu: f32,
    full_scale: f32,
    max_side_px: usize,
) -> Result<Picture> {
    let pixels = (prediction.pixels.iter().zip(&target.pixels).enumerate()).map(|(i, (&p, &t))| {
        let valid = mask::is_valid(mask, i);
        [if valid { mu_error(p, t, mu) } else { 0.0 }, f32::from(u8::from(valid)), 0.0]
    });
    let error = Image::from_pixels(target.width, target.height, pixels.collect()).context("prediction and target differ in size")?;
    values(&error, full_scale, max_side_px)
}

/// Returns the first channel on `INFERNO` from 0 to `full_scale`. Pixels are masked where the
/// second channel is 0; where it is 1 they count in averages.
///
/// # Errors
/// The image cannot be encoded.
pub fn values(image: &Image, full_scale: f32, max_side_px: usize) -> Result<Picture> {
    let small = reduce(image, reduction(image, max_side_px));
    let colors = small.pixels.iter().map(|&[value, valid, _]| if valid > 0.0 { inferno(value / valid / full_scale) } else { MASKED });
    encode(small.width, small.height, colors.collect())
}

/// Returns the mean over channels of the absolute difference under the mu-law.
pub(crate) fn mu_error(prediction: [f32; 3], target: [f32; 3], mu: f32) -> f32 {
    (0..3).map(|c| (mu_law(prediction[c].max(0.0), mu) - mu_law(target[c].max(0.0), mu)).abs()).sum::<f32>() / 3.0
}

/// Returns the colour of `share` 0 to 1; outside, and for NaN, the nearer end.
pub(super) fn inferno(share: f32) -> [u8; 3] {
    luxel_metrics::colormap::ramp(&INFERNO, share)
}

/// Returns the integer factor that brings the longer side to `max_side_px` or below.
fn reduction(image: &Image, max_side_px: usize) -> usize {
    image.width.max(image.height).div_ceil(max_side_px.max(1)).max(1)
}

/// Returns means over blocks of `factor` x `factor` pixels, smaller ones at the right and lower
/// edge.
fn reduce(image: &Image, factor: usize) -> Image {
    if factor == 1 {
        return image.clone();
    }
    let (width, height) = (image.width.div_ceil(factor), image.height.div_ceil(factor));
    let mut pixels = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut count) = ([0f32; 3], 0f32);
            for row in y * factor..((y + 1) * factor).min(image.height) {
                for column in x * factor..((x + 1) * factor).min(image.width) {
                    let pixel = image.at(column, row);
                    sum = std::array::from_fn(|c| sum[c] + pixel[c]);
                    count += 1.0;
                }
            }
            pixels.push(sum.map(|v| v / count));
        }
    }
    Image { width, height, pixels }
}

fn encode(width: usize, height: usize, pixels: Vec<[u8; 3]>) -> Result<Picture> {
    let mut png = Cursor::new(Vec::new());
    let (w, h) = (u32::try_from(width)?, u32::try_from(height)?);
    let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::Adaptive);
    encoder.write_image(pixels.as_flattened(), w, h, ExtendedColorType::Rgb8).context("encode a picture")?;
    Ok(Picture { uri: format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png.into_inner())), width, height })
}

/// Returns stops with their sign: `+4`, `−6`.
pub fn signed(ev: f32) -> String {
    if ev < 0.0 { format!("−{}", -ev) } else { format!("+{ev}") }
}

/// Returns an image element; `alt` is HTML.
pub fn img(picture: &Picture, class: &str, alt: &str) -> String {
    let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
    format!(
        "<img{class} src=\"{}\" width=\"{}\" height=\"{}\" alt=\"{alt}\" decoding=\"async\">",
        picture.uri, picture.width, picture.height
    )
}

/// Returns an image with a caption; both are HTML.
pub fn figure(picture: &Picture, what: &str, how: &str) -> String {
    format!("<figure>{}<figcaption><b>{what}</b> {how}</figcaption></figure>", img(picture, "", &format!("{what}, {how}")))
}

/// The exposures that are chosen from all targets together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposures {
    /// Brings the darkest quarter to a little below middle grey.
    pub shadows_ev: f32,
    /// Brings the log-average to an evening's grey: how the scene looks.
    pub overview_ev: f32,
    /// Brings the brightest half per mille below white.
    pub lamps_ev: f32,
}

impl Exposures {
    /// Returns whole stops within +-16, from luminances in normalised units (any order).
    pub fn new(mut luminances: Vec<f32>) -> Self {
        luminances.retain(|l| l.is_finite() && *l > 0.0);
        luminances.sort_by(f32::total_cmp);
        let quantile =
            |share: f32| luminances.get((share * luminances.len() as f32) as usize).or(luminances.last()).copied().unwrap_or(1.0);
        let log_mean = luminances.iter().map(|l| f64::from(l.ln())).sum::<f64>() / luminances.len().max(1) as f64;
        let stops = |to: f32, from: f32| (to / from).log2();
        Self {
            shadows_ev: stops(0.12, quantile(0.25)).round().clamp(1.0, 16.0),
            overview_ev: stops(0.12, log_mean.exp() as f32).round().clamp(-16.0, 16.0),
            lamps_ev: stops(0.8, quantile(0.9995)).floor().clamp(-16.0, -1.0),
        }
    }
}

/// Returns at most a quarter of a million luminances, evenly from all images.
pub fn sample_luminances<'a>(images: impl Iterator<Item = &'a Image> + Clone) -> Vec<f32> {
    let total: usize = images.clone().map(|image| image.pixels.len()).sum();
    let stride = total.div_ceil(1 << 18).max(1);
    images.flat_map(|image| image.pixels.iter()).step_by(stride).map(|&p| luminance_rec709(p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reduction_is_the_mean_of_blocks_in_linear_light() {
        let image = Image::from_pixels(3, 2, (0..6).map(|i| [i as f32; 3]).collect()).unwrap();
        assert_eq!(reduction(&image, 3), 1);
        assert_eq!(reduction(&image, 2), 2);
        let small = reduce(&image, 2);
        assert_eq!((small.width, small.height), (2, 1));
        assert_eq!(small.pixels, [[2.0; 3], [3.5; 3]]);
    }

    #[test]
    fn inferno_runs_from_end_to_end_and_survives_anything() {
        assert_eq!(inferno(0.0), INFERNO[0]);
        assert_eq!(inferno(0.3), INFERNO[3]);
        assert_eq!(inferno(7.0), INFERNO[10]);
        assert_eq!(inferno(f32::NAN), INFERNO[0]);
    }

    #[test]
    fn masked_pixels_are_grey_and_do_not_dilute_the_mean() {
        let target = Image::filled(2, 1, [0.0; 3]);
        let prediction = Image::filled(2, 1, [1.0; 3]);
        let mask = Mask::from_valid(vec![true, false]);
        let decode = |picture: Picture| {
            let png = BASE64_STANDARD.decode(picture.uri.trim_start_matches("data:image/png;base64,")).unwrap();
            image::load_from_memory(&png).unwrap().to_rgb8().into_raw()
        };
        let full = decode(error_map(&prediction, &target, Some(&mask), 5000.0, 1.0, 10).unwrap());
        assert_eq!(full, [INFERNO[10], MASKED].concat());
        let reduced = decode(error_map(&prediction, &target, Some(&mask), 5000.0, 1.0, 1).unwrap());
        assert_eq!(reduced, INFERNO[10]);
    }

    #[test]
    fn exposures_show_shadows_and_resolve_lamps() {
        let mut luminances = vec![0.01; 1000];
        luminances.extend([100.0; 10]);
        let exposures = Exposures::new(luminances);
        assert_eq!(exposures.shadows_ev, 4.0);
        assert_eq!(exposures.lamps_ev, -7.0);
        assert!(exposures.overview_ev > 2.0);
        for odd in [vec![], vec![0.0; 5], vec![f32::NAN, f32::INFINITY]] {
            let exposures = Exposures::new(odd);
            assert!([exposures.shadows_ev, exposures.overview_ev, exposures.lamps_ev].iter().all(|ev| ev.is_finite()));
        }
    }
}

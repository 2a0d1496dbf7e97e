//! 8-bit pictures for structure from motion, in which dark and bright regions both have features.
//!
//! In: scene-linear radiance. Out: sRGB bytes at an integer reduction. The logarithm of luminance
//! is split by a guided filter (He et al. 2010, self-guided) into a base that changes at edges and
//! a detail; the base is compressed to a few stops around middle grey, the detail is kept. Every
//! view is normalised by its own range: the pictures do not depend on exposure. Noise far below the
//! median is not amplified.
//!
//! Degenerate: black views are black; pixels that are no numbers count as black.

use luxel_core::{Image, luminance_rec709, tone::srgb_encode};
use rayon::prelude::*;

/// How a proxy is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProxyOptions {
    /// Longest side, pixels.
    pub max_side_px: usize,
}

/// An 8-bit picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Proxy {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// `[H*W*3]`, sRGB.
    pub rgb8: Vec<u8>,
    /// How many times a side the view was reduced; blocks that are incomplete at the right and
    /// bottom border are left out.
    pub reduction: usize,
}

/// Stops that the base may span, from its 1st to its 99th percentile.
const BASE_STOPS: f32 = 3.0;
/// Darkness that counts as noise: below a quarter of the 5th percentile, or this many stops
/// below the median.
const FLOOR_STOPS: f32 = 12.0;
/// Strength of an edge that stays in the base, squared stops.
const EDGE: f32 = 0.5;
/// The filter's radius as a share of the longest side.
const RADIUS_SHARE: usize = 40;
/// Middle grey.
const GREY: f32 = 0.18;

/// Returns the proxy of a view.
pub fn proxy(image: &Image, options: &ProxyOptions) -> Proxy {
    let reduction = image.width.max(image.height).div_ceil(options.max_side_px.max(1)).max(1);
    let (width, height) = (image.width / reduction, image.height / reduction);
    let pixels: Vec<[f32; 3]> = (0..width * height)
        .into_par_iter()
        .map(|i| image.block_mean([i % width * reduction, i / width * reduction], reduction, |_| true).0)
        .map(|p| p.map(|v| if v > 0.0 && v.is_finite() { v } else { 0.0 }))
        .collect();
    let luminance: Vec<f32> = pixels.iter().map(|p| luminance_rec709(*p)).collect();
    let Some(middle) = percentile(&luminance, 0.5, |v| v > 0.0) else {
        return Proxy { width, height, rgb8: vec![0; width * height * 3], reduction };
    };
    let dark = percentile(&luminance, 0.05, |v| v > 0.0).unwrap_or(middle);
    let floor = (0.25 * dark).max(middle * (-FLOOR_STOPS).exp2());
    let stops: Vec<f32> = luminance.par_iter().map(|l| ((l + floor) / middle).log2()).collect();
    let base = guided_filter(&stops, width, height, (width.max(height) / RADIUS_SHARE).max(4), EDGE);
    let [low, high] = [0.01, 0.99].map(|share| percentile(&base, share, |_| true).unwrap_or(0.0));
    let center = 0.5 * (low + high);
    let compression = (BASE_STOPS / (high - low).max(1e-3)).min(1.0);
    let mut rgb8 = vec![0u8; width * height * 3];
    rgb8.par_chunks_mut(3).enumerate().for_each(|(i, out)| {
        let display = ((base[i] - center) * compression + stops[i] - base[i]).exp2() * GREY;
        let gain = display / (luminance[i] + floor);
        for (out, v) in out.iter_mut().zip(pixels[i]) {
            *out = (srgb_encode((v * gain).min(1.0)) * 255.0 + 0.5) as u8;
        }
    });
    Proxy { width, height, rgb8, reduction }
}

fn percentile(values: &[f32], share: f64, counts: impl Fn(f32) -> bool) -> Option<f32> {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|v| counts(*v)).collect();
    let last = sorted.len().checked_sub(1)?;
    let at = (share * last as f64).round() as usize;
    Some(*sorted.select_nth_unstable_by(at.min(last), f32::total_cmp).1)
}

/// Computes a * value + b with a and b from the mean and variance of boxes, averaged over boxes
/// again.
fn guided_filter(values: &[f32], width: usize, height: usize, radius: usize, edge: f32) -> Vec<f32> {
    let mean = box_mean(values, width, height, radius);
    let squares: Vec<f32> = values.par_iter().map(|v| v * v).collect();
    let square_mean = box_mean(&squares, width, height, radius);
    let slope: Vec<f32> = mean
        .par_iter()
        .zip(&square_mean)
        .map(|(m, s)| {
            let variance = (s - m * m).max(0.0);
            variance / (variance + edge)
        })
        .collect();
    let offset: Vec<f32> = mean.par_iter().zip(&slope).map(|(m, a)| m * (1.0 - a)).collect();
    let slope = box_mean(&slope, width, height, radius);
    let offset = box_mean(&offset, width, height, radius);
    values.par_iter().zip(slope.par_iter().zip(&offset)).map(|(v, (a, b))| a * v + b).collect()
}

/// Returns the mean over the part of a square of side 2 radius + 1 that lies in the image.
fn box_mean(values: &[f32], width: usize, height: usize, radius: usize) -> Vec<f32> {
    if width == 0 || height == 0 {
        return Vec::new();
    }
    let mut rows = vec![0.0f32; values.len()];
    rows.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| {
        sliding_mean(row.len(), radius, |x| f64::from(row[x]), |x, v| out[x] = v as f32);
    });
    // Columns are summed row by row, so that memory is read in order.
    let mut out = vec![0.0f32; values.len()];
    let mut sums = vec![0.0f64; width];
    let row = |y: usize| rows.get(y * width..(y + 1) * width).unwrap_or_default();
    for y in 0..radius.min(height) {
        sums.iter_mut().zip(row(y)).for_each(|(s, v)| *s += f64::from(*v));
    }
    for (y, out) in out.chunks_mut(width).enumerate() {
        if y + radius < height {
            sums.iter_mut().zip(row(y + radius)).for_each(|(s, v)| *s += f64::from(*v));
        }
        if y > radius {
            sums.iter_mut().zip(row(y - radius - 1)).for_each(|(s, v)| *s -= f64::from(*v));
        }
        let count = ((y + radius).min(height - 1) - y.saturating_sub(radius) + 1) as f64;
        out.iter_mut().zip(&sums).for_each(|(o, s)| *o = (s / count) as f32);
    }
    out
}

fn sliding_mean(length: usize, radius: usize, value: impl Fn(usize) -> f64, mut put: impl FnMut(usize, f64)) {
    let mut sum: f64 = (0..radius.min(length)).map(&value).sum();
    for i in 0..length {
        if i + radius < length {
            sum += value(i + radius);
        }
        if i > radius {
            sum -= value(i - radius - 1);
        }
        put(i, sum / ((i + radius).min(length - 1) - i.saturating_sub(radius) + 1) as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an image with the left half dark, the right half ten stops brighter, both with the
    /// same texture.
    fn two_lights(scale: f32) -> Image {
        let pixel = |i: usize| {
            let (x, y) = (i % 128, i / 128);
            let texture = 1.0 + 0.3 * ((x as f32 * 0.9).sin() * (y as f32 * 0.7).cos());
            [texture * scale * if x < 64 { 1.0 } else { 1024.0 }; 3]
        };
        Image { width: 128, height: 96, pixels: (0..128 * 96).map(pixel).collect() }
    }

    fn contrast(proxy: &Proxy, columns: std::ops::Range<usize>) -> f32 {
        let values: Vec<f32> = (0..proxy.width * proxy.height)
            .filter(|i| columns.contains(&(i % proxy.width)))
            .map(|i| f32::from(proxy.rgb8[3 * i]))
            .collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
    }

    #[test]
    fn dark_and_bright_keep_their_texture() {
        let proxy = proxy(&two_lights(1.0), &ProxyOptions { max_side_px: 4000 });
        assert_eq!((proxy.width, proxy.height, proxy.reduction), (128, 96, 1));
        for columns in [8..56, 72..120] {
            let found = contrast(&proxy, columns.clone());
            assert!(found > 4.0, "columns {columns:?}: {found}");
        }
    }

    #[test]
    fn exposure_does_not_matter() {
        let options = ProxyOptions { max_side_px: 50 };
        let (a, b) = (proxy(&two_lights(1.0), &options), proxy(&two_lights(1e-3), &options));
        assert_eq!((a.width, a.height, a.reduction), (42, 32, 3));
        assert!(a.rgb8.iter().zip(&b.rgb8).all(|(x, y)| x.abs_diff(*y) <= 1));
    }

    #[test]
    fn hostile_pixels_are_black() {
        let mut image = two_lights(1.0);
        image.pixels[..40].fill([f32::NAN, f32::INFINITY, -1.0]);
        assert_eq!(proxy(&image, &ProxyOptions { max_side_px: 4000 }).rgb8[0], 0);
        assert!(proxy(&Image::filled(3, 2, [0.0; 3]), &ProxyOptions { max_side_px: 0 }).rgb8.is_empty());
        assert_eq!(proxy(&Image::default(), &ProxyOptions { max_side_px: 10 }).width, 0);
    }

    #[test]
    fn box_means_are_those_of_the_definition() {
        let values: Vec<f32> = (0..7 * 5).map(|i| ((i * 13) % 11) as f32).collect();
        for radius in [0, 1, 3, 9] {
            let found = box_mean(&values, 7, 5, radius);
            for y in 0..5i32 {
                for x in 0..7i32 {
                    let r = radius as i32;
                    let inside: Vec<f32> = (y - r..=y + r)
                        .flat_map(|v| (x - r..=x + r).map(move |u| (u, v)))
                        .filter(|(u, v)| (0..7).contains(u) && (0..5).contains(v))
                        .map(|(u, v)| values[(v * 7 + u) as usize])
                        .collect();
                    let expected = inside.iter().sum::<f32>() / inside.len() as f32;
                    assert!((found[(y * 7 + x) as usize] - expected).abs() < 1e-4, "{radius} {x} {y}");
                }
            }
        }
    }
}

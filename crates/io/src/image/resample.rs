//! Resampling in linear light: area average, and undistortion into a pinhole camera. Pixel centres at +0.5.

use glam::DVec2;
use luxel_core::{Camera, Distortion, Image, Mask};
use rayon::prelude::*;

/// Area average of `factor` x `factor` blocks; incomplete blocks at the right and bottom border are left out. A factor of 0 is taken
/// as 1; an image smaller than a block becomes empty.
pub fn downscale(image: &Image, factor: usize) -> Image {
    reduce(image, None, factor).0
}

/// [`downscale`] over valid pixels only; a block without any is invalid and 0.
pub fn downscale_masked(image: &Image, mask: &Mask, factor: usize) -> (Image, Mask) {
    let (image, valid) = reduce(image, Some(mask), factor);
    (image, Mask { valid })
}

fn is_valid(mask: Option<&Mask>, pixel: usize) -> bool {
    mask.is_none_or(|mask| mask.valid.get(pixel).copied().unwrap_or(false))
}

fn reduce(image: &Image, mask: Option<&Mask>, factor: usize) -> (Image, Vec<bool>) {
    let factor = factor.max(1);
    let (width, height) = (image.width / factor, image.height / factor);
    let block = |index: usize| {
        let (left, top) = (index % width * factor, index / width * factor);
        // Sums in f64: a filament beside darkness must not swallow the darkness.
        let (mut sum, mut count) = ([0.0f64; 3], 0u32);
        for y in top..top + factor {
            for x in left..left + factor {
                let at = y * image.width + x;
                if let Some(pixel) = image.pixels.get(at).filter(|_| is_valid(mask, at)) {
                    sum = [0, 1, 2].map(|c| sum[c] + f64::from(pixel[c]));
                    count += 1;
                }
            }
        }
        if count == 0 { ([0.0; 3], false) } else { (sum.map(|s| (s / f64::from(count)) as f32), true) }
    };
    let (pixels, valid) = (0..width * height).into_par_iter().map(block).unzip();
    (Image { width, height, pixels }, valid)
}

/// Resamples a distorted image into the same camera without distortion, bilinearly. Pixels whose ray falls outside of the image, or
/// that touch an invalid pixel, are invalid and 0. `camera` is the image's, of its size.
pub fn undistort(image: &Image, mask: Option<&Mask>, camera: &Camera) -> (Image, Mask, Camera) {
    let lens = camera.distortion;
    let limit = fold_radius2(&lens);
    let (width, height) = (image.width, image.height);
    let pixel = |index: usize| {
        let target = DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let straight = (target - camera.center_px) / camera.focal_px;
        if straight.length_squared() >= limit {
            return ([0.0; 3], false);
        }
        let source = lens.distort(straight) * camera.focal_px + camera.center_px;
        sample(image, mask, source).map_or(([0.0; 3], false), |rgb| (rgb, true))
    };
    let (pixels, valid) = (0..width * height).into_par_iter().map(pixel).unzip();
    let pinhole = Camera { distortion: Distortion::default(), ..camera.clone() };
    (Image { width, height, pixels }, Mask { valid }, pinhole)
}

/// Squared radius from which on the radial polynomial turns back: rays beyond it would show parts of the image a second time.
/// Smallest positive root s of d/dr [r (1 + k1 r^2 + k2 r^4)] = 1 + 3 k1 s + 5 k2 s^2, s = r^2; infinite if there is none.
fn fold_radius2(lens: &Distortion) -> f64 {
    let (a, b) = (5.0 * lens.k2, 3.0 * lens.k1);
    let discriminant = b * b - 4.0 * a;
    if discriminant < 0.0 {
        return f64::INFINITY;
    }
    // The form that neither cancels nor divides by a vanishing k2: roots are 2 / (-b -+ sqrt(b^2 - 4 a)).
    let root = discriminant.sqrt();
    [2.0 / (-b - root), 2.0 / (-b + root)].into_iter().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min)
}

/// Bilinear value at `position` in pixels; the outer half of border pixels is constant. `None` outside, or if a pixel that counts is
/// invalid.
fn sample(image: &Image, mask: Option<&Mask>, position: DVec2) -> Option<[f32; 3]> {
    let (width, height) = (image.width as f64, image.height as f64);
    // Also refuses NaN.
    if !(position.x >= 0.0 && position.x <= width && position.y >= 0.0 && position.y <= height) {
        return None;
    }
    let corner = (position - 0.5).clamp(DVec2::ZERO, DVec2::new(width - 1.0, height - 1.0));
    let (base, fraction) = (corner.floor(), corner - corner.floor());
    let (left, top) = (base.x as usize, base.y as usize);
    let taps = [
        (0, 0, (1.0 - fraction.x) * (1.0 - fraction.y)),
        (1, 0, fraction.x * (1.0 - fraction.y)),
        (0, 1, (1.0 - fraction.x) * fraction.y),
        (1, 1, fraction.x * fraction.y),
    ];
    let mut sum = [0.0f64; 3];
    for (dx, dy, weight) in taps.into_iter().filter(|(_, _, weight)| *weight > 0.0) {
        let at = (top + dy) * image.width + left + dx;
        let pixel = image.pixels.get(at).filter(|_| is_valid(mask, at))?;
        sum = [0, 1, 2].map(|c| sum[c] + weight * f64::from(pixel[c]));
    }
    Some(sum.map(|s| s as f32))
}

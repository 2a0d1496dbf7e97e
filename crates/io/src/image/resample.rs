//! Resampling in linear light: area average, and undistortion into a pinhole camera. Pixel centres
//! at +0.5.

use glam::DVec2;
use luxel_core::{Camera, Distortion, Image, Mask, mask};
use rayon::prelude::*;

/// Returns the area average of `factor` x `factor` blocks; incomplete blocks at the right and
/// bottom border are left out. A factor of 0 counts as 1; an image smaller than a block becomes
/// empty.
///
/// ```
/// use luxel_core::Image;
///
/// let image = Image { width: 2, height: 2, pixels: vec![[0.0; 3], [4.0; 3], [8.0; 3], [4.0; 3]] };
/// assert_eq!(luxel_io::downscale(&image, 2).pixels, [[4.0; 3]]);
/// ```
pub fn downscale(image: &Image, factor: usize) -> Image {
    reduce(image, None, factor).0
}

/// Reduces as [`downscale`] does, over valid pixels only, each block with the mean weight of its
/// valid pixels; a block without any is invalid and 0.
pub fn downscale_masked(image: &Image, mask: &Mask, factor: usize) -> (Image, Mask) {
    let (image, weights) = reduce(image, Some(mask), factor);
    (image, Mask { weights })
}

fn reduce(image: &Image, mask: Option<&Mask>, factor: usize) -> (Image, Vec<f32>) {
    let factor = factor.max(1);
    let (width, height) = (image.width / factor, image.height / factor);
    let block = |index: usize| {
        let corner = [index % width * factor, index / width * factor];
        let block = image.reduce_block(mask, corner, factor);
        (block.mean, block.weight)
    };
    let (pixels, weights) = (0..width * height).into_par_iter().map(block).unzip();
    (Image { width, height, pixels }, weights)
}

/// Resamples a distorted image into the same camera without distortion, bilinearly. Pixels whose
/// ray falls outside of the image, or that touch an invalid pixel, are invalid and 0; the others
/// weigh as much as the least of the pixels that they are made of. `camera` is the image's, of its
/// size.
pub fn undistort(image: &Image, mask: Option<&Mask>, camera: &Camera) -> (Image, Mask, Camera) {
    let lens = camera.distortion;
    let limit = fold_radius2(&lens);
    let (width, height) = (image.width, image.height);
    let pixel = |index: usize| {
        let target = DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let straight = (target - camera.center_px) / camera.focal_px;
        if straight.length_squared() >= limit {
            return ([0.0; 3], 0.0);
        }
        let source = lens.distort(straight) * camera.focal_px + camera.center_px;
        sample(image, mask, source).unwrap_or(([0.0; 3], 0.0))
    };
    let (pixels, weights) = (0..width * height).into_par_iter().map(pixel).unzip();
    let pinhole = Camera { distortion: Distortion::default(), ..camera.clone() };
    (Image { width, height, pixels }, Mask { weights }, pinhole)
}

/// Returns the largest part of what `camera` sees that is a pinhole image without empty pixels: the
/// same size and principal point, focal lengths longer by the smallest factor for which every pixel
/// lies in the distorted image. `None` where no factor up to 4 does.
pub fn pinhole_within(camera: &Camera) -> Option<Camera> {
    let [width, height] = camera.size_px.map(f64::from);
    let limit = fold_radius2(&camera.distortion);
    let holds = |zoom: f64| {
        // The border decides; 64 places on each side.
        (0..=64).map(|i| f64::from(i) / 64.0).all(|share| {
            let places = [(share * width, 0.0), (share * width, height), (0.0, share * height), (width, share * height)];
            places.into_iter().all(|(x, y)| {
                let straight = (DVec2::new(x, y) - camera.center_px) / (camera.focal_px * zoom);
                let at = camera.distortion.distort(straight) * camera.focal_px + camera.center_px;
                straight.length_squared() < limit && at.x >= 0.0 && at.y >= 0.0 && at.x <= width && at.y <= height
            })
        })
    };
    // A lens that pulls in keeps its centre sharper when nothing is thrown away: below 1 there is
    // nothing to win.
    let (mut low, mut high) = (0.999, 4.0);
    if !holds(high) {
        return None;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if holds(middle) { high = middle } else { low = middle }
    }
    Some(Camera { focal_px: camera.focal_px * high.max(1.0), distortion: Distortion::default(), ..camera.clone() })
}

/// Resamples an image of `camera` for a pinhole camera in the same place, bilinearly; with how many
/// pixels had to be taken from the border.
pub fn undistort_into(image: &Image, camera: &Camera, pinhole: &Camera) -> (Image, usize) {
    let [width, height] = pinhole.size_px.map(|side| side as usize);
    let size = DVec2::new(image.width as f64, image.height as f64);
    let pixel = |index: usize| {
        let target = DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let straight = (target - pinhole.center_px) / pinhole.focal_px;
        let source = camera.distortion.distort(straight) * camera.focal_px + camera.center_px;
        let inside = source.clamp(DVec2::ZERO, size);
        (sample(image, None, inside).map_or([0.0; 3], |(value, _)| value), usize::from(inside != source))
    };
    let (pixels, outside): (Vec<[f32; 3]>, Vec<usize>) = (0..width * height).into_par_iter().map(pixel).unzip();
    (Image { width, height, pixels }, outside.into_iter().sum())
}

/// Returns the squared radius from which on the radial polynomial turns back: rays beyond it would
/// show parts of the image a second time. Smallest positive root s of d/dr [r (1 + k1 r^2 + k2
/// r^4)] = 1 + 3 k1 s + 5 k2 s^2, s = r^2; infinite if there is none.
fn fold_radius2(lens: &Distortion) -> f64 {
    let (a, b) = (5.0 * lens.k2, 3.0 * lens.k1);
    let discriminant = b * b - 4.0 * a;
    if discriminant < 0.0 {
        return f64::INFINITY;
    }
    // The form that neither cancels nor divides by a vanishing k2: roots are 2 / (-b -+ sqrt(b^2 -
    // 4 a)).
    let root = discriminant.sqrt();
    [2.0 / (-b - root), 2.0 / (-b + root)].into_iter().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min)
}

/// Returns the bilinear value at `position` in pixels, and the least weight of the pixels in it;
/// the outer half of border pixels is constant. `None` outside, or if a pixel that counts is
/// invalid.
pub(super) fn sample(image: &Image, mask: Option<&Mask>, position: DVec2) -> Option<([f32; 3], f32)> {
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
    let (mut sum, mut least) = ([0.0f64; 3], 1.0f32);
    for (dx, dy, part) in taps.into_iter().filter(|(_, _, part)| *part > 0.0) {
        let at = (top + dy) * image.width + left + dx;
        let pixel = image.pixels.get(at).filter(|_| mask::is_valid(mask, at))?;
        sum = [0, 1, 2].map(|c| sum[c] + part * f64::from(pixel[c]));
        least = least.min(mask::weight(mask, at));
    }
    Some((sum.map(|s| s as f32), least))
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;

    fn camera(distortion: Distortion) -> Camera {
        let (focal_px, center_px) = (DVec2::new(50.0, 55.0), DVec2::new(33.0, 23.5));
        Camera {
            camera_from_world: DAffine3::IDENTITY,
            focal_px,
            center_px,
            size_px: [64, 48],
            distortion,
            projection: luxel_core::CameraProjection::Pinhole,
        }
    }

    /// Returns a ramp, on which bilinear resampling is exact.
    fn ramp(x: f64, y: f64) -> [f32; 3] {
        [x as f32, y as f32, (100.0 + x - 2.0 * y) as f32]
    }

    fn grid() -> Image {
        let pixels = (0..64 * 48).map(|i| ramp(f64::from(i % 64) + 0.5, f64::from(i / 64) + 0.5)).collect();
        Image { width: 64, height: 48, pixels }
    }

    #[test]
    fn undistorted_grid_follows_the_analytic_map() {
        let lens = Distortion { k1: -0.2, k2: 0.05, p1: 0.01, p2: -0.015 };
        let (image, mask, pinhole) = undistort(&grid(), None, &camera(lens));
        assert_eq!(pinhole, camera(Distortion::default()));
        let (mut checked, mut outside) = (0, 0);
        for i in 0..64 * 48 {
            let target = DVec2::new((i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5);
            let source = lens.distort((target - pinhole.center_px) / pinhole.focal_px) * pinhole.focal_px + pinhole.center_px;
            let is_inside = (0.0..=64.0).contains(&source.x) && (0.0..=48.0).contains(&source.y);
            assert_eq!(mask.is_valid(i), is_inside, "pixel {i} from {source}");
            if !is_inside {
                assert_eq!(image.pixels[i], [0.0; 3]);
                outside += 1;
            } else if (0.5..=63.5).contains(&source.x) && (0.5..=47.5).contains(&source.y) {
                let expected = ramp(source.x, source.y);
                assert!(
                    (0..3).all(|c| (image.pixels[i][c] - expected[c]).abs() < 1e-3),
                    "pixel {i}: {:?} expected {expected:?}",
                    image.pixels[i]
                );
                checked += 1;
            }
        }
        assert!(checked > 2000, "{checked} interior pixels, {outside} outside");
    }

    #[test]
    fn a_pinhole_within_has_no_empty_pixels() {
        for lens in [
            Distortion { k1: -0.2, k2: 0.05, p1: 0.01, p2: -0.015 },
            Distortion { k1: 0.1, ..Distortion::default() },
            Distortion::default(),
        ] {
            let camera = camera(lens);
            let pinhole = pinhole_within(&camera).unwrap();
            let (image, outside) = undistort_into(&grid(), &camera, &pinhole);
            assert_eq!(outside, 0, "{lens:?}");
            assert!(pinhole.focal_px.x >= camera.focal_px.x && pinhole.focal_px.x < 1.5 * camera.focal_px.x);
            let target = (DVec2::new(20.5, 30.5) - pinhole.center_px) / pinhole.focal_px;
            let source = lens.distort(target) * camera.focal_px + camera.center_px;
            let (found, expected) = (image.at(20, 30), ramp(source.x, source.y));
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-3), "{lens:?} {found:?} {expected:?}");
        }
        assert_eq!(pinhole_within(&camera(Distortion { k1: -40.0, ..Distortion::default() })), None);
    }

    #[test]
    fn no_distortion_changes_nothing() {
        let (image, mask, _) = undistort(&grid(), None, &camera(Distortion::default()));
        assert_eq!(image, grid());
        assert!(mask.weights.iter().all(|w| *w == 1.0));
    }

    #[test]
    fn pixels_that_touch_an_invalid_one_are_invalid() {
        let mut valid = vec![true; 64 * 48];
        valid[20 * 64 + 30] = false;
        let shift = Distortion { p1: 1e-4, p2: 1e-4, ..Distortion::default() };
        let (image, mask, _) = undistort(&grid(), Some(&Mask::from_valid(valid)), &camera(shift));
        let lost: Vec<_> = (0..64 * 48).filter(|&i| !mask.is_valid(i)).collect();
        assert!(
            (1..=4).contains(&lost.iter().filter(|&&i| (28..=32).contains(&(i % 64)) && (18..=22).contains(&(i / 64))).count()),
            "{lost:?}"
        );
        assert_eq!(image.pixels[20 * 64 + 30], [0.0; 3]);
    }

    #[test]
    fn rays_beyond_the_lens_fold_are_invalid() {
        // r (1 - r^2 / 3 * 3) turns back at r = 1 / sqrt(3): pixels beyond would show the centre
        // again.
        let fold = Distortion { k1: -1.0, ..Distortion::default() };
        assert!((fold_radius2(&fold) - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(fold_radius2(&Distortion::default()), f64::INFINITY);
        assert_eq!(fold_radius2(&Distortion { k1: 0.1, k2: 0.02, ..Distortion::default() }), f64::INFINITY);
        // 1 - 3 s + 5 k2 s^2 with k2 = 0.4: smaller root of 2 s^2 - 3 s + 1 is 1/2.
        assert!((fold_radius2(&Distortion { k1: -1.0, k2: 0.4, ..Distortion::default() }) - 0.5).abs() < 1e-12);
        let (_, mask, _) = undistort(&grid(), None, &camera(fold));
        let corner = DVec2::new(0.5 - 33.0, 0.5 - 23.5) / DVec2::new(50.0, 55.0);
        assert!(corner.length_squared() > 1.0 / 3.0 && !mask.is_valid(0));
    }

    #[test]
    fn downscaling_averages_whole_blocks_in_linear_light() {
        let image = Image { width: 5, height: 3, pixels: (0..15).map(|i| [i as f32, 1000.0 * (i % 2) as f32, -1.0]).collect() };
        let half = downscale(&image, 2);
        assert_eq!((half.width, half.height), (2, 1));
        assert_eq!(half.pixels, [[3.0, 500.0, -1.0], [5.0, 500.0, -1.0]]);
        assert_eq!(downscale(&image, 1), image);
        assert_eq!(downscale(&image, 0), image);
        assert!(downscale(&image, 4).pixels.is_empty());
    }

    #[test]
    fn downscaling_leaves_invalid_pixels_out() {
        let mut image = Image { width: 4, height: 2, pixels: (0..8).map(|i| [i as f32; 3]).collect() };
        image.pixels[5] = [f32::NAN; 3];
        let mask = Mask::from_valid(vec![true, true, false, false, true, false, false, false]);
        let (half, valid) = downscale_masked(&image, &mask, 2);
        assert_eq!(half.pixels, [[5.0 / 3.0; 3], [0.0; 3]]);
        assert_eq!(valid.weights, [1.0, 0.0]);
    }
}

//! Random parts of training views: crops, for images of more pixels than a step should see, and
//! strips of about half of a view, which make steps faster.
//!
//! In: the size of an image, the shape of the part, a random stream. Out: a window, and the view
//! that shows it alone.
//!
//! The choice is unbiased: the expected loss of a crop, a mean over its pixels, is the mean over
//! the whole image. Each axis is divided into pieces at random places, and the crop is the tile
//! that holds a pixel drawn uniformly. Given the division, a tile is so chosen with a probability
//! in proportion to its area, and each of its pixels then counts in inverse proportion to it.
//! Crops of one size at uniform places would count pixels near the border less. Windows of SSIM
//! end at the border of a crop, as they do at that of an image; the places of borders are random.
//!
//! A strip is a piece of one axis, drawn as for a crop of three quarters of its length, and all of
//! the other: 0.54 of the pixels on average.
//!
//! Degenerate: an image that is not longer than a crop is taken whole along that axis. A panorama
//! keeps its whole width, because its ends meet.
//!
//! The gradient of a splat's position on screen, by which splats are divided, grows: a crop has
//! fewer pixels to average over, and is shorter in its own units ([`gradient_factor`]).

use luxel_core::{CameraProjection, Image, Mask, View};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Shortest piece of an axis, pixels, as long as crops are twice as long: less than the window of
/// SSIM would be noise.
const MIN_PIECE_PX: u32 = 32;

/// The mean part of the pixels of a view that are in a strip.
pub(crate) const STRIP_SHARE: f64 = 0.54;

/// A request for a part of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Crop {
    pub(crate) shape: Shape,
    /// The seed that alone decides the window.
    pub(crate) seed: u64,
}

/// The shape of a part of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    /// A rectangle of at most so many pixels a side.
    Tile { side_px: u32 },
    /// A strip across or down the view.
    Strip,
}

/// A part of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    /// Top left pixel.
    pub(crate) corner_px: [u32; 2],
    pub(crate) size_px: [u32; 2],
}

/// Returns the longest sides of crops of a view, pixels.
fn longest(view: &View, side_px: u32) -> [u32; 2] {
    let [width, height] = view.camera.size_px;
    let across = if view.camera.projection == CameraProjection::Equirectangular { width } else { side_px };
    [across.min(width), side_px.min(height)]
}

/// Draws the window of a part.
pub(crate) fn draw(view: &View, Crop { shape, seed }: Crop) -> Window {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let size = view.camera.size_px;
    let longest = match shape {
        Shape::Tile { side_px } => longest(view, side_px),
        Shape::Strip => size.map(|side| side.div_ceil(4) * 3),
    };
    let [across, down] = [0, 1].map(|axis| piece(size[axis], longest[axis], [random.random(), random.random()]));
    let [across, down] = match shape {
        Shape::Tile { .. } => [across, down],
        Shape::Strip if view.camera.projection != CameraProjection::Equirectangular && random.random() => [across, [0, size[1]]],
        Shape::Strip => [[0, size[0]], down],
    };
    Window { corner_px: [across[0], down[0]], size_px: [across[1], down[1]] }
}

/// Returns the start and the length of a piece of an axis of `length` pixels, none longer than
/// `longest`, by two numbers from 0 up to 1: for the division, and for a pixel.
fn piece(length: u32, longest: u32, [division, pixel]: [f32; 2]) -> [u32; 2] {
    if length <= longest {
        return [0, length];
    }
    // The first and the last piece share what whole ones leave: one to two times the longest.
    let whole = length / longest - 1;
    let rest = length - whole * longest;
    let least = MIN_PIECE_PX.min(longest / 2);
    let (low, high) = ((rest - longest).max(least), longest.min(rest - least));
    let first = low + ((high - low + 1) as f32 * division) as u32;
    let first = first.min(high);
    let at = ((length as f32 * pixel) as u32).min(length - 1);
    if at < first {
        return [0, first];
    }
    let start = first + (at - first) / longest * longest;
    [start, longest.min(length - start)]
}

/// Returns the factor by which gradients of positions on screen are larger in crops than in whole
/// views, on average over the views.
pub(crate) fn gradient_factor(views: &[View], side_px: u32) -> f32 {
    let factor = |view: &View| {
        let (size, crop) = (view.camera.size_px, longest(view, side_px));
        let part = f64::from(crop[0]) * f64::from(crop[1]) / (f64::from(size[0]) * f64::from(size[1]));
        part.sqrt().recip()
    };
    (views.iter().map(factor).sum::<f64>() / views.len().max(1) as f64) as f32
}

/// Returns what a window of a loaded view shows, without the captured images beside it.
pub(crate) fn cropped(view: &View, window: Window) -> View {
    let Window { corner_px, size_px } = window;
    if size_px == view.camera.size_px {
        return view.clone();
    }
    let [left, top] = corner_px.map(|at| at as usize);
    let [width, height] = size_px.map(|side| side as usize);
    let rows = || (top..top + height).map(|y| y * view.image.width + left).map(|start| start..start + width);
    let pixels = rows().flat_map(|row| &view.image.pixels[row]).copied().collect();
    let weights = |mask: &Mask| rows().flat_map(|row| &mask.weights[row]).copied().collect();
    let mut camera = view.camera.clone();
    camera.center_px -= glam::DVec2::from_array(corner_px.map(f64::from));
    camera.size_px = size_px;
    View {
        camera,
        image: Image { width, height, pixels }.into(),
        mask: view.mask.as_ref().map(|mask| Mask { weights: weights(mask) }.into()),
        recordings: Vec::new(),
        ..view.clone()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use luxel_core::PixelValues;

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn view(width: u32, height: u32) -> View {
        let pixels = (0..width * height).map(|i| [i as f32, (i % width) as f32, (i / width) as f32]).collect();
        let image = Image::from_pixels(width as usize, height as usize, pixels).unwrap();
        let weights = (0..width * height).map(|i| (i % 5) as f32 / 4.0).collect();
        View { mask: Some(Mask { weights }.into()), ..view_of("a", camera_at([0.0; 3], [width, height]), image) }
    }

    #[test]
    fn every_pixel_counts_the_same_in_the_mean_over_crops() {
        for (width, side) in [(200, 64), (130, 64), (129, 100), (64, 64), (191, 64), (70, 64)] {
            let mut counts = vec![0.0f64; width as usize];
            let mut random = Pcg64Mcg::seed_from_u64(7);
            const DRAWS: usize = 40_000;
            for _ in 0..DRAWS {
                let [start, length] = piece(width, side, [random.random(), random.random()]);
                assert!(length >= 1 && length <= side && start + length <= width, "{width} {side}: {start} {length}");
                counts[start as usize..(start + length) as usize].iter_mut().for_each(|count| *count += f64::from(length).recip());
            }
            let expected = DRAWS as f64 / f64::from(width);
            for (x, count) in counts.iter().enumerate() {
                // Six standard deviations of a count, whose share of the draws is at most one half.
                let spread = 6.0 * (expected * 2.0 / f64::from(side.min(MIN_PIECE_PX))).sqrt().max(expected * 0.004);
                assert!((count - expected).abs() < spread, "{width} {side}: {x}: {count} {expected}");
            }
        }
    }

    #[test]
    fn strips_go_across_and_down_and_hold_their_share_of_the_pixels() {
        let full = view(200, 90);
        let strips: Vec<Window> = (0..4000).map(|seed| draw(&full, Crop { shape: Shape::Strip, seed })).collect();
        let (down, across): (Vec<&Window>, Vec<&Window>) = strips.iter().partition(|strip| strip.size_px[0] == 200);
        assert!(across.iter().all(|strip| strip.size_px[1] == 90 && (50..=150).contains(&strip.size_px[0])));
        assert!(down.iter().all(|strip| (22..=68).contains(&strip.size_px[1])));
        assert!(across.len().abs_diff(down.len()) < 400, "{} {}", across.len(), down.len());
        let pixels = |strip: &Window| f64::from(strip.size_px[0]) * f64::from(strip.size_px[1]) / 18_000.0;
        let share = strips.iter().map(pixels).sum::<f64>() / strips.len() as f64;
        assert!((share - STRIP_SHARE).abs() < 0.02, "{share}");
    }

    #[test]
    fn a_crop_sees_what_the_view_sees_there() {
        let captured = View { values: PixelValues::Recorded { exposure_s: 1.0 }, ..view(200, 90) };
        let full = View { recordings: vec![captured], ..view(200, 90) };
        full.validate().unwrap();
        for seed in 0..50 {
            let crop = Crop { shape: Shape::Tile { side_px: 64 }, seed };
            let window = draw(&full, crop);
            assert_eq!(window, draw(&full, crop));
            let part = cropped(&full, window);
            assert_eq!(part.camera.size_px, window.size_px);
            part.validate().unwrap();
            let [left, top] = window.corner_px;
            assert_eq!(part.image.at(0, 0), full.image.at(left as usize, top as usize));
            let [right, bottom] = [0, 1].map(|i| (window.size_px[i] - 1) as usize);
            assert_eq!(part.image.at(right, bottom), full.image.at(left as usize + right, top as usize + bottom));
            let weight = |view: &View, x: usize, y: usize| view.mask.as_ref().unwrap().weights[y * view.image.width + x];
            assert_eq!(weight(&part, right, bottom), weight(&full, left as usize + right, top as usize + bottom));
            let point = DVec3::new(0.3, -0.2, 2.0);
            let shift = glam::DVec2::new(left.into(), top.into());
            assert_eq!(part.camera.project(point).unwrap().0 + shift, full.camera.project(point).unwrap().0);
        }
        // Small images are taken whole.
        assert_eq!(draw(&full, Crop { shape: Shape::Tile { side_px: 512 }, seed: 3 }), Window { corner_px: [0, 0], size_px: [200, 90] });
        assert_eq!(gradient_factor(std::slice::from_ref(&full), 512), 1.0);
        assert!((gradient_factor(&[full], 50) - (200.0f32 * 90.0 / 2500.0).sqrt()).abs() < 1e-4);
    }
}

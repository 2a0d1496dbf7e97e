//! Radiance of a point from the HDR pixels that show it.
//!
//! In: a point, training views (data-set units). Out: linear RGB (data-set units). Its luminance is
//! the median R + G + B of the pixels, and its chromaticity that of the medians of the channels.
//! Medians are robust to views in which the point is occluded or in a highlight. `None` if no valid
//! pixel shows the point.

use glam::{DVec2, DVec3};
use luxel_core::{Point, View, luminance_sum};

/// Returns the radiance over the point's track or, without a track, over the views it projects
/// into.
pub(super) fn of_point(point: &Point, train: &[View]) -> Option<[f32; 3]> {
    let track = point.observations.iter().filter_map(|seen| {
        let [x, y] = seen.pixel_px;
        sample(train.get(seen.view as usize)?, DVec2::new(x.into(), y.into()))
    });
    median_color(track.collect()).or_else(|| {
        let [x, y, z] = point.position;
        let at = DVec3::new(x.into(), y.into(), z.into());
        median_color(train.iter().filter_map(|view| sample(view, view.camera.project(at)?.0)).collect())
    })
}

/// Samples an image bilinearly at pixel coordinates (pixel centres at +0.5), from valid pixels
/// only. Returns `None` outside the image.
fn sample(view: &View, at_px: DVec2) -> Option<[f32; 3]> {
    let image = &view.image;
    let (width, height) = (image.width as f64, image.height as f64);
    // The comparisons are written so that NaN counts as outside.
    if !(at_px.x >= 0.0 && at_px.x <= width && at_px.y >= 0.0 && at_px.y <= height) || image.pixels.is_empty() {
        return None;
    }
    let corner = (at_px - 0.5).floor();
    let fraction = at_px - 0.5 - corner;
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let x = (corner.x as i64 + dx).clamp(0, image.width as i64 - 1) as usize;
        let y = (corner.y as i64 + dy).clamp(0, image.height as i64 - 1) as usize;
        let along = |d: i64, f: f64| if d == 0 { 1.0 - f } else { f };
        let weight = along(dx, fraction.x) * along(dy, fraction.y);
        let i = y * image.width + x;
        let rgb = image.pixels[i];
        if view.is_valid(i) && rgb.iter().all(|v| v.is_finite()) {
            sum = std::array::from_fn(|c| sum[c] + weight * f64::from(rgb[c]));
            total += weight;
        }
    }
    (total > 1e-3).then(|| sum.map(|s| (s / total).max(0.0) as f32))
}

fn median_color(samples: Vec<[f32; 3]>) -> Option<[f32; 3]> {
    // The sum is in f64, because the sum of three f32 channels may exceed f32.
    let sum = |rgb: [f64; 3]| rgb.iter().sum::<f64>();
    let luminance = median(samples.iter().map(|rgb| sum(rgb.map(f64::from))).collect())?;
    let mut rgb = [0.0; 3];
    for (c, out) in rgb.iter_mut().enumerate() {
        *out = median(samples.iter().map(|sample| sample[c].into()).collect())?;
    }
    let sum = sum(rgb);
    let color = if sum > 0.0 { rgb.map(|v| v / sum * luminance) } else { [luminance / 3.0; 3] };
    Some(color.map(|v| v.min(f32::MAX.into()) as f32))
}

/// Returns the median, which for an even count is the mean of the two middle values, or `None`
/// without values.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = *values.get((values.len() - 1) / 2)?;
    Some(0.5 * lower + 0.5 * upper)
}

/// The colour of points that no view shows: the file's display colour, scaled to the images'
/// typical luminance.
pub(super) struct Fallback {
    /// Radiance (R + G + B) / 3 of a typical pixel, data-set units.
    typical: f32,
    /// Factor on linearised display colours.
    display_gain: f32,
}

impl Fallback {
    pub(super) fn new(points: &[Point], typical: f32) -> Self {
        let luminances = points.iter().filter_map(|point| point.rgb8).map(|rgb| luminance_sum(rgb.map(srgb_to_linear)) / 3.0);
        let display = median(luminances.filter(|l| *l > 0.0).map(f64::from).collect()).unwrap_or(1.0) as f32;
        Self { typical, display_gain: typical / display }
    }

    pub(super) fn of_point(&self, point: &Point) -> [f32; 3] {
        match point.rgb8 {
            Some(rgb) => rgb.map(|v| srgb_to_linear(v) * self.display_gain),
            None => [self.typical; 3],
        }
    }
}

/// Returns the linear value of an sRGB byte (IEC 61966-2-1).
fn srgb_to_linear(byte: u8) -> f32 {
    let v = f32::from(byte) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use luxel_core::{Image, Mask};

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn two_pixels() -> View {
        let image = Image::from_pixels(2, 1, vec![[1.0; 3], [3.0; 3]]).unwrap();
        view_of("two", camera_at([0.0; 3], [2, 1]), image)
    }

    #[test]
    fn samples_lie_between_pixel_centres() {
        let view = two_pixels();
        let at = |x: f64| sample(&view, DVec2::new(x, 0.5)).map(|rgb| rgb[0]);
        assert_eq!([at(0.0), at(0.5), at(1.0), at(1.5), at(2.0)], [Some(1.0), Some(1.0), Some(2.0), Some(3.0), Some(3.0)]);
        assert_eq!([at(-0.1), at(2.1), at(f64::NAN)], [None; 3]);
    }

    #[test]
    fn masked_pixels_are_not_sampled() {
        let mut view = two_pixels();
        view.mask = Some(Arc::new(Mask::from_valid(vec![false, true])));
        assert_eq!(sample(&view, DVec2::new(1.0, 0.5)), Some([3.0; 3]));
        assert_eq!(sample(&view, DVec2::new(0.5, 0.5)), None);
    }

    #[test]
    fn one_highlight_does_not_change_the_color() {
        let color = median_color(vec![[0.2, 0.1, 0.1], [90.0, 90.0, 90.0], [0.2, 0.1, 0.1]]).unwrap();
        assert!((color[0] - 0.2).abs() < 1e-6 && (color[1] - 0.1).abs() < 1e-6, "{color:?}");
        assert_eq!(median_color(Vec::new()), None);
    }

    #[test]
    fn a_sum_beyond_the_largest_number_is_a_color_all_the_same() {
        let huge = [3e38, 1.5e38, 3e38];
        let color = median_color(vec![huge; 3]).unwrap();
        assert!(color.iter().zip(huge).all(|(found, expected)| (found / expected - 1.0).abs() < 1e-6), "{color:?}");
        // The medians of the channels may sum to less than the median of the sums.
        let mixed =
            median_color(vec![[3e38, 3e38, 0.0], [3e38, 0.0, 3e38], [0.0, 3e38, 3e38], [3e38, 0.0, 0.0], [1e38, 0.0, 0.0]]).unwrap();
        assert!(mixed.iter().all(|v| v.is_finite()), "{mixed:?}");
    }

    #[test]
    fn the_middle_of_an_even_number_is_the_mean_of_two() {
        assert_eq!(median(vec![4.0, 1.0]), Some(2.5));
    }
}

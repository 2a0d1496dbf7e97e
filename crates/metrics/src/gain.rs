//! The gain between a render and an image of the same view.
//!
//! In: a render `[H,W,3]` and an image `[H,W,3]`, both in normalised units. Out: ln gain by
//! channel, the weighted median of ln(image / render) over reliable pixels. A pixel is reliable if
//! it is valid and, in both images, brighter than a small part of the image's mean, below which
//! noise and the floor of the render dominate. Its weight grows with its radiance and levels off.
//! Degenerate: an image with too few reliable pixels has no gain.

use luxel_core::{Image, View};

/// The least radiance of a reliable pixel, as a part of the image's mean.
const RELIABLE_PART: f64 = 0.05;
/// The least number of reliable pixels for a gain.
const MIN_PIXELS: usize = 64;
/// The largest number of pixels sampled in a view; more would not change the median.
const MAX_SAMPLES: usize = 1 << 16;

/// The channels that share a gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GainChannels {
    /// One gain for all channels: exposure.
    Shared,
    /// A gain for each channel: exposure and white balance.
    Separate,
}

/// The ratio of a pixel's target to its render in a channel.
#[derive(Clone, Copy)]
struct Ratio {
    /// ln of the ratio.
    log: f32,
    weight: f32,
}

/// Returns ln gain of an image over its render by channel, or `None` if it has too few reliable
/// pixels.
///
/// `target` returns the image's radiance at a pixel index and channel, or `None` where the value
/// cannot be relied on.
pub fn log_gain(render: &Image, target: impl Fn(usize, usize) -> Option<f32>, channels: GainChannels) -> Option<[f32; 3]> {
    let stride = (render.pixels.len() / MAX_SAMPLES + 1) | 1;
    let mut ratios: [Vec<Ratio>; 3] = Default::default();
    let sampled = || render.pixels.iter().enumerate().step_by(stride);
    let values = sampled().flat_map(|(i, _)| (0..3).filter_map(|c| target(i, c)).collect::<Vec<_>>());
    let (sum, count) = values.fold((0.0f64, 0usize), |(sum, count), v| (sum + f64::from(v), count + 1));
    let least = (RELIABLE_PART * sum / count.max(1) as f64) as f32;
    for (i, pixel) in sampled() {
        for (c, ratios) in ratios.iter_mut().enumerate() {
            let Some(target) = target(i, c).filter(|target| *target > least && pixel[c] > least) else { continue };
            // Relative differences of dark pixels are noise.
            let weight = target / (target + 10.0 * least);
            ratios.push(Ratio { log: (target / pixel[c]).ln(), weight });
        }
    }
    match channels {
        GainChannels::Shared => Some([weighted_median(ratios.concat())?; 3]),
        GainChannels::Separate => {
            let [r, g, b] = ratios.map(weighted_median);
            Some([r?, g?, b?])
        }
    }
}

/// Returns [`log_gain`] of a view whose image times `scale` is normalised radiance.
pub fn log_gain_of_view(render: &Image, view: &View, scale: [f32; 3], channels: GainChannels) -> Option<[f32; 3]> {
    log_gain(render, |i, c| view.is_valid(i).then(|| view.image.pixels.get(i).map(|pixel| pixel[c] * scale[c])).flatten(), channels)
}

/// Returns the weighted median, or `None` for too few values.
fn weighted_median(mut values: Vec<Ratio>) -> Option<f32> {
    if values.len() < MIN_PIXELS {
        return None;
    }
    values.sort_unstable_by(|a, b| a.log.total_cmp(&b.log));
    let half = 0.5 * values.iter().map(|ratio| f64::from(ratio.weight)).sum::<f64>();
    let mut below = 0.0;
    let at = values.iter().position(|ratio| {
        below += f64::from(ratio.weight);
        below >= half
    })?;
    values.get(at).map(|ratio| ratio.log)
}

#[cfg(test)]
mod tests {

    use glam::{DAffine3, DVec2};
    use luxel_core::{Camera, CameraProjection, Distortion, PixelValues, Target};

    use super::*;

    fn ramp() -> Image {
        Image::from_pixels(20, 20, (0..400).map(|i| [0.01 * i as f32, 0.02 * i as f32, 0.005 * i as f32]).collect()).unwrap()
    }

    fn drifted(gain: [f32; 3]) -> View {
        let pixels = ramp().pixels.iter().map(|rgb| [0, 1, 2].map(|c| rgb[c] * gain[c])).collect();
        let camera = Camera {
            camera_from_world: DAffine3::IDENTITY,
            focal_px: DVec2::splat(20.0),
            center_px: DVec2::splat(10.0),
            size_px: [20, 20],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        };
        let image = Image::from_pixels(20, 20, pixels).unwrap().into();
        let (recordings, target) = (Vec::new(), Target::default());
        View { name: "a".into(), camera, image, values: PixelValues::Radiance, noise: None, mask: None, recordings, target }
    }

    #[test]
    fn the_gain_of_an_image_is_found_through_an_object_that_is_not_in_the_scene() {
        let mut view = drifted([1.3, 1.0, 0.8]);
        let mut image = Image::clone(&view.image);
        image.pixels.iter_mut().take(120).for_each(|pixel| *pixel = [50.0, 0.0, 9.0]);
        view.image = image.into();
        let found = log_gain_of_view(&ramp(), &view, [1.0; 3], GainChannels::Separate).unwrap();
        for (found, gain) in found.into_iter().zip([1.3f32, 1.0, 0.8]) {
            assert!((found - gain.ln()).abs() < 1e-5, "{found} {gain}");
        }
        let one = log_gain_of_view(&ramp(), &drifted([2.5; 3]), [0.5; 3], GainChannels::Shared).unwrap();
        assert!(one.iter().all(|log| (log - 1.25f32.ln()).abs() < 1e-5), "{one:?}");
    }

    #[test]
    fn a_view_without_reliable_pixels_has_no_gain() {
        let mut view = drifted([2.0; 3]);
        view.mask = Some(luxel_core::Mask::from_valid(vec![false; 400]).into());
        assert_eq!(log_gain_of_view(&ramp(), &view, [1.0; 3], GainChannels::Separate), None);
    }
}

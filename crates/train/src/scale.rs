//! The radiance of one normalised unit.
//!
//! In: the training views [H,W,3] in the data set's units, with masks. Out: one factor > 0 by which
//! all radiance is divided in training. It matters because the mu-law of the loss is linear below
//! 1/mu and logarithmic above. A typical pixel has to lie well above 1/mu, so that the loss sees
//! the dark, and at most near 1, so that metrics are comparable with published ones. If all pixels
//! are black, the result is an error.

use luxel_core::{RadianceScale, View};

use crate::TrainError;
use crate::config::ScaleRule;
use crate::views::pixels;

/// The median radiance after [`ScaleRule::Median20`], which is typical of HDR-NeRF's synthetic
/// scenes.
const MEDIAN_TARGET: f32 = 0.05;

/// Largest number of pixels that a percentile is computed from; it is stable with that many.
const MAX_SAMPLES: usize = 1 << 21;

/// Returns the radiance of one normalised unit by `rule`.
///
/// # Errors
/// Returns [`TrainError::NoTrainViews`], [`TrainError::NoPixels`], [`TrainError::AllBlack`], or
/// [`TrainError::Read`] for an image that cannot be read again.
pub fn choose_radiance_scale(train: &[View], rule: ScaleRule) -> Result<RadianceScale, TrainError> {
    let scale = match rule {
        ScaleRule::Raw => 1.0,
        ScaleRule::Max => brightest_channel(train)?,
        ScaleRule::P99 => percentile(positive_luminances(train)?, 0.99),
        ScaleRule::Median20 => percentile(positive_luminances(train)?, 0.5) / MEDIAN_TARGET,
    };
    // Denormal radiance would make 1 / scale infinite.
    RadianceScale::new(scale.clamp(f32::MIN_POSITIVE * 16.0, f32::MAX / 16.0)).ok_or(TrainError::NoPixels)
}

/// Returns the median (R + G + B) / 3 of the training views' pixels, data-set units. Black pixels
/// are left out, because they often stand for a mask.
pub(crate) fn median_luminance(train: &[View]) -> Result<f32, TrainError> {
    Ok(percentile(positive_luminances(train)?, 0.5))
}

fn positive_luminances(train: &[View]) -> Result<Vec<f32>, TrainError> {
    if train.is_empty() {
        return Err(TrainError::NoTrainViews);
    }
    let total = pixels(train) as usize;
    // An odd stride does not fall in step with even image widths.
    let stride = (total / MAX_SAMPLES + 1) | 1;
    let collect = |stride: usize| -> Result<(bool, Vec<f32>), TrainError> {
        let mut any_valid = false;
        let mut values = Vec::with_capacity(total / stride + 1);
        for view in train {
            let view = view.loaded()?;
            for i in (0..view.image.pixels.len()).step_by(stride).filter(|i| view.is_valid(*i)) {
                any_valid = true;
                let [r, g, b] = view.image.pixels[i];
                values.push(r / 3.0 + g / 3.0 + b / 3.0);
            }
        }
        values.retain(|v| *v > 0.0 && v.is_finite());
        Ok((any_valid, values))
    };
    let (mut any_valid, mut values) = collect(stride)?;
    if values.is_empty() && stride > 1 {
        (any_valid, values) = collect(1)?;
    }
    match (values.is_empty(), any_valid) {
        (false, _) => Ok(values),
        (true, true) => Err(TrainError::AllBlack),
        (true, false) => Err(TrainError::NoPixels),
    }
}

fn brightest_channel(train: &[View]) -> Result<f32, TrainError> {
    positive_luminances(train)?;
    let mut brightest = 0.0;
    for view in train {
        let view = view.loaded()?;
        let valid = view.image.pixels.iter().enumerate().filter(|(i, _)| view.is_valid(*i));
        brightest = valid.flat_map(|(_, rgb)| rgb).copied().filter(|v| v.is_finite()).fold(brightest, f32::max);
    }
    Ok(brightest)
}

/// Returns the value below which the fraction `part` of `values` lies; `values` must not be empty.
fn percentile(mut values: Vec<f32>, part: f64) -> f32 {
    let at = ((values.len() - 1) as f64 * part).round() as usize;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

#[cfg(test)]
mod tests {

    use luxel_core::{Image, Mask};

    use super::*;
    use crate::testing::{camera_at, view_of};

    fn ramp() -> Vec<View> {
        // 101 grey pixels of radiance 0, 1, ..., 100.
        let pixels = (0..101).map(|i| [i as f32; 3]).collect();
        vec![view_of("ramp", camera_at([0.0; 3], [101, 1]), Image::from_pixels(101, 1, pixels).unwrap())]
    }

    #[test]
    fn rules_put_the_typical_pixel_where_they_say() {
        let views = ramp();
        // The black pixel is left out: the median of 1..=100 by nearest rank is 51.
        assert!((choose_radiance_scale(&views, ScaleRule::Median20).unwrap().get() * 0.05 - 51.0).abs() < 1e-3);
        assert!((choose_radiance_scale(&views, ScaleRule::P99).unwrap().get() - 99.0).abs() < 1e-3);
        assert_eq!(choose_radiance_scale(&views, ScaleRule::Max).unwrap().get(), 100.0);
        assert_eq!(choose_radiance_scale(&views, ScaleRule::Raw).unwrap(), RadianceScale::ONE);
    }

    #[test]
    fn masked_pixels_are_left_out() {
        let mut views = ramp();
        views[0].mask = Some(Mask::from_valid((0..101).map(|i| i <= 10)).into());
        assert_eq!(choose_radiance_scale(&views, ScaleRule::Max).unwrap().get(), 10.0);
        views[0].mask = Some(Mask::from_valid(vec![false; 101]).into());
        assert!(matches!(choose_radiance_scale(&views, ScaleRule::Max), Err(TrainError::NoPixels)));
    }

    #[test]
    fn black_images_are_an_error() {
        let views = [view_of("black", camera_at([0.0; 3], [4, 4]), Image::filled(4, 4, [0.0; 3]))];
        for rule in [ScaleRule::Median20, ScaleRule::P99, ScaleRule::Max] {
            assert!(matches!(choose_radiance_scale(&views, rule), Err(TrainError::AllBlack)));
        }
        assert!(matches!(choose_radiance_scale(&[], ScaleRule::Max), Err(TrainError::NoTrainViews)));
    }
}

//! Training on captured LDR images: the curve through which the loss sees a view, and the radiance
//! to start from.
//!
//! In: training views of captured values (0 to 1, exposures in seconds). Out: the [`ToneCurve`] of
//! a step, and the views as radiance by the initial curve, with black and saturated pixels masked.
//! That radiance determines the scale and the colours of the first splats; the loss never compares
//! with it.

use luxel_core::response::{BLACK, SATURATED};
use luxel_core::{Dataset, Knots, Mask, PixelValues, RadianceScale, Response, ToneCurve, View};

use crate::camera_response::exposure_of;
use crate::{TrainConfig, TrainError};

/// Returns whether the training views are captured values; either all are, or none is.
pub(crate) fn is_recorded(train: &[View]) -> Result<bool, TrainError> {
    let (recorded, radiance): (Vec<&View>, Vec<&View>) = train.iter().partition(|view| exposure_of(view).is_some());
    if let (Some(radiance), Some(recorded)) = (radiance.first(), recorded.first()) {
        return Err(TrainError::MixedValues { radiance: radiance.name.clone(), recorded: recorded.name.clone() });
    }
    for view in &recorded {
        if let Some(exposure_s) = exposure_of(view).filter(|seconds| !(seconds.is_normal() && *seconds > 0.0)) {
            return Err(TrainError::Exposure { view: view.name.clone(), exposure_s });
        }
    }
    Ok(!recorded.is_empty())
}

/// Returns whether a run learns the response of a camera: of captured images, unless its method has
/// networks for that.
pub(crate) fn learns_response(dataset: &Dataset, config: &TrainConfig) -> Result<bool, TrainError> {
    Ok(is_recorded(&dataset.train)? && !config.method.has_own_networks())
}

/// Returns the curve through which the loss sees `view` of gain `gain`, or `None` if the view is
/// radiance.
pub(crate) fn curve(view: &View, knots: &Knots, radiance_scale: RadianceScale, gain: [f32; 3]) -> Option<ToneCurve> {
    let exposure_s = exposure_of(view)?;
    Some(ToneCurve::Response(Response { knots: *knots, exposure: radiance_scale.exposure(exposure_s, gain) }))
}

/// Returns the radiance of a captured value in a channel by `knots`, or `None` if the value is
/// black or saturated.
pub(crate) fn radiance_of(value: f32, channel: usize, knots: &Knots, exposure_s: f32) -> Option<f32> {
    let is_between = value > BLACK && value < SATURATED;
    is_between.then(|| (Response::exposure_at(&knots[channel], value) / f64::from(exposure_s)) as f32)
}

/// Returns a captured view as radiance, in the memory of its image where nothing shares that.
/// Pixels that are black or saturated in any channel are masked.
pub(crate) fn radiance_view(view: View, exposure_s: f32, knots: &Knots) -> View {
    let (mut image, given) = (view.image.into_value(), view.mask);
    let mut mask = Mask { weights: vec![0.0; image.pixels.len()] };
    for (i, (pixel, weight)) in image.pixels.iter_mut().zip(&mut mask.weights).enumerate() {
        let is_valid = given.as_deref().is_none_or(|given| given.is_valid(i));
        let rgb = [0, 1, 2].map(|c| radiance_of(pixel[c], c, knots, exposure_s));
        (*pixel, *weight) = match rgb {
            [Some(r), Some(g), Some(b)] if is_valid => ([r, g, b], 1.0),
            _ => ([0.0; 3], 0.0),
        };
    }
    View { image: image.into(), values: PixelValues::Radiance, mask: Some(mask.into()), ..view }
}

#[cfg(test)]
mod tests {
    use luxel_core::Image;
    use luxel_metrics::render_as_captured;

    use super::*;
    use crate::camera_response::CameraResponse;
    use crate::testing::{camera_at, view_of};

    fn exposed(exposure_s: f32, values: Vec<[f32; 3]>) -> View {
        let view = view_of("a", camera_at([0.0; 3], [values.len() as u32, 1]), Image::from_pixels(values.len(), 1, values).unwrap());
        View { values: PixelValues::Recorded { exposure_s }, ..view }
    }

    #[test]
    fn recorded_radiance_comes_back_where_it_is_neither_black_nor_saturated() {
        let knots = CameraResponse::new(0.5, &[]).knots();
        let view = exposed(0.25, vec![[0.5; 3], [0.0, 0.5, 0.5], [0.5, 1.0, 0.5]]);
        let radiance = radiance_view(view, 0.25, &knots);
        // 0.5 is the value of the unit exposure, which here takes a quarter of a second: radiance
        // 4.
        assert!(radiance.image.pixels[0].iter().all(|v| (v - 4.0).abs() < 1e-3), "{:?}", radiance.image.pixels[0]);
        assert_eq!(radiance.mask.as_ref().unwrap().weights, [1.0, 0.0, 0.0]);
        assert_eq!(radiance.values, PixelValues::Radiance);
    }

    #[test]
    fn what_is_recorded_of_a_render_is_what_the_loss_compares() {
        let knots = CameraResponse::new(0.5, &[]).knots();
        let view = exposed(0.5, vec![[0.1; 3]]);
        let Some(ToneCurve::Response(response)) = curve(&view, &knots, RadianceScale::new(2.0).unwrap(), [1.0, 2.0, 1.0]) else {
            panic!("of a recorded view")
        };
        let found = render_as_captured(&Image::filled(1, 1, [1.0; 3]), &response).pixels[0];
        // Radiance 1 in units of 2, for half a second, is the unit exposure.
        assert!((found[0] - 0.5).abs() < 1e-4 && found[1] > 0.6, "{found:?}");
        assert_eq!(render_as_captured(&Image::filled(1, 1, [1e9; 3]), &response).pixels[0], [1.0; 3]);
    }

    #[test]
    fn one_kind_of_values_is_trained_on() {
        let (radiance, recorded) = (view_of("r", camera_at([0.0; 3], [1, 1]), Image::filled(1, 1, [1.0; 3])), exposed(1.0, vec![[0.5; 3]]));
        assert!(!is_recorded(std::slice::from_ref(&radiance)).unwrap() && is_recorded(std::slice::from_ref(&recorded)).unwrap());
        assert!(matches!(is_recorded(&[radiance, recorded]), Err(TrainError::MixedValues { .. })));
        assert!(matches!(is_recorded(&[exposed(0.0, vec![[0.5; 3]])]), Err(TrainError::Exposure { .. })));
    }
}

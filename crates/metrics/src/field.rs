//! Established HDR metrics that need no mu-law.
//!
//! In: prediction and target `[H,W,3]` in normalised units, their primaries, and the luminance at
//! which a display shows 1. Out: [`FieldMetrics`]. Images are converted to linear Rec.709 first.
//! Colours outside its gamut are clipped to it, because no light is negative.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::decades::{log_rmse, relative_error_by_decade};
use super::pu21::pu21_psnr_ssim;
use super::{DecadeError, MetricsError, Pair, hdr_flip};
use luxel_core::tone::rec709_of;
use luxel_core::{ColorSpace, Image, Mask};

/// The choice to compute HDR-FLIP or not: it takes many times as long as all other metrics
/// together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlipChoice {
    /// HDR-FLIP is not computed: [`FieldMetrics::hdr_flip`] is `None`.
    #[default]
    Skip,
    /// HDR-FLIP is computed.
    Compute,
}

/// Options of [`field_metrics`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOptions {
    /// The luminance at which a display shows white of 1 normalised unit, cd/m2.
    pub peak_luminance: f32,
    /// The primaries of both images.
    pub color_space: ColorSpace,
    /// The choice to compute HDR-FLIP or not.
    pub flip: FlipChoice,
}

impl FieldOptions {
    /// The default peak luminance, cd/m2: a good current HDR display, well within the range that
    /// PU21 was fitted to.
    pub const DEFAULT_PEAK_LUMINANCE: f32 = 1000.0;
}

impl Default for FieldOptions {
    fn default() -> Self {
        Self { peak_luminance: Self::DEFAULT_PEAK_LUMINANCE, color_space: ColorSpace::default(), flip: FlipChoice::Skip }
    }
}

/// Metrics of one view, or their means over several views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FieldMetrics {
    /// PSNR of PU21-encoded radiance, channels pooled, dB.
    pub pu21_psnr: f64,
    /// SSIM of PU21-encoded luminance.
    pub pu21_ssim: f64,
    /// The luminance at which a display shows 1 normalised unit of both images, cd/m2.
    pub pu21_peak_luminance: f32,
    /// Root mean squared error of log10 of the channels, decades.
    pub log_rmse: f64,
    /// Mean HDR-FLIP, 0 to 1, at 67 pixels per degree.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hdr_flip: Option<f64>,
    /// LPIPS with AlexNet on mu-law images by protocol `gtmax`, scaled to `[-1, 1]`; `None` without
    /// its weights.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_alex: Option<f64>,
    /// LPIPS with VGG16, otherwise like [`FieldMetrics::lpips_alex`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_vgg: Option<f64>,
    /// Relative error by decade of the target's luminance in normalised units.
    pub relative_error_by_decade: Vec<DecadeError>,
}

impl FieldMetrics {
    /// Returns the mean of every metric, or `None` without any view. Decades are pooled by pixels.
    /// An optional metric has a mean only if all views have it.
    pub fn mean(views: &[Self]) -> Option<Self> {
        let mean = |of: fn(&Self) -> f64| views.iter().map(of).sum::<f64>() / views.len() as f64;
        let mean_of_all = |of: fn(&Self) -> Option<f64>| {
            let values: Option<Vec<f64>> = views.iter().map(of).collect();
            values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
        };
        Some(Self {
            pu21_peak_luminance: views.first()?.pu21_peak_luminance,
            pu21_psnr: mean(|v| v.pu21_psnr),
            pu21_ssim: mean(|v| v.pu21_ssim),
            log_rmse: mean(|v| v.log_rmse),
            hdr_flip: mean_of_all(|v| v.hdr_flip),
            lpips_alex: mean_of_all(|v| v.lpips_alex),
            lpips_vgg: mean_of_all(|v| v.lpips_vgg),
            relative_error_by_decade: DecadeError::pooled(views.iter().map(|view| view.relative_error_by_decade.as_slice())),
        })
    }
}

/// Computes every metric of a view: `prediction` against `target`, both in normalised units.
///
/// # Errors
/// [`MetricsError`]: sizes differ, no pixel is valid, a valid pixel is NaN or infinite, or the peak
/// luminance is not positive.
pub fn field_metrics(
    prediction: &Image,
    target: &Image,
    mask: Option<&Mask>,
    options: &FieldOptions,
) -> Result<FieldMetrics, MetricsError> {
    if !(options.peak_luminance.is_finite() && options.peak_luminance > 0.0) {
        return Err(MetricsError::PeakLuminance(options.peak_luminance));
    }
    // The images are checked before the conversion, because clipping hides NaN: the maximum of NaN
    // and 0 is 0.
    Pair::new(prediction, target, mask)?;
    let [prediction, target] = [prediction, target].map(|image| light(image, options.color_space));
    let pair = Pair::new(&prediction, &target, mask)?;
    let (pu21_psnr, pu21_ssim) = pu21_psnr_ssim(&pair, options.peak_luminance.into());
    let hdr_flip = match options.flip {
        FlipChoice::Skip => None,
        FlipChoice::Compute => Some(hdr_flip(&prediction, &target, mask, ColorSpace::LinearRec709)?.mean),
    };
    Ok(FieldMetrics {
        pu21_psnr,
        pu21_ssim,
        pu21_peak_luminance: options.peak_luminance,
        log_rmse: log_rmse(&pair),
        hdr_flip,
        lpips_alex: None,
        lpips_vgg: None,
        relative_error_by_decade: relative_error_by_decade(&pair),
    })
}

/// Returns an image in linear Rec.709 without negative values.
fn light(image: &Image, space: ColorSpace) -> Cow<'_, Image> {
    if space == ColorSpace::LinearRec709 && image.pixels.as_flattened().iter().all(|v| *v >= 0.0) {
        return Cow::Borrowed(image);
    }
    let pixels = image.pixels.iter().map(|&rgb| rec709_of(space, rgb).map(|v| v.max(0.0)));
    Cow::Owned(Image { width: image.width, height: image.height, pixels: pixels.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_PSNR_DB;

    const ALL: FieldOptions = FieldOptions { peak_luminance: 100.0, color_space: ColorSpace::LinearRec709, flip: FlipChoice::Compute };

    #[test]
    fn equal_images_have_no_error() {
        for (size, value) in [(1, 0.0), (1, 0.3), (12, 1e3)] {
            let image = Image::filled(size, size, [value; 3]);
            let metrics = field_metrics(&image, &image, None, &ALL).unwrap();
            assert_eq!((metrics.pu21_psnr, metrics.log_rmse, metrics.hdr_flip), (MAX_PSNR_DB, 0.0, Some(0.0)));
            assert!((metrics.pu21_ssim - 1.0).abs() < 1e-12);
            let json = serde_json::to_string(&metrics).unwrap();
            assert_eq!(serde_json::from_str::<FieldMetrics>(&json).unwrap(), metrics);
        }
    }

    #[test]
    fn black_against_white_of_a_common_display_is_no_decibel() {
        let (black, white) = (Image::filled(4, 4, [0.0; 3]), Image::filled(4, 4, [1.0; 3]));
        let metrics = field_metrics(&black, &white, None, &ALL).unwrap();
        assert!(metrics.pu21_psnr.abs() < 0.02, "{}", metrics.pu21_psnr);
    }

    #[test]
    fn masked_pixels_do_not_count_and_bad_ones_are_named() {
        let target = Image::filled(15, 13, [0.2, 0.4, 0.1]);
        let mut prediction = target.clone();
        prediction.pixels[7] = [f32::NAN; 3];
        let mask = Mask::from_valid((0..195).map(|i| i != 7));
        let metrics = field_metrics(&prediction, &target, Some(&mask), &ALL).unwrap();
        assert_eq!((metrics.pu21_psnr, metrics.log_rmse, metrics.hdr_flip), (MAX_PSNR_DB, 0.0, Some(0.0)));
        assert_eq!(metrics.relative_error_by_decade[0].count, 194);
        let error = field_metrics(&prediction, &target, None, &ALL).unwrap_err();
        assert_eq!(error, MetricsError::NotFinite { image: "prediction", x: 7, y: 0 });
        let dark = FieldOptions { peak_luminance: 0.0, ..ALL };
        assert_eq!(field_metrics(&target, &target, None, &dark), Err(MetricsError::PeakLuminance(0.0)));
    }

    #[test]
    fn means_are_of_what_all_have() {
        let of = |pu21_psnr, hdr_flip| FieldMetrics { pu21_psnr, hdr_flip, pu21_peak_luminance: 100.0, ..FieldMetrics::default() };
        assert_eq!(FieldMetrics::mean(&[of(20.0, Some(0.1)), of(30.0, Some(0.3))]), Some(of(25.0, Some(0.2))));
        assert_eq!(FieldMetrics::mean(&[of(20.0, Some(0.1)), of(30.0, None)]).unwrap().hdr_flip, None);
        assert_eq!(FieldMetrics::mean(&[]), None);
    }
}

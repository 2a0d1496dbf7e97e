//! The metrics of an image in memory against a reference.

use luxel_core::{ColorSpace, Image, Mask};
use luxel_metrics::{FieldMetrics, ViewMetrics};
use serde::Serialize;

use super::CompareOptions;
use super::measure::{Settings, measure_pixels};
use crate::Result;
use crate::error::{Context, ensure};

/// The metrics of an image, as [`compare`](super::compare) has them of files.
#[derive(Clone, Debug, Serialize)]
pub struct ImageComparison {
    /// Radiance of 1 in protocol `scene`, in the decades, and of the peak luminance.
    pub scale: f32,
    /// How the scale was found, for people.
    pub scale_rule: &'static str,
    /// Number of pixels left out.
    pub masked_pixels: usize,
    /// Metrics under the mu-law.
    #[serde(flatten)]
    pub mu_law: ViewMetrics,
    /// Metrics without a mu-law.
    #[serde(flatten)]
    pub field: FieldMetrics,
    /// First and last exposure of HDR-FLIP, stops.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hdr_flip_exposures_ev: Option<[f32; 2]>,
}

/// Measures `test` against `reference`, linear radiance in `color_space`. Of the options, those
/// about files have no effect. Pixels of the reference that are not finite are left out.
///
/// ```
/// use luxel::ColorSpace;
/// use luxel::compare::{CompareOptions, compare_images};
/// use luxel_core::Image;
///
/// # fn main() -> luxel::Result<()> {
/// let [reference, test] = [2.0, 1.5].map(|value| Image::filled(16, 16, [value; 3]));
/// let options = CompareOptions { scale: Some(2.0), ..CompareOptions::default() };
/// let found = compare_images(reference, test, None, ColorSpace::default(), &options)?;
/// assert!(found.mu_law.psnr_scene > 20.0);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// Sizes that differ; a test that is not finite; weights of LPIPS that cannot be read.
pub fn compare_images(
    mut reference: Image,
    mut test: Image,
    mask: Option<Mask>,
    color_space: ColorSpace,
    options: &CompareOptions,
) -> Result<ImageComparison> {
    ensure!(
        (reference.width, reference.height) == (test.width, test.height),
        "the reference is {}x{}, the image {}x{}: expected equal sizes",
        reference.width,
        reference.height,
        test.width,
        test.height
    );
    if let Some(mask) = &mask {
        let [found, expected] = [mask.weights.len(), reference.pixels.len()];
        ensure!(found == expected, "the mask has {found} pixels, the images {expected}: expected equal sizes");
    }
    let settings = Settings::of_image(options, &reference, mask.as_ref(), color_space)?;
    let measured = measure_pixels(&mut reference, &mut test, mask, color_space, &settings).context("cannot compare the images")?;
    Ok(ImageComparison {
        scale: settings.scale,
        scale_rule: settings.scale_rule,
        masked_pixels: measured.masked_pixels(),
        hdr_flip_exposures_ev: measured.exposures_ev(),
        mu_law: measured.mu_law,
        field: measured.field,
    })
}

//! `report.html`: one self-contained page about a run, for eyes and for keeping.
//!
//! In: [`ReportInput`], images in normalised units. Out: HTML with pictures and plots inlined: nothing is loaded from anywhere. All text
//! is escaped. Without test views the page says so and shows the rest. Pictures shrink until the page stays within a few megabytes.

mod field;
pub(crate) mod html;
mod page;
pub(crate) mod picture;
mod plot;
pub(crate) mod profile;
mod views;

use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use luxel_core::metrics::{FieldMetrics, LuminanceProfile, ViewMetrics};
use luxel_core::{ColorSpace, Image, Mask};
use luxel_io::{IoError, write_atomically};

/// Everything the page shows.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReportInput {
    /// Headline: the data set's name.
    pub(crate) title: String,
    /// One line below it: method, iterations, device.
    pub(crate) subtitle: String,
    /// Name and value: splats, seconds, memory, scale, versions.
    pub(crate) facts: Vec<(String, String)>,
    /// Things the reader should know, such as 8-bit input.
    pub(crate) warnings: Vec<String>,
    /// Figures; the first split is the headline's (`test` before `train`). May be empty.
    pub(crate) splits: Vec<ReportSplit>,
    /// Training curves, by iteration. May be empty.
    pub(crate) curve: Vec<CurveSample>,
    /// Renders beside ground truth. May be empty.
    pub(crate) views: Vec<ReportView>,
    /// Error by luminance, pooled over the views of the first split.
    pub(crate) profile: LuminanceProfile,
    /// Resolved configuration.
    pub(crate) config_toml: String,
    /// Licences and authors of what the pictures show.
    pub(crate) credits: Vec<String>,
    /// mu of the mu-law.
    pub(crate) mu: f32,
    /// Data-set radiance of one normalised unit.
    pub(crate) radiance_scale: f32,
    /// Primaries of the images.
    pub(crate) color_space: ColorSpace,
}

/// Figures of one split.
#[derive(Clone, Debug)]
pub(crate) struct ReportSplit {
    /// `test`.
    pub(crate) name: String,
    /// Means over the views.
    pub(crate) mean: ViewMetrics,
    /// Name and figures of each view.
    pub(crate) views: Vec<(String, ViewMetrics)>,
    /// Means of what needs no mu-law.
    pub(crate) mean_field: Option<FieldMetrics>,
    /// Name and figures without a mu-law of each view that has them.
    pub(crate) fields: Vec<(String, FieldMetrics)>,
}

/// One point of the training curves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CurveSample {
    /// Steps made.
    pub(crate) iteration: u32,
    /// Training loss.
    pub(crate) loss: f64,
    /// Mean absolute difference under the mu-law.
    pub(crate) l1: f64,
    /// Mean SSIM under the mu-law.
    pub(crate) ssim: f64,
    /// Splats.
    pub(crate) splats: usize,
    /// Seconds of training.
    pub(crate) elapsed_s: f64,
    /// PSNR of training views, protocol `scene`, dB.
    pub(crate) psnr_train: Option<f64>,
    /// PSNR of the test views, protocol `scene`, dB.
    pub(crate) psnr_test: Option<f64>,
}

/// A test view.
#[derive(Clone, Debug)]
pub(crate) struct ReportView {
    /// Of the view.
    pub(crate) name: String,
    /// Normalised units.
    pub(crate) prediction: Image,
    /// Normalised units.
    pub(crate) target: Image,
    /// `None`: all pixels are valid.
    pub(crate) mask: Option<Arc<Mask>>,
    /// Figures.
    pub(crate) metrics: ViewMetrics,
}

/// Writes the page, whole or not at all.
///
/// # Errors
/// If a prediction and its target differ in size, or the file can't be written.
pub(crate) fn write_report(path: &Path, input: &ReportInput) -> Result<()> {
    let page = page::page(input)?;
    write_atomically(path, |out| out.write_all(page.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))?;
    Ok(())
}

#[cfg(test)]
mod tests;

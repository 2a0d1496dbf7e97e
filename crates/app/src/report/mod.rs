//! `report.html`: one self-contained page about a run.
//!
//! In: [`ReportInput`], images in normalised units. Out: HTML with pictures and plots inlined:
//! nothing is loaded from anywhere. All text is escaped. Degenerate: without test views the page
//! says so and has the other sections. Pictures are reduced until the page has a few megabytes.

mod field;
pub mod html;
mod page;
pub mod picture;
mod plot;
pub mod profile;
mod views;

use std::path::Path;

use luxel::Result;
use luxel_core::{ColorSpace, Image, Mask, OnDemand, RadianceScale};
use luxel_io::{IoError, write_atomically};
use luxel_metrics::{FieldMetrics, LuminanceProfile, ViewMetrics};

/// The content of the page.
#[derive(Clone, Debug, Default)]
pub struct ReportInput {
    /// Headline, the data set's name.
    pub title: String,
    /// Line below the headline: method, iterations, device.
    pub subtitle: String,
    /// Facts with name and value: splats, seconds, memory, scale, versions.
    pub facts: Vec<(String, String)>,
    /// Things the reader should know, such as 8-bit input.
    pub warnings: Vec<String>,
    /// Metrics; the first split is the headline's (`test` before `train`). May be empty.
    pub splits: Vec<ReportSplit>,
    /// Training curves, by iteration. May be empty.
    pub curve: Vec<CurveSample>,
    /// Renders beside ground truth. May be empty.
    pub views: Vec<ReportView>,
    /// Error by luminance, pooled over the views of the first split.
    pub profile: LuminanceProfile,
    /// Resolved configuration.
    pub config_toml: String,
    /// Licences and authors of the data set.
    pub credits: Vec<String>,
    /// mu of the mu-law.
    pub mu: f32,
    /// Data-set radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
    /// Primaries of the images.
    pub color_space: ColorSpace,
}

/// The metrics of one split.
#[derive(Clone, Debug)]
pub struct ReportSplit {
    /// Name: `test`.
    pub name: String,
    /// Means over the views.
    pub mean: ViewMetrics,
    /// Name and metrics of each view.
    pub views: Vec<(String, ViewMetrics)>,
    /// Means of metrics without a mu-law.
    pub mean_field: Option<FieldMetrics>,
    /// Name and metrics without a mu-law of each view that has them.
    pub fields: Vec<(String, FieldMetrics)>,
}

/// A point of the training curves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurveSample {
    /// Steps made.
    pub iteration: u32,
    /// Training loss.
    pub loss: f64,
    /// Mean absolute difference under the mu-law, if the loss has it.
    pub l1: Option<f64>,
    /// Mean SSIM under the mu-law, if the loss has it.
    pub ssim: Option<f64>,
    /// Number of splats.
    pub splats: usize,
    /// Seconds of training.
    pub elapsed_s: f64,
    /// PSNR of training views, protocol `scene`, dB.
    pub psnr_train: Option<f64>,
    /// PSNR of the test views, protocol `scene`, dB; where they were evaluated.
    pub psnr_test: Option<f64>,
    /// PSNR of a few test views, protocol `scene`, dB; where they were looked at.
    pub psnr_test_sample: Option<f64>,
}

/// A test view.
#[derive(Clone, Debug)]
pub struct ReportView {
    /// Name of the view.
    pub name: String,
    /// Render, normalised units.
    pub prediction: Image,
    /// Ground truth, normalised units.
    pub target: Image,
    /// Mask; `None` if all pixels are valid.
    pub mask: Option<OnDemand<Mask>>,
    /// Metrics of the view.
    pub metrics: ViewMetrics,
}

/// Writes the page, whole or not at all.
///
/// # Errors
/// A prediction and a target that differ in size; the file system's refusal.
pub fn write_report(path: &Path, input: &ReportInput) -> Result<()> {
    let page = page::page(input)?;
    write_atomically(path, |out| out.write_all(page.as_bytes()).map_err(|e| IoError::system(path, "write", &e)))?;
    Ok(())
}

#[cfg(test)]
mod tests;

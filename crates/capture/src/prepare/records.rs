//! Records of finished views, and the result of structure from motion.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::LeftOut;
use crate::CaptureMetrics;

/// A view that is finished.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewRecord {
    /// Name of the view.
    pub name: String,
    /// Digest of its inputs and settings.
    pub key: String,
    /// Files it was made of, shortest exposure first.
    pub files: Vec<String>,
    /// Their exposures, stops of signal per cd/m2.
    pub stops: Vec<f64>,
    /// Index of its camera.
    pub camera: usize,
    /// Size of the radiance image, pixels.
    pub size_px: [usize; 2],
    /// Size of the picture for structure from motion, pixels.
    pub proxy_px: [usize; 2],
    /// Factor by which each side of that picture is smaller.
    pub proxy_reduction: usize,
    /// Share of pixels that are saturated in every frame.
    pub saturated: f64,
    /// Share of samples that are black in every frame.
    pub dark: f64,
    /// Share of pixels of which a channel was below 0 and was set to it.
    pub negative: f64,
    /// Share of samples in which frames disagree beyond noise.
    pub disagreeing: f64,
    /// Largest shift between neighbouring exposures, pixels of the photographs.
    pub offset_px: Option<f64>,
    /// Range and sharpness.
    #[serde(alias = "figures")]
    pub metrics: CaptureMetrics,
    /// Those of its files that could not be decoded.
    pub left_out: Vec<LeftOut>,
    /// Remarks from its files.
    pub notes: Vec<String>,
}

/// The result of structure from motion.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// Views that have a pose, by name.
    pub views: BTreeMap<String, RegisteredView>,
    /// Number of points.
    pub points: usize,
    /// Mean distance between where points are seen and where the cameras project them, pixels of
    /// the proxies.
    pub mean_error_px: f64,
    /// Mean number of views that see a point.
    pub mean_track: f64,
    /// Number of models that were found; views of all but the largest have no pose.
    pub models: usize,
}

/// A view that has a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RegisteredView {
    /// Number of points it sees.
    pub points: usize,
    /// Their mean error, pixels of the proxy.
    pub error_px: f64,
    /// Focal length of the written image, pixels.
    pub focal_px: f64,
    /// Share of the photograph's width that is left after undistortion.
    pub kept: f64,
}

/// Returns the stops from the darkest thousandth of any view to the brightest; 0 where there is no
/// light.
pub fn range_stops(views: &[ViewRecord]) -> f32 {
    let dark = views.iter().map(|v| v.metrics.dark_luminance).filter(|l| *l > 0.0).fold(f32::INFINITY, f32::min);
    let bright = views.iter().map(|v| v.metrics.bright_luminance).fold(0.0, f32::max);
    if bright > dark { (bright / dark).log2() } else { 0.0 }
}

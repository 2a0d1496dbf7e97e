//! Options of [`compare`](super::compare).

use std::path::PathBuf;

use luxel_core::ColorSpace;
use luxel_io::Transfer;
use luxel_metrics::{FieldOptions, FlipChoice};

/// Options of [`compare`](super::compare).
#[derive(Clone, Debug)]
pub struct CompareOptions {
    /// Radiance that is 1 in protocol `scene`, in the decades and on the display of PU21; `None`
    /// for the radiance scale that the files state, or if none does the 99.9th percentile of the
    /// luminance of all references.
    pub scale: Option<f32>,
    /// Luminance at which the display of PU21 has that radiance, cd/m2.
    pub peak_luminance: f32,
    /// mu of the mu-law.
    pub mu: f32,
    /// Whether HDR-FLIP is measured; it always is for error maps.
    pub flip: FlipChoice,
    /// Weights for LPIPS, which is measured if they are given.
    pub lpips_weights: Option<PathBuf>,
    /// Mask, black where pixels are left out; with folders one for all, or a folder of masks.
    pub mask: Option<PathBuf>,
    /// Transfer function of integer images that do not state theirs.
    pub transfer: Option<Transfer>,
    /// Part, layer or view of OpenEXR files that have several: [`luxel_io::ReadOptions::layer`].
    pub layer: Option<String>,
    /// Primaries of images that do not state theirs; `None` for linear Rec.709.
    pub color_space: Option<ColorSpace>,
    /// Place of the error map of HDR-FLIP: a PNG; with folders, a folder of them.
    pub heatmap: Option<PathBuf>,
    /// Whether error maps that exist are replaced.
    pub overwrite: bool,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            scale: None,
            peak_luminance: FieldOptions::DEFAULT_PEAK_LUMINANCE,
            mu: luxel_core::tone::MU,
            flip: FlipChoice::Compute,
            lpips_weights: None,
            mask: None,
            transfer: None,
            layer: None,
            color_space: None,
            heatmap: None,
            overwrite: false,
        }
    }
}

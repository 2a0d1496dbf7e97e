//! Metrics of images against references: of two images, or of two folders of them.
//!
//! In: paths and [`CompareOptions`]. Out: [`Comparison`]: every metric of every pair, and means.
//! Images of folders are matched by their names without extension. Degenerate: images without a
//! partner are left out with a warning; folders without a pair are an error.

mod images;
mod measure;
mod options;
mod pairs;

use std::path::{Path, PathBuf};

use luxel_core::{ColorSpace, Remedy};
use luxel_metrics::{FieldMetrics, Lpips, ViewMetrics};
use rayon::prelude::*;
use serde::Serialize;

pub use self::images::{ImageComparison, compare_images};
use self::measure::Settings;
pub use self::options::CompareOptions;
use self::pairs::Pairs;
use crate::error::{Context, bail};
use crate::{Error, Observer, Result, output};

/// The metrics of images against references. Serialized, it is the JSON output of the program.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Reference image or folder.
    pub reference: String,
    /// Tested image or folder.
    pub test: String,
    /// Radiance of 1 in protocol `scene`, in the decades, and of the peak luminance.
    pub scale: f32,
    /// How the scale was found, for people.
    pub scale_rule: &'static str,
    /// Luminance of that radiance on the display of PU21, cd/m2.
    pub peak_luminance: f32,
    /// mu of the mu-law.
    pub mu: f32,
    /// Means over the images.
    pub mean: MeanMetrics,
    /// Metrics of each pair, by name.
    pub images: Vec<ImageMetrics>,
    /// References without a test.
    pub missing_test: Vec<String>,
    /// Tests without a reference.
    pub missing_reference: Vec<String>,
    /// Whether folders were compared.
    #[serde(skip)]
    pub are_folders: bool,
}

/// Means of metrics over images.
#[derive(Clone, Debug, Serialize)]
pub struct MeanMetrics {
    /// Metrics under the mu-law.
    #[serde(flatten)]
    pub mu_law: ViewMetrics,
    /// Metrics without a mu-law.
    #[serde(flatten)]
    pub field: FieldMetrics,
}

impl MeanMetrics {
    /// Returns the means over images; zeros without any.
    pub fn new(mu_law: &[ViewMetrics], field: &[FieldMetrics]) -> Self {
        Self { mu_law: ViewMetrics::mean(mu_law).unwrap_or_default(), field: FieldMetrics::mean(field).unwrap_or_default() }
    }
}

/// The metrics of an image.
#[derive(Clone, Debug, Serialize)]
pub struct ImageMetrics {
    /// Name without folder and extension.
    pub name: String,
    /// Path of the reference.
    pub reference: String,
    /// Path of the tested image.
    pub test: String,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Primaries in which the images are compared.
    pub color_space: ColorSpace,
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
    /// Whether both files state their primaries.
    #[serde(skip)]
    states_primaries: bool,
    #[serde(skip)]
    warning: Option<String>,
}

/// Measures `test` against `reference`, two images or two folders of images.
///
/// ```
/// use luxel::compare::{CompareOptions, compare};
/// use luxel_core::Image;
/// use luxel_io::{ExrOptions, write_exr};
///
/// # fn main() -> luxel::Result<()> {
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = |name: &str| folder.path().join(name);
/// write_exr(&path("reference.exr"), &Image::filled(16, 16, [2.0; 3]), &ExrOptions::default())?;
/// write_exr(&path("test.exr"), &Image::filled(16, 16, [1.5; 3]), &ExrOptions::default())?;
/// let options = CompareOptions { scale: Some(2.0), ..CompareOptions::default() };
/// let found = compare(&path("reference.exr"), &path("test.exr"), &options, &luxel::Silent)?;
/// assert_eq!((found.images.len(), found.images[0].name.as_str()), (1, "test"));
/// assert!(found.mean.mu_law.psnr_scene > 20.0);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// Images that cannot be read or differ in size, folders without a common name, error maps that
/// exist already.
pub fn compare(reference: &Path, test: &Path, options: &CompareOptions, observer: &dyn Observer) -> Result<Comparison> {
    let pairs = Pairs::find(reference, test, options)?;
    for line in pairs.missing_lines() {
        observer.warn(&line);
    }
    if pairs.pairs.is_empty() {
        bail!("{}", pairs.nothing_matches(reference, test));
    }
    for path in pairs.pairs.iter().filter_map(|pair| pair.heatmap.as_ref()) {
        output::check_free(path, options.overwrite)?;
        output::check_no_input(path, pairs.pairs.iter().flat_map(|pair| pair.inputs()))?;
        output::check_extension(path, &["png"])?;
    }
    let _confinement = match &options.heatmap {
        Some(folder) if pairs.are_folders => {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))?;
            Some(luxel_io::confine(folder)?)
        }
        _ => None,
    };
    let settings = Settings::new(options, &pairs, observer)?;
    let mut images = Vec::with_capacity(pairs.pairs.len());
    for batch in pairs.pairs.chunks(settings.batch()) {
        // In the order of the names: the first error is reported, and warnings come out in order.
        let measured: Vec<Result<ImageMetrics>> = batch.par_iter().map(|pair| measure::measure(pair, &settings)).collect();
        for image in measured {
            let image = image?;
            if let Some(warning) = &image.warning {
                observer.warn(warning);
            }
            images.push(image);
        }
    }
    if let (Some(given), true) = (options.color_space, images.iter().all(|image| image.states_primaries)) {
        let error = Error::new(format!("the colour space {} has nothing to act on: every image states its own", given.name()));
        return Err(error.with_remedy(Remedy::leave_out("color_space")));
    }
    let mu_law: Vec<ViewMetrics> = images.iter().map(|image| image.mu_law).collect();
    let field: Vec<FieldMetrics> = images.iter().map(|image| image.field.clone()).collect();
    let paths = |paths: Vec<PathBuf>| paths.iter().map(|path| path.display().to_string()).collect();
    Ok(Comparison {
        reference: reference.display().to_string(),
        test: test.display().to_string(),
        scale: settings.scale,
        scale_rule: settings.scale_rule,
        peak_luminance: settings.peak_luminance,
        mu: settings.mu,
        mean: MeanMetrics::new(&mu_law, &field),
        images,
        missing_test: paths(pairs.only_reference),
        missing_reference: paths(pairs.only_test),
        are_folders: pairs.are_folders,
    })
}

/// Reads the network of LPIPS from a file of weights; `None` without one.
///
/// # Errors
/// A file that cannot be read, or whose weights are of another network.
pub fn read_lpips(weights: Option<&Path>) -> Result<Option<Lpips>> {
    let Some(path) = weights else { return Ok(None) };
    let tensors = luxel_io::read_tensors(path).context("cannot read the weights")?;
    Lpips::from_tensors(&tensors).map(Some).with_context(|| format!("{}: cannot be used for LPIPS", path.display()))
}

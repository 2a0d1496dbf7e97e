//! Measurements after training, one cell at a time: frames per second, and metrics that training
//! leaves out.
//!
//! In: finished cells. Out: [`Measured`], stored in the cell and measured again only when more is
//! asked for, or by another radiance scale ([`super::one_scale`]). Frames per second: all test
//! views are rendered in turn, once unmeasured, then until [`ENOUGH`] or [`MOST_PASSES`]; the
//! result is the number of views over the median time of a pass. Images stay in memory. Degenerate:
//! without test views there is no number.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};
use std::path::Path;
use std::time::{Duration, Instant};

use luxel::compare::read_lpips;
use luxel::error::{Context, bail};
use luxel::{Device, DeviceOptions, Observer, Result, SelectedEngine};
use luxel_core::{Dataset, Engine, RadianceScale, RenderOptions, View};
use luxel_io::LoadOptions;
use luxel_metrics::{FieldOptions, FlipChoice};
use luxel_metrics::{GainFit, Lpips};
use luxel_train::LensVignetting;
use serde::{Deserialize, Serialize};

use super::Failure;
use super::matrix::{Cell, Matrix};
use super::one_scale::{self, ByScale};
use super::options::StudyOptions;
use crate::files;
use crate::run::evaluation::Rendering;
use crate::run::state::{self, LoadedRun};
use crate::schema;

/// Duration after which no further pass over the views is made.
const ENOUGH: Duration = Duration::from_secs(3);
/// Number of passes that are made even if they take longer.
const LEAST_PASSES: usize = 3;
/// Number of passes that are enough in any case.
const MOST_PASSES: usize = 20;

/// Limit of the size of measured.json, which has a few hundred bytes, and with metrics by another
/// scale a few kilobytes more for each view.
const LIMIT_BYTES: u64 = 256 << 20;

/// Contents of `measured.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Measured {
    /// Steps of training of the scene that was measured.
    pub(super) iterations: u32,
    pub(super) splats: usize,
    /// `None` without test views.
    pub(super) frames_per_second: Option<f64>,
    /// Device that rendered: threads of a processor, or a GPU.
    #[serde(default)]
    pub(super) computed_by: String,
    /// Number of views in a pass.
    pub(super) views: usize,
    /// Size of the first view, pixels.
    pub(super) size_px: [u32; 2],
    /// Mean over the test views.
    pub(super) hdr_flip: Option<f64>,
    pub(super) lpips: Option<MeasuredLpips>,
    /// Metrics of the test views by the radiance scale of the data set, where the run has another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) by_scale: Option<ByScale>,
}

/// A mean over the test views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct MeasuredLpips {
    /// `alex` or `vgg`.
    pub(super) network: String,
    pub(super) distance: f64,
    /// Digest of the weights: other weights give other distances.
    pub(super) weights: String,
}

/// The metrics that are measured besides frames per second.
pub(super) struct MeasureOptions {
    flip: FlipChoice,
    lpips: Option<(Lpips, String)>,
}

/// Measures the finished cells that have not been measured. A cell that cannot be measured does not
/// stop the others.
pub(super) fn measure(
    matrix: &Matrix,
    finished: &[usize],
    options: &MeasureOptions,
    device: &DeviceOptions,
    observer: &dyn Observer,
) -> Result<Vec<Failure>> {
    let place = |on_cpu| engine_of(on_cpu, device).map(|selected| selected.computed_by);
    let (of_splats, on_cpu) = (place(false)?, place(true)?);
    let scales = one_scale::due(matrix, finished)?;
    let is_open = |(cell, scale): &(&Cell, Option<RadianceScale>)| {
        let computed_by = if renders_on_cpu(cell) { &on_cpu } else { &of_splats };
        read(cell).is_none_or(|measured| !options.are_covered_by(&measured, *scale) || measured.computed_by != *computed_by)
    };
    let cells = finished.iter().filter_map(|&i| Some((matrix.cells.get(i)?, scales.get(&i).copied())));
    let mut todo: Vec<(&Cell, Option<RadianceScale>)> = cells.filter(is_open).collect();
    // One data set after another, so that each is read once and one is held.
    todo.sort_by_cached_key(|(cell, _)| (cell.source, format!("{:?}", cell.config.load)));
    let mut dataset: Option<HeldDataset> = None;
    let mut failures = Vec::new();
    for (cell, scale) in todo {
        let name = cell.name(matrix);
        let measured = dataset_of(&mut dataset, cell, observer)
            .and_then(|dataset| options.measure(cell, scale, dataset, engine_of(renders_on_cpu(cell), device)?, observer))
            .and_then(|measured| files::write_json(&cell.folder.measured(), schema::MEASURED, &measured).map(|()| measured));
        match measured {
            Ok(Measured { frames_per_second: Some(fps), .. }) => observer.note(&format!("{name}: {fps:.1} frames per second")),
            Ok(_) => observer.note(&format!("{name}: no test views to measure")),
            Err(error) => {
                let error = error.context("cannot measure");
                observer.warn(&format!("{name}: {error:#}"));
                failures.push(Failure { run: name, error });
            }
        }
    }
    Ok(failures)
}

/// Returns whether the scene of a run is rendered on the CPU alone.
fn renders_on_cpu(cell: &Cell) -> bool {
    let method = cell.config.train.method;
    !method.stores_splats() || method.lifts_colors()
}

/// Opens what renders splats, or the processor, which renders fields, anchors and lifted colours.
fn engine_of(on_cpu: bool, device: &DeviceOptions) -> Result<SelectedEngine> {
    if on_cpu { SelectedEngine::open(&DeviceOptions { device: Device::Cpu, ..device.clone() }) } else { SelectedEngine::open(device) }
}

/// The data set in memory.
struct HeldDataset {
    /// Index into [`Matrix::sources`].
    source: usize,
    load: LoadOptions,
    dataset: Dataset,
}

/// Returns the data set of a cell, and reads it if it is not the one in memory.
fn dataset_of<'d>(held: &'d mut Option<HeldDataset>, cell: &Cell, observer: &dyn Observer) -> Result<&'d Dataset> {
    let load = &cell.config.load;
    if held.as_ref().is_none_or(|held| (held.source, &held.load) != (cell.source, load)) {
        *held = None;
        let dataset = luxel::Dataset::open_reporting(&cell.config.dataset, load, observer)?.into_core();
        *held = Some(HeldDataset { source: cell.source, load: load.clone(), dataset });
    }
    held.as_ref().map(|held| &held.dataset).context("no data set")
}

/// Reads the measurements of a cell; `None` if there are none, or they are of an earlier state.
pub(super) fn read(cell: &Cell) -> Option<Measured> {
    let measured: Measured = serde_json::from_str(&files::read_text(&cell.folder.measured(), LIMIT_BYTES).ok()?).ok()?;
    (measured.iterations == cell.config.train.iterations).then_some(measured)
}

impl MeasureOptions {
    /// Takes the options, and reads the weights of LPIPS.
    pub(super) fn read(options: &StudyOptions) -> Result<Self> {
        let lpips = match (&options.lpips_weights, read_lpips(options.lpips_weights.as_deref())?) {
            (Some(path), Some(lpips)) => Some((lpips, digest(path)?)),
            _ => None,
        };
        Ok(Self { flip: options.flip, lpips })
    }

    /// Returns whether everything has been measured, and by the scale that it is to be.
    fn are_covered_by(&self, measured: &Measured, scale: Option<RadianceScale>) -> bool {
        if measured.by_scale.as_ref().map(|by_scale| by_scale.radiance_scale) != scale {
            return false;
        }
        if measured.views == 0 {
            return true;
        }
        let has_lpips = self.lpips.as_ref().is_none_or(|(lpips, weights)| {
            measured.lpips.as_ref().is_some_and(|found| found.network == lpips.network().name() && found.weights == *weights)
        });
        has_lpips && (self.flip == FlipChoice::Skip || measured.hdr_flip.is_some())
    }

    fn measure(
        &self,
        cell: &Cell,
        scale: Option<RadianceScale>,
        dataset: &Dataset,
        selected: SelectedEngine,
        observer: &dyn Observer,
    ) -> Result<Measured> {
        let iterations = cell.config.train.iterations;
        let LoadedRun { iteration: found, scene, selected, non_splat } =
            state::load_newest(&cell.folder, &cell.config, selected, observer)?;
        if found != iterations {
            bail!(
                "{}: its newest readable scene is of step {found}, expected {iterations}; delete the folder to train it anew",
                cell.place.display()
            );
        }
        let SelectedEngine { mut engine, computed_by, .. } = selected;
        let engine = engine.as_mut();
        let response = state::response(&cell.folder, &cell.config, iterations, non_splat.as_ref())?;
        let options = scene.render_options_before(cell.config.train.background);
        let frames_per_second = frames_per_second(engine, &dataset.test, &options)?;
        let before = read(cell).filter(|before| before.by_scale.as_ref().map(|by_scale| by_scale.radiance_scale) == scale);
        let (mut hdr_flip, mut measured_lpips) = before.map_or((None, None), |before| (before.hdr_flip, before.lpips));
        let mut by_scale = None;
        if self.flip == FlipChoice::Compute || self.lpips.is_some() || scale.is_some() {
            let lenses = state::vignetting(&cell.folder, &cell.config, dataset, iterations)?;
            let mut test = dataset.test.clone();
            LensVignetting::show_in(&lenses, &dataset.test, &mut test);
            let mut rendering = Rendering {
                engine,
                options,
                radiance_scale: scene.radiance_scale,
                protocol_scale: scale,
                mu: cell.config.train.mu,
                color_space: dataset.color_space,
                peak_luminance: FieldOptions::DEFAULT_PEAK_LUMINANCE,
                flip: self.flip,
                lpips: self.lpips.as_ref().map(|(lpips, _)| lpips),
                response,
                // Test views have none.
                log_gains: BTreeMap::new(),
                progress: None,
            };
            let found = rendering.evaluate(&test, None, GainFit::None)?;
            if scale.is_some() {
                by_scale = Some(ByScale::measure(&mut rendering, &cell.config, &test, found.clone())?);
            }
            if let Some(metrics) = found.and_then(|split| split.mean_field) {
                hdr_flip = metrics.hdr_flip.or(hdr_flip);
                if let (Some((lpips, weights)), Some(distance)) = (&self.lpips, metrics.lpips_alex.or(metrics.lpips_vgg)) {
                    measured_lpips = Some(MeasuredLpips { network: lpips.network().name().into(), distance, weights: weights.clone() });
                }
            }
        }
        let size_px = dataset.test.first().map_or([0; 2], |view| view.camera.size_px);
        let splats = engine.len();
        Ok(Measured {
            iterations,
            splats,
            frames_per_second,
            computed_by,
            views: dataset.test.len(),
            size_px,
            hdr_flip,
            lpips: measured_lpips,
            by_scale,
        })
    }
}

fn frames_per_second(engine: &mut dyn Engine, views: &[View], options: &RenderOptions) -> Result<Option<f64>> {
    if views.is_empty() {
        return Ok(None);
    }
    let mut passes: Vec<f64> = Vec::new();
    let start = Instant::now();
    for round in 0..=MOST_PASSES {
        let before = Instant::now();
        for view in views {
            engine.render(&view.camera, options).with_context(|| format!("cannot render {}", view.name))?;
        }
        // The first round brings everything into memory.
        if round > 0 {
            passes.push(before.elapsed().as_secs_f64());
        }
        if passes.len() >= LEAST_PASSES && start.elapsed() >= ENOUGH {
            break;
        }
    }
    passes.sort_unstable_by(f64::total_cmp);
    let median = passes.get(passes.len() / 2).copied().filter(|seconds| *seconds > 0.0);
    Ok(median.map(|seconds| views.len() as f64 / seconds))
}

fn digest(path: &Path) -> Result<String> {
    let bytes = luxel_io::read_file(path)?;
    let mut hasher = DefaultHasher::new();
    hasher.write(&bytes);
    Ok(format!("{:016x}", hasher.finish()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn additional_metrics_are_measured_again() {
        let measured = Measured {
            iterations: 10,
            splats: 5,
            frames_per_second: Some(12.0),
            computed_by: "2 threads".into(),
            views: 3,
            size_px: [4, 3],
            hdr_flip: None,
            lpips: None,
            by_scale: None,
        };
        let options = |flip| MeasureOptions { flip, lpips: None };
        assert!(options(FlipChoice::Skip).are_covered_by(&measured, None));
        assert!(!options(FlipChoice::Compute).are_covered_by(&measured, None));
        assert!(options(FlipChoice::Compute).are_covered_by(&Measured { hdr_flip: Some(0.1), ..measured.clone() }, None));
        assert!(options(FlipChoice::Compute).are_covered_by(&Measured { views: 0, ..measured }, None));
    }
}

//! `luxel info`: the content of a file or folder.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};
use glam::DVec3;
use luxel::memory::RunMemory;
use luxel_app::run::evaluation::Metrics;
use luxel_app::run::{ExplicitArgs, NonSplatKind, RunFolder, state, vignetting_text};
use luxel_app::{schema, text};
use luxel_core::tone::rec709_of;
use luxel_core::{ColorModel, ColorSpace, Dataset, Image, Scene, Splats, View, luminance_rec709, sigmoid};
use luxel_io::{DatasetDescription, DepthFolder, DepthReport, ImagePlan, Loading, ReadOptions, SampleDepth};
use luxel_train::TrainConfig;

use crate::args::{InfoArgs, LoadArgs};
use crate::commands::devices;
use crate::inputs::data;
use crate::output::console::Console;
use crate::output::tree::{Tree, set_point};

/// Percentiles that describe ranges.
pub(crate) const PERCENTILES: [u8; 7] = [0, 1, 25, 50, 75, 99, 100];

/// Describes `args.path`, or the devices; `explicit` names the options that were given.
pub(crate) fn run(args: &InfoArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let facts = match &args.path {
        Some(path) => describe(path, args, explicit, &console)?,
        None => devices::describe(),
    };
    let text = if args.json { facts.document(schema::INFO) } else { facts.text().trim_end().to_owned() };
    console.finish(facts.json(), &text)
}

/// Options of reading images, in a data set or not.
const IMAGE_OPTIONS: [&str; 3] = ["transfer", "color_space", "layer"];

fn describe(path: &Path, args: &InfoArgs, explicit: &ExplicitArgs, console: &Console) -> Result<Tree> {
    let metadata = std::fs::metadata(path).with_context(|| format!("{}: cannot open", path.display()))?;
    if metadata.is_dir() {
        if RunFolder::is_run(path) {
            refuse(explicit, &[], path, "a run")?;
            return describe_run(path, console);
        }
        return describe_dataset(path, args, explicit, console);
    }
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let mut facts = match extension.as_str() {
        "ply" | "usda" | "usdc" | "usdz" | "usd" | "glb" | "spz" | "sog" | "splat" | "ksplat" | "gltf" | "html" => {
            if extension.starts_with("usd") && has_only_cameras(path) {
                return describe_dataset(path, args, explicit, console);
            }
            refuse(explicit, &[], path, "a scene")?;
            describe_scene_file(path)?
        }
        "safetensors" => {
            refuse(explicit, &[], path, "a checkpoint")?;
            describe_checkpoint(path)?
        }
        "json" | "csv" | "xml" => return describe_dataset(path, args, explicit, console),
        _ => {
            refuse(explicit, &IMAGE_OPTIONS, path, "an image")?;
            describe_image(path, args)?
        }
    };
    facts.set("file_bytes", metadata.len());
    Ok(facts)
}

/// Returns whether a file of OpenUSD is no scene and has cameras.
fn has_only_cameras(path: &Path) -> bool {
    let cameras = || luxel_io::read_file(path).and_then(|bytes| luxel_io::decode_usd_cameras(path, &bytes));
    luxel_io::read_scene_file(path).is_err() && cameras().is_ok_and(|cameras| !cameras.is_empty())
}

/// Refuses options of reading data sets, except those `used`, where the path is `what`.
fn refuse(explicit: &ExplicitArgs, used: &[&str], path: &Path, what: &str) -> Result<()> {
    LoadArgs::refuse(explicit, used, &format!("and {} is {what}; leave it out", path.display()))
}

fn describe_scene_file(path: &Path) -> Result<Tree> {
    let file = luxel_io::read_scene_file(path).context("cannot read the scene")?;
    let mut facts = Tree::default();
    facts.set("kind", "scene");
    add_scene(&mut facts, &file.scene);
    if !file.warnings.is_empty() {
        facts.set("warnings", file.warnings);
    }
    Ok(facts)
}

fn describe_checkpoint(path: &Path) -> Result<Tree> {
    let mut facts = Tree::default();
    if let Some(scene) = luxel_app::non_splat::open_file(path).context("cannot read the scene")? {
        facts.set("kind", scene.kind());
        for (name, value) in scene.facts() {
            facts.set(name, value);
        }
        return Ok(facts);
    }
    let snapshot = luxel_io::read_checkpoint(path).context("cannot read the checkpoint")?;
    facts.set("kind", "checkpoint");
    add_scene(&mut facts, &snapshot.scene);
    // Some of the trainer's own state.
    if let Ok(state) = serde_json::from_str::<serde_json::Value>(&snapshot.state_json) {
        for name in ["step", "iteration", "fingerprint"] {
            if let Some(value) = state.get(name) {
                facts.set(name, value.clone());
            }
        }
    }
    Ok(facts)
}

fn describe_run(path: &Path, console: &Console) -> Result<Tree> {
    let (folder, config) = RunFolder::open(path)?;
    let mut facts = Tree::default();
    facts.set("kind", "run");
    facts.set("dataset", config.dataset_path(folder.root()).display().to_string());
    facts.set("method", config.method_name());
    facts.set("iterations", config.train.iterations);
    facts.set("seed", config.train.seed);
    facts.set("luxel_version", config.luxel_version.clone());
    if let Some(kind) = NonSplatKind::of(config.train.method) {
        match luxel_app::non_splat::newest_scene(&folder, console) {
            Ok((iteration, scene)) => {
                let mut newest = Tree::default();
                newest.set("iteration", iteration);
                for (name, value) in scene.facts() {
                    newest.set(name, value);
                }
                facts.group(kind.name(), newest);
            }
            Err(error) => {
                facts.set(kind.name(), format!("{error:#}"));
            }
        }
    } else {
        add_newest_scene(&mut facts, &folder, console);
    }
    add_metrics(&mut facts, &folder);
    Ok(facts)
}

fn add_newest_scene(facts: &mut Tree, folder: &RunFolder, console: &Console) {
    match state::newest_scene(folder, console) {
        Ok((iteration, scene)) => {
            let mut newest = Tree::default();
            newest.set("iteration", iteration);
            add_scene(&mut newest, &scene);
            facts.group("scene", newest);
        }
        Err(error) => {
            facts.set("scene", format!("{error:#}"));
        }
    }
}

fn add_metrics(facts: &mut Tree, folder: &RunFolder) {
    let metrics = luxel_io::read_file(&folder.metrics()).ok().and_then(|bytes| serde_json::from_slice::<Metrics>(&bytes).ok());
    if let Some(metrics) = metrics {
        let mut metrics_tree = Tree::default();
        metrics_tree.set("iterations", metrics.iterations).set("train_seconds", metrics.train_seconds);
        metrics_tree.set("peak_rss_bytes", metrics.peak_rss_bytes);
        if !metrics.vignetting.is_empty() {
            metrics_tree.set("vignetting", vignetting_text(&metrics.vignetting));
        }
        for (name, split) in &metrics.splits {
            let mut mean = Tree::default();
            for (name, value) in split.mean.named() {
                mean.set(name, value);
            }
            metrics_tree.group(name, mean);
        }
        facts.group("metrics", metrics_tree);
    }
}

fn describe_dataset(path: &Path, args: &InfoArgs, explicit: &ExplicitArgs, console: &Console) -> Result<Tree> {
    let options = luxel::Dataset::resolve_options(path, &args.load.options(), console)?;
    // By the images' headers: before one is read.
    let needs = Mutex::new(None);
    let check = |plan: &ImagePlan| {
        *needs.lock().unwrap_or_else(PoisonError::into_inner) = Some(RunMemory::new(plan, &TrainConfig::default(), None, false));
        Ok(())
    };
    let loading = Loading { check: Some(&check), ..Loading::default() };
    let dataset = luxel_io::load_dataset_within(path, &options, &loading).context("cannot read the data set")?;
    data::check_color_space(&dataset, &options, explicit)?;
    let words = luxel_io::describe_dataset(path, &options).context("cannot read the data set")?;
    let depth = luxel_io::find_depth(path, &dataset).context("cannot read the depth maps")?;
    let depth = depth.map(|folder| Ok::<_, luxel_io::IoError>((folder.report(&dataset)?, folder))).transpose()?;
    let mut facts = dataset_facts(&dataset, &words)?;
    if let Some((report, folder)) = depth {
        facts.group("depth", depth_facts(&report, &folder));
    }
    if let Some(needs) = *needs.lock().unwrap_or_else(PoisonError::into_inner) {
        let mut memory = Tree::default();
        memory.set("images_bytes", needs.images_bytes).set("buffers_bytes", needs.buffers_bytes);
        memory.set("splat_bytes", needs.splat_bytes).set("splats", needs.splats).set("most_splats", needs.most_splats);
        memory.set("total_bytes", needs.total_bytes()).set("system_bytes", luxel_io::system_memory());
        facts.group("training_memory", memory);
    }
    Ok(facts)
}

fn depth_facts(report: &DepthReport, folder: &DepthFolder) -> Tree {
    let mut facts = Tree::default();
    facts.set("folder", folder.folder.display().to_string());
    facts.set("maps", report.maps).set("views", report.views);
    let kind = report.kind.map_or("unknown".to_owned(), |kind| kind.to_string());
    facts.set("holds", format!("{kind} ({})", report.kind_from));
    if let Some(scale) = report.scale {
        facts.set("scale", scale);
    }
    facts.set_f32s("range", &report.range);
    facts.set("coverage_percent", (1e4 * report.coverage).round() / 1e2);
    facts.set("sizes_px", report.sizes_px.iter().map(|[w, h]| format!("{w}x{h}")).collect::<Vec<_>>());
    if !report.warnings.is_empty() {
        facts.set("warnings", report.warnings.clone());
    }
    facts
}

/// Largest number of pixels whose luminance is looked at; of more, a regular part is.
const MAX_LUMINANCES: usize = 1 << 26;

fn dataset_facts(dataset: &Dataset, words: &DatasetDescription) -> Result<Tree> {
    let mut facts = Tree::default();
    facts.set("kind", "data set").set("format", dataset.format.clone());
    facts.set("train_views", dataset.train.len()).set("test_views", dataset.test.len());
    let mut sizes: Vec<[u32; 2]> = dataset.train.iter().chain(&dataset.test).map(|view| view.camera.size_px).collect();
    sizes.sort_unstable();
    sizes.dedup();
    facts.set("image_sizes_px", sizes.iter().map(|[w, h]| format!("{w}x{h}")).collect::<Vec<_>>());
    facts.set("cameras", words.cameras.clone());
    if !words.notes.is_empty() {
        facts.set("notes", words.notes.clone());
    }
    facts.set("points", dataset.points.len());
    facts.set("observations", dataset.points.iter().map(|point| point.observations.len()).sum::<usize>());
    if let Some(line) = text::origin_line(&dataset.world_from_local) {
        facts.set("coordinates", line);
    }
    if let Some(metres) = dataset.metres_per_unit {
        facts.set("metres_per_unit", metres);
    }
    facts.set("color_space", dataset.color_space.name());
    facts.set("fingerprint", dataset.fingerprint.clone());
    let views = || dataset.train.iter().chain(&dataset.test);
    let pixels = views().map(View::pixel_count).sum::<u64>() as usize;
    // An odd stride does not fall in step with even image widths.
    let stride = if pixels > MAX_LUMINANCES { (pixels / MAX_LUMINANCES) | 1 } else { 1 };
    let mut luminance = Vec::new();
    for view in views() {
        luminance.extend(valid_luminance(&view.loaded()?, dataset.color_space).step_by(stride));
    }
    add_luminance(&mut facts, luminance);
    facts.set("decoded_bytes", pixels * size_of::<[f32; 3]>());
    let mut bad = Tree::default();
    bad.set("images", dataset.bad_pixels.len());
    bad.set("nan", dataset.bad_pixels.iter().map(|bad| bad.nan).sum::<usize>());
    bad.set("infinite", dataset.bad_pixels.iter().map(|bad| bad.infinite).sum::<usize>());
    bad.set("negative", dataset.bad_pixels.iter().map(|bad| bad.negative).sum::<usize>());
    facts.group("masked_pixels", bad);
    let warnings: Vec<String> = dataset.warnings.iter().cloned().chain(luxel::bad_pixel_lines(dataset)).collect();
    if !warnings.is_empty() {
        facts.set("warnings", warnings);
    }
    Ok(facts)
}

/// Relative luminance of a pixel of any primaries.
fn luminance(color_space: ColorSpace, rgb: [f32; 3]) -> f32 {
    luminance_rec709(rec709_of(color_space, rgb))
}

fn valid_luminance(view: &View, color_space: ColorSpace) -> impl Iterator<Item = f32> {
    let valid = view.image.pixels.iter().enumerate().filter(|(i, _)| view.is_valid(*i));
    valid.map(move |(_, &rgb)| luminance(color_space, rgb))
}

fn describe_image(path: &Path, args: &InfoArgs) -> Result<Tree> {
    let options = ReadOptions { transfer: args.load.transfer.map(Into::into), layer: args.load.layer.clone() };
    let decoded = luxel_io::read_image(path, &options).context("cannot read the image")?;
    let image: &Image = &decoded.image;
    let mut facts = Tree::default();
    let depth = match decoded.depth {
        SampleDepth::Float => "floating point".to_owned(),
        SampleDepth::Integer16 => "16-bit integer".to_owned(),
        SampleDepth::Integer8 => "8-bit integer, not HDR".to_owned(),
        SampleDepth::FewBits(bits) => format!("{bits}-bit integer, not HDR"),
    };
    let assumed = args.load.color_space.map(ColorSpace::from);
    if let Some(given) = assumed {
        data::check_stated(given, decoded.color_space, &path.display().to_string())?;
    }
    let color_space = decoded.color_space.or(assumed).map_or("not stated, taken for linear-rec709", ColorSpace::name);
    facts.set("kind", "image").set("samples", depth).set("width", image.width).set("height", image.height);
    facts.set("color_space", color_space).set("alpha", decoded.alpha.is_some());
    if !decoded.warnings.is_empty() {
        facts.set("warnings", decoded.warnings.clone());
    }
    let values = || image.pixels.iter();
    let mut bad = Tree::default();
    bad.set("nan", values().filter(|p| p.iter().any(|v| v.is_nan())).count());
    bad.set("infinite", values().filter(|p| p.iter().any(|v| v.is_infinite()) && !p.iter().any(|v| v.is_nan())).count());
    bad.set("negative", values().filter(|p| p.iter().any(|v| *v < 0.0) && p.iter().all(|v| v.is_finite())).count());
    facts.group("bad_pixels", bad);
    let good = values().filter(|p| p.iter().all(|v| v.is_finite() && *v >= 0.0));
    let color_space = decoded.color_space.or(assumed).unwrap_or_default();
    add_luminance(&mut facts, good.map(|&p| luminance(color_space, p)).collect());
    Ok(facts)
}

fn add_scene(facts: &mut Tree, scene: &Scene) {
    let splats = &scene.splats;
    facts.set("splats", splats.len()).set("color_model", splats.color_model.name());
    if splats.color_model.lights() > 1 {
        facts.set("lights", splats.color_model.lights());
    }
    if let ColorModel::Lcd { activation, .. } = splats.color_model {
        facts.set("activation", format!("{activation:?}").to_lowercase());
    }
    facts.set("color_space", scene.color_space.name());
    facts.set_f32("radiance_scale", scene.radiance_scale.get());
    facts.set("antialias", format!("{:?}", scene.raster.antialias).to_lowercase());
    facts.set("samples", scene.raster.samples);
    facts.set("parameters_bytes", parameter_bytes(splats));
    if !scene.edits.is_empty() {
        facts.set("edits", scene.edits.clone());
    }
    if splats.is_empty() {
        return;
    }
    if let Some(line) = text::origin_line(&scene.world_from_local) {
        facts.set("coordinates", line);
    }
    if let Some(metres) = scene.metres_per_unit {
        facts.set("metres_per_unit", metres);
    }
    let mut bounds = Tree::default();
    for (name, pick) in [("min", f32::min as fn(f32, f32) -> f32), ("max", f32::max)] {
        let corner = splats.position.iter().copied().reduce(|a, b| std::array::from_fn(|i| pick(a[i], b[i])));
        let local = DVec3::from_array(corner.unwrap_or_default().map(f64::from));
        set_point(&mut bounds, name, scene.world_from_local.point(local).to_array(), scene);
    }
    facts.group("bounds", bounds);
    let mut percentiles = Tree::default();
    percentiles.set("at_percent", PERCENTILES.to_vec());
    let unit = scene.world_from_local.scale() as f32;
    percentiles.set_f32s("scale", &quantiles(splats.log_scale.as_flattened().iter().map(|s| unit * s.exp()).collect()));
    percentiles.set_f32s("opacity", &quantiles(splats.opacity_logit.iter().map(|&o| sigmoid(o)).collect()));
    percentiles.set_f32s("luminance", &quantiles(scene_luminance(scene)));
    percentiles.set_f32s("luminance_sum", &quantiles((0..splats.len()).map(|i| scene.luminance(i)).collect()));
    facts.group("percentiles", percentiles);
}

/// Returns the luminance Y of each splat as seen along +z, in the units of the data set.
pub(crate) fn scene_luminance(scene: &Scene) -> Vec<f32> {
    let radiance = |i| scene.splats.radiance(i, [0.0, 0.0, 1.0]);
    (0..scene.splats.len()).map(|i| scene.radiance_scale.restored_value(luminance(scene.color_space, radiance(i)))).collect()
}

fn parameter_bytes(splats: &Splats) -> usize {
    let floats = splats.len() * (3 + 4 + 3 + 1) + splats.sh.len() + splats.raw_luminance.len() + splats.smoothing.len() + splats.gain.len();
    floats * size_of::<f32>()
}

/// Adds percentiles and dynamic range of luminance in the units of the data set.
fn add_luminance(facts: &mut Tree, luminance: Vec<f32>) {
    if luminance.is_empty() {
        return;
    }
    let values = quantiles(luminance);
    let mut group = Tree::default();
    group.set("at_percent", PERCENTILES.to_vec()).set_f32s("luminance", &values);
    // Above the 1st percentile: a single black pixel would make the range infinite.
    if let (Some(&low), Some(&high)) = (values.get(1), values.last())
        && low > 0.0
    {
        let ratio = f64::from(high) / f64::from(low);
        group.set("decades_max_to_p1", ratio.log10()).set("stops_max_to_p1", ratio.log2());
    }
    facts.group("percentiles", group);
}

/// Returns the values at [`PERCENTILES`] by nearest rank; none for no values.
pub(crate) fn quantiles(mut values: Vec<f32>) -> Vec<f32> {
    values.sort_unstable_by(f32::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return Vec::new() };
    PERCENTILES.iter().filter_map(|p| values.get((f64::from(*p) / 100.0 * last as f64).round() as usize).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_have_the_nearest_rank() {
        assert_eq!(quantiles((0..=100).rev().map(|v| v as f32).collect()), [0.0, 1.0, 25.0, 50.0, 75.0, 99.0, 100.0]);
        assert_eq!(quantiles(vec![2.0]), [2.0; 7]);
        assert!(quantiles(Vec::new()).is_empty());
    }
}

//! `luxel eval`: metrics of a run's newest scene.

use anyhow::{Context, Result, bail};
use luxel::run::evaluation::read_lpips;
use luxel::run::{Captures, ExplicitArgs, Metrics, Rendering, RunFolder, log, report, state};
use luxel::{files, memory};
use luxel_core::RenderOptions;
use luxel_train::GainFit;

use crate::args::EvalArgs;
use crate::inputs::scene_source::DataRequest;
use crate::inputs::{data, engine};
use crate::output::console::{self, Console, LogFormat};
use crate::output::metrics_table;

/// Evaluates and reports; `explicit` names the options that were given.
pub(crate) fn run(args: &EvalArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(LogFormat::Text, false);
    let (folder, config) = RunFolder::open(&args.run)?;
    // While a training works in the folder, metrics of an older step would replace its own.
    let _lock = folder.lock()?;
    let lpips = read_lpips(args.lpips_weights.as_deref())?;
    let luxel::SelectedEngine { mut engine, threads, computed_by, .. } = engine::engine(&args.device)?;
    let request = DataRequest { data: args.data.as_deref(), load: &args.load, explicit };
    let (path, load) = request.of_run(&folder, &config);
    let dataset = data::load(&path, &load, &console)?;
    let (iteration, scene) = state::newest_scene(&folder, &console)?;
    if dataset.color_space != scene.color_space {
        bail!(
            "{}: images are in {}, the scene is in {}: metrics need one colour space; convert the images",
            path.display(),
            dataset.color_space.name(),
            scene.color_space.name()
        );
    }
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = RenderOptions { raster: scene.raster, background: config.background(scene.radiance_scale), ..RenderOptions::default() };
    let mut rendering = Rendering {
        engine: engine.as_mut(),
        options,
        radiance_scale: scene.radiance_scale,
        mu: config.train.mu,
        color_space: dataset.color_space,
        peak_luminance: args.peak_luminance,
        flip: args.metrics.into(),
        lpips: lpips.as_ref(),
        response: state::response(&folder, &config, iteration)?,
        log_gains: Captures::read(&folder)?.log_gains_at(iteration),
    };
    // The folder of a step's evaluation is for the run's own data as the run read it: other
    // programs rely on it.
    let is_own = files::is_same(&path, &config.dataset_path(folder.root())) && load == config.load;
    let images = if is_own { folder.evaluation(iteration) } else { folder.claim_evaluation_of(iteration, &path, &load)? };
    let mut named = Vec::new();
    for (name, views, images) in [("test", &dataset.test, Some(images.as_path())), ("train", &dataset.train, None)] {
        named.extend(rendering.evaluate(views, images, GainFit::None)?.map(|split| (name, split)));
    }
    named.extend(rendering.evaluate_fitted(&config, &dataset.test)?);
    let tables: Vec<String> = named.iter().map(|(name, split)| metrics_table::table(name, split)).collect();
    let splits = named.into_iter().map(|(name, split)| (name.to_owned(), split)).collect();
    let log = log::read(&folder.log())?;
    let spent = log.iter().rev().find(|record| record.iteration <= iteration);
    let metrics = Metrics {
        method: config.method_name(),
        iterations: iteration,
        splats: scene.splats.len(),
        train_seconds: spent.map_or(0.0, |record| record.elapsed_s),
        peak_rss_bytes: spent.and_then(|record| record.peak_rss_bytes).max(memory::peak_resident_bytes()),
        radiance_scale: scene.radiance_scale,
        mu: config.train.mu,
        seed: config.train.seed,
        threads,
        computed_by,
        luxel_version: luxel::VERSION.into(),
        dataset: path.display().to_string(),
        splits,
    };
    // Not beside the images: metrics there mark an evaluation by training.
    files::write_json(&folder.metrics(), &metrics)?;
    report::write(&folder, &config, &dataset, report::Evaluated { metrics: &metrics, images: &images })?;
    // Last: a reader that leaves early costs no metrics.
    for table in &tables {
        console::print(table)?;
    }
    console.note(&format!("metrics {}\nreport  {}", folder.metrics().display(), folder.report().display()));
    Ok(())
}

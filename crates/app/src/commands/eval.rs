//! `luxel eval`: figures of a run's newest scene.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};
use luxel_core::RenderOptions;
use luxel_train::GainFit;

use crate::captures::Captures;
use crate::cli::EvalArgs;
use crate::console::{self, Console, LogFormat};
use crate::engine::Chosen;
use crate::evaluation::{self, Metrics, Rendering};
use crate::run_folder::RunFolder;
use crate::{data, engine, files, memory, reporting, run_log, run_state};

/// Evaluates and reports.
pub(crate) fn run(args: &EvalArgs) -> Result<()> {
    let console = Console::new(LogFormat::Text, false);
    let (folder, config) = RunFolder::open(&args.run)?;
    let lpips = evaluation::read_lpips(args.lpips_weights.as_deref())?;
    let Chosen { mut engine, threads, computed_by, .. } = engine::engine(&args.device)?;
    let own = config.dataset_path(folder.root());
    let path = args.data.clone().unwrap_or_else(|| own.clone());
    let dataset = data::load(&path, &config.load, &console)?;
    let (iteration, scene) = run_state::newest_scene(&folder, &console)?;
    if dataset.color_space != scene.color_space {
        bail!(
            "{}: images are in {}, the scene is in {}: figures need one colour space; convert the images",
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
        response: run_state::response(&folder, &config, iteration)?,
        log_gains: Captures::read(&folder)?.log_gains_at(iteration),
    };
    // What training wrote is of the run's own data, and other programs go by it.
    let images = if data::is_same_folder(&path, &own) { folder.evaluation(iteration) } else { folder.evaluation_of(iteration, &path) };
    let mut splits = BTreeMap::new();
    for (name, views, images) in [("test", &dataset.test, Some(images.as_path())), ("train", &dataset.train, None)] {
        if let Some(split) = rendering.evaluate(views, images, GainFit::None)? {
            console::print(&evaluation::table(name, &split))?;
            splits.insert(name.to_owned(), split);
        }
    }
    for (name, split) in rendering.evaluate_fitted(&config, &dataset.test)? {
        console::print(&evaluation::table(name, &split))?;
        splits.insert(name.to_owned(), split);
    }
    let log = run_log::read(&folder.log())?;
    let spent = log.iter().rev().find(|record| record.iteration <= iteration);
    let metrics = Metrics {
        method: evaluation::method_name(&config),
        iterations: iteration,
        splats: scene.splats.len(),
        train_seconds: spent.map_or(0.0, |record| record.elapsed_s),
        peak_rss_bytes: spent.and_then(|record| record.peak_rss_bytes).max(memory::peak_resident_bytes()),
        radiance_scale: scene.radiance_scale,
        mu: config.train.mu,
        seed: config.train.seed,
        threads,
        computed_by,
        luxel_version: env!("CARGO_PKG_VERSION").into(),
        dataset: path.display().to_string(),
        splits,
    };
    // Not beside the images: figures there say that training has evaluated this step.
    files::write_json(&folder.metrics(), &metrics)?;
    reporting::write(&folder, &config, &dataset, (&metrics, &images))?;
    console.note(&format!("figures {}\nreport  {}", folder.metrics().display(), folder.report().display()));
    Ok(())
}

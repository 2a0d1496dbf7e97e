//! `luxel eval`: metrics of a run's newest scene, or of a scene file.

use std::path::Path;

use anyhow::{Context, Result, bail};
use luxel::compare::read_lpips;
use luxel_app::run::{EvaluationData, ExplicitArgs, MetricsOptions, RunFolder, evaluate_run, evaluate_scene};
use luxel_app::{files, output, schema};
use luxel_core::RadianceScale;
use luxel_metrics::Lpips;
use serde_json::json;

use crate::args::EvalArgs;
use crate::inputs::scene_source::DataRequest;
use crate::inputs::{data, engine};
use crate::output::console::Console;
use crate::output::metrics_table;

/// Evaluates and reports; `explicit` names the options that were given.
pub(crate) fn run(args: &EvalArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let lpips = read_lpips(args.metrics.lpips_weights.as_deref())?;
    if args.scene.is_file() {
        return scene_file(args, explicit, lpips.as_ref(), &console);
    }
    if let Some(output) = &args.output {
        bail!("--output {} is for a scene file; the metrics of a run are written into its folder", output.display());
    }
    let (folder, config) = RunFolder::open(&args.scene)?;
    // While a training works in the folder, metrics of an older step would replace its own.
    let _lock = folder.lock()?;
    let engine = engine::engine_of(&args.device, Some(&config))?;
    let request = DataRequest { data: args.data.as_deref(), load: &args.load, explicit };
    let (path, load) = request.of_run(&folder, &config)?;
    let load = luxel::Dataset::resolve_options(&path, &load, &console)?;
    let dataset = data::load(&path, &load, &console)?;
    data::check_color_space(&dataset, &load, explicit)?;
    let data = EvaluationData { path: &path, load: &load, dataset: &dataset };
    let splits = evaluate_run(&folder, &config, data, metrics(args, lpips.as_ref()), engine, &console)?;
    // Last: a reader that leaves early costs no metrics.
    let [metrics, report] = [folder.metrics(), folder.report()].map(|path| path.display().to_string());
    if args.json {
        let text = files::read_text(&folder.metrics(), u64::MAX - 1)?;
        return console.finish(json!({ "metrics": metrics, "report": report }), text.trim_end());
    }
    for (name, split) in &splits {
        let event = json!({ "event": "evaluation", "split": name, "mean": split.mean, "mean_field": split.mean_field });
        console.result(&event, &metrics_table::table(name, split))?;
    }
    console.finish_with_note(json!({ "metrics": metrics, "report": report }), &format!("metrics {metrics}\nreport  {report}"));
    Ok(())
}

fn metrics<'a>(args: &EvalArgs, lpips: Option<&'a Lpips>) -> MetricsOptions<'a> {
    let scale = args.scale.and_then(RadianceScale::new);
    MetricsOptions { peak_luminance: args.peak_luminance, flip: args.metrics.metrics.into(), lpips, scale }
}

/// Evaluates a scene that is a file.
fn scene_file(args: &EvalArgs, explicit: &ExplicitArgs, lpips: Option<&Lpips>, console: &Console) -> Result<()> {
    let Some(path) = &args.data else {
        bail!("{}: a scene file has no views to measure against; give --data DATASET", args.scene.display());
    };
    if let Some(folder) = &args.output {
        output::check_new_folder(folder)?;
    }
    let scene = luxel::Scene::open_reporting(&args.scene, console)?.into_core();
    let load = luxel::Dataset::resolve_options(path, &args.load.options(), console)?;
    let dataset = data::load(path, &load, console)?;
    data::check_color_space(&dataset, &load, explicit)?;
    let data = EvaluationData { path, load: &load, dataset: &dataset };
    let engine = engine::engine(&args.device)?;
    let _confinement = args.output.as_deref().map(start_folder).transpose()?;
    let found = evaluate_scene(&args.scene, &scene, data, metrics(args, lpips), engine, args.output.as_deref())?;
    if let Some(folder) = &args.output {
        let path = folder.join("metrics.json");
        files::write_json(&path, schema::SCENE_METRICS, &found)?;
        console.note(&format!("metrics {}", path.display()));
    }
    if args.json {
        let text = serde_json::to_string_pretty(&schema::SCENE_METRICS.versioned(&found)).context("cannot encode the metrics")?;
        return console.finish(json!({ "evaluation": found }), &text);
    }
    for (name, split) in &found.splits {
        let event = json!({ "event": "evaluation", "split": name, "mean": split.mean, "mean_field": split.mean_field });
        console.result(&event, &metrics_table::table(name, split))?;
    }
    let scale = luxel_app::text::number(found.radiance_scale.get().into());
    let whose = if args.scale.is_some() { "that of --scale" } else { "the scene's radiance scale" };
    console.note(&format!("1 in protocol scene is {whose}, {scale}; gtmax and selfmax do not depend on it"));
    console.finish_silently(json!({ "output": args.output.as_ref().map(|folder| folder.display().to_string()) }));
    Ok(())
}

/// Makes the folder of results, which nothing is written out of.
fn start_folder(folder: &Path) -> Result<luxel_io::Confinement> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))?;
    Ok(luxel_io::confine(folder)?)
}

//! `luxel eval`: metrics of a run's newest scene.

use anyhow::Result;
use luxel::run::evaluation::read_lpips;
use luxel::run::{EvaluationData, ExplicitArgs, MetricsOptions, RunFolder, evaluate_run};

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
    let lpips = read_lpips(args.metrics.lpips_weights.as_deref())?;
    let engine = engine::engine(&args.device)?;
    let request = DataRequest { data: args.data.as_deref(), load: &args.load, explicit };
    let (path, load) = request.of_run(&folder, &config)?;
    let dataset = data::load(&path, &load, &console)?;
    data::check_color_space(&dataset, &load, explicit)?;
    let data = EvaluationData { path: &path, load: &load, dataset: &dataset };
    let metrics = MetricsOptions { peak_luminance: args.peak_luminance, flip: args.metrics.metrics.into(), lpips: lpips.as_ref() };
    let splits = evaluate_run(&folder, &config, data, metrics, engine, &console)?;
    // Last: a reader that leaves early costs no metrics.
    for (name, split) in &splits {
        console::print(&metrics_table::table(name, split))?;
    }
    console.note(&format!("metrics {}\nreport  {}", folder.metrics().display(), folder.report().display()));
    Ok(())
}

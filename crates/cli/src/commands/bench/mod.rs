//! `luxel bench`: the time of a render and of a training step on a scene, pass by pass.

mod count;
mod report;
mod workload;

use anyhow::Result;
use luxel::SelectedEngine;
use luxel_app::bench::{Protocol, measure};
use luxel_app::process;
use luxel_train::NamedChoice;
use report::{PassMedian, Report, Spread};
use serde_json::json;
use workload::Workload;

use crate::args::BenchArgs;
use crate::inputs::engine;
use crate::output::console::Console;

/// Measures and prints.
pub(crate) fn run(args: &BenchArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    if let Some(path) = &args.save {
        workload::save(args, path)?;
        console.finish_with_note(json!({ "scene": path.display().to_string() }), &format!("scene {}", path.display()));
        return Ok(());
    }
    if args.count {
        return count::run(args, &console);
    }
    let SelectedEngine { mut engine, threads, gpu, instruction_set, .. } = engine::engine_with(&args.device, args.instruction_set.into())?;
    let workload = Workload::prepare(args, engine.as_mut())?;
    let protocol = Protocol { render: workload.render, mu: args.mu, warmup: args.warmup, steps: args.steps };
    let measured = measure(engine.as_mut(), &workload.view, &protocol)?;
    let cutoffs = args.cutoffs.name().to_owned();
    let report = Report {
        workload: workload.name,
        method: workload.method,
        splats: workload.splats,
        visible: measured.first.visible,
        evaluations: measured.evaluations,
        width: workload.view.image.width,
        height: workload.view.image.height,
        threads,
        gpu,
        instruction_set,
        cutoffs,
        order: args.order,
        mu: args.mu,
        target: workload.target,
        warmup: args.warmup,
        steps: args.steps,
        forward_ms: Spread::from_times(&measured.forward_ms),
        step_ms: Spread::from_times(&measured.step_ms),
        step_in_a_row_ms: measured.step_in_a_row_ms,
        passes_ms: measured.passes_ms.iter().map(|(pass, ms)| PassMedian { pass: *pass, ms: Spread::from_times(ms).median }).collect(),
        peak_rss_bytes: process::peak_resident_bytes(),
        first_loss: measured.first.loss,
        luxel_version: luxel::VERSION,
    };
    let text = if args.json { report.json()? } else { report.table() };
    console.finish(json!({ "measurement": report }), &text)
}

//! `luxel bench`: how long a render and a training step take on a scene, pass by pass.

mod measure;
mod report;
mod workload;

use anyhow::{Context, Result};
use clap::ValueEnum;

use crate::cli::BenchArgs;
use crate::{console, engine, memory};
use measure::{Protocol, measure};
use report::{Report, Spread};
use workload::Workload;

/// Measures and prints.
pub(crate) fn run(args: &BenchArgs) -> Result<()> {
    let (mut engine, threads) = engine::cpu_engine(&args.device)?;
    engine.set_instruction_set(args.instruction_set.into()).context("--instruction-set")?;
    let workload = Workload::prepare(args, &mut engine)?;
    let protocol = Protocol { render: workload.render, mu: args.mu, warmup: args.warmup, steps: args.steps };
    let measured = measure(&mut engine, &workload.view, &protocol)?;
    let cutoffs = args.cutoffs.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
    let report = Report {
        workload: workload.name,
        method: workload.method,
        splats: workload.splats,
        visible: measured.first.visible,
        width: workload.view.image.width,
        height: workload.view.image.height,
        threads,
        instruction_set: engine.instruction_set(),
        cutoffs,
        order: args.order,
        mu: args.mu,
        target: workload.target,
        warmup: args.warmup,
        steps: args.steps,
        forward_ms: Spread::of(&measured.forward_ms),
        step_ms: Spread::of(&measured.step_ms),
        passes_ms: measured.passes_ms.iter().map(|(pass, ms)| (*pass, Spread::of(ms).median)).collect(),
        peak_rss_bytes: memory::peak_resident_bytes(),
        first_loss: measured.first.loss,
        luxel_version: env!("CARGO_PKG_VERSION"),
    };
    console::print(&if args.json { report.json()? } else { report.table() })
}

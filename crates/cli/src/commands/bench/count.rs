//! `luxel bench --count`: the work of a training step on the GPU engine.

use anyhow::Result;

use crate::args::BenchArgs;
use crate::output::console::Console;

/// Counts and prints.
#[cfg(feature = "gpu")]
pub(super) fn run(args: &BenchArgs, console: &Console) -> Result<()> {
    use anyhow::{Context, bail};
    use luxel::Device;
    use luxel_app::bench::Protocol;
    use luxel_app::schema;
    use luxel_gpu::{DeviceChoice, Gpu, GpuEngine};
    use luxel_train::NamedChoice;
    use serde_json::{Map, Value, json};

    use super::workload::Workload;

    let choice = match args.device.options().device {
        Device::Cpu => bail!("--count: counts the work of the GPU engine; use --device gpu, or --device gpu:NAME for a software renderer"),
        Device::Named(name) => DeviceChoice::Named(name),
        Device::Auto | Device::Gpu => DeviceChoice::Best,
    };
    let gpu = Gpu::open(&choice).context("--count")?;
    let mut engine = GpuEngine::new(&gpu)?;
    let workload = Workload::prepare(args, &mut engine)?;
    let protocol = Protocol { render: workload.render, mu: args.mu, warmup: 0, steps: 1 };
    let work = engine.count_work(&protocol.view(&workload.view), &protocol.step(1)).context("cannot count the work of a training step")?;
    let counts: Map<String, Value> = work.list().into_iter().map(|(name, count)| (name.to_owned(), count.into())).collect();
    let document = json!({
        "workload": workload.name,
        "method": workload.method,
        "splats": workload.splats,
        "width": workload.view.image.width,
        "height": workload.view.image.height,
        "samples": workload.render.raster.samples,
        "cutoffs": args.cutoffs.name(),
        "gpu": gpu.facts().name,
        "work": counts,
    });
    let text = if args.json {
        serde_json::to_string(&schema::BENCH_COUNT.versioned(&document))?
    } else {
        let rows = work.list().into_iter().map(|(name, count)| format!("{:<16}{count:>14}", name.replace('_', " ")));
        rows.collect::<Vec<_>>().join("\n")
    };
    console.finish(json!({ "count": document }), &text)
}

#[cfg(not(feature = "gpu"))]
pub(super) fn run(_: &BenchArgs, _: &Console) -> Result<()> {
    anyhow::bail!("--count: this build of luxel has no GPU engine (cargo feature gpu)")
}

//! The engine that `--device` and `--threads` ask for.

use anyhow::{Context, Result, bail};
use luxel_core::Engine;
use luxel_cpu::CpuEngine;

use crate::cli::DeviceArgs;
use crate::values::DeviceArg;

/// An engine without a scene, and the number of threads it uses.
pub(crate) fn engine(args: &DeviceArgs) -> Result<(Box<dyn Engine>, usize)> {
    let (engine, threads) = cpu_engine(args)?;
    Ok((Box::new(engine), threads))
}

/// [`engine`] for those who want to choose among the processor's instruction sets.
pub(crate) fn cpu_engine(args: &DeviceArgs) -> Result<(CpuEngine, usize)> {
    match args.device {
        DeviceArg::Gpu => bail!("--device gpu: this build of luxel has no GPU engine; use --device cpu"),
        DeviceArg::Auto | DeviceArg::Cpu => {}
    }
    let threads = threads(args);
    let engine = CpuEngine::new(threads).context("cannot start the CPU engine")?;
    Ok((engine, threads))
}

/// Threads for this command: as many as asked for, else all cores. Also bounds what reading files uses.
fn threads(args: &DeviceArgs) -> usize {
    let threads = match args.threads {
        Some(threads) => threads as usize,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    // Only the first call of a process can set it, and only one is made.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    threads
}

//! The engine that `--device` and `--threads` ask for.

use anyhow::{Context, Result};
use luxel_core::Engine;
use luxel_cpu::{CpuEngine, InstructionSet};

use crate::cli::DeviceArgs;
use crate::config::RunConfig;
use crate::values::{DeviceArg, SupervisionArg};

/// An engine without a scene, and where it runs.
pub(crate) struct Chosen {
    /// The engine.
    pub(crate) engine: Box<dyn Engine>,
    /// Threads for everything that the processor does.
    pub(crate) threads: usize,
    /// For people: `2 threads`, `NVIDIA H200 (vulkan)`, and why it is not a GPU if there seems to be one.
    pub(crate) machine: String,
    /// The same for comparisons: `2 threads of AMD EPYC 9B14`, `NVIDIA H200 (vulkan)`. Times of equal ones compare.
    pub(crate) computed_by: String,
    /// Name of the GPU.
    pub(crate) gpu: Option<String>,
    /// The processor's instruction set, if it is the engine.
    pub(crate) instruction_set: Option<String>,
}

/// The engine for a command.
pub(crate) fn engine(args: &DeviceArgs) -> Result<Chosen> {
    engine_with(args, InstructionSet::Best)
}

/// The engine for training: of the GPU's and the CPU's the latter alone learns a camera's response, so that it is the best there is for recordings.
pub(crate) fn training_engine(config: &RunConfig) -> Result<Chosen> {
    let learns_response = config.load.supervision == SupervisionArg::Ldr;
    if learns_response && config.device.device == DeviceArg::Auto {
        return cpu(threads(&config.device), InstructionSet::Best, None);
    }
    engine(&config.device)
}

/// [`engine`] for those who want to choose among the processor's instruction sets.
pub(crate) fn engine_with(args: &DeviceArgs, set: InstructionSet) -> Result<Chosen> {
    let threads = threads(args);
    if set != InstructionSet::Best {
        anyhow::ensure!(!matches!(args.device, DeviceArg::Gpu(_)), "--instruction-set is the processor's; use --device cpu");
        return cpu(threads, set, None);
    }
    match &args.device {
        DeviceArg::Cpu => cpu(threads, set, None),
        DeviceArg::Auto => match gpu::best(threads) {
            Ok(chosen) => Ok(chosen),
            Err(reason) => cpu(threads, set, reason),
        },
        DeviceArg::Gpu(name) => gpu::open(threads, name.as_deref()).with_context(|| format!("--device {}", args.device)),
    }
}

/// The CPU engine; `reason` says why it is not the GPU's.
fn cpu(threads: usize, set: InstructionSet, reason: Option<String>) -> Result<Chosen> {
    let mut engine = CpuEngine::new(threads).context("cannot start the CPU engine")?;
    engine.set_instruction_set(set).context("--instruction-set")?;
    let instruction_set = Some(engine.instruction_set());
    let mut machine = crate::text::plural(threads, "thread");
    let computed_by = format!("{machine} of {}", crate::machine::processor().unwrap_or_else(|| "the CPU".into()));
    if let Some(reason) = reason {
        machine += &format!(" ({reason})");
    }
    Ok(Chosen { engine: Box::new(engine), threads, machine, computed_by, gpu: None, instruction_set })
}

#[cfg(feature = "gpu")]
mod gpu {
    use anyhow::Result;
    use luxel_gpu::{AdapterKind, DeviceChoice, Gpu, GpuEngine, adapters};

    use super::Chosen;

    pub(super) fn open(threads: usize, name: Option<&str>) -> Result<Chosen> {
        let choice = name.map_or(DeviceChoice::Best, |name| DeviceChoice::Named(name.to_owned()));
        let gpu = Gpu::open(&choice)?;
        let engine = GpuEngine::new(&gpu)?;
        let facts = gpu.facts();
        let machine = format!("{} ({})", facts.name, facts.backend);
        let computed_by = machine.clone();
        Ok(Chosen { engine: Box::new(engine), threads, machine, computed_by, gpu: Some(facts.name.clone()), instruction_set: None })
    }

    /// The best real GPU. Without one there is nothing to say; one that cannot be used is told of.
    pub(super) fn best(threads: usize) -> Result<Chosen, Option<String>> {
        open(threads, None).map_err(|error| {
            let is_there = adapters().iter().any(|facts| facts.kind != AdapterKind::Software);
            is_there.then(|| format!("{error:#}"))
        })
    }
}

#[cfg(not(feature = "gpu"))]
mod gpu {
    use anyhow::{Result, bail};

    use super::Chosen;

    pub(super) fn open(_: usize, _: Option<&str>) -> Result<Chosen> {
        bail!("this build of luxel has no GPU engine (cargo feature gpu); use --device cpu")
    }

    pub(super) fn best(_: usize) -> Result<Chosen, Option<String>> {
        Err(None)
    }
}

/// Threads for this command: as many as asked for, else all cores. Also bounds what reading files uses.
fn threads(args: &DeviceArgs) -> usize {
    let threads = match args.threads {
        Some(threads) => threads as usize,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    // Only the first call of a process can set it; those after it ask for the same number.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    threads
}

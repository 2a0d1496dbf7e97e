//! Opens what `--device` and `--threads` ask for; errors name the options.

use anyhow::{Context, Result, ensure};
use luxel::{InstructionSet, SelectedEngine};

use crate::cli::DeviceArgs;
use crate::config::RunConfig;
use crate::values::SupervisionArg;

/// Opens the engine for a command.
pub(crate) fn engine(args: &DeviceArgs) -> Result<SelectedEngine> {
    worded(args, SelectedEngine::open(&args.options()))
}

/// Opens the engine for training.
pub(crate) fn training_engine(config: &RunConfig) -> Result<SelectedEngine> {
    let learns_response = config.load.supervision == SupervisionArg::Ldr;
    worded(&config.device, SelectedEngine::for_training(&config.device.options(), learns_response))
}

/// Opens the engine with a choice among the processor's instruction sets.
pub(crate) fn engine_with(args: &DeviceArgs, set: InstructionSet) -> Result<SelectedEngine> {
    let is_best = set == InstructionSet::Best;
    ensure!(is_best || !args.device.is_gpu(), "--instruction-set is for the processor; use --device cpu");
    let opened = SelectedEngine::open_with(&args.options(), set);
    if is_best { worded(args, opened) } else { opened.context("--instruction-set") }
}

fn worded(args: &DeviceArgs, opened: luxel::Result<SelectedEngine>) -> Result<SelectedEngine> {
    if args.device.is_gpu() { opened.with_context(|| format!("--device {}", args.device)) } else { Ok(opened?) }
}

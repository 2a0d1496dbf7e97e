//! Opens what `--device` and `--threads` ask for; errors name the options.

use anyhow::{Context, Result, ensure};
use luxel::{Device, DeviceOptions, InstructionSet, SelectedEngine, Supervision};
use luxel_app::run::RunConfig;
use luxel_train::NamedChoice;

use crate::args::DeviceArgs;

/// Opens the engine for a command.
pub(crate) fn engine(args: &DeviceArgs) -> Result<SelectedEngine> {
    let options = args.options();
    worded(&options, SelectedEngine::open(&options))
}

/// Opens the engine for a run's newest state, or a scene without a run: a radiance field, anchors
/// and lifted colours are rendered on the processor.
pub(crate) fn engine_of(args: &DeviceArgs, run: Option<&RunConfig>) -> Result<SelectedEngine> {
    let options = args.options();
    match run.map(|config| config.train.method) {
        Some(method) if !method.stores_splats() => worded(&options, luxel_app::non_splat::open_processor(&options, method)),
        Some(method) if method.lifts_colors() => {
            let reason = format!("method {} lifts colours to radiance on the CPU", method.name());
            worded(&options, SelectedEngine::on_processor(&options, &reason))
        }
        _ => engine(args),
    }
}

/// Opens the engine for training.
pub(crate) fn training_engine(config: &RunConfig) -> Result<SelectedEngine> {
    if !config.train.method.stores_splats() {
        return worded(&config.device, luxel_app::non_splat::open_processor(&config.device, config.train.method));
    }
    let has_own_steps = config.train.method.has_own_steps();
    let is_packed = config.train.packs_moments();
    let needs_cpu = config.load.supervision == Supervision::Ldr || has_own_steps || is_packed;
    let mut selected = worded(&config.device, SelectedEngine::for_training(&config.device, needs_cpu))?;
    if has_own_steps && config.device.device == Device::Auto {
        selected.machine += &format!(", the CPU: method {} has no steps on a GPU", config.method_name());
    } else if is_packed && config.device.device == Device::Auto {
        selected.machine += ", the CPU: moments of sixteen bits are not on a GPU";
    }
    Ok(selected)
}

/// Opens the engine with a choice among the processor's instruction sets.
pub(crate) fn engine_with(args: &DeviceArgs, set: InstructionSet) -> Result<SelectedEngine> {
    let is_best = set == InstructionSet::Best;
    ensure!(is_best || !args.device.is_gpu(), "--instruction-set is for the processor; use --device cpu");
    let options = args.options();
    let opened = SelectedEngine::open_with(&options, set);
    if is_best { worded(&options, opened) } else { opened.context("--instruction-set") }
}

fn worded(options: &DeviceOptions, opened: luxel::Result<SelectedEngine>) -> Result<SelectedEngine> {
    if options.device.is_gpu() { opened.with_context(|| format!("--device {}", options.device)) } else { Ok(opened?) }
}

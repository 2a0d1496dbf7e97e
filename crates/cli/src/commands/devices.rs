//! `luxel info --devices`: the devices, and which of them `--device auto` takes.

use luxel_cpu::CpuEngine;

use crate::output::tree::Tree;

/// Describes the processor and the GPUs, each with whether auto takes it, or the reason why not.
pub(crate) fn describe() -> Tree {
    let mut facts = Tree::default();
    let taken = gpus(&mut facts);
    let mut cpu = Tree::default();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    cpu.set("threads", threads);
    if let Ok(engine) = CpuEngine::new(1) {
        cpu.set("instruction_set", engine.instruction_set());
    }
    cpu.set("auto", if taken { "taken where the GPU is not" } else { "taken: there is no GPU that auto may take" });
    facts.group("cpu", cpu);
    facts
}

/// Adds the GPUs; returns whether one is taken.
#[cfg(feature = "gpu")]
fn gpus(facts: &mut Tree) -> bool {
    let mut taken = false;
    for (n, adapter) in luxel_gpu::adapters().into_iter().enumerate() {
        let reason = adapter.reason_against(&luxel_gpu::DeviceChoice::Best);
        let auto = match &reason {
            Some(reason) => format!("not taken: {reason}"),
            None if taken => "not taken: another comes first".into(),
            None if adapter.needs_trial() => "taken where a short measurement finds it clearly faster than the CPU".into(),
            None => "taken".into(),
        };
        taken |= reason.is_none();
        let [from, to] = adapter.subgroup_size;
        let mut gpu = Tree::default();
        gpu.set("name", adapter.name).set("kind", adapter.kind.to_string()).set("backend", adapter.backend).set("driver", adapter.driver);
        gpu.set("binding_bytes", adapter.binding_bytes).set("subgroup_size", format!("{from} to {to}"));
        gpu.set("timestamps", adapter.timestamps).set("auto", auto);
        facts.group(&format!("gpu_{n}"), gpu);
    }
    taken
}

#[cfg(not(feature = "gpu"))]
fn gpus(facts: &mut Tree) -> bool {
    facts.set("gpus", "none looked for: this build has no GPU engine (cargo feature gpu)");
    false
}

//! Which GPUs there are, what each can do, and which one is taken.
//!
//! `auto` and `gpu` take a real GPU, discrete before integrated before virtual; a software renderer is only ever taken by a part of its name.

use std::fmt;

use crate::device::ready;
use crate::layout::MAX_GROUPS;

/// Backends this build speaks.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// Bytes of workgroup memory, storage buffers and threads of a workgroup that the shaders take, which is what WebGPU asks of every adapter; a test
/// holds them to it.
pub(crate) const WORKGROUP_BYTES: u32 = 16_384;
pub(crate) const STORAGE_BUFFERS: u32 = 8;
pub(crate) const WORKGROUP_THREADS: u32 = 256;

/// Bytes of a binding at most, whatever the adapter says: shaders count them in 32 bits with a sign on Vulkan and Direct3D 12, and the checks of
/// bounds on Metal, which may say more, in 32 bits.
pub(crate) const MOST_BINDING_BYTES: u64 = (1 << 31) - BUFFER_STEP;

/// Sizes of buffers are multiples of this, bytes.
pub(crate) const BUFFER_STEP: u64 = 16;

/// A binding that an adapter gives, as far as it can be used: whole steps, so that a buffer which fills it is not rounded up beyond it.
pub(crate) fn usable_binding(bytes: u64) -> u64 {
    bytes.min(MOST_BINDING_BYTES) / BUFFER_STEP * BUFFER_STEP
}

/// Which GPU is wanted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The best real one.
    Best,
    /// The best whose name contains this, upper or lower case; software renderers too.
    Named(String),
}

/// What an adapter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A card of its own.
    Discrete,
    /// Part of the processor.
    Integrated,
    /// A share of a GPU in a virtual machine.
    Virtual,
    /// The driver does not say.
    Unknown,
    /// A renderer on the processor.
    Software,
}

impl fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Unknown => "unknown kind",
            Self::Software => "software renderer",
        })
    }
}

/// A GPU as its driver describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterFacts {
    /// As the driver has it.
    pub name: String,
    /// `vulkan`, `metal`, `dx12`.
    pub backend: String,
    /// Driver and version.
    pub driver: String,
    /// What it is.
    pub kind: AdapterKind,
    /// Bytes of a buffer that a shader can see at once.
    pub binding_bytes: u64,
    /// Threads of a subgroup, from and to.
    pub subgroup_size: [u32; 2],
    /// Whether passes can be timed.
    pub timestamps: bool,
    /// What the engine needs and the adapter lacks, with what there is.
    pub lacks: Vec<String>,
}

impl AdapterFacts {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let mut lacks = Vec::new();
        let mut need = |what: &str, least: u64, found: u64| {
            if found < least {
                lacks.push(format!("{what}: {found}, needed {least}"));
            }
        };
        need("bytes of workgroup memory", WORKGROUP_BYTES.into(), limits.max_compute_workgroup_storage_size.into());
        need("storage buffers per shader", STORAGE_BUFFERS.into(), limits.max_storage_buffers_per_shader_stage.into());
        need("threads per workgroup", WORKGROUP_THREADS.into(), limits.max_compute_invocations_per_workgroup.into());
        need("workgroups per dimension", MAX_GROUPS.into(), limits.max_compute_workgroups_per_dimension.into());
        let flags = adapter.get_downlevel_capabilities().flags;
        for (flag, what) in
            [(wgpu::DownlevelFlags::COMPUTE_SHADERS, "compute shaders"), (wgpu::DownlevelFlags::INDIRECT_EXECUTION, "indirect dispatches")]
        {
            if !flags.contains(flag) {
                lacks.push(what.into());
            }
        }
        Self {
            name: info.name.clone(),
            backend: info.backend.to_string(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            kind: match info.device_type {
                wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
                wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
                wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
                wgpu::DeviceType::Cpu => AdapterKind::Software,
                wgpu::DeviceType::Other => AdapterKind::Unknown,
            },
            binding_bytes: usable_binding(limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)),
            subgroup_size: [info.subgroup_min_size, info.subgroup_max_size],
            timestamps: adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY),
            lacks,
        }
    }

    /// Why the adapter is not taken for `choice`, for people; `None` if it may be.
    pub fn reason_against(&self, choice: &DeviceChoice) -> Option<String> {
        if !self.lacks.is_empty() {
            return Some(format!("lacks {}", self.lacks.join(", ")));
        }
        match choice {
            DeviceChoice::Best => (self.kind == AdapterKind::Software).then(|| "a software renderer is only taken by its name".into()),
            DeviceChoice::Named(part) => {
                (!self.name.to_lowercase().contains(&part.to_lowercase())).then(|| format!("its name does not contain \"{part}\""))
            }
        }
    }
}

/// All adapters that a driver offers, the best first.
pub fn adapters() -> Vec<AdapterFacts> {
    found().into_iter().map(|(facts, _)| facts).collect()
}

/// [`adapters`], open to be taken.
pub(crate) fn found() -> Vec<(AdapterFacts, wgpu::Adapter)> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = BACKENDS;
    // Without validation layers and the check of indirect dispatches, whose numbers come from our own shaders and are folded to the limits. No
    // shader asks for the number of workgroups, which Direct3D 12 does not tell without that check.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor);
    let adapters = ready(instance.enumerate_adapters(BACKENDS));
    let mut adapters: Vec<_> = adapters.into_iter().map(|adapter| (AdapterFacts::of(&adapter), adapter)).collect();
    adapters.sort_by_key(|(facts, _)| facts.kind);
    adapters
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(name: &str, kind: AdapterKind) -> AdapterFacts {
        AdapterFacts {
            name: name.into(),
            backend: "vulkan".into(),
            driver: String::new(),
            kind,
            binding_bytes: 1 << 27,
            subgroup_size: [32; 2],
            timestamps: true,
            lacks: Vec::new(),
        }
    }

    #[test]
    fn software_renderers_are_taken_by_name_only() {
        let software = facts("llvmpipe (LLVM 15.0.6, 256 bits)", AdapterKind::Software);
        assert!(software.reason_against(&DeviceChoice::Best).is_some());
        assert_eq!(software.reason_against(&DeviceChoice::Named("LLVMpipe".into())), None);
        let card = facts("NVIDIA H200", AdapterKind::Discrete);
        assert_eq!(card.reason_against(&DeviceChoice::Best), None);
        assert_eq!(card.reason_against(&DeviceChoice::Named("h200".into())), None);
        let reason = card.reason_against(&DeviceChoice::Named("radeon".into())).unwrap();
        assert_eq!(reason, "its name does not contain \"radeon\"");
    }

    #[test]
    fn an_adapter_that_lacks_something_says_what() {
        let old = AdapterFacts { lacks: vec!["storage buffers per shader: 4, needed 8".into()], ..facts("old", AdapterKind::Integrated) };
        let reason = old.reason_against(&DeviceChoice::Best).unwrap();
        assert_eq!(reason, "lacks storage buffers per shader: 4, needed 8");
    }

    #[test]
    fn a_binding_is_whole_steps_within_32_bits() {
        // As Vulkan, Direct3D 12 and Metal have it, and the least that WebGPU asks for.
        for (found, usable) in
            [((1 << 31) - 4, (1 << 31) - 16), ((1 << 31) - 1, (1 << 31) - 16), (48 << 30, (1 << 31) - 16), (1 << 27, 1 << 27)]
        {
            assert_eq!(usable_binding(found), usable, "{found}");
        }
    }

    #[test]
    fn real_cards_come_before_software() {
        let mut kinds = [AdapterKind::Software, AdapterKind::Integrated, AdapterKind::Unknown, AdapterKind::Discrete, AdapterKind::Virtual];
        kinds.sort();
        assert_eq!((kinds[0], kinds[4]), (AdapterKind::Discrete, AdapterKind::Software));
    }
}

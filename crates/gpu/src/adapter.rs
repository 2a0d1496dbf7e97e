//! The available GPUs, their capabilities, and the choice of one.
//!
//! In: [`DeviceChoice`]. Out: adapters, best first: discrete before integrated before virtual GPUs.
//! Degenerate: a software renderer is used only if a part of its name is given; an adapter without
//! the required features is never used.

use std::fmt;

use crate::block_on::block_on;
use crate::layout::MAX_GROUPS;

/// The graphics interfaces that this build uses.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// Bytes of workgroup memory, number of storage buffers and threads per workgroup that the shaders
/// need. WebGPU guarantees them on every adapter; a test checks the shaders against them.
pub(crate) const WORKGROUP_BYTES: u32 = 16_384;
pub(crate) const STORAGE_BUFFERS: u32 = 8;
pub(crate) const WORKGROUP_THREADS: u32 = 256;

/// Greatest size of a binding that is used, whatever the adapter reports, bytes: on Vulkan and
/// Direct3D 12 shaders address bytes with signed 32-bit numbers, and Metal's bounds checks use 32
/// bits although it may report more.
pub(crate) const MOST_BINDING_BYTES: u64 = (1 << 31) - BUFFER_STEP;

/// Sizes of buffers are multiples of this, bytes.
pub(crate) const BUFFER_STEP: u64 = 16;

/// Returns the usable part of a binding of `bytes`: whole steps, so that a buffer of that size is
/// not rounded up beyond it.
pub(crate) fn usable_binding(bytes: u64) -> u64 {
    bytes.min(MOST_BINDING_BYTES) / BUFFER_STEP * BUFFER_STEP
}

/// The choice of a GPU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The best real GPU.
    Best,
    /// The best GPU whose name contains this text, ignoring case; software renderers, too.
    Named(String),
}

/// The kind of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A separate card.
    Discrete,
    /// Part of the processor.
    Integrated,
    /// A share of a GPU in a virtual machine.
    Virtual,
    /// The driver does not report the kind.
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
    /// Name, as the driver reports it.
    pub name: String,
    /// Graphics interface: `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// Driver and version.
    pub driver: String,
    /// Kind of the adapter.
    pub kind: AdapterKind,
    /// Greatest size of a buffer that a shader can access, bytes.
    pub binding_bytes: u64,
    /// Least and greatest number of threads in a subgroup.
    pub subgroup_size: [u32; 2],
    /// Whether passes can be timed.
    pub timestamps: bool,
    /// Requirements of the engine that the adapter does not meet, with the values found.
    pub missing_features: Vec<String>,
}

impl AdapterFacts {
    fn new(adapter: &wgpu::Adapter) -> Self {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let mut missing_features = Vec::new();
        let mut need = |what: &str, least: u64, found: u64| {
            if found < least {
                missing_features.push(format!("{what}: {found}, needed {least}"));
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
                missing_features.push(what.into());
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
            missing_features,
        }
    }

    /// Reports whether the adapter may be slower than the processor beside it: all but separate
    /// cards, with memory of their own.
    pub fn needs_trial(&self) -> bool {
        self.kind != AdapterKind::Discrete
    }

    /// Returns the reason why `choice` excludes the adapter, for display; `None` if it does not.
    pub fn reason_against(&self, choice: &DeviceChoice) -> Option<String> {
        if !self.missing_features.is_empty() {
            return Some(format!("lacks {}", self.missing_features.join(", ")));
        }
        match choice {
            DeviceChoice::Best => (self.kind == AdapterKind::Software).then(|| "a software renderer is only taken by its name".into()),
            DeviceChoice::Named(part) => {
                (!self.name.to_lowercase().contains(&part.to_lowercase())).then(|| format!("its name does not contain \"{part}\""))
            }
        }
    }
}

/// Returns all adapters that a driver offers, the best first.
pub fn adapters() -> Vec<AdapterFacts> {
    found().into_iter().map(|(facts, _)| facts).collect()
}

/// Returns all adapters with their facts, the best first.
pub(crate) fn found() -> Vec<(AdapterFacts, wgpu::Adapter)> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = BACKENDS;
    // No validation layers, and no check of indirect dispatches: their sizes come from our own
    // shaders and are folded to the limits. No shader reads the number of workgroups, which
    // Direct3D 12 does not provide without that check.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor);
    let adapters = block_on(instance.enumerate_adapters(BACKENDS));
    let mut adapters: Vec<_> = adapters.into_iter().map(|adapter| (AdapterFacts::new(&adapter), adapter)).collect();
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
            missing_features: Vec::new(),
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
        let old = AdapterFacts {
            missing_features: vec!["storage buffers per shader: 4, needed 8".into()],
            ..facts("old", AdapterKind::Integrated)
        };
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
    fn separate_cards_alone_are_taken_unmeasured() {
        for kind in [AdapterKind::Integrated, AdapterKind::Virtual, AdapterKind::Unknown, AdapterKind::Software] {
            assert!(facts("gpu", kind).needs_trial(), "{kind}");
        }
        assert!(!facts("card", AdapterKind::Discrete).needs_trial());
    }

    #[test]
    fn real_cards_come_before_software() {
        let mut kinds = [AdapterKind::Software, AdapterKind::Integrated, AdapterKind::Unknown, AdapterKind::Discrete, AdapterKind::Virtual];
        kinds.sort();
        assert_eq!((kinds[0], kinds[4]), (AdapterKind::Discrete, AdapterKind::Software));
    }
}

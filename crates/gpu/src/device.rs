//! Which GPU: what there is, which one is taken, what it can do, and what went wrong with it.
//!
//! `auto` and `gpu` take a real GPU, discrete before integrated before virtual; a software renderer is only ever taken by a part of its name.
//! Errors of the device are collected as they come in and handed out by [`Gpu::check`], with a remedy.

use std::collections::HashMap;
use std::fmt;
use std::pin::pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use luxel_core::EngineError;

use crate::kernels::{Kernel, KernelId};

/// How long the device may take for one submission before it is taken to hang. Drivers of desktop systems give up after a few seconds
/// themselves; a software renderer may need minutes.
const PATIENCE: Duration = Duration::from_secs(600);

/// Backends this build speaks.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// Bytes of workgroup memory and number of storage buffers that the shaders take; checked against them by tests.
const WORKGROUP_BYTES: u32 = 16_384;
const STORAGE_BUFFERS: u32 = 8;

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
        need("threads per workgroup", 256, limits.max_compute_invocations_per_workgroup.into());
        need("workgroups per dimension", crate::layout::MAX_GROUPS.into(), limits.max_compute_workgroups_per_dimension.into());
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
            binding_bytes: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
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

fn found() -> Vec<(AdapterFacts, wgpu::Adapter)> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = BACKENDS;
    // Without validation layers and the check of indirect dispatches, whose numbers come from our own shaders and are folded to the limits.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor);
    let adapters = ready(instance.enumerate_adapters(BACKENDS));
    let mut adapters: Vec<_> = adapters.into_iter().map(|adapter| (AdapterFacts::of(&adapter), adapter)).collect();
    adapters.sort_by_key(|(facts, _)| facts.kind);
    adapters
}

/// Result of a future of wgpu's native backends, which are ready at once or after a moment.
fn ready<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        match future.as_mut().poll(&mut context) {
            Poll::Ready(output) => return output,
            Poll::Pending => std::thread::yield_now(),
        }
    }
}

/// A device buffer with a number of its own, by which bindings are remembered.
#[derive(Debug)]
pub(crate) struct Buffer {
    pub(crate) id: u64,
    pub(crate) raw: wgpu::Buffer,
}

/// An open GPU. Engines share it and its compiled shaders.
pub struct Gpu {
    facts: AdapterFacts,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    /// Bytes of a buffer that a shader may see at once.
    pub(crate) binding_bytes: u64,
    kernels: Mutex<HashMap<KernelId, Arc<Kernel>>>,
    next_buffer: AtomicU64,
    /// The first error that came in, for people.
    fault: Arc<Mutex<Option<String>>>,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Gpu").field("facts", &self.facts).finish_non_exhaustive()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Gpu {
    /// Opens the best adapter that `choice` allows.
    ///
    /// # Errors
    /// [`EngineError::Device`] that lists what was found and why it was not taken, or what its driver says.
    pub fn open(choice: &DeviceChoice) -> Result<Arc<Self>, EngineError> {
        let mut refused = Vec::new();
        for (facts, adapter) in found() {
            match facts.reason_against(choice) {
                Some(reason) => refused.push(format!("{} ({}): {reason}", facts.name, facts.backend)),
                None => return Self::of(facts, &adapter),
            }
        }
        let wanted = match choice {
            DeviceChoice::Best => "no GPU".to_owned(),
            DeviceChoice::Named(part) => format!("no GPU named \"{part}\""),
        };
        let list = if refused.is_empty() {
            "no driver offers one; install the driver of the graphics card (on Linux with its Vulkan part)".to_owned()
        } else {
            refused.join("; ")
        };
        Err(EngineError::Device(format!("gpu: {wanted} can be used: {list}; or use --device cpu")))
    }

    fn of(facts: AdapterFacts, adapter: &wgpu::Adapter) -> Result<Arc<Self>, EngineError> {
        let timestamps = if facts.timestamps { wgpu::Features::TIMESTAMP_QUERY } else { wgpu::Features::empty() };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("luxel"),
            required_features: timestamps,
            // All that the adapter has: large scenes need large buffers.
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = ready(adapter.request_device(&descriptor)).map_err(|error| {
            EngineError::Device(format!("gpu: {}: cannot be opened: {error}; update its driver, or use --device cpu", facts.name))
        })?;
        let fault = Arc::new(Mutex::new(None));
        let (of_error, of_loss, name) = (Arc::clone(&fault), Arc::clone(&fault), facts.name.clone());
        device.on_uncaptured_error(Arc::new(move |error| {
            locked(&of_error).get_or_insert_with(|| describe(&error));
        }));
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                let message = if message.is_empty() { "no reason given" } else { message.as_str() };
                *locked(&of_loss) = Some(format!(
                    "{name} was lost ({message}); the last checkpoint is intact: go on with --resume, if it happens again with another driver \
                     or --device cpu"
                ));
            }
        });
        tracing::debug!(name = facts.name, driver = facts.driver, "opened GPU");
        let (next_buffer, binding_bytes) = (AtomicU64::new(0), facts.binding_bytes);
        Ok(Arc::new(Self { facts, device, queue, binding_bytes, kernels: Mutex::default(), next_buffer, fault }))
    }

    /// What the adapter is.
    pub fn facts(&self) -> &AdapterFacts {
        &self.facts
    }

    /// An error, if the device has had one.
    pub(crate) fn check(&self) -> Result<(), EngineError> {
        match locked(&self.fault).as_ref() {
            None => Ok(()),
            Some(fault) => Err(EngineError::Device(format!("gpu: {fault}"))),
        }
    }

    /// A kernel, compiled if it has not been.
    pub(crate) fn kernel(&self, id: KernelId) -> Arc<Kernel> {
        let mut kernels = locked(&self.kernels);
        Arc::clone(kernels.entry(id).or_insert_with(|| Arc::new(Kernel::compile(&self.device, id))))
    }

    /// A buffer of at least `bytes`.
    pub(crate) fn buffer(&self, label: &'static str, bytes: u64, usage: wgpu::BufferUsages) -> Result<Buffer, EngineError> {
        // Never empty, nor smaller than any structure in it: bindings must not be.
        let size = bytes.max(256).next_multiple_of(16);
        if usage.contains(wgpu::BufferUsages::STORAGE) && size > self.binding_bytes {
            return Err(self.too_large(label, size));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let raw = self.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false });
        if ready(scope.pop()).is_some() {
            return Err(EngineError::Device(format!(
                "gpu: {}: out of memory: buffer {label} needs {}; lower --max-splats or the resolution, or close other programs",
                self.facts.name,
                megabytes(size)
            )));
        }
        self.check()?;
        Ok(Buffer { id: self.next_buffer.fetch_add(1, Ordering::Relaxed), raw })
    }

    fn too_large(&self, label: &str, size: u64) -> EngineError {
        EngineError::Device(format!(
            "gpu: {}: buffer {label} needs {}, the adapter allows {} a binding; lower --max-splats or the resolution, or use --device cpu",
            self.facts.name,
            megabytes(size),
            megabytes(self.binding_bytes)
        ))
    }

    /// A storage buffer that can be copied from and to.
    pub(crate) fn storage(&self, label: &'static str, bytes: u64) -> Result<Buffer, EngineError> {
        self.buffer(label, bytes, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC)
    }

    /// A uniform buffer that holds `value`.
    pub(crate) fn uniform<T: bytemuck::Pod>(&self, label: &'static str, value: &T) -> Result<Buffer, EngineError> {
        let buffer = self.buffer(label, size_of::<T>() as u64, wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST)?;
        self.queue.write_buffer(&buffer.raw, 0, bytemuck::bytes_of(value));
        Ok(buffer)
    }

    /// Waits until a submission is done.
    pub(crate) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), EngineError> {
        let polled = self.device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(PATIENCE) });
        self.check()?;
        match polled {
            Ok(_) => Ok(()),
            Err(wgpu::PollError::Timeout) => Err(EngineError::Device(format!(
                "gpu: {} has not answered for {} s and seems to hang; the last checkpoint is intact: go on with --resume, if it happens again \
                 with another driver or --device cpu",
                self.facts.name,
                PATIENCE.as_secs()
            ))),
            Err(error) => Err(EngineError::Device(format!("gpu: {}: {error}; go on with --resume", self.facts.name))),
        }
    }

    /// Lets callbacks of what is done run, without waiting.
    pub(crate) fn poll(&self) -> Result<(), EngineError> {
        // What a poll finds out about a lost device comes by its callback.
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.check()
    }

    /// The whole contents of a buffer's first `bytes`.
    pub(crate) fn read(&self, buffer: &Buffer, bytes: u64) -> Result<Vec<u8>, EngineError> {
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let staging = self.buffer("read-back", bytes, usage)?;
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&buffer.raw, 0, &staging.raw, 0, bytes.next_multiple_of(4).min(buffer.raw.size()));
        let submission = self.queue.submit([encoder.finish()]);
        staging.raw.slice(..).map_async(wgpu::MapMode::Read, |_| {});
        self.wait(submission)?;
        let mut out = mapped(&staging.raw, self)?;
        out.truncate(bytes as usize);
        Ok(out)
    }
}

/// Contents of a buffer that was mapped for reading; unmaps it.
pub(crate) fn mapped(buffer: &wgpu::Buffer, gpu: &Gpu) -> Result<Vec<u8>, EngineError> {
    let view = buffer
        .slice(..)
        .get_mapped_range()
        .map_err(|error| EngineError::Device(format!("gpu: {}: cannot read back: {error}; go on with --resume", gpu.facts.name)))?;
    let bytes = view.to_vec();
    drop(view);
    buffer.unmap();
    Ok(bytes)
}

fn describe(error: &wgpu::Error) -> String {
    match error {
        wgpu::Error::OutOfMemory { .. } => "out of memory; lower --max-splats or the resolution, or close other programs".into(),
        wgpu::Error::Validation { description, .. } => {
            format!("the driver's interface refused a call: {}; this is a bug of luxel, --device cpu avoids it", one_line(description))
        }
        wgpu::Error::Internal { description, .. } => {
            format!("the driver failed: {}; update it, or use --device cpu", one_line(description))
        }
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// `128 MiB`.
fn megabytes(bytes: u64) -> String {
    format!("{} MiB", bytes.div_ceil(1 << 20))
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
    fn real_cards_come_before_software() {
        let mut kinds = [AdapterKind::Software, AdapterKind::Integrated, AdapterKind::Unknown, AdapterKind::Discrete, AdapterKind::Virtual];
        kinds.sort();
        assert_eq!((kinds[0], kinds[4]), (AdapterKind::Discrete, AdapterKind::Software));
    }
}

//! An open GPU: its kernels and buffers, waiting for it, and its errors.
//!
//! In: [`DeviceChoice`]. Out: [`Gpu`]. Degenerate: errors of the device are collected as they
//! occur; [`Gpu::check`] returns them with a remedy.

use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use luxel_core::{EngineError, Remedy};

use crate::adapter::{AdapterFacts, BUFFER_STEP, DeviceChoice, found};
use crate::block_on::block_on;
use crate::kernels::{Kernel, KernelId};

/// Time after which a submission is considered to hang. Drivers of desktop systems give up after a
/// few seconds; a software renderer may need minutes.
const PATIENCE: Duration = Duration::from_secs(600);

/// A device buffer with a unique number, by which bindings are cached.
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
    /// Greatest size of a buffer that a shader can access, bytes.
    pub(crate) binding_bytes: u64,
    kernels: Mutex<HashMap<KernelId, Arc<Kernel>>>,
    next_buffer: AtomicU64,
    /// The first error that occurred.
    fault: Arc<Mutex<Option<Fault>>>,
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
    /// [`EngineError::Device`] that lists the GPUs that were found with the reasons against them,
    /// or has the driver's message.
    pub fn open(choice: &DeviceChoice) -> Result<Arc<Self>, EngineError> {
        let mut refused = Vec::new();
        for (facts, adapter) in found() {
            match facts.reason_against(choice) {
                Some(reason) => refused.push(format!("{} ({}): {reason}", facts.name, facts.backend)),
                None => return Self::open_adapter(facts, &adapter),
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
        Err(EngineError::device(format!("gpu: {wanted} can be used: {list}")).with_remedy(use_cpu()))
    }

    /// Opens the same adapter as if it had no optional feature. For tests.
    ///
    /// # Errors
    /// The errors of [`Self::open`].
    pub fn reopen_plain(&self) -> Result<Arc<Self>, EngineError> {
        let adapter = found().into_iter().find(|(facts, _)| *facts == self.facts);
        let (facts, adapter) = adapter.ok_or_else(|| EngineError::device(format!("gpu: {}: is gone", self.facts.name)))?;
        Self::open_adapter(AdapterFacts { timestamps: false, ..facts }, &adapter)
    }

    fn open_adapter(facts: AdapterFacts, adapter: &wgpu::Adapter) -> Result<Arc<Self>, EngineError> {
        let timestamps = if facts.timestamps { wgpu::Features::TIMESTAMP_QUERY } else { wgpu::Features::empty() };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("luxel"),
            required_features: timestamps,
            // All limits of the adapter: large scenes need large buffers.
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = block_on(adapter.request_device(&descriptor)).map_err(|error| {
            let reason = error.to_string();
            let reason = reason.trim_end_matches('.');
            EngineError::device(format!("gpu: {}: cannot be opened: {reason}", facts.name))
                .with_remedy(Remedy::advice("update its driver").or(use_cpu()))
        })?;
        let fault = Arc::new(Mutex::new(None));
        let (of_error, of_loss, name) = (Arc::clone(&fault), Arc::clone(&fault), facts.name.clone());
        device.on_uncaptured_error(Arc::new(move |error| {
            locked(&of_error).get_or_insert_with(|| describe(&error));
        }));
        device.set_device_lost_callback(move |_, message| {
            let message = if message.is_empty() { "no reason given" } else { message.as_str() };
            let message = format!("{name} was lost ({message}); the last checkpoint is intact");
            *locked(&of_loss) = Some(Fault { message, remedy: resume_elsewhere() });
        });
        tracing::debug!(name = facts.name, driver = facts.driver, "opened GPU");
        let (next_buffer, binding_bytes) = (AtomicU64::new(0), facts.binding_bytes);
        Ok(Arc::new(Self { facts, device, queue, binding_bytes, kernels: Mutex::default(), next_buffer, fault }))
    }

    /// Returns the facts about the adapter.
    pub fn facts(&self) -> &AdapterFacts {
        &self.facts
    }

    /// Destroys the device, as if its driver had failed. For tests.
    pub fn lose(&self) {
        self.device.destroy();
    }

    /// Returns the first error of the device, if there was one.
    pub(crate) fn check(&self) -> Result<(), EngineError> {
        match locked(&self.fault).as_ref() {
            None => Ok(()),
            Some(fault) => Err(EngineError::device(format!("gpu: {}", fault.message)).with_remedy(fault.remedy.clone())),
        }
    }

    /// Returns a kernel, and compiles it at first use.
    pub(crate) fn kernel(&self, id: KernelId) -> Arc<Kernel> {
        let mut kernels = locked(&self.kernels);
        Arc::clone(kernels.entry(id).or_insert_with(|| Arc::new(Kernel::compile(&self.device, id))))
    }

    /// Makes a buffer of at least `bytes`.
    pub(crate) fn buffer(&self, label: &'static str, bytes: u64, usage: wgpu::BufferUsages) -> Result<Buffer, EngineError> {
        // Never empty or smaller than a structure in it: bindings must not be.
        let size = bytes.max(256).next_multiple_of(BUFFER_STEP);
        if usage.contains(wgpu::BufferUsages::STORAGE) && size > self.binding_bytes {
            return Err(self.too_large(label, size));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let raw = self.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false });
        if block_on(scope.pop()).is_some() {
            let message = format!("gpu: {}: out of memory: buffer {label} needs {}", self.facts.name, megabytes(size));
            return Err(EngineError::device(message).with_remedy(use_less_memory()));
        }
        self.check()?;
        Ok(Buffer { id: self.next_buffer.fetch_add(1, Ordering::Relaxed), raw })
    }

    fn too_large(&self, label: &str, size: u64) -> EngineError {
        let (needed, limit) = (megabytes(size), megabytes(self.binding_bytes));
        let message = format!("gpu: {}: buffer {label} needs {needed}, the adapter allows {limit} a binding", self.facts.name);
        EngineError::device(message).with_remedy(render_less().or(use_cpu()))
    }

    /// Makes a storage buffer that can be copied from and to.
    pub(crate) fn storage(&self, label: &'static str, bytes: u64) -> Result<Buffer, EngineError> {
        self.buffer(label, bytes, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC)
    }

    /// Makes a uniform buffer that holds `value`.
    pub(crate) fn uniform<T: bytemuck::Pod>(&self, label: &'static str, value: &T) -> Result<Buffer, EngineError> {
        let buffer = self.buffer(label, size_of::<T>() as u64, wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST)?;
        self.queue.write_buffer(&buffer.raw, 0, bytemuck::bytes_of(value));
        Ok(buffer)
    }

    /// Waits until a submission is done.
    pub(crate) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), EngineError> {
        self.wait_until(Some(submission))
    }

    /// Waits until all submissions are done, which frees unused buffers.
    pub(crate) fn wait_for_all(&self) -> Result<(), EngineError> {
        self.wait_until(None)
    }

    fn wait_until(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<(), EngineError> {
        let polled = self.device.poll(wgpu::PollType::Wait { submission_index, timeout: Some(PATIENCE) });
        self.check()?;
        match polled {
            Ok(_) => Ok(()),
            Err(wgpu::PollError::Timeout) => {
                let (name, seconds) = (&self.facts.name, PATIENCE.as_secs());
                let message = format!("gpu: {name} has not answered for {seconds} s and seems to hang; the last checkpoint is intact");
                Err(EngineError::device(message).with_remedy(resume_elsewhere()))
            }
            Err(error) => Err(EngineError::device(format!("gpu: {}: {error}", self.facts.name)).with_remedy(resume())),
        }
    }

    /// Runs the callbacks of finished work, without waiting.
    pub(crate) fn poll(&self) -> Result<(), EngineError> {
        // A lost device is reported by its callback.
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.check()
    }

    /// Reads the first `count` numbers or structures of a buffer.
    pub(crate) fn read<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
        &self,
        buffer: &Buffer,
        count: usize,
    ) -> Result<Vec<T>, EngineError> {
        self.read_parts(buffer, &[0], count)
    }

    /// Downloads parts of `buffer`, of `count` numbers or structures each, one behind the other.
    /// Offsets, in bytes, and sizes are multiples of 4.
    pub(crate) fn read_parts<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
        &self,
        buffer: &Buffer,
        offsets: &[u64],
        count: usize,
    ) -> Result<Vec<T>, EngineError> {
        let bytes = (count * size_of::<T>()) as u64;
        if bytes == 0 || offsets.is_empty() {
            return Ok(Vec::new());
        }
        let all = bytes * offsets.len() as u64;
        let staging = self.buffer("read-back", all, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST)?;
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (n, offset) in (0..).zip(offsets) {
            encoder.copy_buffer_to_buffer(&buffer.raw, *offset, &staging.raw, n * bytes, bytes);
        }
        let submission = self.queue.submit([encoder.finish()]);
        staging.raw.slice(..all).map_async(wgpu::MapMode::Read, |_| {});
        self.wait(submission)?;
        let view = mapping(&staging.raw, all, self)?;
        Ok(bytemuck::try_cast_slice(&view).map_or_else(|_| bytemuck::pod_collect_to_vec(&view), <[T]>::to_vec))
    }
}

/// Returns the first `bytes` of a buffer that was mapped for reading. It is unmapped by the caller,
/// unless it is dropped.
pub(crate) fn mapping(buffer: &wgpu::Buffer, bytes: u64, gpu: &Gpu) -> Result<wgpu::BufferView, EngineError> {
    buffer
        .slice(..bytes)
        .get_mapped_range()
        .map_err(|error| EngineError::device(format!("gpu: {}: cannot read back: {error}", gpu.facts.name)).with_remedy(resume()))
}

fn describe(error: &wgpu::Error) -> Fault {
    match error {
        wgpu::Error::OutOfMemory { .. } => Fault { message: "out of memory".into(), remedy: use_less_memory() },
        wgpu::Error::Validation { description, .. } => {
            let message = format!("the driver's interface refused a call, which is a bug of luxel: {}", one_line(description));
            Fault { message, remedy: use_cpu() }
        }
        wgpu::Error::Internal { description, .. } => {
            let message = format!("the driver failed: {}", one_line(description));
            Fault { message, remedy: Remedy::advice("update the driver").or(use_cpu()) }
        }
    }
}

/// A failure of the device, reported by a callback and kept until [`Gpu::check`].
#[derive(Debug)]
struct Fault {
    message: String,
    remedy: Remedy,
}

/// Returns the remedy of computing without the GPU.
pub(crate) fn use_cpu() -> Remedy {
    Remedy::set("device", "cpu")
}

/// Returns the remedy of continuing from the last checkpoint.
pub(crate) fn resume() -> Remedy {
    Remedy::set("resume", "true")
}

/// Returns the remedy of fewer splats or pixels.
pub(crate) fn render_less() -> Remedy {
    Remedy::lower("max_splats").or(Remedy::advice("lower the resolution"))
}

fn use_less_memory() -> Remedy {
    render_less().or(Remedy::advice("close other programs"))
}

fn resume_elsewhere() -> Remedy {
    resume().or(Remedy::advice("if it happens again, update the driver")).or(use_cpu())
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Formats a number of bytes, as in `128 MiB`.
fn megabytes(bytes: u64) -> String {
    format!("{} MiB", bytes.div_ceil(1 << 20))
}

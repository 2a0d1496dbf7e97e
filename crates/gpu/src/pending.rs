//! Steps in progress: submitted to the device, but not yet reported to the host.
//!
//! In: recorded commands. Out: reports. A step's report and timestamps are copied into a buffer
//! that is mapped when the step is done; the host submits the next steps meanwhile.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use luxel_core::engine::StepConfig;
use luxel_core::{EngineError, Pass, View};

use crate::commands::Timer;
use crate::device::{Buffer, Gpu, mapping};
use crate::layout::State;

/// Greatest number of steps in progress. Two would be enough to keep the device busy.
pub(crate) const LAG: usize = 3;

/// A step in progress.
pub(crate) struct Pending {
    pub(crate) view: View,
    pub(crate) step: StepConfig,
    pub(crate) report: Report,
}

/// The report of a step in progress.
pub(crate) struct Report {
    slot: Slot,
    submission: wgpu::SubmissionIndex,
    segments: Vec<Pass>,
    /// Bytes that the host will read.
    pub(crate) bytes: u64,
}

/// A buffer from which a report is read.
pub(crate) struct Slot {
    buffer: Buffer,
    is_mapped: Arc<AtomicBool>,
}

/// The size of a [`State`], bytes.
const STATE_BYTES: u64 = size_of::<State>() as u64;

/// Buffers for reports, used in turn.
#[derive(Default)]
pub(crate) struct Slots {
    free: Vec<Slot>,
}

impl Slots {
    /// Takes a free buffer, or makes one.
    pub(crate) fn take(&mut self, gpu: &Gpu) -> Result<Slot, EngineError> {
        if let Some(slot) = self.free.pop() {
            return Ok(slot);
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        Ok(Slot { buffer: gpu.buffer("report", STATE_BYTES + Timer::BYTES, usage)?, is_mapped: Arc::default() })
    }

    fn give_back(&mut self, slot: Slot) {
        slot.is_mapped.store(false, Ordering::Release);
        self.free.push(slot);
    }
}

impl Slot {
    /// Appends copies of state and timestamps to `encoder`, and submits it.
    pub(crate) fn submit(
        self,
        gpu: &Gpu,
        mut encoder: wgpu::CommandEncoder,
        state: &Buffer,
        timer: Option<&Timer>,
        segments: Vec<Pass>,
    ) -> Report {
        encoder.copy_buffer_to_buffer(&state.raw, 0, &self.buffer.raw, 0, STATE_BYTES);
        let mut bytes = STATE_BYTES;
        if let Some(timer) = timer {
            bytes += timer.resolve(&mut encoder, segments.len(), &self.buffer.raw, STATE_BYTES);
        }
        let submission = gpu.queue.submit([encoder.finish()]);
        let is_mapped = Arc::clone(&self.is_mapped);
        self.buffer.raw.slice(..).map_async(wgpu::MapMode::Read, move |result| {
            // An error appears again when the buffer is read.
            is_mapped.store(result.is_ok(), Ordering::Release);
        });
        Report { slot: self, submission, segments, bytes }
    }
}

impl Report {
    /// Reports whether the step is done.
    pub(crate) fn is_done(&self) -> bool {
        self.slot.is_mapped.load(Ordering::Acquire)
    }

    /// Waits for the step. Returns its state, and the timestamps with their passes.
    pub(crate) fn receive(self, gpu: &Gpu, slots: &mut Slots) -> Result<(State, Vec<Pass>, Vec<u8>), EngineError> {
        if !self.is_done() {
            gpu.wait(self.submission)?;
        }
        let buffer = &self.slot.buffer.raw;
        let view = mapping(buffer, buffer.size(), gpu)?;
        let (state, timestamps) = view.split_at(STATE_BYTES as usize);
        let state = bytemuck::pod_read_unaligned(state);
        let timestamps = timestamps[..timestamps.len().min(16 * self.segments.len())].to_vec();
        drop(view);
        buffer.unmap();
        slots.give_back(self.slot);
        Ok((state, self.segments, timestamps))
    }
}

//! The commands of a submission: kernels with their bindings in order, and timestamps between
//! passes.
//!
//! In: kernels and buffers. Out: an encoded submission; times of passes. Degenerate: without
//! timestamps, passes are not timed.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use luxel_core::{EngineError, Pass, PassTime};

use crate::device::{Buffer, Gpu};
use crate::kernels::{Kernel, KernelId};
use crate::layout::MAX_GROUPS;

/// Greatest number of runs of passes in a submission.
const MAX_SEGMENTS: u32 = 16;
/// The size of a pair of timestamps, bytes.
const PAIR_BYTES: u64 = 16;

/// The number of workgroups of a dispatch.
#[derive(Clone, Copy)]
pub(crate) enum Groups<'a> {
    /// A number of workgroups along one dimension.
    Line(u64),
    /// Columns and rows.
    Grid([u32; 2]),
    /// A number that the device has written at an offset of a buffer.
    Indirect(&'a Buffer, usize),
}

/// A buffer bound to a number in a shader.
#[derive(Clone, Copy)]
pub(crate) struct Binding<'a> {
    /// The number after `@binding`.
    pub(crate) slot: u32,
    pub(crate) buffer: &'a Buffer,
}

/// Binds `buffer` to `slot`.
pub(crate) fn bind(slot: u32, buffer: &Buffer) -> Binding<'_> {
    Binding { slot, buffer }
}

enum Dispatch {
    Direct([u32; 2]),
    Indirect(wgpu::Buffer, u64),
}

struct Command {
    pass: Pass,
    kernel: Arc<Kernel>,
    bindings: wgpu::BindGroup,
    dispatch: Dispatch,
}

/// The kernels to run, in order.
#[derive(Default)]
pub(crate) struct Commands {
    list: Vec<Command>,
    /// Cached bindings, by kernel and buffers.
    bindings: HashMap<(KernelId, Vec<u64>), wgpu::BindGroup>,
}

impl Commands {
    /// Drops cached bindings and waiting kernels, because buffers were replaced.
    pub(crate) fn forget(&mut self) {
        self.list.clear();
        self.bindings.clear();
    }

    /// Adds a kernel.
    pub(crate) fn add(&mut self, gpu: &Gpu, pass: Pass, id: KernelId, bindings: &[Binding<'_>], groups: Groups<'_>) {
        let dispatch = match groups {
            Groups::Line(0) => return,
            Groups::Line(groups) => Dispatch::Direct(fold(groups)),
            Groups::Grid(groups) => Dispatch::Direct(groups),
            Groups::Indirect(buffer, offset) => Dispatch::Indirect(buffer.raw.clone(), offset as u64),
        };
        let kernel = gpu.kernel(id);
        let key = (id, bindings.iter().map(|binding| binding.buffer.id).collect());
        let group = self.bindings.entry(key).or_insert_with(|| {
            let entries: Vec<wgpu::BindGroupEntry<'_>> = bindings
                .iter()
                .map(|Binding { slot, buffer }| wgpu::BindGroupEntry { binding: *slot, resource: buffer.raw.as_entire_binding() })
                .collect();
            gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(id.name()), layout: &kernel.layout, entries: &entries })
        });
        self.list.push(Command { pass, kernel, bindings: group.clone(), dispatch });
    }

    /// Returns the number of waiting dispatches.
    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    /// Encodes and removes the waiting kernels. Returns the pass of each pair of timestamps.
    pub(crate) fn encode(&mut self, encoder: &mut wgpu::CommandEncoder, timer: Option<&Timer>) -> Vec<Pass> {
        let mut segments = Vec::new();
        for run in self.list.chunk_by(|a, b| a.pass == b.pass) {
            let pair = 2 * segments.len() as u32;
            let timestamp_writes = timer.filter(|_| pair < 2 * MAX_SEGMENTS).map(|timer| wgpu::ComputePassTimestampWrites {
                query_set: &timer.queries,
                beginning_of_pass_write_index: Some(pair),
                end_of_pass_write_index: Some(pair + 1),
            });
            let label = Some(run[0].pass.name());
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label, timestamp_writes });
            for command in run {
                pass.set_pipeline(&command.kernel.pipeline);
                pass.set_bind_group(0, &command.bindings, &[]);
                match &command.dispatch {
                    Dispatch::Direct([x, y]) => pass.dispatch_workgroups(*x, *y, 1),
                    Dispatch::Indirect(buffer, offset) => pass.dispatch_workgroups_indirect(buffer, *offset),
                }
            }
            segments.push(run[0].pass);
        }
        self.list.clear();
        segments.truncate(MAX_SEGMENTS as usize);
        segments
    }
}

/// Folds a number of workgroups into rows of [`MAX_GROUPS`], as `group_index` in common.wgsl
/// expects; kernels ignore surplus workgroups.
fn fold(groups: u64) -> [u32; 2] {
    let most = u64::from(MAX_GROUPS);
    // The sizes of buffers keep both numbers far below 2^32.
    [groups.min(most) as u32, groups.div_ceil(most) as u32]
}

/// The timestamps of a submission.
pub(crate) struct Timer {
    queries: wgpu::QuerySet,
    resolved: Buffer,
    /// Nanoseconds per tick.
    period: f64,
}

impl Timer {
    /// Makes a timer; `None` if the adapter has no timestamps.
    pub(crate) fn new(gpu: &Gpu) -> Result<Option<Self>, EngineError> {
        if !gpu.facts().timestamps {
            return Ok(None);
        }
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("passes"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * MAX_SEGMENTS,
        });
        let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
        let resolved = gpu.buffer("timestamps", PAIR_BYTES * u64::from(MAX_SEGMENTS), usage)?;
        Ok(Some(Self { queries, resolved, period: gpu.queue.get_timestamp_period().into() }))
    }

    /// The size of the greatest number of timestamps, bytes.
    pub(crate) const BYTES: u64 = PAIR_BYTES * MAX_SEGMENTS as u64;

    /// Copies the timestamps of `segments` passes to an offset of `out`.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder, segments: usize, out: &wgpu::Buffer, offset: u64) -> u64 {
        let bytes = PAIR_BYTES * segments as u64;
        if segments > 0 {
            encoder.resolve_query_set(&self.queries, 0..2 * segments as u32, &self.resolved.raw, 0);
            encoder.copy_buffer_to_buffer(&self.resolved.raw, 0, out, offset, bytes);
        }
        bytes
    }

    /// Adds the times between the timestamps to the times of the passes.
    pub(crate) fn add(&self, segments: &[Pass], bytes: &[u8], timings: &mut [PassTime]) {
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(bytes);
        for (pass, pair) in segments.iter().zip(ticks.chunks_exact(2)) {
            let nanoseconds = pair[1].saturating_sub(pair[0]) as f64 * self.period;
            if let Some(PassTime { time, .. }) = timings.get_mut(*pass as usize) {
                *time += Duration::from_nanos(nanoseconds as u64);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folded_dispatches_hold_all_in_rows_of_one_length() {
        for groups in [1u64, 7, 65_535, 65_536, 131_070, 131_071, 1_000_003] {
            let [x, y] = fold(groups).map(u64::from);
            assert!(x <= 65_535 && (y == 1 || x == 65_535) && x * y >= groups && x * (y - 1) < groups, "{groups}: {x} x {y}");
        }
    }
}

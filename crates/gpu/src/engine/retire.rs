//! Steps in progress: retires them in order, and repeats those that a halted device skipped.
//!
//! In: reports of steps. Out: the latest report; a diverged step is remembered. Degenerate: after
//! an overflow the buffers grow, and the skipped steps are submitted again.

use luxel_core::engine::StepConfig;
use luxel_core::{EngineError, Remedy, StepReport, View};

use super::{GpuEngine, Submission, required_sizes, step_report};
use crate::device::resume;
use crate::layout::{HALT_NONE, HALT_NOT_FINITE, HALT_OVERFLOW, State};
use crate::pending::{Pending, Report};
use crate::screen::supersampled;

impl GpuEngine {
    /// Waits until no step is in progress.
    pub(super) fn wait_idle(&mut self) -> Result<(), EngineError> {
        while !self.pending.is_empty() {
            self.retire_oldest()?;
        }
        Ok(())
    }

    /// Waits until no step is in progress. Fails if training has diverged.
    pub(super) fn wait_idle_checked(&mut self) -> Result<(), EngineError> {
        self.wait_idle()?;
        match self.diverged {
            None => Ok(()),
            Some(step) => Err(EngineError::invalid(format!("the loss of step {step} is not finite"))
                .with_remedy(Remedy::advice("lower the learning rates").or(resume()))),
        }
    }

    /// Receives the report of the oldest step in progress.
    pub(super) fn retire_oldest(&mut self) -> Result<(), EngineError> {
        let Some(Pending { view, step, report }) = self.pending.pop_front() else { return Ok(()) };
        let state = self.receive(report)?;
        match state.halted {
            HALT_OVERFLOW => {
                let mut again = vec![(view, step)];
                again.extend(self.drop_pending()?);
                let (view, step) = &again[0];
                self.make_room(&state, required_sizes(&supersampled(&view.camera, &step.render).0, self.scene.count, true))?;
                for (view, step) in again {
                    self.enqueue(view, step)?;
                }
            }
            HALT_NOT_FINITE => {
                self.drop_pending()?;
                self.diverged = Some(step.step);
                self.latest = Some(StepReport { loss: f32::NAN, ..step_report(&state, step.step) });
            }
            _ => self.latest = Some(step_report(&state, step.step)),
        }
        Ok(())
    }

    /// Waits for all steps in progress, which a halted device skips, and returns them.
    pub(super) fn drop_pending(&mut self) -> Result<Vec<(View, StepConfig)>, EngineError> {
        let mut dropped = Vec::new();
        while let Some(Pending { view, step, report }) = self.pending.pop_front() {
            self.receive(report)?;
            dropped.push((view, step));
        }
        Ok(dropped)
    }

    pub(super) fn receive(&mut self, report: Report) -> Result<State, EngineError> {
        let (state, segments, timestamps) = report.receive(&self.gpu, &mut self.slots)?;
        if let Some(timer) = &self.timer {
            timer.add(&segments, &timestamps, &mut self.timings);
        }
        Ok(state)
    }

    /// Clears the halt, so that the device executes steps again.
    pub(super) fn clear_halt(&self) {
        let halted = std::mem::offset_of!(State, halted) as u64;
        self.gpu.queue.write_buffer(&self.frame.state.raw, halted, bytemuck::bytes_of(&HALT_NONE));
    }

    /// Submits a training step.
    pub(super) fn enqueue(&mut self, view: View, step: StepConfig) -> Result<(), EngineError> {
        let report = self.submit(&Submission::Train { view: &view, step: &step })?;
        self.pending.push_back(Pending { view: view.released(), step, report });
        Ok(())
    }
}

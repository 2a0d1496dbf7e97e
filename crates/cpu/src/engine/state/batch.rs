//! The passes of a step up to the gradients of one view, and the update from the sum of a batch.
//!
//! In: a view, or gradients. Out: gradients, or the updated scene. Nothing is deferred here.

use luxel_core::engine::{CameraGradientChoice, SparseGradients, StatsCollection, StepConfig};
use luxel_core::{Pass, Splats, StepReport, View};

use super::State;
use crate::engine::clock::Clock;
use crate::passes::adam::Optimizer;
use crate::passes::project_backward::Inputs;
use crate::passes::sparse_update::{sparse_adam, sparse_gradients};
use crate::passes::update::gradients;
use crate::store::{Store, StoreShape};
use crate::view::ScreenCamera;

impl State {
    /// Returns the layout and the number of splats.
    pub(in crate::engine) fn shape(&self) -> StoreShape {
        self.parameters.shape()
    }

    /// Computes the gradients of a view, without its update. The view has the size of the image.
    pub(in crate::engine) fn view_gradients(
        &mut self,
        camera: &ScreenCamera,
        view: &View,
        step: &StepConfig,
    ) -> (StepReport, SparseGradients) {
        let mut report = self.forward_backward(camera, view, step);
        if step.camera_gradient == CameraGradientChoice::Compute {
            report.camera = Some(self.camera_backward(camera, view, step));
        }
        let Self { level, parameters, smoothing, frame, spare_gradients, timings, .. } = self;
        let inputs = Inputs::new(parameters, smoothing, &frame.bins, frame.by_screen.by_screen(), &step.loss);
        let mut clock = Clock::new(timings);
        let spare = spare_gradients.pop().unwrap_or_else(|| SparseGradients::none(parameters.layout));
        let gradients = sparse_gradients(*level, camera, &inputs, &parameters.lanes, step.stats, spare);
        clock.lap(Pass::ProjectBackward);
        (report, gradients)
    }

    /// Keeps gradients whose memory the next ones have.
    pub(in crate::engine) fn reuse_gradients(&mut self, gradients: SparseGradients) {
        self.spare_gradients.push(gradients);
    }

    /// Makes the update of a step from gradients of its splats.
    pub(in crate::engine) fn apply_gradients(&mut self, gradients: &SparseGradients, step: &StepConfig) {
        self.finish();
        let Self { level, parameters, moments, stats, timings, .. } = self;
        let mut clock = Clock::new(timings);
        sparse_adam(*level, gradients, Optimizer { parameters, moments }, step, stats);
        clock.lap(Pass::Adam);
        if step.stats == StatsCollection::Off {
            self.spare.resize(0);
        }
    }

    /// Computes a step's gradients without its update. The view has the size of the image.
    pub(in crate::engine) fn gradients(&mut self, camera: &ScreenCamera, view: &View, step: &StepConfig) -> (StepReport, Splats) {
        let report = self.forward_backward(camera, view, step);
        let Self { level, parameters, smoothing, stats, frame, timings, .. } = self;
        let inputs = Inputs::new(parameters, smoothing, &frame.bins, frame.by_screen.by_screen(), &step.loss);
        let stats = (step.stats != StatsCollection::Off).then_some(stats);
        let mut clock = Clock::new(timings);
        let lanes = gradients(*level, camera, &inputs, &parameters.lanes, stats);
        clock.lap(Pass::ProjectBackward);
        (report, Store { lanes, ..Store::zeros(parameters.layout, parameters.count) }.to_splats())
    }
}

//! The gradient by the camera: buffers for the sums of workgroups, and their sum on the host.
//!
//! In: a view and a step. Out: [`CameraGradient`], with the same bits every time on one adapter.

use luxel_core::engine::{CAMERA_SUMS, CameraGradient, CameraSums, StepConfig};
use luxel_core::{EngineError, View};

use super::GpuEngine;
use crate::layout::CAMERA_SUMS_BYTES;
use crate::step::backward_groups;

impl GpuEngine {
    /// Makes the buffers for the sums, if the scene has none yet.
    pub(super) fn prepare_camera_sums(&mut self) -> Result<(), EngineError> {
        if self.camera_sums.len() != self.scene.shards.len() {
            let bytes: Vec<u64> = self.scene.shards.iter().map(|shard| CAMERA_SUMS_BYTES * backward_groups(shard)).collect();
            self.camera_sums =
                self.with_room(|engine| bytes.iter().map(|bytes| engine.gpu.storage("sums for the camera", *bytes)).collect())?;
        }
        Ok(())
    }

    /// Reads the sums of the last step and returns the gradient by its camera.
    pub(super) fn read_camera_gradient(&self, view: &View, step: &StepConfig) -> Result<CameraGradient, EngineError> {
        let mut rows: Vec<[f64; CAMERA_SUMS]> = Vec::new();
        for (shard, sums) in self.scene.shards.iter().zip(&self.camera_sums) {
            let groups: Vec<[f32; CAMERA_SUMS]> = self.gpu.read(sums, backward_groups(shard) as usize)?;
            rows.extend(groups.into_iter().map(|group| group.map(f64::from)));
        }
        Ok(CameraSums::of_rows(rows).gradient(&view.camera, step.render.raster.samples))
    }
}

const _: () = assert!(CAMERA_SUMS_BYTES as usize == CAMERA_SUMS * size_of::<f32>());

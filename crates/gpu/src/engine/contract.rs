//! The contract of `luxel_core::Engine`, implemented by [`GpuEngine`].
//!
//! In and out: see [`Engine`]. Degenerate: bad input is an error, and leaves the engine unchanged.

use std::ops::Range;
use std::time::Instant;

use luxel_core::edit::Contributions;
use luxel_core::engine::{
    CameraGradientChoice, DensifyPlan, DensifyStats, Geometry, SavedPart, SparseGradients, SplatArray, StepConfig, check_range,
};
use luxel_core::{Camera, Engine, EngineError, Image, Moments, Pass, PassTime, RenderOptions, Splats, StepReport, View};

use super::lights::of_one_light;
use super::{GpuEngine, Submission, step_report};
use crate::densify;
use crate::device::{Buffer, resume};
use crate::layout::HALT_NONE;
use crate::pending::LAG;
use crate::scene::{GpuScene, Shard};
use crate::screen::check;

impl Engine for GpuEngine {
    fn load(&mut self, splats: &Splats, moments: Option<&Moments>) -> Result<(), EngineError> {
        splats.validate()?;
        if let Some(moments) = moments {
            moments.validate_for(splats)?;
        }
        self.wait_idle()?;
        // The old scene is freed first, so that two scenes are never in memory at once.
        self.replace_scene(GpuScene::empty());
        let shard_len = self.shard_len_for(splats.color_model);
        let scene = self.with_room(|engine| GpuScene::upload(&engine.gpu, splats, moments, shard_len))?;
        self.replace_scene(scene);
        (self.latest, self.diverged) = (None, None);
        self.clear_halt();
        Ok(())
    }

    fn save(&mut self) -> Result<(Splats, Moments), EngineError> {
        self.wait_idle_checked()?;
        let mut splats = self.scene.download(&self.gpu, |_, shard| &shard.parameters)?;
        splats.smoothing = self.scene.smoothing(&self.gpu)?;
        splats.gain.clone_from(&self.scene.gain);
        let first = self.scene.download(&self.gpu, |_, shard| &shard.first)?;
        let second = self.scene.download(&self.gpu, |_, shard| &shard.second)?;
        Ok((splats, Moments { first, second }))
    }

    fn save_array(&mut self, part: SavedPart, array: SplatArray, splats: Range<usize>) -> Result<Vec<f32>, EngineError> {
        check_range(&splats, self.len())?;
        self.wait_idle_checked()?;
        let scene = &self.scene;
        let mut rows = array.rows(scene.rows.color_model);
        if array == SplatArray::Smoothing && part == SavedPart::Parameters && scene.has_smoothing {
            // The filter's row is behind those of the parameters.
            rows = rows.start..rows.start + 1;
        }
        let pick: fn(&Shard) -> &Buffer = match part {
            SavedPart::Parameters => |shard| &shard.parameters,
            SavedPart::FirstMoments => |shard| &shard.first,
            SavedPart::SecondMoments => |shard| &shard.second,
        };
        scene.download_array(&self.gpu, pick, rows, &splats)
    }

    fn render(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Image, EngineError> {
        let mut image = Image::default();
        self.render_into(camera, options, &mut image)?;
        Ok(image)
    }

    fn render_into(&mut self, camera: &Camera, options: &RenderOptions, image: &mut Image) -> Result<(), EngineError> {
        check(camera)?;
        self.wait_idle_checked()?;
        let lights = self.scene.rows.color_model.lights();
        let options = &of_one_light(options, lights);
        self.render_light(camera, options, 0, image)?;
        for light in 1..lights {
            let mut added = Image::default();
            self.render_light(camera, options, light, &mut added)?;
            *image = std::mem::take(image).plus(added);
        }
        Ok(())
    }

    fn contributions(&mut self, camera: &Camera, options: &RenderOptions, mask: &[f32]) -> Result<Contributions, EngineError> {
        check(camera)?;
        let pixels = camera.size_px[0] as usize * camera.size_px[1] as usize;
        if mask.len() != pixels {
            return Err(EngineError::invalid(format!("mask holds {} pixels, the camera's image {pixels}", mask.len())));
        }
        self.wait_idle_checked()?;
        let mask = self.upload_mask(mask)?;
        let lights = self.scene.rows.color_model.lights();
        let lights: Result<Vec<_>, _> = (0..lights).map(|light| self.contributions_of_light(camera, options, light, &mask)).collect();
        Ok(Contributions::of_lights(lights?))
    }

    fn train_step(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError> {
        self.scene.check_trainable()?;
        view.validate()?;
        if let Some(report) = self.latest.filter(|_| self.diverged.is_some()) {
            return Ok(report);
        }
        self.enqueue(view.clone(), *step)?;
        let wants_camera = step.camera_gradient == CameraGradientChoice::Compute;
        if wants_camera || view.target.vignetting.is_some() {
            // What moves by the gradient must not depend on how far the device is.
            self.wait_idle()?;
            if self.diverged.is_none() {
                let camera = if wants_camera { Some(self.read_camera_gradient(view, step)?) } else { None };
                let by_vignetting = self.read_vignetting_gradient(view)?;
                self.latest = self.latest.map(|report| StepReport { camera, by_vignetting, ..report });
            }
        }
        self.gpu.poll()?;
        while self.pending.front().is_some_and(|pending| pending.report.is_done()) || self.pending.len() > LAG {
            self.retire_oldest()?;
        }
        while self.latest.is_none() && !self.pending.is_empty() {
            self.retire_oldest()?;
        }
        self.latest.ok_or_else(|| EngineError::device("gpu: a step left no report").with_remedy(resume()))
    }

    fn limit_images(&mut self, bytes: u64) {
        self.targets.set_budget(bytes);
    }

    fn camera_gradient(&mut self, view: &View, step: &StepConfig) -> Result<StepReport, EngineError> {
        self.scene.check_trainable()?;
        view.validate()?;
        self.wait_idle_checked()?;
        let state = self.run(&Submission::CameraGradient { view, step })?;
        let report = step_report(&state, step.step);
        if state.halted != HALT_NONE {
            return Ok(StepReport { loss: f32::NAN, ..report });
        }
        let (camera, by_vignetting) = (Some(self.read_camera_gradient(view, step)?), self.read_vignetting_gradient(view)?);
        Ok(StepReport { camera, by_vignetting, ..report })
    }

    fn view_gradients(&mut self, view: &View, step: &StepConfig) -> Result<(StepReport, SparseGradients), EngineError> {
        self.scene.check_trainable()?;
        view.validate()?;
        self.read_view_gradients(view, step)
    }

    fn apply_gradients(&mut self, gradients: &SparseGradients, step: &StepConfig) -> Result<(), EngineError> {
        self.update_from(gradients, step)
    }

    fn finish(&mut self) -> Result<(), EngineError> {
        self.wait_idle()
    }

    fn densify_stats(&mut self) -> Result<DensifyStats, EngineError> {
        self.wait_idle_checked()?;
        self.scene.stats(&self.gpu)
    }

    fn set_densify_stats(&mut self, stats: &DensifyStats) -> Result<(), EngineError> {
        self.wait_idle()?;
        stats.check(self.scene.count)?;
        self.scene.set_stats(&self.gpu, stats)
    }

    fn geometry(&mut self) -> Result<Geometry, EngineError> {
        self.wait_idle_checked()?;
        self.scene.geometry(&self.gpu)
    }

    fn densify(&mut self, plan: &DensifyPlan) -> Result<(), EngineError> {
        plan.check(self.scene.count)?;
        self.wait_idle_checked()?;
        let start = Instant::now();
        let shard_len = self.shard_len();
        let scene = self.with_room(|engine| densify::apply(&engine.gpu, &mut engine.commands, &engine.scene, plan, shard_len))?;
        self.replace_scene(scene);
        self.timings[Pass::Densify as usize].time += start.elapsed();
        Ok(())
    }

    fn len(&self) -> usize {
        self.scene.count
    }

    fn timings(&self) -> &[PassTime] {
        &self.timings
    }
}

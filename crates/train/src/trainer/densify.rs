//! The parts of a step that add, remove and limit splats, where the schedule asks for them.
//!
//! In: statistics and geometry of the engine's scene. Out: a [`DensifyPlan`], which the engine
//! applies. Degenerate: a plan without a splat is [`TrainError::AllPruned`].

use luxel_core::engine::{DensifyPlan, PlanRow, StatsCollection};
use luxel_core::{Antialias, logit, spatial_order};

use super::Trainer;
use crate::config::Strategy;
use crate::contribution::{Round, contribution, visible_splats};
use crate::densify::{adc::Adc, mcmc::Mcmc};
use crate::{TrainError, free_space, smoothing};

/// The default of `percent_dense` with absolute gradients (AbsGS), and below it that of 3DGS.
const PERCENT_DENSE_ABSGRAD: f32 = 0.001;
const PERCENT_DENSE: f32 = 0.01;

/// Number of steps between two removals of splats in front of cameras, once none are added.
const CLEARING_INTERVAL: u32 = 100;

impl Trainer {
    /// Returns the statistics that `step` has to collect.
    pub(super) fn stats_of(&self, step: u32) -> StatsCollection {
        let config = &self.state.config;
        match config.strategy {
            Strategy::Adc if !self.schedule.is_densifying(step) => StatsCollection::Off,
            Strategy::Adc if config.absgrad => StatsCollection::GradientsAndAbsolute,
            Strategy::Adc => StatsCollection::Gradients,
            Strategy::Mcmc => StatsCollection::Off,
        }
    }

    /// Applies everything that is due after `step`: a round of densification, pruning of splats
    /// that are unseen or in front of cameras, a cap on opacities, the smoothing filter; nothing
    /// where geometry is frozen.
    pub(super) fn densify(&mut self, step: u32) -> Result<(), TrainError> {
        if self.state.config.freezes_geometry() {
            return Ok(());
        }
        let is_over = self.end_early(step) && !self.schedule.is_densifying(step);
        let is_round = self.schedule.densifies_after(step);
        let cap = self.schedule.opacity_cap_after(step);
        let unseen = self.unseen_after(step, is_over);
        let is_in_front = self.in_free_space(step)?;
        if is_round || unseen.is_some() || cap.is_some() || is_in_front.is_some() {
            let before = self.engine.len();
            let mut rows = if is_round { self.plan_round(step)? } else { all_rows(before) };
            if let Some(part) = unseen {
                let options = self.render_options_of(step);
                let is_visible = visible_splats(&mut *self.engine, &mut self.views, step, &options, part)?;
                rows.retain(|row| is_visible.get(row.source as usize).is_some_and(|visible| *visible));
            }
            if let Some(is_in_front) = is_in_front {
                rows.retain(|row| is_in_front.get(row.source as usize).is_none_or(|is_in_front| !is_in_front));
            }
            if rows.is_empty() {
                return Err(TrainError::AllPruned { step });
            }
            tracing::debug!(step, before, after = rows.len(), opacity_cap = cap, "densified");
            if let Some(method) = &mut self.method {
                method.densify(&rows);
            }
            self.engine.densify(&DensifyPlan { rows, opacity_logit_cap: cap.map(logit), smoothing: None })?;
        }
        let is_mip = self.state.config.antialias == Antialias::Mip;
        if is_mip && (is_round || self.schedule.smooths_after(step)) {
            self.update_smoothing()?;
        }
        Ok(())
    }

    /// Returns the fraction of the views' pixels below which splats are pruned as unseen, if that
    /// is due after `step`, as it is where densification `is_over` before its time.
    fn unseen_after(&self, step: u32, is_over: bool) -> Option<f32> {
        let (part, strategy) = (self.state.config.prune_unseen, self.state.config.strategy);
        let is_due = is_over || self.schedule.stops_adding_after(step);
        (part > 0.0 && strategy == Strategy::Adc && is_due).then_some(part)
    }

    /// Returns whether each splat is in the free space in front of a camera (`[N]`), if any is and
    /// pruning is due after `step`: at rounds while splats are added, later every 100 steps until
    /// the average begins.
    fn in_free_space(&mut self, step: u32) -> Result<Option<Vec<bool>>, TrainError> {
        let is_due = match self.schedule.is_densifying(step) {
            true => self.schedule.densifies_after(step),
            false => step.is_multiple_of(CLEARING_INTERVAL) && !self.schedule.is_averaging(step),
        };
        if !is_due || self.state.clearances.is_empty() {
            return Ok(None);
        }
        let positions = self.engine.geometry()?.position;
        let found = free_space::contains(&self.views.cameras(), &self.state.clearances, &positions);
        Ok(found.contains(&true).then_some(found))
    }

    /// Returns the rows of the scene after a round of densification, in spatial order.
    fn plan_round(&mut self, step: u32) -> Result<Vec<PlanRow>, TrainError> {
        let max_splats = self.room(step)?;
        let geometry = self.engine.geometry()?;
        let config = &self.state.config;
        let rows = match config.strategy {
            Strategy::Adc => {
                let percent = config.percent_dense.unwrap_or(if config.absgrad { PERCENT_DENSE_ABSGRAD } else { PERCENT_DENSE });
                let extent = self.state.extent;
                // Crops have larger gradients by splat than whole views, which thresholds are for.
                let factor = config.crop.map_or(1.0, |side_px| self.views.gradient_factor(step, side_px));
                let policy = Adc {
                    gradient_threshold: factor * config.densify_threshold,
                    absgrad_threshold: config.absgrad.then_some(factor * config.absgrad_threshold),
                    dense_scale: percent * extent,
                    prune_opacity: config.prune_opacity,
                    prune_scale: (config.prune_scale > 0.0 && self.schedule.has_reset_before(step)).then_some(config.prune_scale * extent),
                    max_splats,
                    max_replaced: (self.turnover() * max_splats as f32) as usize,
                };
                let (stats, options) = (self.engine.densify_stats()?, self.render_options_of(step));
                let round = Round { step, number: step / self.schedule.densify_interval };
                let contribution = || contribution(&mut *self.engine, &mut self.views, round, &options);
                policy.plan(&stats, &geometry, contribution, &mut self.state.rng)?
            }
            Strategy::Mcmc => {
                let policy = Mcmc { dead_opacity: config.prune_opacity, growth: config.mcmc_growth, max_splats };
                policy.plan(&geometry, &mut self.state.rng)
            }
        };
        let positions: Vec<[f32; 3]> = rows.iter().filter_map(|row| geometry.position.get(row.source as usize).copied()).collect();
        Ok(spatial_order(&positions).into_iter().filter_map(|i| rows.get(i as usize).copied()).collect())
    }

    /// Replaces the 3D filter of all splats.
    pub(super) fn update_smoothing(&mut self) -> Result<(), TrainError> {
        let positions = self.engine.geometry()?.position;
        let filter = smoothing(&positions, &self.views.cameras(), self.state.config.raster().cutoffs.near);
        let plan = DensifyPlan { rows: all_rows(positions.len()), opacity_logit_cap: None, smoothing: Some(filter) };
        Ok(self.engine.densify(&plan)?)
    }
}

fn all_rows(count: usize) -> Vec<PlanRow> {
    (0u32..).take(count).map(PlanRow::keep).collect()
}

#[cfg(test)]
mod tests {
    use luxel_core::{Dataset, Image, Point, Splat, Splats};
    use luxel_cpu::CpuEngine;

    use super::*;
    use crate::TrainConfig;
    use crate::config::Method;
    use crate::testing::{camera_at, dataset_of, view_of};

    /// Three cameras before a grey wall of points at z = 4.
    fn wall() -> Dataset {
        let view = |x: f64| view_of(&format!("{x}"), camera_at([x, 0.0, 0.0], [32, 32]), Image::filled(32, 32, [0.2; 3]));
        let mut dataset = dataset_of([-0.5, 0.0, 0.5].map(view).into());
        let point = |i: usize| Point {
            position: [0.25 * (i % 15) as f32 - 1.75, 0.25 * (i / 15) as f32 - 1.75, 4.0],
            rgb8: None,
            observations: Vec::new(),
        };
        dataset.points = (0..225).map(point).collect();
        dataset
    }

    fn trainer(method: Method, clearance: f32) -> Trainer {
        let config =
            TrainConfig { method, clearance, iterations: 400, densify_from: Some(50), densify_until: Some(300), ..TrainConfig::default() };
        Trainer::new(&wall(), config, Box::new(CpuEngine::new(1).unwrap())).unwrap()
    }

    /// Adds a faint, bright splat in front of the first camera, trains for 100 steps, and returns
    /// the distance of the nearest splat from the plane of the cameras.
    fn nearest_after_fog(mut trainer: Trainer) -> f32 {
        let (mut splats, _) = trainer.engine().save().unwrap();
        let mut fog: Splats = splats.select([0]);
        let (base, raw) = splats.color_model.constant([1.0; 3]);
        fog.sh[..3].copy_from_slice(&base);
        splats.push(&Splat {
            position: [-0.5, 0.0, 1.0],
            rotation: fog.rotation[0],
            log_scale: [0.05f32.ln(); 3],
            opacity_logit: logit(0.05),
            sh: &fog.sh,
            raw_luminance: &vec![raw; splats.color_model.luminance_coefficients()],
        });
        trainer.engine().load(&splats, None).unwrap();
        for _ in 0..100 {
            trainer.step().unwrap();
        }
        let positions = trainer.engine().geometry().unwrap().position;
        positions.iter().map(|at| at[2]).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn a_splat_in_front_of_a_camera_is_pruned_whatever_the_colour_model() {
        for method in [Method::Lcd, Method::Sh3] {
            assert!(nearest_after_fog(trainer(method, 0.0)) < 1.5, "{method:?}");
            assert!(nearest_after_fog(trainer(method, 0.4)) > 1.6, "{method:?}");
        }
    }

    #[test]
    fn a_resumed_run_has_the_same_free_space() {
        let mut first = trainer(Method::Lcd, 0.4);
        let radii = first.state.clearances.clone();
        assert!(radii.len() == 3 && radii.iter().all(|radius| (1.5..1.9).contains(radius)), "{radii:?}");
        let snapshot = first.snapshot().unwrap();
        let resumed = Trainer::resume(&wall(), snapshot, Box::new(CpuEngine::new(1).unwrap())).unwrap();
        assert_eq!(resumed.state.clearances, radii);
    }
}

//! The plan of a run, made anew while it goes on: for runs within a given time, and where more
//! steps would gain little on views that are not trained on.
//!
//! A plan is a number of steps and the resolutions of its images. Rates, densification, degrees,
//! samples and averaging are parts of the whole ([`Schedule`]), so they move with it.

use std::ops::RangeInclusive;

use super::Trainer;
use crate::resolution::{self, ResolutionSchedule, Stage};
use crate::{Schedule, TrainConfig};

/// Part of the planned steps from which a run may end early. Images have had their full size since
/// 0.35 of them, so some rounds have compared validation views.
const EARLY_END_FROM: f64 = 0.4;

/// Least lead of views that are trained on over validation views at which a run ends early, dB.
const EARLY_END_LEAD_DB: f64 = 3.0;

impl Trainer {
    /// Plans the run for `iterations` steps in all, in place of those that it was planned for.
    pub fn plan(&mut self, iterations: u32, resolution: ResolutionSchedule) {
        self.state.config.early_end = None;
        self.state.config.resolution_schedule = resolution;
        self.plan_steps(iterations);
    }

    fn plan_steps(&mut self, iterations: u32) {
        self.state.planned_iterations = iterations.max(1);
        self.move_end(iterations);
        self.views.set_stages(stages(&self.state.config, &self.schedule, self.views.smallest_side_px()));
    }

    /// Plans the run for `early_end` steps, if it has more, and if validation views lag behind at a
    /// round of densification after `step`. Returns whether it does; with `adc`, no more splats are
    /// added then.
    pub(super) fn end_early(&mut self, step: u32) -> bool {
        let planned = self.state.planned_iterations;
        let is_due = self.schedule.densifies_after(step) && f64::from(step) >= EARLY_END_FROM * f64::from(planned);
        let end = self.state.config.early_end.filter(|end| is_due && (step + 1..planned).contains(end));
        let Some(end) = end.filter(|_| self.state.fit.is_some_and(|fit| fit.lead_db >= EARLY_END_LEAD_DB)) else { return false };
        tracing::info!(step, end, "early end");
        self.plan_steps(end);
        true
    }

    /// Returns whether the run is planned for `early_end` steps.
    pub fn ends_early(&self) -> bool {
        self.state.config.early_end == Some(self.state.planned_iterations)
    }

    /// Returns the steps that a plan would leave, in steps as costly as the last `made` ones on
    /// average.
    pub fn steps_left_by(&self, iterations: u32, resolution: &ResolutionSchedule, made: u32) -> f64 {
        let step = self.state.iteration;
        let config = TrainConfig { iterations, resolution_schedule: resolution.clone(), ..self.state.config.clone() };
        let schedule = Schedule::new(&config, iterations, self.schedule.extent);
        let stages = stages(&config, &schedule, self.views.smallest_side_px());
        let left = resolution::work(&stages, step + 1..=iterations, |step| schedule.samples_per_pixel(step));
        let made = made.min(step);
        let of_made = resolution::work(self.views.stages(), step - made + 1..=step, |step| self.schedule.samples_per_pixel(step));
        if of_made > 0.0 { left * f64::from(made) / of_made } else { f64::from(iterations.saturating_sub(step)) }
    }

    /// Returns the numbers of steps that the run may be planned for from here on: densification and
    /// samples that have ended or begun stay so, and an average that is being taken goes on.
    pub fn possible_plans(&self) -> RangeInclusive<u32> {
        let (step, planned) = (self.state.iteration, self.state.planned_iterations);
        if self.average.is_some() || self.schedule.is_averaging(step.saturating_add(1)) {
            return planned..=planned;
        }
        let scaled = |limit: u32| (u64::from(step) * u64::from(planned) / u64::from(limit.max(1))).try_into().unwrap_or(u32::MAX);
        let mut most = u32::MAX;
        if step >= self.schedule.densify_until {
            most = scaled(self.schedule.densify_until);
        }
        let (samples, first) = self.schedule.samples;
        if samples > 1 && step >= first {
            most = most.min(scaled(first));
        }
        step + 1..=most.max(step + 1)
    }

    /// Returns the smallest side of the training images, pixels.
    pub fn smallest_side_px(&self) -> u32 {
        self.views.smallest_side_px()
    }
}

/// Returns the stages of the resolution that a configuration asks for.
pub(super) fn stages(config: &TrainConfig, schedule: &Schedule, smallest_side_px: u32) -> Vec<Stage> {
    config.resolution_schedule.stages(schedule.iterations, schedule.densify_interval, smallest_side_px)
}

#[cfg(test)]
mod tests {
    use luxel_core::{Dataset, Image, Point};
    use luxel_cpu::CpuEngine;

    use super::*;
    use crate::config::LateViews;
    use crate::testing::{camera_at, dataset_of, view_of};
    use crate::validation_views::Fit;

    fn dataset() -> Dataset {
        let view = |i: usize| view_of(&format!("{i}"), camera_at([0.1 * i as f64, 0.0, 0.0], [24, 24]), Image::filled(24, 24, [0.5; 3]));
        let points =
            (0..50).map(|i| Point { position: [0.1 * (i % 10) as f32, 0.1 * (i / 10) as f32, 4.0], rgb8: None, observations: Vec::new() });
        Dataset { points: points.collect(), ..dataset_of((0..3).map(view).collect()) }
    }

    fn trainer(iterations: u32, samples: u8) -> Trainer {
        let shares = TrainConfig { samples_share: 0.25, average_share: 0.15, late_views: LateViews::Whole, ..TrainConfig::default() };
        let config = TrainConfig { iterations, samples: Some(samples), ..shares };
        Trainer::new(&dataset(), config, Box::new(CpuEngine::new(1).unwrap())).unwrap()
    }

    /// A run of 60 steps that may end after 40, and whose validation views lag behind by `lead_db`.
    fn lagging(lead_db: f64) -> Trainer {
        let mut trainer = trainer(60, 1);
        let config = &mut trainer.state.config;
        (config.early_end, config.densify_from, config.densify_interval) = (Some(40), Some(0), Some(4));
        trainer.state.fit = Some(Fit { room: 50, lead_db });
        trainer.move_end(60);
        trainer
    }

    #[test]
    fn a_plan_moves_the_whole_schedule() {
        let mut trainer = trainer(1000, 1);
        for _ in 0..3 {
            trainer.step().unwrap();
        }
        trainer.plan(40, ResolutionSchedule::Off);
        assert_eq!(trainer.schedule(), self::trainer(40, 1).schedule());
        assert_eq!((trainer.config().iterations, trainer.possible_plans()), (40, 4..=u32::MAX));
        assert_eq!(trainer.steps_left_by(43, &ResolutionSchedule::Off, 3), 40.0);
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        assert_eq!(trainer.iteration(), 40);
    }

    #[test]
    fn a_run_ends_early_where_validation_views_lag_behind_unless_its_end_was_moved() {
        let end = |lead_db, moved: Option<u32>| {
            let mut trainer = lagging(lead_db);
            moved.into_iter().for_each(|iterations| trainer.set_iterations(iterations));
            let mut adding = 0;
            while !trainer.is_finished() {
                trainer.step().unwrap();
                adding += u32::from(trainer.schedule().is_densifying(trainer.iteration()));
            }
            assert_eq!(trainer.ends_early(), trainer.iteration() == 40);
            [trainer.iteration(), trainer.state.planned_iterations, adding]
        };
        // The first round from 0.4 of 60 steps on is that of step 24.
        assert_eq!(end(5.0, None), [40, 40, 23]);
        assert_eq!(end(2.0, None), [60, 60, 29]);
        assert_eq!(end(5.0, Some(60)), [60, 60, 29]);
        assert_eq!(end(5.0, Some(70)), [70, 60, 29]);
    }

    #[test]
    fn a_resumed_run_keeps_its_early_end() {
        let mut trainer = lagging(5.0);
        while trainer.iteration() < 30 {
            trainer.step().unwrap();
        }
        let resumed = Trainer::resume(&dataset(), trainer.snapshot().unwrap(), Box::new(CpuEngine::new(1).unwrap())).unwrap();
        assert!(resumed.ends_early() && resumed.config().iterations == 40);
        assert_eq!(resumed.schedule(), trainer.schedule());
    }

    #[test]
    fn a_run_from_before_early_ends_makes_all_its_steps() {
        let mut snapshot = trainer(60, 1).snapshot().unwrap();
        let old = snapshot.state_json.replace("\"early_end\":5500,", "");
        assert_ne!(old, snapshot.state_json);
        snapshot.state_json = old;
        assert_eq!(crate::snapshot_config(&snapshot).unwrap().early_end, None);
    }

    #[test]
    fn what_has_ended_does_not_begin_again() {
        let mut trainer = trainer(40, 2);
        let mut most = Vec::new();
        while !trainer.is_finished() {
            trainer.step().unwrap();
            most.push(*trainer.possible_plans().end());
        }
        // Densification ends at step 20, samples begin at step 31, the average at 35.
        assert_eq!([most[18], most[19], most[29], most[30], most[34]], [u32::MAX, 40, 60, 40, 40]);
    }
}

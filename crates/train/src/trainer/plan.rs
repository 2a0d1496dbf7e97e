//! The plan of a run, made anew while it goes on: for runs within a given time.
//!
//! A plan is a number of steps and the resolutions of its images. Rates, densification, degrees,
//! samples and averaging are parts of the whole ([`Schedule`]), so they move with it.

use std::ops::RangeInclusive;

use super::Trainer;
use crate::resolution::{self, ResolutionSchedule, Stage};
use crate::{Schedule, TrainConfig};

impl Trainer {
    /// Plans the run for `iterations` steps in all, in place of those that it was planned for.
    pub fn plan(&mut self, iterations: u32, resolution: ResolutionSchedule) {
        self.state.config.resolution_schedule = resolution;
        self.state.planned_iterations = iterations.max(1);
        self.set_iterations(iterations);
        self.views.set_stages(stages(&self.state.config, &self.schedule, self.views.smallest_side_px()));
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

    fn trainer(iterations: u32, samples: u8) -> Trainer {
        let view = |i: usize| view_of(&format!("{i}"), camera_at([0.1 * i as f64, 0.0, 0.0], [24, 24]), Image::filled(24, 24, [0.5; 3]));
        let points =
            (0..50).map(|i| Point { position: [0.1 * (i % 10) as f32, 0.1 * (i / 10) as f32, 4.0], rgb8: None, observations: Vec::new() });
        let dataset = Dataset { points: points.collect(), ..dataset_of((0..3).map(view).collect()) };
        let shares = TrainConfig { samples_share: 0.25, average_share: 0.15, late_views: LateViews::Whole, ..TrainConfig::default() };
        let config = TrainConfig { iterations, samples: Some(samples), ..shares };
        Trainer::new(&dataset, config, Box::new(CpuEngine::new(1).unwrap())).unwrap()
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

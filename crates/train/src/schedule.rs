//! The schedule: everything that depends on the step alone.
//!
//! In: the configuration, the number of steps that the run was planned for, and the scene's extent
//! (world units). Out: the learning rates, the active degree and the densification rounds of a step
//! (1 for the first). Source: Kerbl et al. 2023; 3DGS-MCMC (Kheradmand et al. 2024). Beyond the
//! planned end all rates keep their final values. A run of frozen geometry densifies nothing, and
//! its rates of geometry and opacity are 0. The averaged steps lie before the current end,
//! which may differ from the planned one.
//!
//! Published schedules are for 30000 steps. In shorter runs the end of densification and all decays
//! scale in proportion; in runs below 10000 steps, the start of densification and the increases of
//! the degree scale too, and in runs below 9000 steps the interval between rounds, down to 50
//! steps. Resets stay as many steps apart, because opacities need a fixed number of steps to
//! recover: with 3000, a run of 10000 steps has one reset instead of four.
//! After the last reset, splats need time to prove useless. In 3DGS a whole reset interval of
//! rounds follows it; here at least a third of an interval must follow, or the reset is left out.
//!
//! With several views a step, these numbers of steps are numbers of views: a run of a quarter of
//! the steps with four views each has as many rounds and resets, at the same views.

use luxel_core::engine::LearningRates;

use crate::config::{Strategy, TrainConfig};
use crate::crop::STRIP_SHARE;

/// Divisor of the learning rate of harmonics above degree 0, relative to the constant term (Kerbl
/// et al. 2023).
const REST_LR_DIVISOR: f32 = 20.0;

/// Number of steps between two reductions of all opacities to [`ABSGRAD_OPACITY_CAP`] (AbsGS).
const ABSGRAD_CAP_INTERVAL: u32 = 500;

/// Opacity to which AbsGS lowers all higher opacities, so that occluded splats get gradients.
pub const ABSGRAD_OPACITY_CAP: f32 = 0.8;

/// Opacity to which a reset lowers all higher opacities.
pub const RESET_OPACITY: f32 = 0.01;

/// Divisor of the reset interval: a reset takes place if more than this part of an interval is left
/// of densification.
const RESET_TAIL_DIVISOR: u32 = 3;

/// Number of steps after a reset in which renders are too faint to be compared with images. At its
/// rate of 0.05, a splat's logit takes 140 steps from an opacity of 0.01 to 0.9, and only steps
/// whose view sees the splat count.
const RECOVERY_STEPS: u32 = 600;

/// Greatest number of rounds of densification that the steps of a run would have room for, if it
/// lasted to the end.
const ROUNDS: u32 = 90;

/// Least and greatest number of steps between two rounds, unless a number is given: a round needs
/// the statistics of some views, and in short runs many rounds are worth more than good ones.
const ROUND_INTERVALS: [u32; 2] = [50, 100];

/// Number of steps between two updates of the 3D smoothing filter.
const SMOOTHING_INTERVAL: u32 = 100;

/// Largest number of states that are averaged: enough for a steady mean, few enough to cost little.
const AVERAGED_STATES: u32 = 32;

/// The schedule of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// Number of steps the run was planned for, after which learning rates have their final values.
    pub iterations: u32,
    /// Step after which the run ends now.
    pub end: u32,
    /// Number of views a step.
    pub batch: u32,
    /// Extent of the scene, world units; learning rates of positions are multiples of it.
    pub extent: f32,
    /// Number of steps after which one more degree of the harmonics becomes active.
    pub sh_interval: u32,
    /// Step after which densification begins.
    pub densify_from: u32,
    /// Step before which densification ends.
    pub densify_until: u32,
    /// Number of steps between two rounds of densification.
    pub densify_interval: u32,
    /// Number of steps between two opacity resets; `None` for no resets.
    pub reset_interval: Option<u32>,
    /// Whether opacities are reduced as in AbsGS.
    pub reduces_opacity: bool,
    /// Number of samples along a pixel's side, and the step before which there is one.
    pub samples: (u8, u32),
    /// Whether steps train on strips of their views once no more splats are added.
    pub has_late_strips: bool,
    /// Steps after which poses are optimised and fixed again; `None` if they are fixed throughout.
    pub poses: Option<[u32; 2]>,
    /// Number of steps before `end` that are averaged, none of them before densification ends or in
    /// the first half of the supersampled steps, if there are others; 0 for none.
    pub averaged_steps: u32,
}

impl Schedule {
    /// Returns the schedule of `config` for a run planned for `iterations` steps; the run ends
    /// after `config.iterations`.
    pub fn new(config: &TrainConfig, iterations: u32, extent: f32) -> Self {
        let is_adc = config.strategy == Strategy::Adc;
        let default_until = if is_adc { iterations / 2 } else { (u64::from(iterations) * 5 / 6) as u32 };
        let is_frozen = config.freezes_geometry();
        let densify_until = if is_frozen { 0 } else { config.densify_until.unwrap_or(default_until) };
        let sampled_steps = (f64::from(iterations) * f64::from(config.samples_share)).round() as u32;
        let end = config.iterations;
        let (batch, views) = (config.batch.max(1), iterations.saturating_mul(config.batch.max(1)));
        let steps_of = |views: u32| views.div_ceil(batch);
        let [least, most] = ROUND_INTERVALS;
        let default_interval = if is_adc { (views / ROUNDS).clamp(least, most) } else { most };
        let averaged_steps = (f64::from(end) * f64::from(config.average_share)) as u32;
        let samples = config.raster().samples;
        let unsampled_steps = if samples > 1 { iterations.saturating_sub(sampled_steps) } else { 0 };
        let adapted = if unsampled_steps > 0 { unsampled_steps + sampled_steps / 2 } else { 0 };
        let unaveraged_steps = match end {
            end if end > adapted => densify_until.max(adapted),
            // A run that ends early has the states that it has.
            end if end > unsampled_steps => densify_until.max(unsampled_steps),
            _ => densify_until,
        };
        Self {
            iterations,
            end,
            batch,
            extent,
            sh_interval: config.sh_interval.unwrap_or(steps_of((views / 10).clamp(1, 1000))),
            densify_from: config.densify_from.unwrap_or(steps_of((views / 20).min(500))),
            densify_until,
            densify_interval: steps_of(config.densify_interval.unwrap_or(default_interval).max(1)),
            reset_interval: (is_adc && !is_frozen && config.opacity_reset_interval > 0).then_some(steps_of(config.opacity_reset_interval)),
            reduces_opacity: is_adc && !is_frozen && config.absgrad,
            samples: (samples, iterations.saturating_sub(sampled_steps) + 1),
            has_late_strips: config.takes_late_strips(),
            poses: config.refine_poses.then(|| pose_steps(config, iterations)),
            averaged_steps: averaged_steps.min(end.saturating_sub(unaveraged_steps)),
        }
    }

    /// Returns the number of steps that see as many views.
    fn steps_of(&self, views: u32) -> u32 {
        views.div_ceil(self.batch)
    }

    /// Returns the highest degree of harmonics that is active in `step`.
    pub fn active_degree(&self, step: u32, max_degree: usize) -> usize {
        max_degree.min((step / self.sh_interval) as usize)
    }

    /// Returns the number of samples along a pixel's side in `step`.
    pub fn samples(&self, step: u32) -> u8 {
        let (samples, first) = self.samples;
        if step < first { 1 } else { samples }
    }

    /// Returns whether `step` trains on a strip of its view.
    pub fn takes_strips(&self, step: u32) -> bool {
        self.has_late_strips && step > self.densify_until
    }

    /// Returns the samples of `step` on average over the pixels of its whole view.
    pub fn samples_per_pixel(&self, step: u32) -> f64 {
        let share = if self.takes_strips(step) { STRIP_SHARE } else { 1.0 };
        f64::from(self.samples(step)).powi(2) * share
    }

    /// Returns the fraction of the splats that `step` leaves out, if any: it rises linearly from 0,
    /// and stays at `dropout` where a run goes on beyond its planned end. Frozen geometry, which
    /// cannot make up for what is missing, is left whole.
    pub fn dropout_rate(&self, config: &TrainConfig, step: u32) -> Option<f32> {
        if config.freezes_geometry() {
            return None;
        }
        let rate = config.dropout * (step as f32 / self.iterations.max(1) as f32).min(1.0);
        (rate > 0.0).then_some(rate)
    }

    /// Returns whether `step` collects statistics for densification.
    pub fn is_densifying(&self, step: u32) -> bool {
        step < self.densify_until
    }

    /// Returns whether a round of densification takes place after `step`.
    pub fn densifies_after(&self, step: u32) -> bool {
        self.is_densifying(step) && step > self.densify_from && step.is_multiple_of(self.densify_interval)
    }

    /// Returns whether densification ends at `step`, after which unseen splats are pruned once.
    pub fn stops_adding_after(&self, step: u32) -> bool {
        step == self.densify_until
    }

    /// Returns whether all opacities are reset after `step`.
    pub fn resets_after(&self, step: u32) -> bool {
        self.reset_interval.is_some_and(|interval| step.is_multiple_of(interval) && self.leaves_time_after_reset(step, interval))
    }

    /// Returns whether enough of densification is left after a reset after `step`.
    fn leaves_time_after_reset(&self, step: u32, interval: u32) -> bool {
        self.densify_until.saturating_sub(step) > interval / RESET_TAIL_DIVISOR
    }

    /// Returns whether opacities are still recovering from a reset before `step`, which makes its
    /// render too faint to be measured. Recovery takes at most half of the reset interval, so that
    /// frequent resets leave steps to measure.
    pub fn is_recovering(&self, step: u32) -> bool {
        let Some(interval) = self.reset_interval else { return false };
        let since = step % interval;
        step > interval && (1..=self.steps_of(RECOVERY_STEPS).min(interval / 2)).contains(&since) && self.resets_after(step - since)
    }

    /// Returns whether a reset lies before `step`; from then on large splats are pruned.
    pub fn has_reset_before(&self, step: u32) -> bool {
        self.reset_interval.is_some_and(|interval| step > interval && self.leaves_time_after_reset(interval, interval))
    }

    /// Returns the opacity to which all higher opacities are lowered after `step`.
    pub fn opacity_cap_after(&self, step: u32) -> Option<f32> {
        if self.resets_after(step) {
            return Some(RESET_OPACITY);
        }
        let is_due = self.reduces_opacity && self.is_densifying(step) && step > self.densify_from;
        (is_due && step.is_multiple_of(self.steps_of(ABSGRAD_CAP_INTERVAL))).then_some(ABSGRAD_OPACITY_CAP)
    }

    /// Returns whether the 3D smoothing filter is updated after `step`, apart from densification.
    /// While splats are added, the rounds update it, because an update starts the statistics anew.
    pub fn smooths_after(&self, step: u32) -> bool {
        (step >= self.densify_until || step <= self.densify_from) && step.is_multiple_of(self.steps_of(SMOOTHING_INTERVAL))
    }

    /// Returns whether `step` is among the steps that are averaged.
    pub fn is_averaging(&self, step: u32) -> bool {
        self.end.checked_sub(step).is_some_and(|left| left < self.averaged_steps)
    }

    /// Returns whether the parameters after `step` are added to the average: those of the last
    /// step, and others at equal distances before it.
    pub fn averages_after(&self, step: u32) -> bool {
        let interval = self.averaged_steps.div_ceil(AVERAGED_STATES);
        self.is_averaging(step) && (self.end - step).is_multiple_of(interval)
    }

    /// Returns whether densification lasts to the end, so that there is nothing to average.
    pub fn densifies_to_the_end(&self) -> bool {
        self.densify_until >= self.end
    }

    /// Returns the fraction of the steps that optimise poses which are done before `step`; `None`
    /// if `step` is not one of them. While opacities recover from a reset, images say little about
    /// poses.
    pub fn pose_progress(&self, step: u32) -> Option<f64> {
        let [from, until] = self.poses?;
        let is_due = step > from && step <= until && !self.is_recovering(step);
        is_due.then(|| f64::from(step - from - 1) / f64::from(until - from))
    }

    /// Returns the learning rates of `step`.
    pub fn learning_rates(&self, config: &TrainConfig, step: u32) -> LearningRates {
        let progress = (f64::from(step) / f64::from(self.iterations.max(1))).min(1.0);
        let decayed = |first: f32, last: Option<f32>| last.map_or(first, |last| log_linear(first, last, progress));
        let sh = decayed(config.sh_lr, config.sh_lr_final);
        let luminance = decayed(config.luminance_lr, config.luminance_lr_final);
        let rates = LearningRates {
            position: log_linear(config.position_lr, config.position_lr_final, progress) * self.extent,
            rotation: config.rotation_lr,
            log_scale: decayed(config.scale_lr, config.scale_lr_final),
            opacity_logit: decayed(config.opacity_lr, config.opacity_lr_final),
            sh_dc: sh,
            sh_rest: sh / REST_LR_DIVISOR,
            luminance_dc: luminance,
            luminance_rest: luminance / REST_LR_DIVISOR,
        };
        // Engines leave parameters with a rate of 0 as they are, to the bit.
        if config.freezes_geometry() {
            LearningRates { position: 0.0, rotation: 0.0, log_scale: 0.0, opacity_logit: 0.0, ..rates }
        } else {
            rates
        }
    }
}

/// Interpolates from `first` to `last` (both > 0) linearly in the logarithm.
fn log_linear(first: f32, last: f32, progress: f64) -> f32 {
    let (first, last) = (f64::from(first).ln(), f64::from(last).ln());
    (first + (last - first) * progress).exp() as f32
}

/// Returns the steps after which poses are optimised and fixed again, in a run planned for
/// `iterations` steps.
fn pose_steps(config: &TrainConfig, iterations: u32) -> [u32; 2] {
    let until = config.pose_until.unwrap_or((u64::from(iterations) * 4 / 5) as u32);
    [config.pose_from.unwrap_or(iterations / 10), until]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::LateViews;

    fn schedule(iterations: u32) -> (TrainConfig, Schedule) {
        let config = TrainConfig { iterations, opacity_reset_interval: 3000, ..TrainConfig::default() };
        let schedule = Schedule::new(&config, iterations, 2.0);
        (config, schedule)
    }

    #[test]
    fn thirty_thousand_steps_follow_3dgs() {
        let (config, s) = schedule(30_000);
        let rounds: Vec<u32> = (1..=30_000).filter(|t| s.densifies_after(*t)).collect();
        assert_eq!((rounds.first(), rounds.last(), rounds.len()), (Some(&600), Some(&14_900), 144));
        let resets: Vec<u32> = (1..=30_000).filter(|t| s.resets_after(*t)).collect();
        assert_eq!(resets, [3000, 6000, 9000, 12_000]);
        assert!(!s.has_reset_before(3000) && s.has_reset_before(3001));
        assert_eq!([999, 1000, 2999, 3000, 30_000].map(|t| s.active_degree(t, 3)), [0, 1, 2, 3, 3]);
        let rates = s.learning_rates(&config, 15_000);
        assert!((rates.position / (8e-5 * 2.0) - 1.0).abs() < 1e-4, "{}", rates.position);
        assert_eq!((rates.sh_dc, rates.sh_rest, rates.luminance_dc), (2.5e-3, 2.5e-3 / 20.0, 0.05));
    }

    #[test]
    fn several_views_a_step_make_a_schedule_of_as_many_views() {
        let of = |iterations, batch| {
            let config = TrainConfig { iterations, batch, ..TrainConfig::default() };
            Schedule::new(&config, iterations, 2.0)
        };
        for (one, four) in [(of(30_000, 1), of(7500, 4)), (of(8000, 1), of(2000, 4))] {
            let steps = |s: &Schedule, is_due: fn(&Schedule, u32) -> bool| {
                (1..=s.iterations).filter(|step| is_due(s, *step)).map(|step| step * s.batch).collect::<Vec<u32>>()
            };
            assert_eq!(steps(&one, Schedule::densifies_after), steps(&four, Schedule::densifies_after));
            assert_eq!(steps(&one, Schedule::resets_after), steps(&four, Schedule::resets_after));
            assert_eq!([one.sh_interval, one.densify_from], [4 * four.sh_interval, 4 * four.densify_from]);
        }
    }

    #[test]
    fn the_end_of_a_run_is_supersampled() {
        let samples = |share: f32| {
            let config = TrainConfig { samples: Some(2), samples_share: share, iterations: 1000, ..TrainConfig::default() };
            let schedule = Schedule::new(&config, 1000, 2.0);
            [0, 1, 750, 751, 1000, 1001].map(|step| schedule.samples(step))
        };
        assert_eq!(samples(0.25), [1, 1, 1, 2, 2, 2]);
        assert_eq!(samples(1.0), [1, 2, 2, 2, 2, 2]);
        assert_eq!(samples(0.0), [1, 1, 1, 1, 1, 2]);
        assert_eq!(schedule(1000).1.samples(1000), 1);
    }

    #[test]
    fn the_end_of_a_run_is_averaged() {
        let averaged = |config: TrainConfig| -> Vec<u32> {
            let s = Schedule::new(&config, config.iterations, 2.0);
            (1..=config.iterations + 100).filter(|t| s.averages_after(*t)).collect()
        };
        let config = |iterations, average_share| TrainConfig { iterations, average_share, ..TrainConfig::default() };
        let long = averaged(config(30_000, 0.15));
        assert_eq!((long.len(), long[0], long.last()), (32, 25_629, Some(&30_000)));
        assert_eq!(averaged(config(20, 0.15)), [18, 19, 20]);
        assert_eq!(averaged(TrainConfig { densify_until: Some(19), ..config(20, 0.15) }), [20]);
        assert_eq!(averaged(TrainConfig { densify_until: Some(50), ..config(20, 0.15) }), Vec::<u32>::new());
        assert_eq!(averaged(config(20, 0.0)), Vec::<u32>::new());
    }

    #[test]
    fn only_steps_that_have_adapted_to_supersampling_are_averaged() {
        let averaged = |samples, samples_share| {
            let config =
                TrainConfig { samples: Some(samples), samples_share, average_share: 0.15, iterations: 1000, ..TrainConfig::default() };
            Schedule::new(&config, 1000, 2.0).averaged_steps
        };
        assert_eq!([averaged(2, 0.4), averaged(2, 0.12), averaged(2, 0.0), averaged(2, 1.0), averaged(1, 0.12)], [150, 60, 150, 150, 150]);
    }

    #[test]
    fn a_run_that_ends_early_averages_what_it_has_adapted() {
        let averaged = |end| {
            let config =
                TrainConfig { samples: Some(2), samples_share: 0.2, average_share: 0.15, iterations: end, ..TrainConfig::default() };
            Schedule::new(&config, 1000, 2.0).averaged_steps
        };
        // Supersampled from 801, adapted from 901.
        assert_eq!([1000, 950, 900, 850, 800].map(averaged), [100, 50, 100, 50, 120]);
    }

    #[test]
    fn the_average_is_taken_before_the_current_end() {
        let of = |planned, end| {
            let config = TrainConfig { average_share: 0.15, iterations: end, ..TrainConfig::default() };
            let s = Schedule::new(&config, planned, 2.0);
            let averaged: Vec<u32> = (1..=10_000).filter(|t| s.averages_after(*t)).collect();
            (averaged.first().copied(), averaged.last().copied(), s.densifies_to_the_end())
        };
        assert_eq!(of(3000, 3000), (Some(2565), Some(3000), false));
        assert_eq!(of(3000, 3600), (Some(3073), Some(3600), false));
        assert_eq!(of(3000, 2000), (Some(1710), Some(2000), false));
        // Splats are added until step 1500, as planned.
        assert_eq!(of(3000, 1600), (Some(1504), Some(1600), false));
        assert_eq!(of(3000, 1500), (None, None, true));
    }

    #[test]
    fn renders_recover_from_a_reset_and_from_nothing_else() {
        let s = schedule(30_000).1;
        let steps = [600, 2999, 3000, 3001, 3600, 3601, 6001, 12_600, 12_601, 15_001, 29_000];
        let recovering: Vec<u32> = steps.into_iter().filter(|t| s.is_recovering(*t)).collect();
        assert_eq!(recovering, [3001, 3600, 6001, 12_600]);
        assert!((1..=6000).all(|t| !schedule(6000).1.is_recovering(t)), "no reset takes place");
        let often = Schedule { reset_interval: Some(100), ..s.clone() };
        assert_eq!([50, 100, 101, 150, 151, 201].map(|t| often.is_recovering(t)), [false, false, true, true, false, true]);
        assert!((1..=100).all(|t| !Schedule { reset_interval: Some(1), ..s.clone() }.is_recovering(t)));
    }

    #[test]
    fn strips_come_after_the_last_round() {
        let config = TrainConfig { iterations: 100, late_views: LateViews::Strips, ..TrainConfig::default() };
        let strips = |config: &TrainConfig| {
            let s = Schedule::new(config, config.iterations, 2.0);
            (1..=config.iterations).filter(|step| s.takes_strips(*step)).collect::<Vec<_>>()
        };
        assert_eq!(strips(&config), (51..=100).collect::<Vec<_>>());
        assert!(strips(&TrainConfig { late_views: LateViews::Whole, ..config.clone() }).is_empty());
        let s = Schedule::new(&TrainConfig { samples: Some(2), ..config }, 100, 2.0);
        assert_eq!([1, 51, 100].map(|step| s.samples_per_pixel(step)), [1.0, STRIP_SHARE, 4.0 * STRIP_SHARE]);
    }

    #[test]
    fn rates_stay_at_their_last_value_beyond_the_planned_end() {
        let (mut config, s) = schedule(1000);
        config.luminance_lr_final = Some(0.002);
        assert_eq!(s.learning_rates(&config, 1000), s.learning_rates(&config, 5000));
        assert!((s.learning_rates(&config, 1000).luminance_dc - 0.002).abs() < 1e-7);
        assert!((s.learning_rates(&config, 500).luminance_dc - 0.01).abs() < 1e-6);
    }

    #[test]
    fn only_rates_with_a_final_value_decay() {
        let (config, s) = schedule(1000);
        let decaying =
            TrainConfig { sh_lr_final: Some(2.5e-5), opacity_lr_final: Some(5e-4), scale_lr_final: Some(5e-5), ..config.clone() };
        let (first, half, last) = (s.learning_rates(&config, 500), s.learning_rates(&decaying, 500), s.learning_rates(&decaying, 1000));
        for (name, first, half, last) in [
            ("sh", first.sh_dc, half.sh_dc, last.sh_dc),
            ("sh above", first.sh_rest, half.sh_rest, last.sh_rest),
            ("opacity", first.opacity_logit, half.opacity_logit, last.opacity_logit),
            ("scale", first.log_scale, half.log_scale, last.log_scale),
        ] {
            assert!((half / first * 10.0 - 1.0).abs() < 1e-4 && (last / first * 100.0 - 1.0).abs() < 1e-4, "{name}: {first} {half} {last}");
        }
        assert_eq!((half.luminance_dc, half.rotation, half.position), (first.luminance_dc, first.rotation, first.position));
    }

    #[test]
    fn a_reset_leaves_a_third_of_its_interval_for_rounds() {
        let resets = |iterations| {
            let s = schedule(iterations).1;
            let resets: Vec<u32> = (1..=iterations).filter(|t| s.resets_after(*t)).collect();
            assert_eq!(s.has_reset_before(iterations), !resets.is_empty());
            resets
        };
        assert_eq!([resets(6000), resets(8000), resets(8002), resets(10_000)], [vec![], vec![], vec![3000], vec![3000]]);
        assert_eq!(resets(15_000), [3000, 6000]);
    }

    #[test]
    fn short_runs_are_short_versions_of_the_long_one() {
        let (_, s) = schedule(2000);
        let rounds: Vec<u32> = (1..=2000).filter(|t| s.densifies_after(*t)).collect();
        assert_eq!((rounds.first(), rounds.last(), rounds.len()), (Some(&150), Some(&950), 17));
        assert!((1..=2000).all(|t| !s.resets_after(t)));
        assert!(!s.has_reset_before(2000), "no reset takes place, so none lies before");
        assert_eq!(s.active_degree(600, 3), 3);
        // The shortest run there is has no division by zero.
        let (config, s) = schedule(1);
        assert!(s.learning_rates(&config, 1).position.is_finite());
        assert!(!s.densifies_after(1));
    }

    #[test]
    fn absgrad_lowers_opacities_between_resets() {
        let config = TrainConfig { absgrad: true, opacity_reset_interval: 3000, ..TrainConfig::default() };
        let s = Schedule::new(&config, 30_000, 1.0);
        assert_eq!([500, 600, 1000, 3000, 15_000].map(|t| s.opacity_cap_after(t)), [None, None, Some(0.8), Some(0.01), None]);
    }
}

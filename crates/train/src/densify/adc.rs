//! Adaptive density control: clone, split, prune (Kerbl et al. 2023), with AbsGS's thresholds as an
//! option (Ye et al. 2024).
//!
//! In: `stats [N]` since the last round, `geometry [N]`, thresholds. Out: the rows of the new
//! scene, in this order: splats that stay, clones, halves of split splats. The gradient of a splat
//! is its mean over the views in which it was visible, in NDC units. A splat that was never visible
//! has gradient 0 and stays unless it is transparent.
//!
//! With a bound on the number of splats alone, growth would end early, as soon as the bound is
//! reached. Therefore each round that needs more room relocates a fraction of the splats: it prunes
//! those that contribute least to the views, as the budgets of Mini-Splatting (Fang and Wang 2024)
//! and Taming 3DGS (Mallick et al. 2024) do, and gives their places to the splats with the largest
//! gradients.

use luxel_core::engine::{DensifyStats, Geometry, PlanRow};
use luxel_core::sigmoid;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Number of halves of a split splat.
const SPLIT_SAMPLES: usize = 2;
/// Divisor of the scale of a half: 0.8 times the number of halves.
const SPLIT_SHRINK: f32 = 0.8 * SPLIT_SAMPLES as f32;

/// Thresholds of a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adc {
    /// Mean gradient from which small splats are cloned; large splats are split from it unless
    /// `absgrad_threshold` is set.
    pub gradient_threshold: f32,
    /// Mean absolute gradient from which large splats are split (AbsGS).
    pub absgrad_threshold: Option<f32>,
    /// Scale up to which splats are cloned and above which they are split, world units.
    pub dense_scale: f32,
    /// Opacity below which splats are pruned.
    pub prune_opacity: f32,
    /// Scale above which splats are pruned, world units; `None` for no limit.
    pub prune_scale: Option<f32>,
    /// Largest number of splats; those with the largest gradients are densified first.
    pub max_splats: usize,
    /// Largest number of splats that a round prunes to make room for others within `max_splats`,
    /// least contribution first.
    pub max_replaced: usize,
}

impl Adc {
    /// Returns the rows of the new scene. `contribution` returns how much each splat contributes to
    /// the views (`[N]`, in any unit); it is called only if there is no room for all growth.
    ///
    /// # Errors
    /// Returns the error of `contribution`.
    pub fn plan<E>(
        &self,
        stats: &DensifyStats,
        geometry: &Geometry,
        contribution: impl FnOnce() -> Result<Vec<f32>, E>,
        rng: &mut impl Rng,
    ) -> Result<Vec<PlanRow>, E> {
        let count = geometry.position.len();
        let mut actions: Vec<Action> = (0..count).map(|i| self.action(stats, geometry, i)).collect();
        let replaced = self.excess(&actions).min(self.max_replaced);
        if replaced > 0 {
            // A splat without room even then stays as it is, and may itself be pruned.
            keep_within(&mut actions, self.max_splats.saturating_add(replaced));
            make_room(&mut actions, replaced, &contribution()?);
        }
        keep_within(&mut actions, self.max_splats);
        let kept = actions.iter().zip(0u32..).filter(|(action, _)| matches!(action, Action::Keep | Action::Clone(_)));
        let mut rows: Vec<PlanRow> = kept.map(|(_, i)| PlanRow::keep(i)).collect();
        let clones = actions.iter().zip(0u32..).filter(|(action, _)| matches!(action, Action::Clone(_)));
        rows.extend(clones.map(|(_, i)| PlanRow { keep_moments: false, ..PlanRow::keep(i) }));
        for (_, source) in actions.iter().zip(0u32..).filter(|(action, _)| matches!(action, Action::Split(_))) {
            for _ in 0..SPLIT_SAMPLES {
                rows.push(PlanRow {
                    offset_sigma: std::array::from_fn(|_| StandardNormal.sample(rng)),
                    log_scale_shift: -SPLIT_SHRINK.ln(),
                    keep_moments: false,
                    ..PlanRow::keep(source)
                });
            }
        }
        Ok(rows)
    }

    /// Returns the action for splat `i`, regardless of the limit.
    fn action(&self, stats: &DensifyStats, geometry: &Geometry, i: usize) -> Action {
        let scale = geometry.log_scale[i].into_iter().fold(f32::NEG_INFINITY, f32::max).exp();
        let is_too_large = |scale: f32| self.prune_scale.is_some_and(|limit| scale > limit);
        if sigmoid(geometry.opacity_logit[i]) < self.prune_opacity {
            return Action::Prune;
        }
        let views = stats.views[i].max(1) as f32;
        let (gradient, abs_gradient) = (stats.gradient[i] / views, stats.abs_gradient[i] / views);
        let (split_gradient, split_threshold) = match self.absgrad_threshold {
            Some(threshold) => (abs_gradient, threshold),
            None => (gradient, self.gradient_threshold),
        };
        // A split takes place before the size is checked, and only the halves have to pass.
        let is_split = scale > self.dense_scale && split_gradient >= split_threshold;
        if is_too_large(if is_split { scale / SPLIT_SHRINK } else { scale }) {
            Action::Prune
        } else if is_split {
            Action::Split(split_gradient / split_threshold)
        } else if scale <= self.dense_scale && gradient >= self.gradient_threshold {
            Action::Clone(gradient / self.gradient_threshold)
        } else {
            Action::Keep
        }
    }

    /// Returns the number of splats beyond the limit if all growth took place.
    fn excess(&self, actions: &[Action]) -> usize {
        let growing = actions.iter().filter(|action| action.urgency().is_some()).count();
        (survivors(actions) + growing).saturating_sub(self.max_splats)
    }
}

/// Returns the number of splats that are left if none grows.
fn survivors(actions: &[Action]) -> usize {
    actions.iter().filter(|action| !matches!(action, Action::Prune)).count()
}

/// Limits clones and splits, each of which adds one splat, to `limit` splats: largest gradient
/// first, then lowest index.
fn keep_within(actions: &mut [Action], limit: usize) {
    let room = limit.saturating_sub(survivors(actions));
    let mut growing: Vec<(f32, usize)> =
        actions.iter().enumerate().filter_map(|(i, action)| action.urgency().map(|urgency| (urgency, i))).collect();
    if growing.len() <= room {
        return;
    }
    growing.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, i) in growing.drain(room..) {
        actions[i] = Action::Keep;
    }
}

/// Prunes `count` of the splats that would otherwise stay: least contribution first, then lowest
/// index.
fn make_room(actions: &mut [Action], count: usize, contribution: &[f32]) {
    let staying = actions.iter().zip(contribution).enumerate().filter(|(_, (action, _))| matches!(action, Action::Keep));
    let mut least: Vec<(f32, usize)> = staying.map(|(i, (_, contribution))| (*contribution, i)).collect();
    least.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (_, i) in least.into_iter().take(count) {
        actions[i] = Action::Prune;
    }
}

/// The action for a splat; clones and splits hold their gradient as a multiple of the threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Action {
    Keep,
    Clone(f32),
    Split(f32),
    Prune,
}

impl Action {
    fn urgency(self) -> Option<f32> {
        match self {
            Self::Clone(urgency) | Self::Split(urgency) => Some(urgency),
            Self::Keep | Self::Prune => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::logit;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const POLICY: Adc = Adc {
        gradient_threshold: 2e-4,
        absgrad_threshold: None,
        dense_scale: 0.01,
        prune_opacity: 0.005,
        prune_scale: None,
        max_splats: usize::MAX,
        max_replaced: 0,
    };

    /// Splats of (scale, opacity, summed gradient, summed absolute gradient, views).
    fn scene(splats: &[(f32, f32, f32, f32, u32)]) -> (DensifyStats, Geometry) {
        let stats = DensifyStats {
            gradient: splats.iter().map(|s| s.2).collect(),
            abs_gradient: splats.iter().map(|s| s.3).collect(),
            views: splats.iter().map(|s| s.4).collect(),
        };
        let geometry = Geometry {
            position: vec![[0.0; 3]; splats.len()],
            log_scale: splats.iter().map(|s| [s.0.ln() - 1.0, s.0.ln(), s.0.ln() - 2.0]).collect(),
            opacity_logit: splats.iter().map(|s| logit(s.1)).collect(),
        };
        (stats, geometry)
    }

    fn sources(rows: &[PlanRow]) -> Vec<u32> {
        rows.iter().map(|row| row.source).collect()
    }

    fn plan(policy: &Adc, splats: &[(f32, f32, f32, f32, u32)]) -> Vec<PlanRow> {
        let unasked = || -> Result<Vec<f32>, String> { Err("contributions are not needed".to_owned()) };
        plan_by(policy, splats, unasked).unwrap()
    }

    fn plan_by(
        policy: &Adc,
        splats: &[(f32, f32, f32, f32, u32)],
        contribution: impl FnOnce() -> Result<Vec<f32>, String>,
    ) -> Result<Vec<PlanRow>, String> {
        let (stats, geometry) = scene(splats);
        policy.plan(&stats, &geometry, contribution, &mut Pcg64Mcg::seed_from_u64(1))
    }

    #[test]
    fn small_splats_are_cloned_large_ones_split_transparent_ones_pruned() {
        let rows = plan(
            &POLICY,
            &[
                (0.005, 0.5, 1e-3, 0.0, 2), // small, 5e-4 on average: clone
                (0.005, 0.5, 1e-3, 0.0, 9), // small, 1.1e-4 on average: keep
                (0.1, 0.5, 1e-3, 0.0, 2),   // large: split
                (0.1, 0.004, 1e-3, 0.0, 2), // transparent: prune
                (0.1, 0.5, 0.0, 0.0, 0),    // never seen: keep
            ],
        );
        assert_eq!(sources(&rows), [0, 1, 4, 0, 2, 2]);
        assert_eq!(rows[0], PlanRow::keep(0));
        assert_eq!(rows[3], PlanRow { keep_moments: false, ..PlanRow::keep(0) });
        for half in &rows[4..] {
            assert!((half.log_scale_shift.exp() * 1.6 - 1.0).abs() < 1e-6);
            assert!(!half.keep_moments && half.offset_sigma != [0.0; 3]);
        }
        assert_ne!(rows[4].offset_sigma, rows[5].offset_sigma);
    }

    #[test]
    fn large_splats_are_pruned_after_a_reset_unless_their_halves_pass() {
        let policy = Adc { prune_scale: Some(0.1), ..POLICY };
        let splats = [(0.2, 0.5, 0.0, 0.0, 1), (0.15, 0.5, 1.0, 0.0, 1), (0.2, 0.5, 1.0, 0.0, 1), (0.05, 0.5, 0.0, 0.0, 1)];
        assert_eq!(sources(&plan(&policy, &splats)), [3, 1, 1]);
        assert_eq!(sources(&plan(&POLICY, &splats)), [0, 3, 1, 1, 2, 2]);
    }

    #[test]
    fn absgrad_splits_by_absolute_and_clones_by_signed_gradients() {
        let policy = Adc { absgrad_threshold: Some(4e-4), ..POLICY };
        let splats = [
            (0.1, 0.5, 1e-3, 3e-4, 1),   // large: the signed gradient does not count
            (0.1, 0.5, 0.0, 5e-4, 1),    // large: cancelling gradients count
            (0.005, 0.5, 3e-4, 9e-4, 1), // small
            (0.005, 0.5, 1e-4, 9e-4, 1),
        ];
        assert_eq!(sources(&plan(&policy, &splats)), [0, 2, 3, 2, 1, 1]);
    }

    #[test]
    fn limit_is_kept_by_the_largest_gradients() {
        let splats = [(0.005, 0.5, 3e-4, 0.0, 1), (0.005, 0.5, 9e-4, 0.0, 1), (0.1, 0.5, 5e-4, 0.0, 1), (0.005, 0.001, 0.0, 0.0, 1)];
        let limited = |max_splats| sources(&plan(&Adc { max_splats, ..POLICY }, &splats));
        assert_eq!(limited(6), [0, 1, 0, 1, 2, 2]);
        assert_eq!(limited(5), [0, 1, 1, 2, 2]);
        assert_eq!(limited(4), [0, 1, 2, 1]);
        // At or above the limit already: pruning alone.
        assert_eq!(limited(3), [0, 1, 2]);
        assert_eq!(limited(1), [0, 1, 2]);
    }

    #[test]
    fn at_the_limit_the_least_contributions_make_room_for_growth() {
        let splats = [
            (0.005, 0.5, 3e-4, 0.0, 1), // would be cloned
            (0.005, 0.5, 0.0, 0.0, 1),
            (0.005, 0.5, 0.0, 0.0, 1),
            (0.005, 0.5, 0.0, 0.0, 1),
            (0.1, 0.5, 5e-4, 0.0, 1), // would be split, first
        ];
        // Splats 0 and 4, which would grow, contribute least; they stay if there is room for their
        // growth.
        let seen = || Ok(vec![0.1, 3.0, 1.0, 2.0, 0.2]);
        let replacing = |max_replaced, max_splats| sources(&plan_by(&Adc { max_splats, max_replaced, ..POLICY }, &splats, seen).unwrap());
        assert_eq!(replacing(0, 5), [0, 1, 2, 3, 4]);
        assert_eq!(replacing(1, 5), [1, 2, 3, 4, 4]);
        assert_eq!(replacing(2, 5), [0, 1, 0, 4, 4]);
        // No more are pruned than growth needs.
        assert_eq!(replacing(9, 5), [0, 1, 0, 4, 4]);
        assert_eq!(replacing(9, 6), [0, 1, 3, 0, 4, 4]);
        // Above the limit, the round moves towards it.
        assert_eq!(replacing(1, 3), [1, 2, 3, 4]);
        // If there is room for all, contributions are not requested; an error of theirs ends the
        // round.
        assert_eq!(sources(&plan(&Adc { max_splats: 7, max_replaced: 9, ..POLICY }, &splats)), [0, 1, 2, 3, 0, 4, 4]);
        let blind = || Err("blind".to_owned());
        assert_eq!(plan_by(&Adc { max_splats: 5, max_replaced: 1, ..POLICY }, &splats, blind), Err("blind".to_owned()));
    }

    #[test]
    fn same_seed_same_plan() {
        let splats = vec![(0.1, 0.5, 1.0, 0.0, 1); 50];
        assert_eq!(plan(&POLICY, &splats), plan(&POLICY, &splats));
    }

    #[test]
    fn no_splats_no_rows() {
        assert_eq!(plan(&POLICY, &[]), []);
    }
}

//! Gaussian splatting as Markov chain Monte Carlo (Kheradmand et al. 2024): dead splats are
//! relocated to living ones, and the scene grows to a fixed size. The noise on positions is the
//! engine's.
//!
//! In: `geometry [N]`. Out: the rows of the new scene: the N old places (a dead splat's place holds
//! a copy of its new source), then growth. A splat that has N copies after a round gets opacity o'
//! = 1 - (1 - o)^(1/N) and the scale that preserves its render (eq. 9). Its moments start anew,
//! those of the source too. Without living splats, nothing is relocated.

use luxel_core::engine::{Geometry, PlanRow};
use luxel_core::{logit, sigmoid};
use rand::Rng;

/// Largest number of copies that the formula is evaluated for, beyond which its terms do not matter
/// (the original's table ends here).
const MAX_COPIES: u32 = 51;
/// Largest opacity of copies: 1 - 2^-23, as in the original, so that the logit is finite.
const MAX_OPACITY: f64 = 1.0 - f32::EPSILON as f64;

/// Parameters of a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mcmc {
    /// Opacity up to which splats are dead; copies are at least this opaque.
    pub dead_opacity: f32,
    /// Growth per round: 0.05 for 5 %, but at least one splat; 0 for none.
    pub growth: f32,
    /// Largest number of splats.
    pub max_splats: usize,
}

impl Mcmc {
    /// Returns the rows of the new scene.
    pub fn plan(&self, geometry: &Geometry, rng: &mut impl Rng) -> Vec<PlanRow> {
        let count = geometry.position.len();
        let mut opacity: Vec<f64> = geometry.opacity_logit.iter().map(|l| f64::from(sigmoid(*l))).collect();
        let mut rows: Vec<PlanRow> = (0u32..).take(count).map(PlanRow::keep).collect();
        self.relocate(&mut rows, &mut opacity, rng);
        self.grow(&mut rows, &mut opacity, rng);
        rows
    }

    fn relocate(&self, rows: &mut [PlanRow], opacity: &mut [f64], rng: &mut impl Rng) {
        let threshold = f64::from(self.dead_opacity);
        let (dead, alive): (Vec<usize>, Vec<usize>) = (0..rows.len()).partition(|i| opacity[*i] <= threshold);
        let Some(sampler) = Sampler::new(alive, opacity) else { return };
        let drawn: Vec<usize> = dead.iter().map(|_| sampler.draw(rng)).collect();
        self.share(rows, opacity, &drawn);
        for (place, source) in dead.into_iter().zip(drawn) {
            rows[place] = rows[source];
            opacity[place] = opacity[source];
        }
    }

    fn grow(&self, rows: &mut Vec<PlanRow>, opacity: &mut Vec<f64>, rng: &mut impl Rng) {
        // At least one splat is added, because 5 % of fewer than 20 splats rounds to none.
        let least = rows.len() + usize::from(self.growth > 0.0);
        let target = (((1.0 + f64::from(self.growth)) * rows.len() as f64) as usize).max(least).min(self.max_splats);
        let wanted = target.saturating_sub(rows.len());
        let Some(sampler) = Sampler::new((0..rows.len()).collect(), opacity) else { return };
        let drawn: Vec<usize> = (0..wanted).map(|_| sampler.draw(rng)).collect();
        self.share(rows, opacity, &drawn);
        for source in drawn {
            rows.push(rows[source]);
            opacity.push(opacity[source]);
        }
    }

    /// Shares the opacity and scale of the rows that were `drawn` among their copies.
    fn share(&self, rows: &mut [PlanRow], opacity: &mut [f64], drawn: &[usize]) {
        let mut copies = vec![1u32; rows.len()];
        for source in drawn {
            copies[*source] += 1;
        }
        for i in (0..rows.len()).filter(|i| copies[*i] > 1) {
            let (shared, shrink) = share_opacity(opacity[i], copies[i].min(MAX_COPIES));
            opacity[i] = shared.max(f64::from(self.dead_opacity)).min(MAX_OPACITY);
            rows[i].opacity_logit = Some(logit(opacity[i] as f32));
            rows[i].log_scale_shift += shrink.ln() as f32;
            rows[i].keep_moments = false;
        }
    }
}

/// Returns the opacity of each of `copies` that replace one splat of `opacity`, and the factor on
/// their scale.
///
/// The denominator of the scale, sum_{i=1..N} sum_{k<i} C(i-1,k) (-1)^k o'^(k+1) / sqrt(k+1), is
/// summed over i first: the sum of C(i-1,k) is C(N,k+1).
fn share_opacity(opacity: f64, copies: u32) -> (f64, f64) {
    let n = f64::from(copies);
    let shared = -((-opacity.min(MAX_OPACITY)).ln_1p() / n).exp_m1();
    let mut denominator = 0.0;
    let mut term = -1.0; // C(N,j) (-o')^j, from j = 0 with its sign turned
    for j in 1..=copies {
        term *= -shared * (n - f64::from(j) + 1.0) / f64::from(j);
        denominator += term / f64::from(j).sqrt();
    }
    let shrink = opacity / denominator;
    if shrink.is_finite() && shrink > 0.0 { (shared, shrink) } else { (shared, 1.0) }
}

/// Draws indices with probability proportional to their opacity.
struct Sampler {
    indices: Vec<usize>,
    cumulative: Vec<f64>,
}

impl Sampler {
    /// Returns `None` if there is nothing to draw.
    fn new(indices: Vec<usize>, opacity: &[f64]) -> Option<Self> {
        let mut sum = 0.0;
        let cumulative: Vec<f64> = indices
            .iter()
            .map(|i| {
                sum += opacity[*i];
                sum
            })
            .collect();
        (sum > 0.0 && sum.is_finite()).then_some(Self { indices, cumulative })
    }

    fn draw(&self, rng: &mut impl Rng) -> usize {
        let at = rng.random::<f64>() * self.cumulative.last().copied().unwrap_or(0.0);
        let index = self.cumulative.partition_point(|sum| *sum <= at).min(self.indices.len() - 1);
        self.indices[index]
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn geometry(opacity: &[f32]) -> Geometry {
        Geometry {
            position: vec![[0.0; 3]; opacity.len()],
            log_scale: vec![[0.0; 3]; opacity.len()],
            opacity_logit: opacity.iter().map(|o| logit(*o)).collect(),
        }
    }

    fn plan(policy: Mcmc, opacity: &[f32]) -> Vec<PlanRow> {
        policy.plan(&geometry(opacity), &mut Pcg64Mcg::seed_from_u64(3))
    }

    const POLICY: Mcmc = Mcmc { dead_opacity: 0.005, growth: 0.05, max_splats: 1000 };

    #[test]
    fn copies_compose_to_the_original_opacity() {
        for opacity in [0.01, 0.3, 0.9, 0.999] {
            for copies in [2, 3, 10, MAX_COPIES] {
                let (shared, _) = share_opacity(opacity, copies);
                let composed = 1.0 - (1.0 - shared).powi(copies as i32);
                assert!((composed - opacity).abs() < 1e-12, "{opacity} {copies}: {composed}");
            }
        }
    }

    #[test]
    fn scale_is_that_of_the_papers_double_sum() {
        let binomial = |n: u32, k: u32| (0..k).map(|i| f64::from(n - i) / f64::from(i + 1)).product::<f64>();
        for (opacity, copies) in [(0.3, 2), (0.9, 3), (0.6, 10)] {
            let (shared, shrink) = share_opacity(opacity, copies);
            let mut denominator = 0.0;
            for i in 1..=copies {
                for k in 0..i {
                    denominator += binomial(i - 1, k) * (-1f64).powi(k as i32) * shared.powi(k as i32 + 1) / f64::from(k + 1).sqrt();
                }
            }
            assert!((shrink - opacity / denominator).abs() < 1e-9, "{opacity} {copies}: {shrink}");
        }
        let (shared, shrink) = share_opacity(0.5, 1);
        assert!((shared - 0.5).abs() < 1e-12 && (shrink - 1.0).abs() < 1e-12);
    }

    #[test]
    fn dead_splats_move_onto_living_ones_and_share_their_opacity() {
        let rows = plan(Mcmc { growth: 0.0, ..POLICY }, &[0.9, 0.001, 0.0, 0.8]);
        assert_eq!(rows.len(), 4);
        assert!([0, 3].contains(&rows[1].source) && [0, 3].contains(&rows[2].source));
        for source in [0u32, 3] {
            let group: Vec<&PlanRow> = rows.iter().filter(|row| row.source == source).collect();
            let original = if source == 0 { 0.9 } else { 0.8 };
            if group.len() == 1 {
                assert_eq!(*group[0], PlanRow::keep(source));
                continue;
            }
            assert!(group.iter().all(|row| *row == group[0] && !row.keep_moments && row.log_scale_shift < 0.0));
            let o = sigmoid(group[0].opacity_logit.unwrap());
            assert!((1.0 - (1.0 - o).powi(group.len() as i32) - original).abs() < 1e-4);
        }
    }

    #[test]
    fn growth_is_five_percent_up_to_the_limit() {
        assert_eq!(plan(POLICY, &[0.5; 100]).len(), 105);
        assert_eq!(plan(Mcmc { max_splats: 102, ..POLICY }, &[0.5; 100]).len(), 102);
        assert_eq!(plan(Mcmc { max_splats: 50, ..POLICY }, &[0.5; 100]).len(), 100);
    }

    #[test]
    fn a_few_splats_grow_by_one() {
        assert_eq!([1, 19, 20, 39, 40].map(|count| plan(POLICY, &vec![0.5; count]).len()), [2, 20, 21, 40, 42]);
        assert_eq!(plan(Mcmc { growth: 0.0, ..POLICY }, &[0.5; 19]).len(), 19);
        assert_eq!(plan(Mcmc { max_splats: 19, ..POLICY }, &[0.5; 19]).len(), 19);
    }

    #[test]
    fn copies_of_a_scene_in_which_all_is_dead_are_as_opaque_as_can_be() {
        let rows = plan(Mcmc { dead_opacity: 1.0, growth: 1.0, ..POLICY }, &[0.5; 3]);
        assert_eq!(rows.len(), 6);
        let drawn: Vec<f32> = rows.iter().filter_map(|row| row.opacity_logit).collect();
        assert!(!drawn.is_empty() && drawn.iter().all(|opacity| *opacity == logit(MAX_OPACITY as f32)), "{drawn:?}");
    }

    #[test]
    fn without_living_splats_nothing_moves() {
        let rows = plan(Mcmc { growth: 0.0, ..POLICY }, &[0.001; 3]);
        assert_eq!(rows, (0..3).map(PlanRow::keep).collect::<Vec<_>>());
        assert_eq!(plan(POLICY, &[]), []);
    }

    #[test]
    fn same_seed_same_plan() {
        let opacity: Vec<f32> = (0..200).map(|i| i as f32 / 250.0).collect();
        assert_eq!(plan(POLICY, &opacity), plan(POLICY, &opacity));
    }
}

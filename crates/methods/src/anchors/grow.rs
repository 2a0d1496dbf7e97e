//! Growth and pruning of anchors, on voxels (Scaffold-GS, Lu et al. 2024, section 3.3).
//!
//! In: anchors, statistics of their splats, the largest number of anchors. Out: other anchors. On
//! each of three grids, the splats whose mean gradient is above the grid's threshold and a random
//! number ask for an anchor in their cell; cells without one get it, those of larger gradients
//! first, as long as there is room. An anchor whose splats were all but transparent is pruned.
//! Where there is no room left, the least opaque anchors make some. Anchors follow one another
//! along a space-filling curve, so that splats that are near in space are near in memory.
//! Degenerate: without candidates nothing changes.

use std::collections::{BTreeMap, BTreeSet};

use luxel_core::{random, spatial_order};

use super::groups::Groups;
use super::scene::{AnchorScene, Anchors};
use super::statistics::Statistics;
use super::{FEATURE, OFFSETS, SCALES, SPLATS_PER_ANCHOR};

/// Sides of the grids' cells, voxels.
const CELLS: [f32; 3] = [4.0, 1.0, 0.25];
/// Factor between the thresholds of one grid and the next finer one.
const THRESHOLD_FACTOR: f32 = 2.0;
/// Part of a round's steps that a splat has to be shown in to be a candidate, and that an anchor
/// has to be decoded in to be pruned.
const CANDIDATE_SHARE: f32 = 0.4;
const PRUNED_SHARE: f32 = 0.8;

/// The rules of a round.
#[derive(Clone, Copy, Debug)]
pub(super) struct GrowthRules {
    /// Side of a voxel, world units.
    pub(super) voxel: f32,
    /// Steps since the last round.
    pub(super) interval: u32,
    /// Mean gradient, NDC units, above which a splat is a candidate on the coarsest grid.
    pub(super) threshold: f32,
    /// Accumulated opacity per view below which an anchor is pruned.
    pub(super) prune_opacity: f32,
    /// Largest number of anchors.
    pub(super) limit: usize,
    /// Part of that number that may make room in a round.
    pub(super) turnover: f32,
    /// Largest standard deviation that splats may have, world units.
    pub(super) largest: f32,
    pub(super) seed: u64,
}

/// The number of anchors that a round added and pruned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Changes {
    pub(super) added: usize,
    pub(super) pruned: usize,
}

/// An anchor that is asked for.
struct Proposal {
    position: [f32; 3],
    size: f32,
    /// Largest mean gradient of the candidates.
    gradient: f32,
    feature: [f32; FEATURE],
}

/// Returns the cell of a position.
pub(super) fn cell_of(position: [f32; 3], side: f32) -> [i64; 3] {
    position.map(|v| (f64::from(v) / f64::from(side)).round() as i64)
}

/// Returns the centre of a cell.
pub(super) fn center_of(cell: [i64; 3], side: f32) -> [f32; 3] {
    cell.map(|v| (v as f64 * f64::from(side)) as f32)
}

/// Makes a round.
pub(super) fn grow(scene: &mut AnchorScene, groups: &mut Groups, statistics: &mut Statistics, rules: &GrowthRules) -> Changes {
    let proposals = proposals(&scene.anchors, statistics, rules);
    let least_views = PRUNED_SHARE * rules.interval as f32;
    let is_kept = |i: &usize| {
        let (opacity, views) = (statistics.opacity[*i], statistics.views[*i]);
        views <= least_views || opacity >= rules.prune_opacity * views
    };
    let mut kept: Vec<usize> = (0..scene.anchors.len()).filter(is_kept).collect();
    make_room(&mut kept, proposals.len(), statistics, rules);
    let pruned = scene.anchors.len() - kept.len();
    let mut anchors = scene.anchors.select(&kept);
    for Proposal { position, size, feature, .. } in proposals.into_iter().take(rules.limit.saturating_sub(kept.len())) {
        anchors.push(position, size, feature);
    }
    let added = anchors.len() - kept.len();
    statistics.restart(CANDIDATE_SHARE * rules.interval as f32, least_views);
    if added + pruned > 0 {
        let order: Vec<usize> = spatial_order(&anchors.position).into_iter().map(|i| i as usize).collect();
        let from: Vec<Option<usize>> = order.iter().map(|i| kept.get(*i).copied()).collect();
        scene.anchors = anchors.select(&order);
        groups.rearrange(&from);
        *statistics = statistics.rearranged(&from);
    }
    let largest = rules.largest.ln();
    for scales in scene.anchors.log_scale.chunks_exact_mut(SCALES) {
        scales[3..].iter_mut().for_each(|scale| *scale = scale.min(largest));
    }
    Changes { added, pruned }
}

/// Removes the least opaque of the anchors that have been seen enough, where there is no room for
/// the ones that are asked for.
fn make_room(kept: &mut Vec<usize>, asked: usize, statistics: &Statistics, rules: &GrowthRules) {
    let room = rules.limit.saturating_sub(kept.len());
    let wanted = asked.saturating_sub(room).min((f64::from(rules.turnover) * rules.limit as f64) as usize);
    let opacity = |i: usize| statistics.opacity[i] / statistics.views[i].max(1.0);
    let mut seen: Vec<usize> = kept.iter().copied().filter(|i| statistics.views[*i] > PRUNED_SHARE * rules.interval as f32).collect();
    seen.sort_by(|a, b| opacity(*a).total_cmp(&opacity(*b)));
    seen.truncate(wanted);
    seen.sort_unstable();
    kept.retain(|i| seen.binary_search(i).is_err());
}

/// Returns the anchors that splats ask for, those of larger gradients first.
fn proposals(anchors: &Anchors, statistics: &Statistics, rules: &GrowthRules) -> Vec<Proposal> {
    let least_draws = CANDIDATE_SHARE * rules.interval as f32;
    let mut all = Vec::new();
    let mut taken: Vec<[f32; 3]> = anchors.position.clone();
    for (level, cells) in (0u64..).zip(CELLS) {
        let side = cells * rules.voxel;
        let threshold = rules.threshold * THRESHOLD_FACTOR.powi(level as i32);
        let least_random = 0.5f32.powi(level as i32 + 1);
        let seed = random::bits(rules.seed, level);
        let occupied: BTreeSet<[i64; 3]> = taken.iter().map(|position| cell_of(*position, side)).collect();
        let mut asked: BTreeMap<[i64; 3], Proposal> = BTreeMap::new();
        for splat in 0..anchors.len() * SPLATS_PER_ANCHOR {
            let gradient = statistics.mean_gradient(splat);
            let is_candidate = statistics.draws[splat] > least_draws && gradient >= threshold;
            if !is_candidate || random::uniform(seed, splat as u64) <= least_random {
                continue;
            }
            let anchor = splat / SPLATS_PER_ANCHOR;
            let cell = cell_of(position_of(anchors, splat), side);
            if occupied.contains(&cell) {
                continue;
            }
            let feature = &anchors.feature[anchor * FEATURE..(anchor + 1) * FEATURE];
            let proposal = asked.entry(cell).or_insert_with(|| Proposal {
                position: center_of(cell, side),
                size: side,
                gradient: 0.0,
                feature: [f32::NEG_INFINITY; FEATURE],
            });
            proposal.gradient = proposal.gradient.max(gradient);
            proposal.feature.iter_mut().zip(feature).for_each(|(most, value)| *most = most.max(*value));
        }
        taken.extend(asked.values().map(|proposal| proposal.position));
        all.extend(asked.into_values());
    }
    // Stable: of equal gradients the coarser cell stays first, then the lower one.
    all.sort_by(|a, b| b.gradient.total_cmp(&a.gradient));
    all
}

/// Returns the position of a splat.
fn position_of(anchors: &Anchors, splat: usize) -> [f32; 3] {
    let (anchor, k) = (splat / SPLATS_PER_ANCHOR, splat % SPLATS_PER_ANCHOR);
    [0, 1, 2].map(|c: usize| {
        anchors.position[anchor][c] + anchors.offset[anchor * OFFSETS + 3 * k + c] * anchors.log_scale[anchor * SCALES + c].exp()
    })
}

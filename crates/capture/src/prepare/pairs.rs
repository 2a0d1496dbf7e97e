//! Pairs of views to match, where there are too many views for all pairs. No vocabulary tree is
//! needed.
//!
//! In: the number of views by name, or their positions. Out: pairs of indices, the smaller first,
//! in order. Degenerate: few views have all pairs; a view without a position has those of its
//! neighbours by name.

use std::collections::BTreeSet;

use glam::DVec3;

/// Number of next views that each view is matched with.
const OVERLAP: usize = 10;
/// Largest distance by name that a view is matched over, in powers of two.
const FARTHEST: usize = 512;
/// Number of views spread over the set that are matched with each other: they close loops.
const KEY_VIEWS: usize = 60;
/// Number of nearest views that each view is matched with.
const NEAREST: usize = 30;
/// Number of next views that a view with a position is matched with.
const SPATIAL_OVERLAP: usize = 2;

/// Returns the pairs of a sequence: neighbours, views at distances of powers of two, the end with
/// the beginning, and views spread over the whole with each other.
///
/// ```
/// use luxel_capture::prepare::sequential_pairs;
///
/// let pairs = sequential_pairs(1000);
/// assert!(pairs.contains(&[41, 42]) && pairs.contains(&[0, 999]));
/// assert!(pairs.len() < 1000 * 999 / 20);
/// ```
pub fn sequential_pairs(views: usize) -> Vec<[usize; 2]> {
    let mut pairs = BTreeSet::new();
    let mut add = |a: usize, b: usize| {
        if a != b && a.max(b) < views {
            pairs.insert([a.min(b), a.max(b)]);
        }
    };
    for a in 0..views {
        (1..=OVERLAP).for_each(|step| {
            // Behind the end is the beginning: a walk around something is a ring.
            add(a, (a + step) % views);
        });
        std::iter::successors(Some(OVERLAP.next_power_of_two()), |step| Some(2 * step))
            .take_while(|step| *step <= FARTHEST)
            .for_each(|step| add(a, a + step));
    }
    let step = views.div_ceil(KEY_VIEWS).max(1);
    for a in (0..views).step_by(step) {
        (a + step..views).step_by(step).for_each(|b| add(a, b));
    }
    pairs.into_iter().collect()
}

/// Returns the pairs of views that are near each other, and a few neighbours by name.
pub fn spatial_pairs(positions_m: &[Option<DVec3>]) -> Vec<[usize; 2]> {
    let views = positions_m.len();
    let mut pairs = BTreeSet::new();
    let placed: Vec<(usize, DVec3)> = positions_m.iter().enumerate().filter_map(|(i, p)| Some((i, (*p)?))).collect();
    for (a, position) in positions_m.iter().enumerate() {
        let overlap = if position.is_some() { SPATIAL_OVERLAP } else { OVERLAP };
        let (first, last) = (a.saturating_sub(overlap), (a + overlap).min(views.saturating_sub(1)));
        pairs.extend((first..=last).filter(|b| *b != a).map(|b| [a.min(b), a.max(b)]));
        let Some(position) = position else { continue };
        let mut near: Vec<(f64, usize)> =
            placed.iter().filter(|(b, _)| *b != a).map(|(b, other)| (position.distance_squared(*other), *b)).collect();
        near.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        pairs.extend(near.iter().take(NEAREST).map(|(_, b)| [a.min(*b), a.max(*b)]));
    }
    pairs.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_views_have_all_pairs() {
        assert_eq!(sequential_pairs(12).len(), 12 * 11 / 2);
        assert!(sequential_pairs(0).is_empty() && sequential_pairs(1).is_empty());
        assert_eq!(sequential_pairs(2), [[0, 1]]);
    }

    #[test]
    fn every_view_has_neighbours_and_loops_close() {
        let pairs: BTreeSet<[usize; 2]> = sequential_pairs(601).into_iter().collect();
        for a in 0..591 {
            assert!((1..=10).all(|step| pairs.contains(&[a, a + step])), "{a}");
        }
        assert!(pairs.contains(&[0, 600]) && pairs.contains(&[3, 3 + 512]) && pairs.contains(&[11, 11 * 50]));
        assert!(pairs.iter().all(|[a, b]| a < b && *b < 601));
    }

    #[test]
    fn near_views_are_matched_and_far_ones_are_not() {
        // Two lines side by side, flown there and back.
        let mut positions: Vec<Option<DVec3>> = (0..200).map(|i| Some(DVec3::new(f64::from(i), 0.0, 0.0))).collect();
        positions.extend((0..200).rev().map(|i| Some(DVec3::new(f64::from(i), 5.0, 0.0))));
        positions[7] = None;
        let pairs: BTreeSet<[usize; 2]> = spatial_pairs(&positions).into_iter().collect();
        assert!(pairs.contains(&[50, 349]) && pairs.contains(&[199, 200]) && pairs.contains(&[7, 17]));
        assert!(!pairs.contains(&[50, 150]) && !pairs.contains(&[7, 392]));
        assert!(spatial_pairs(&[]).is_empty());
    }
}

//! The blocks of a data set: ranges of the ground with an equal part of the points each, and the
//! views that see them.
//!
//! In: the ground, a grid of N columns and M rows, the width of the border. Out: ranges whose cores
//! fill the plane, the outermost without an end; for each view the blocks that it trains.
//!
//! A view belongs to every block in whose reach it stands, and to every block with at least
//! [`LEAST_SHARE`] of the points that it sees; a view without any of these to the one of which it
//! sees most. Degenerate: a block without a training view is an error of the caller's.

use glam::{DVec2, DVec3};
use luxel_core::{Dataset, View};
use luxel_io::{GroundRange, sees};

use super::ground::{Ground, on};

/// Share of the points that a view sees, from which it belongs to a block.
const LEAST_SHARE: f64 = 0.1;

/// Most points that views are compared with.
const MOST_POINTS: usize = 20_000;

/// A block's part of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    pub(super) core: GroundRange,
    pub(super) reach: GroundRange,
}

impl Part {
    pub(super) fn owns(&self, place: DVec2) -> bool {
        within(&self.core, place)
    }

    pub(super) fn reaches(&self, place: DVec2) -> bool {
        within(&self.reach, place)
    }
}

fn within(range: &GroundRange, place: DVec2) -> bool {
    range.iter().zip(place.to_array()).all(|([from, to], at)| from.is_none_or(|from| at >= from) && to.is_none_or(|to| at < to))
}

/// Divides the ground: columns along its long side with an equal part of the places, and rows of
/// each column likewise. `border` is a fraction of a block's side.
pub(super) fn parts(ground: &Ground, [columns, rows]: [usize; 2], border: f64) -> Vec<Part> {
    let mut parts = Vec::with_capacity(columns * rows);
    let by_column = cuts(ground.places.iter().map(|place| place.x), columns);
    for column in ranges(&by_column) {
        let is_in = |place: &&DVec2| within(&[column, [None, None]], **place);
        let inside: Vec<DVec2> = ground.places.iter().filter(is_in).copied().collect();
        let across = wider(column, ends(&inside, |place| place.x), border);
        for row in ranges(&cuts(inside.iter().map(|place| place.y), rows)) {
            let along = wider(row, ends(&inside, |place| place.y), border);
            parts.push(Part { core: [column, row], reach: [across, along] });
        }
    }
    parts
}

/// Returns the values that divide others into `count` equal parts.
fn cuts(values: impl Iterator<Item = f64>, count: usize) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    let cut = |k: usize| {
        let at = k * values.len() / count;
        let [below, above] = [at.checked_sub(1), Some(at)].map(|at| at.and_then(|at| values.get(at)).copied());
        Some(0.5 * (below? + above?))
    };
    (1..count).filter_map(cut).collect()
}

/// Returns the ranges between cuts, with open ends.
fn ranges(cuts: &[f64]) -> Vec<[Option<f64>; 2]> {
    let from = std::iter::once(None).chain(cuts.iter().copied().map(Some));
    let to = cuts.iter().copied().map(Some).chain(std::iter::once(None));
    from.zip(to).map(|(from, to)| [from, to]).collect()
}

fn ends(places: &[DVec2], along: impl Fn(&DVec2) -> f64) -> [f64; 2] {
    places.iter().map(along).fold([f64::MAX, f64::MIN], |[from, to], at| [from.min(at), to.max(at)])
}

/// Returns a range with a border of a fraction of its length; `ends` are those of the scene, which
/// stand for open ones.
fn wider([from, to]: [Option<f64>; 2], ends: [f64; 2], border: f64) -> [Option<f64>; 2] {
    let width = border * (to.unwrap_or(ends[1]) - from.unwrap_or(ends[0])).max(0.0);
    [from.map(|from| from - width), to.map(|to| to + width)]
}

/// Points as views see them.
pub(super) struct Sight<'a> {
    dataset: &'a Dataset,
    axes: [DVec3; 2],
    /// Local positions of some points, and their places on the ground.
    points: Vec<(DVec3, DVec2)>,
    /// For each view, training views first, the points that it sees: indices of `points`.
    seen: Vec<Vec<usize>>,
}

impl<'a> Sight<'a> {
    pub(super) fn new(dataset: &'a Dataset, ground: &Ground) -> Self {
        let stride = dataset.points.len().div_ceil(MOST_POINTS).max(1);
        let local = dataset.points.iter().step_by(stride).map(|point| DVec3::from_array(point.position.map(f64::from)));
        let points: Vec<(DVec3, DVec2)> = local.map(|local| (local, on(ground.axes, dataset.world_from_local.point(local)))).collect();
        let seen_by = |view: &View| (0..points.len()).filter(|i| sees(view, points[*i].0)).collect();
        let mut seen: Vec<Vec<usize>> = dataset.train.iter().chain(&dataset.test).map(seen_by).collect();
        // Structure from motion knows what is hidden; it speaks of training views alone.
        if dataset.points.iter().any(|point| !point.observations.is_empty()) {
            seen[..dataset.train.len()].iter_mut().for_each(Vec::clear);
            for (i, point) in dataset.points.iter().step_by(stride).enumerate() {
                point.observations.iter().for_each(|observation| seen[observation.view as usize].push(i));
            }
        }
        Self { dataset, axes: ground.axes, points, seen }
    }

    /// Returns the names of each block's views, and how many of them are trained on.
    pub(super) fn views_of(&self, parts: &[Part]) -> Vec<PartViews> {
        let owners: Vec<Option<usize>> = self.points.iter().map(|(_, place)| parts.iter().position(|part| part.owns(*place))).collect();
        let mut found = vec![PartViews::default(); parts.len()];
        for (i, view) in self.dataset.train.iter().chain(&self.dataset.test).enumerate() {
            let eye = on(self.axes, self.dataset.world_from_local.point(view.camera.eye()));
            let seen = &self.seen[i];
            let mut counts = vec![0_usize; parts.len()];
            seen.iter().filter_map(|at| owners[*at]).for_each(|owner| counts[owner] += 1);
            let is_of = |k: &usize| counts[*k] as f64 >= LEAST_SHARE * seen.len().max(1) as f64 || parts[*k].reaches(eye);
            let mut of_view: Vec<usize> = (0..parts.len()).filter(is_of).collect();
            if of_view.is_empty() {
                of_view.extend((0..parts.len()).max_by_key(|k| (counts[*k], std::cmp::Reverse(*k))));
            }
            for k in of_view {
                found[k].names.push(view.name.clone());
                found[k].train += usize::from(i < self.dataset.train.len());
            }
        }
        found
    }

    /// Returns the share of the points in each block's reach.
    pub(super) fn shares(&self, parts: &[Part]) -> Vec<f64> {
        let count = |part: &Part| self.points.iter().filter(|(_, place)| part.reaches(*place)).count();
        parts.iter().map(|part| count(part) as f64 / self.points.len().max(1) as f64).collect()
    }
}

/// The views of a block.
#[derive(Clone, Debug, Default)]
pub(super) struct PartViews {
    /// Names, of both sides of the split.
    pub(super) names: Vec<String>,
    /// Number of them that are trained on.
    pub(super) train: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cores_fill_the_ground_with_equal_parts_and_reaches_overlap() {
        let places: Vec<DVec2> = (0..1000).map(|i| DVec2::new(f64::from(i % 40), f64::from(i / 40).powi(2))).collect();
        let ground = Ground { axes: [DVec3::X, DVec3::Y], places };
        let parts = parts(&ground, [2, 3], 0.2);
        assert_eq!(parts.len(), 6);
        for place in ground.places.iter().copied().chain([DVec2::splat(1e9), DVec2::splat(-1e9)]) {
            assert_eq!(parts.iter().filter(|part| part.owns(place)).count(), 1, "{place}");
            assert!(parts.iter().filter(|part| part.owns(place)).all(|part| part.reaches(place)));
        }
        for part in &parts {
            let owned = ground.places.iter().filter(|place| part.owns(**place)).count();
            let reached = ground.places.iter().filter(|place| part.reaches(**place)).count();
            assert!((140..=200).contains(&owned) && reached > owned, "{owned} {reached}");
        }
    }
}

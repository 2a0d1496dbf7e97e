//! Brackets: the photographs that are exposures of one view.
//!
//! In: [`Shot`]s with name, time and exposure. Out: groups of indices, each sorted by exposure, in
//! the order of their first names; and what is odd about them. Rules, in this order unless one is
//! given:
//! - names: `desk_1`, `desk_2` and so on, where all that share the part before the last separator
//!   differ in exposure. Unless given, believed only if most of these groups, and two at least,
//!   repeat a pattern of exposures, or if names state exposures (`desk_ev-2`): cameras count views
//!   as well;
//! - sequence: by camera, time and name; a group ends where an exposure repeats, or after a long
//!   pause. Believed only if most photographs are in groups that repeat the same
//!   exposures, two at least: photographs taken with automatic exposure differ as well, but not by
//!   a pattern.
//!
//! Degenerate: without exposures all are views of their own.

mod names;

use std::collections::BTreeMap;

use names::{believed, by_names};

/// A photograph, with the facts that grouping needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// File name without extension.
    pub name: String,
    /// Which camera; frames of a bracket share it.
    pub camera: usize,
    /// Seconds from any origin.
    pub time_s: Option<f64>,
    /// Exposure in stops.
    pub stops: Option<f64>,
    /// Shutter time.
    pub seconds: Option<f64>,
}

/// How brackets are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BracketRule {
    /// By name or sequence, if either shows a pattern.
    #[default]
    Auto,
    /// Every photograph is a view.
    Off,
    /// By name.
    Names,
    /// This many in a row, by name.
    Count(usize),
}

/// Groups found.
#[derive(Clone, Debug, PartialEq)]
pub struct Brackets {
    /// Indices of shots, each group sorted by exposure, shortest first.
    pub views: Vec<Vec<usize>>,
    /// How they were found, for people.
    pub found_by: &'static str,
    /// Remarks on what is odd.
    pub notes: Vec<BracketNote>,
}

/// Something about one group.
#[derive(Clone, Debug, PartialEq)]
pub enum BracketNote {
    /// Fewer exposures than the others.
    Missing {
        /// Index into [`Brackets::views`].
        view: usize,
        /// Exposures that the others have and this has not, in stops.
        stops: Vec<f64>,
        /// How many it has.
        found: usize,
        /// How many the others have.
        expected: usize,
    },
    /// More exposures than the others.
    Extra {
        /// Index into [`Brackets::views`].
        view: usize,
        /// How many it has.
        found: usize,
        /// How many the others have.
        expected: usize,
    },
}

/// Explains why the rule that was given does not fit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BracketError {
    /// Not a multiple.
    #[error("{shots} photographs are not brackets of {count}: expected a multiple")]
    Count {
        /// Photographs.
        shots: usize,
        /// Number per bracket that the rule gives.
        count: usize,
    },
    /// Names show no pattern.
    #[error("names show no brackets: expected names such as desk_1 and desk_2 of different exposures, found {0}")]
    Names(String),
}

/// Exposures nearer than this (stops) are the same one.
const SAME_STOPS: f64 = 1.0 / 6.0;
/// A pause of more than this, beside the shutter times, ends a bracket, seconds.
const PAUSE_S: f64 = 3.0;
/// Share of photographs whose groups must repeat the commonest exposures.
const PATTERN: f64 = 0.6;

/// Groups shots into brackets, the exposures of one view.
///
/// ```
/// use luxel_capture::{BracketRule, Shot, find_brackets};
///
/// let shot = |name: &str, seconds: f64| Shot {
///     name: name.into(),
///     camera: 0,
///     time_s: None,
///     stops: Some(seconds.log2()),
///     seconds: Some(seconds),
/// };
/// let shots = [shot("a_1", 0.08), shot("a_2", 0.01), shot("b_1", 0.08), shot("b_2", 0.01)];
/// let brackets = find_brackets(&shots, BracketRule::Names)?;
/// // Shortest exposure first.
/// assert_eq!(brackets.views, [[1, 0], [3, 2]]);
/// # Ok::<(), luxel_capture::BracketError>(())
/// ```
///
/// # Errors
/// A rule that does not fit the photographs.
pub fn find_brackets(shots: &[Shot], rule: BracketRule) -> Result<Brackets, BracketError> {
    let singles = || finish(shots, (0..shots.len()).map(|i| vec![i]).collect(), "each photograph is a view");
    match rule {
        BracketRule::Off => Ok(singles()),
        BracketRule::Count(count) => {
            if count == 0 || !shots.len().is_multiple_of(count) {
                return Err(BracketError::Count { shots: shots.len(), count });
            }
            let mut order: Vec<usize> = (0..shots.len()).collect();
            order.sort_by(|a, b| natural(&shots[*a].name).cmp(&natural(&shots[*b].name)));
            Ok(finish(shots, order.chunks(count).map(<[usize]>::to_vec).collect(), "as counted"))
        }
        BracketRule::Names => by_names(shots).map(|named| finish(shots, named.groups, "by name")).ok_or_else(|| {
            let some: Vec<&str> = shots.iter().take(3).map(|s| s.name.as_str()).collect();
            BracketError::Names(some.join(", "))
        }),
        BracketRule::Auto => {
            if let Some(groups) = by_names(shots).and_then(|named| believed(shots, named)) {
                return Ok(finish(shots, groups, "by name"));
            }
            Ok(by_sequence(shots).map_or_else(singles, |groups| finish(shots, groups, "by time and exposure")))
        }
    }
}

/// Splits a name into text and numbers, so that 10 comes after 9.
fn natural(name: &str) -> Vec<(String, u64)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let digits_at = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(digits_at);
        let end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (digits, next) = tail.split_at(end);
        parts.push((text.to_owned(), digits.parse().unwrap_or(u64::MAX)));
        rest = next;
    }
    parts
}

fn all_differ(shots: &[Shot], group: &[usize]) -> bool {
    let stops: Option<Vec<f64>> = group.iter().map(|&i| shots[i].stops).collect();
    stops.is_some_and(|mut stops| {
        stops.sort_by(f64::total_cmp);
        stops.windows(2).all(|pair| pair[1] - pair[0] > SAME_STOPS)
    })
}

fn by_sequence(shots: &[Shot]) -> Option<Vec<Vec<usize>>> {
    let mut order: Vec<usize> = (0..shots.len()).collect();
    let has_times = shots.iter().all(|s| s.time_s.is_some());
    order.sort_by(|&a, &b| {
        let (a, b) = (&shots[a], &shots[b]);
        let times = if has_times { a.time_s.unwrap_or(0.0).total_cmp(&b.time_s.unwrap_or(0.0)) } else { std::cmp::Ordering::Equal };
        a.camera.cmp(&b.camera).then(times).then_with(|| natural(&a.name).cmp(&natural(&b.name)))
    });
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for &i in &order {
        let shot = &shots[i];
        let stops = shot.stops?;
        let goes_on = groups.last().is_some_and(|group| {
            let Some(last) = group.last().map(|&l| &shots[l]) else { return false };
            let pause = last.time_s.zip(shot.time_s).map_or(0.0, |(a, b)| b - a);
            let shutters = last.seconds.unwrap_or(0.0) + shot.seconds.unwrap_or(0.0);
            last.camera == shot.camera
                && pause <= PAUSE_S + shutters
                && group.iter().all(|&other| shots[other].stops.is_some_and(|s| (s - stops).abs() > SAME_STOPS))
        });
        match groups.last_mut().filter(|_| goes_on) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    let pattern = commonest(shots, &groups)?;
    let repeating = groups.iter().filter(|g| steps_of(shots, g).is_some_and(|s| s == pattern)).count();
    (pattern.len() > 1 && repeating > 1 && (repeating * pattern.len()) as f64 >= PATTERN * shots.len() as f64).then_some(groups)
}

/// Returns the exposures of a group in units of [`SAME_STOPS`], sorted.
fn steps_of(shots: &[Shot], group: &[usize]) -> Option<Vec<i64>> {
    let mut steps: Vec<i64> = group.iter().map(|&i| shots[i].stops.map(|s| (s / SAME_STOPS).round() as i64)).collect::<Option<_>>()?;
    steps.sort_unstable();
    Some(steps)
}

/// Returns the exposures that most groups have; of equally many the longest.
fn commonest(shots: &[Shot], groups: &[Vec<usize>]) -> Option<Vec<i64>> {
    let mut counts: BTreeMap<Vec<i64>, usize> = BTreeMap::new();
    for group in groups {
        *counts.entry(steps_of(shots, group)?).or_default() += 1;
    }
    counts.into_iter().max_by_key(|(steps, count)| (*count, steps.len())).map(|(steps, _)| steps)
}

fn finish(shots: &[Shot], mut views: Vec<Vec<usize>>, found_by: &'static str) -> Brackets {
    for group in &mut views {
        group.sort_by(|&a, &b| {
            let stops = |i: usize| shots[i].stops.unwrap_or(0.0);
            stops(a).total_cmp(&stops(b)).then_with(|| natural(&shots[a].name).cmp(&natural(&shots[b].name)))
        });
    }
    let first_name = |group: &Vec<usize>| group.iter().map(|&i| natural(&shots[i].name)).min();
    views.sort_by_key(first_name);
    let notes = odd_ones(shots, &views);
    Brackets { views, found_by, notes }
}

/// The bracket that most views of a camera have.
struct Usual {
    count: usize,
    /// Exposures of one that is like most.
    stops: Vec<f64>,
}

fn usual_of(shots: &[Shot], groups: &[Vec<usize>]) -> Usual {
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    for group in groups {
        *sizes.entry(group.len()).or_default() += 1;
    }
    let count = sizes.iter().max_by_key(|(size, number)| (**number, **size)).map_or(1, |(size, _)| *size);
    let whole: Vec<Vec<usize>> = groups.iter().filter(|g| g.len() == count).cloned().collect();
    let pattern = commonest(shots, &whole);
    let example = whole.iter().find(|g| steps_of(shots, g) == pattern);
    Usual { count, stops: example.into_iter().flatten().filter_map(|&i| shots[i].stops).collect() }
}

/// Groups that have fewer or more exposures than most of their camera's.
fn odd_ones(shots: &[Shot], views: &[Vec<usize>]) -> Vec<BracketNote> {
    let camera_of = |group: &[usize]| group.first().map_or(0, |&i| shots[i].camera);
    let mut by_camera: BTreeMap<usize, Vec<Vec<usize>>> = BTreeMap::new();
    for group in views {
        by_camera.entry(camera_of(group)).or_default().push(group.clone());
    }
    let usual: BTreeMap<usize, Usual> = by_camera.iter().map(|(camera, groups)| (*camera, usual_of(shots, groups))).collect();
    let mut notes = Vec::new();
    for (view, group) in views.iter().enumerate() {
        let Some(usual) = usual.get(&camera_of(group)) else { continue };
        let (found, expected) = (group.len(), usual.count);
        if found < expected {
            let own: Vec<f64> = group.iter().filter_map(|&i| shots[i].stops).collect();
            let lacks = |stops: &&f64| !own.iter().any(|o| (o - **stops).abs() <= 1.5 * SAME_STOPS);
            let stops = usual.stops.iter().filter(lacks).copied().collect();
            notes.push(BracketNote::Missing { view, stops, found, expected });
        } else if found > expected {
            notes.push(BracketNote::Extra { view, found, expected });
        }
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn shot(name: &str, time_s: f64, stops: f64) -> Shot {
        Shot { name: name.into(), camera: 0, time_s: Some(time_s), stops: Some(stops), seconds: Some(stops.exp2()) }
    }

    /// Returns three exposures every ten seconds.
    fn sequence(views: usize) -> Vec<Shot> {
        (0..3 * views)
            .map(|i| shot(&format!("IMG_{:04}", 9998 + i), 10.0 * (i / 3) as f64 + 0.5 * (i % 3) as f64, [0.0, -2.0, 2.0][i % 3] - 5.0))
            .collect()
    }

    #[test]
    fn a_sequence_of_brackets_is_found_and_sorted_by_exposure() {
        let brackets = find_brackets(&sequence(4), BracketRule::Auto).unwrap();
        assert_eq!(brackets.views, [[1, 0, 2], [4, 3, 5], [7, 6, 8], [10, 9, 11]]);
        assert_eq!((brackets.found_by, brackets.notes.len()), ("by time and exposure", 0));
    }

    #[test]
    fn a_frame_that_is_missing_is_named() {
        for missing in [3, 4, 5] {
            let mut shots = sequence(4);
            shots.remove(missing);
            let brackets = find_brackets(&shots, BracketRule::Auto).unwrap();
            assert_eq!(brackets.views.iter().map(Vec::len).collect::<Vec<_>>(), [3, 2, 3, 3]);
            let stops = [0.0, -2.0, 2.0][missing % 3] - 5.0;
            assert_eq!(brackets.notes, [BracketNote::Missing { view: 1, stops: vec![stops], found: 2, expected: 3 }]);
        }
    }

    #[test]
    fn automatic_exposure_is_no_bracket() {
        let stops = [-5.0, -5.4, -4.6, -5.9, -5.1, -4.2, -5.6, -5.3];
        let shots: Vec<Shot> = stops.iter().enumerate().map(|(i, s)| shot(&format!("IMG_{i:04}"), i as f64, *s)).collect();
        let brackets = find_brackets(&shots, BracketRule::Auto).unwrap();
        assert_eq!((brackets.views.len(), brackets.found_by), (8, "each photograph is a view"));
    }

    #[test]
    fn counted_brackets_must_come_out_even() {
        let shots = sequence(2);
        assert_eq!(find_brackets(&shots, BracketRule::Count(3)).unwrap().views.len(), 2);
        assert_eq!(find_brackets(&shots, BracketRule::Count(4)), Err(BracketError::Count { shots: 6, count: 4 }));
        assert!(find_brackets(&shots, BracketRule::Count(0)).is_err());
        assert_eq!(find_brackets(&shots, BracketRule::Off).unwrap().views.len(), 6);
    }

    #[test]
    fn shots_without_exposure_are_views() {
        let shots: Vec<Shot> =
            (0..4).map(|i| Shot { name: format!("a_{i}"), camera: 0, time_s: None, stops: None, seconds: None }).collect();
        assert_eq!(find_brackets(&shots, BracketRule::Auto).unwrap().views.len(), 4);
        assert_eq!(find_brackets(&[], BracketRule::Auto).unwrap().views.len(), 0);
    }

    #[test]
    fn brackets_of_two_cameras_do_not_mix() {
        let mut shots = sequence(2);
        for shot in &mut shots[3..] {
            shot.camera = 1;
            shot.time_s = shot.time_s.map(|t| t - 10.0);
        }
        assert_eq!(find_brackets(&shots, BracketRule::Auto).unwrap().views, [[1, 0, 2], [4, 3, 5]]);
    }
}

//! Brackets by the names of their photographs, and what makes names believable.

use std::collections::BTreeMap;

use super::{PATTERN, SAME_STOPS, Shot, all_differ};

/// The characters that separate a view's name from the number of its exposure.
const SEPARATORS: [char; 3] = ['_', '-', ' '];
/// A pause of more than this, beside the shutter times, ends a bracket, seconds: names hold it
/// together, and a hand may have turned the dial.
const NAMED_PAUSE_S: f64 = 30.0;

/// Returns `desk` for `desk_-2`, `desk_3`, `desk-ev1` and `desk_ev-2`: the part before the last
/// separator, if what follows is short; and whether that is an exposure value, by a sign or by its
/// unit.
fn prefix(name: &str) -> Option<(&str, bool)> {
    let at = name.rfind(SEPARATORS)?;
    let (before, after) = (name.get(..at)?, name.get(at + 1..)?);
    let number = after.trim_start_matches(|c: char| "evEV+".contains(c));
    // A sign belongs to the number, and so does its unit: desk_-2, desk_ev-2.
    let unsigned = before.strip_suffix(SEPARATORS).unwrap_or(before);
    let is_signed = name[at..].starts_with('-') && unsigned.len() < before.len();
    let before = ["ev", "EV"].iter().find_map(|ev| unsigned.strip_suffix(ev)?.strip_suffix(SEPARATORS)).unwrap_or(unsigned);
    let is_exposure_value = is_signed || before.len() < unsigned.len() || number.len() < after.len();
    (number.parse::<f64>().is_ok() && after.len() <= 8 && !before.is_empty()).then_some((before, is_exposure_value))
}

/// Groups by name.
pub(super) struct Named {
    pub(super) groups: Vec<Vec<usize>>,
    /// Whether the names of all groups of more than one state exposures.
    state_exposures: bool,
}

/// Names without a number are groups of their own.
pub(super) fn by_names(shots: &[Shot]) -> Option<Named> {
    let mut by_prefix: BTreeMap<(usize, &str), (Vec<usize>, bool)> = BTreeMap::new();
    let mut groups = Vec::new();
    for (i, shot) in shots.iter().enumerate() {
        match prefix(&shot.name) {
            Some((prefix, is_exposure_value)) => {
                let (group, states_exposures) = by_prefix.entry((shot.camera, prefix)).or_default();
                group.push(i);
                *states_exposures |= is_exposure_value;
            }
            None => groups.push(vec![i]),
        }
    }
    let state_exposures = by_prefix.values().all(|(group, states_exposures)| group.len() == 1 || *states_exposures);
    groups.extend(by_prefix.into_values().map(|(group, _)| group));
    let is_found = groups.iter().any(|g| g.len() > 1) && groups.iter().all(|g| g.len() == 1 || all_differ(shots, g));
    is_found.then_some(Named { groups, state_exposures })
}

/// Groups by name that are brackets by more than their names.
pub(super) fn believed(shots: &[Shot], named: Named) -> Option<Vec<Vec<usize>>> {
    if named.state_exposures {
        return Some(named.groups);
    }
    let groups: Vec<Vec<usize>> = named.groups.iter().flat_map(|group| without_pauses(shots, group)).collect();
    let several: Vec<Vec<f64>> = groups.iter().filter(|g| g.len() > 1).map(|g| sorted_stops(shots, g)).collect();
    // Up to the exposure of the first, which a camera may choose for each view.
    let steps = |stops: &[f64]| stops.iter().map(|s| ((s - stops[0]) / SAME_STOPS).round() as i64).collect::<Vec<_>>();
    let mut counts: BTreeMap<Vec<i64>, (usize, &[f64])> = BTreeMap::new();
    for stops in &several {
        counts.entry(steps(stops)).or_insert((0, stops)).0 += 1;
    }
    let (_, pattern) = counts.into_values().max_by_key(|(count, stops)| (*count, stops.len()))?;
    let alike: Vec<usize> = several.iter().filter(|stops| is_part_of(stops, pattern)).map(Vec::len).collect();
    let share = alike.iter().sum::<usize>() as f64 / several.iter().map(Vec::len).sum::<usize>() as f64;
    (alike.len() > 1 && share >= PATTERN).then_some(groups)
}

/// Returns whether exposures are those of a pattern, or some of them. One of three or more may lie
/// anywhere; two differ by a given step too often.
fn is_part_of(stops: &[f64], pattern: &[f64]) -> bool {
    let has = |shift: f64| stops.iter().all(|s| pattern.iter().any(|p| (s - shift - p).abs() <= 1.5 * SAME_STOPS));
    if pattern.len() > 2 { pattern.iter().any(|p| has(stops[0] - p)) } else { has(0.0) }
}

/// Returns a group cut at long pauses, if all times are known.
fn without_pauses(shots: &[Shot], group: &[usize]) -> Vec<Vec<usize>> {
    let Some(mut timed) = group.iter().map(|&i| Some((shots[i].time_s?, i))).collect::<Option<Vec<_>>>() else {
        return vec![group.to_vec()];
    };
    timed.sort_by(|a, b| a.0.total_cmp(&b.0));
    let goes_on = |a: &(f64, usize), b: &(f64, usize)| {
        let shutters = shots[a.1].seconds.unwrap_or(0.0) + shots[b.1].seconds.unwrap_or(0.0);
        b.0 - a.0 <= NAMED_PAUSE_S + shutters
    };
    timed.chunk_by(goes_on).map(|part| part.iter().map(|(_, i)| *i).collect()).collect()
}

/// Returns the exposures of a group that has them.
fn sorted_stops(shots: &[Shot], group: &[usize]) -> Vec<f64> {
    let mut stops: Vec<f64> = group.iter().filter_map(|&i| shots[i].stops).collect();
    stops.sort_by(f64::total_cmp);
    stops
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::tests::shot;
    use crate::{BracketError, BracketRule, Brackets, find_brackets};

    /// Returns the brackets of names without times.
    fn named(names: &[&str], stops: &[f64]) -> Brackets {
        let shots: Vec<Shot> = names.iter().zip(stops).map(|(name, stops)| Shot { time_s: None, ..shot(name, 0.0, *stops) }).collect();
        find_brackets(&shots, BracketRule::Auto).unwrap()
    }

    #[test]
    fn names_group_where_exposures_differ() {
        let shots: Vec<Shot> = (0..6).map(|i| shot(&format!("desk{:03}_{}", i / 3, i % 3), 0.0, f64::from(i % 3))).collect();
        assert_eq!(find_brackets(&shots, BracketRule::Auto).unwrap().views, [[0, 1, 2], [3, 4, 5]]);
        let same: Vec<Shot> = (0..6).map(|i| shot(&format!("IMG_{i:04}"), f64::from(i), 1.0)).collect();
        assert_eq!(find_brackets(&same, BracketRule::Auto).unwrap().views.len(), 6);
        assert!(matches!(find_brackets(&same, BracketRule::Names), Err(BracketError::Names(_))));
        assert_eq!((prefix("desk_-2"), prefix("desk-ev+1.5")), (Some(("desk", true)), Some(("desk", true))));
        assert_eq!((prefix("desk_ev-1.5"), prefix("desk EV -2")), (Some(("desk", true)), Some(("desk", true))));
        assert_eq!((prefix("desk-2"), prefix("rev-2")), (Some(("desk", false)), Some(("rev", false))));
        assert_eq!(prefix("_5"), None);
    }

    #[test]
    fn names_of_different_views_are_no_brackets() {
        // Four viewpoints a minute apart, with automatic exposure; then without times.
        let stops = [-5.0, -5.7, -4.4, -6.3];
        let shots: Vec<Shot> = (0..4).map(|i| shot(&format!("IMG_{i:04}"), 60.0 * i as f64, stops[i])).collect();
        assert_eq!(find_brackets(&shots, BracketRule::Auto).unwrap().views.len(), 4);
        assert_eq!(named(&["IMG_0001", "IMG_0002", "IMG_0003", "IMG_0004"], &stops).views.len(), 4);
        assert_eq!(named(&["v000", "v014"], &[-5.0, -8.0]).views.len(), 2);
        // A zoom lens at three focal lengths in turn: no pattern, however names are cut.
        let zoom: Vec<Shot> = (0..9)
            .map(|i| Shot {
                camera: i % 3,
                ..shot(&format!("IMG_{i:04}"), 60.0 * i as f64, -5.0 - [0.0, 1.0, 2.0, 0.4, 1.7, 3.0, 0.7, 1.3, 2.6][i])
            })
            .collect();
        assert_eq!(find_brackets(&zoom, BracketRule::Auto).unwrap().views.len(), 9);
        // Two visits to one place are two views, if their brackets are alike.
        let visits: Vec<Shot> =
            (0..6).map(|i| shot(&format!("desk_{i}"), (60 * (i / 3) + i) as f64, [0.0, 2.0, 4.0][i % 3] + 0.7 * (i / 3) as f64)).collect();
        assert_eq!(find_brackets(&visits, BracketRule::Auto).unwrap().views, [[0, 1, 2], [3, 4, 5]]);
    }

    #[test]
    fn a_bracket_without_its_like_is_one_if_its_names_say_so() {
        let found = named(&["desk_ev-2", "desk_ev0", "desk_ev+2"], &[-7.0, -5.0, -3.0]);
        assert_eq!((found.views.as_slice(), found.found_by), (&[vec![0, 1, 2]][..], "by name"));
        assert_eq!(named(&["desk_-2", "desk_0", "desk_+2"], &[-7.0, -5.0, -3.0]).views.len(), 1);
        assert_eq!(named(&["desk_1", "desk_2", "desk_3"], &[-7.0, -5.0, -3.0]).views.len(), 3);
    }

    #[test]
    fn brackets_of_a_wandering_exposure_that_lack_frames_are_found_by_name() {
        let found = named(&["a_1", "a_2", "a_3", "b_1", "b_2", "b_3", "c_1", "c_3"], &[-7.0, -5.0, -3.0, -7.4, -5.4, -3.4, -6.5, -2.5]);
        assert_eq!((found.views.iter().map(Vec::len).collect::<Vec<_>>(), found.found_by), (vec![3, 3, 2], "by name"));
    }

    #[test]
    fn a_name_without_a_number_is_a_view_of_its_own() {
        let names = ["desk0_1", "desk0_2", "cover", "desk1_1", "desk1_2"];
        assert_eq!(named(&names, &[-5.0, -3.0, -4.5, -5.0, -3.0]).views, [vec![2], vec![0, 1], vec![3, 4]]);
    }

    #[test]
    fn exposure_values_in_names_have_signs() {
        let names = ["room0_ev-2", "room0_ev0", "room0_ev+2", "room1_ev-2", "room1_ev0", "room1_ev+2"];
        assert_eq!(named(&names, &[-7.0, -5.0, -3.0, -7.0, -5.0, -3.0]).views, [[0, 1, 2], [3, 4, 5]]);
    }
}

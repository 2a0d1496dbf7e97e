//! Notes about what is odd in a set of photographs: primaries, incomplete brackets, corrections
//! that files ask for.

use std::collections::BTreeMap;

use luxel_core::text::plural;
use luxel_core::{Chromaticities, ColorSpace, Remedy};

use super::photograph::view_name;
use super::{Photograph, PrepareNote};
use crate::{BracketNote, Brackets};

/// Notes pictures that state primaries, by chunks or by a profile; known ones are used.
pub(super) fn note_primaries(photos: &[Photograph], input_space: ColorSpace, notes: &mut Vec<PrepareNote>) {
    let described = |found: &Chromaticities| match ColorSpace::from_chromaticities(found) {
        Some(space) => space.name().to_owned(),
        None => format!("red, green, blue and white at {found:?}"),
    };
    let mut counts: BTreeMap<(Option<&str>, Option<String>), usize> = BTreeMap::new();
    for info in photos.iter().map(|p| &p.info) {
        let profile = info.profile.as_ref().map(|profile| profile.name.as_str());
        *counts.entry((profile, info.primaries.as_ref().map(described))).or_default() += 1;
    }
    for ((profile, primaries), n) in counts {
        let pictures = plural(n, "picture");
        let note = match (profile, primaries) {
            // The default needs no note.
            (None, None) => continue,
            (_, Some(primaries)) if primaries == ColorSpace::LinearRec709.name() => continue,
            (Some(name), Some(primaries)) => {
                PrepareNote::new(format!("{pictures} with the ICC profile \"{name}\": colours are those of {primaries}"))
            }
            (None, Some(primaries)) => PrepareNote::new(format!("{pictures} with primaries of their own: colours are those of {primaries}")),
            (Some(name), None) => PrepareNote::new(format!(
                "not applied, but carried by {pictures}: the ICC profile \"{name}\", whose primaries are none of {}; colours are treated as {}",
                ColorSpace::NAMES,
                input_space.name()
            ))
            .with_remedy(Remedy::give("input_space")),
        };
        notes.push(note);
    }
}

/// Notes pictures with a gain map, which is for one display at a time and says nothing about the camera.
pub(super) fn note_gain_maps(photos: &[Photograph], notes: &mut Vec<PrepareNote>) {
    let count = photos.iter().filter(|photo| photo.info.has_gain_map).count();
    if count > 0 {
        notes.push(PrepareNote::new(format!(
            "{} with a gain map (Ultra HDR, ISO 21496-1), which is not applied: the pictures for ordinary screens are read, through one response \
             curve for all; where light beyond white matters, shoot RAW or brackets",
            plural(count, "picture")
        )));
    }
}

/// Notes brackets that have more or fewer exposures than the others.
pub(super) fn note_brackets(photos: &[Photograph], found: &Brackets, notes: &mut Vec<PrepareNote>) {
    for note in &found.notes {
        let text = match note {
            BracketNote::Missing { view, stops, found: n, expected } => {
                let name = found.views.get(*view).map(|frames| view_name(photos, frames)).unwrap_or_default();
                let missing: Vec<String> = stops.iter().map(|s| format!("{:+.1} EV", s - reference_stops(photos, found))).collect();
                format!(
                    "view {name}: its bracket has {n} of {expected} exposures, missing {}: what only they show is noisy or saturated",
                    if missing.is_empty() { "an unknown one".to_owned() } else { missing.join(", ") }
                )
            }
            BracketNote::Extra { view, found: n, expected } => {
                let name = found.views.get(*view).map(|frames| view_name(photos, frames)).unwrap_or_default();
                format!("view {name}: its bracket has {n} exposures, the others {expected}")
            }
        };
        notes.push(PrepareNote::new(text));
    }
}

/// Returns the exposure of the middle frame of the longest bracket: EV are counted from it.
fn reference_stops(photos: &[Photograph], found: &Brackets) -> f64 {
    let longest = found.views.iter().max_by_key(|frames| frames.len());
    let middle = longest.and_then(|frames| frames.get(frames.len() / 2)).and_then(|i| photos.get(*i));
    middle.and_then(|p| p.exposure).map_or(0.0, |e| e.stops())
}

/// Notes corrections that RAW files ask for: those that are applied, and those that are not.
pub(super) fn note_corrections(photos: &[Photograph], notes: &mut Vec<PrepareNote>) {
    let raws = || photos.iter().filter_map(|p| p.info.raw.as_ref());
    let counted = |names: &mut dyn Iterator<Item = &String>| {
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        names.for_each(|name| *counts.entry(name.clone()).or_default() += 1);
        counts
    };
    for (what, n) in counted(&mut raws().flat_map(|raw| &raw.applied)) {
        notes.push(PrepareNote::new(format!("applied, as requested by {}: {what}", plural(n, "file"))));
    }
    let straightened = raws().filter(|raw| raw.is_straightened).count();
    if straightened > 0 {
        notes.push(PrepareNote::new(format!(
            "{} free of the lens's distortion by what their files say: poses that another program finds must be of the images or the proxies \
             made here, not of pictures from the camera",
            if straightened == 1 { "1 photograph is".to_owned() } else { format!("{straightened} photographs are") }
        )));
    }
    for (what, n) in counted(&mut raws().flat_map(|raw| &raw.not_applied)) {
        notes.push(PrepareNote::new(format!("not applied, but requested by {}: {what}", plural(n, "file"))));
    }
}

//! The changes that edits make to a scene, for a page that has its splats already.
//!
//! In: the scene as it was opened and under edits, both with the same splats. Out: one body of
//! little-endian numbers as in [`crate::splats`]: the length of the head (u32), the head (JSON), a
//! bit for each splat that is removed if any is, a bit for each that changed if any did, and of
//! each changed row the new numbers of the changed splats. All but the bits of rows beyond half
//! floats is what a copy of the edited scene would have: edits of light change gains, and
//! some of them harmonics. Bits begin with the lowest of the first byte, and are padded to a
//! multiple of 4 bytes.

use bytes::Bytes;
use luxel_core::Splats;
use luxel_core::engine::ParameterRows;
use serde::Serialize;

use crate::splats::{GAIN_ROW, RowKind, body_with_head, is_half_row, parameter, push_row};

/// The head of a body of changes.
#[derive(Debug, Serialize)]
struct ChangesHead {
    splats: usize,
    removed: usize,
    changed: usize,
    rows: Vec<ChangedRow>,
}

/// A row of parameters of which some numbers are new.
#[derive(Debug, Serialize)]
struct ChangedRow {
    row: usize,
    kind: RowKind,
}

/// Returns the changes from `before` to `after`; `is_removed` names splats of both by their index.
pub(crate) fn pack_changes(before: &Splats, after: &Splats, is_removed: impl Fn(usize) -> bool) -> Bytes {
    let layout = ParameterRows { color_model: before.color_model };
    let splats = before.len();
    let candidates: Vec<usize> = (ParameterRows::SH..layout.count()).chain([layout.count() + GAIN_ROW]).collect();
    let removed: Vec<bool> = (0..splats).map(is_removed).collect();
    let mut changed = Vec::new();
    let mut is_changed = vec![false; splats];
    let mut rows = vec![false; candidates.len()];
    for splat in (0..splats).filter(|splat| !removed[*splat]) {
        let mut is_same = true;
        for (changes, row) in rows.iter_mut().zip(&candidates) {
            let [old, new] = [before, after].map(|splats| parameter(splats, layout, *row, splat).to_bits());
            (*changes, is_same) = (*changes || old != new, is_same && old == new);
        }
        if is_same {
            continue;
        }
        is_changed[splat] = true;
        changed.push(splat);
    }
    let mut planes = Vec::new();
    for bits in [&removed, &is_changed] {
        if bits.contains(&true) {
            push_bits(&mut planes, bits);
        }
    }
    let mut kinds = Vec::new();
    for (row, _) in candidates.into_iter().zip(rows).filter(|(_, changes)| *changes) {
        let values: Vec<f32> = changed.iter().map(|splat| parameter(after, layout, row, *splat)).collect();
        let is_half = is_half_row(layout, row, &values);
        push_row(&mut planes, &values, is_half);
        kinds.push(ChangedRow { row, kind: if is_half { RowKind::F16 } else { RowKind::F32 } });
    }
    let head = ChangesHead { splats, removed: removed.iter().filter(|is| **is).count(), changed: changed.len(), rows: kinds };
    body_with_head(serde_json::to_string(&head).unwrap_or_default(), planes)
}

fn push_bits(planes: &mut Vec<u8>, bits: &[bool]) {
    planes.extend(bits.chunks(8).map(|chunk| chunk.iter().enumerate().fold(0, |byte, (i, bit)| byte | (u8::from(*bit) << i))));
    planes.resize(planes.len().next_multiple_of(4), 0);
}

#[cfg(test)]
mod tests {
    use half::f16;
    use luxel::synthetic;
    use luxel_core::{Edit, edit::MaskShares};
    use serde_json::Value;

    use super::*;

    fn parts(body: &[u8]) -> (Value, &[u8]) {
        let length = u32::from_le_bytes(body[..4].try_into().unwrap()) as usize;
        (serde_json::from_slice(&body[4..4 + length]).unwrap(), &body[4 + length..])
    }

    fn bits(planes: &[u8], splats: usize) -> Vec<usize> {
        (0..splats).filter(|i| planes[i / 8] >> (i % 8) & 1 == 1).collect()
    }

    #[test]
    fn only_changed_numbers_of_changed_splats_are_there() {
        let before = synthetic::room(100, 1);
        let mut after = luxel::Scene::clone(&before).into_core();
        let edit: Edit = "where L > p50; gain 0.5".parse().unwrap();
        edit.apply(&mut after, &MaskShares::new(), Default::default()).unwrap();
        let body = pack_changes(&before.splats, &after.splats, |splat| splat == 3 || splat == 64);
        let (head, mut planes) = parts(&body);
        assert_eq!((&head["splats"], &head["removed"]), (&100.into(), &2.into()));
        assert_eq!(bits(planes, 100), [3, 64]);
        planes = &planes[16..];
        let expected: Vec<usize> = (0..100)
            .filter(|i| before.splats.gain_of(*i) != after.splats.gain_of(*i) || before.splats.sh_of(*i) != after.splats.sh_of(*i))
            .filter(|i| ![3, 64].contains(i))
            .collect();
        assert!(expected.len() > 40 && expected.len() < 60);
        assert_eq!((bits(planes, 100), head["changed"].as_u64().unwrap() as usize), (expected.clone(), expected.len()));
        planes = &planes[16..];
        let layout = ParameterRows { color_model: before.splats.color_model };
        for changed in head["rows"].as_array().unwrap() {
            let (row, is_half) = (changed["row"].as_u64().unwrap() as usize, changed["kind"] == "f16");
            for (i, splat) in expected.iter().enumerate() {
                let found = match is_half {
                    true => f16::from_le_bytes(planes[2 * i..][..2].try_into().unwrap()).to_f32(),
                    false => f32::from_le_bytes(planes[4 * i..][..4].try_into().unwrap()),
                };
                let value = parameter(&after.splats, layout, row, *splat);
                assert!((found - value).abs() <= if is_half { value.abs() * 4.9e-4 + 6e-8 } else { 0.0 }, "row {row}: {found} for {value}");
            }
            planes = &planes[(expected.len() * if is_half { 2 } else { 4 }).next_multiple_of(4)..];
        }
        assert!(planes.is_empty());
    }

    #[test]
    fn no_change_is_a_head_alone() {
        let scene = synthetic::room(9, 1);
        let body = pack_changes(&scene.splats, &scene.splats, |_| false);
        let (head, planes) = parts(&body);
        assert_eq!((&head["removed"], &head["changed"], planes.len()), (&0.into(), &0.into(), 0));
    }
}

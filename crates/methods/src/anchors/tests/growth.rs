//! Growth and pruning.

use super::super::groups::Groups;
use super::super::grow::{Changes, GrowthRules, grow};
use super::super::statistics::Statistics;
use super::super::{FEATURE, OFFSETS, SPLATS_PER_ANCHOR};
use super::{MODELS, scene};

const RULES: GrowthRules =
    GrowthRules { voxel: 0.1, interval: 100, threshold: 2e-4, prune_opacity: 0.005, limit: 100, turnover: 0.0, largest: 1.0, seed: 3 };

/// Returns the statistics of anchors that are seen and opaque.
fn seen(anchors: usize) -> Statistics {
    let mut statistics = Statistics::zeros(anchors);
    statistics.draws.fill(60.0);
    statistics.views.fill(90.0);
    statistics.opacity.fill(90.0);
    statistics
}

#[test]
fn splats_of_large_gradients_get_anchors_in_empty_cells_up_to_the_limit() {
    let before = scene(MODELS[0], false, 30);
    let grown = |limit: usize, gradient: f32| {
        let (mut scene, mut statistics) = (before.clone(), seen(30));
        let mut groups = Groups::new(&scene);
        statistics.gradient[SPLATS_PER_ANCHOR * 7..SPLATS_PER_ANCHOR * 9].fill(60.0 * gradient);
        let changes = grow(&mut scene, &mut groups, &mut statistics, &GrowthRules { limit, ..RULES });
        groups.validate(&scene).unwrap();
        scene.validate().unwrap();
        assert_eq!(statistics.views.len(), scene.anchors.len());
        (scene, changes)
    };
    let (scene, changes) = grown(100, 1e-2);
    assert!(changes.added > 8 && changes.pruned == 0, "{changes:?}");
    assert_eq!(scene.anchors.len(), 30 + changes.added);
    // New ones have no offsets, the size of their cell, and a feature of the two.
    let new = (0..scene.anchors.len()).filter(|i| scene.anchors.offset[i * OFFSETS..(i + 1) * OFFSETS].iter().all(|v| *v == 0.0));
    for i in new.clone() {
        let size = scene.anchors.log_scale[6 * i].exp();
        assert!([0.4, 0.1, 0.025].iter().any(|side| (size - side).abs() < 1e-4), "{size}");
        for f in 0..FEATURE {
            let of = |anchor: usize| before.anchors.feature[anchor * FEATURE + f];
            let found = scene.anchors.feature[i * FEATURE + f];
            assert!(found == of(7) || found == of(8), "{found}");
        }
    }
    assert_eq!(new.count(), changes.added);
    assert_eq!(grown(33, 1e-2).1, Changes { added: 3, pruned: 0 });
    assert_eq!(grown(20, 1e-2).1, Changes::default());
    assert_eq!(grown(100, 1e-4).1, Changes::default());
}

#[test]
fn transparent_anchors_are_pruned_and_moments_follow_the_others() {
    let (mut scene, mut statistics) = (scene(MODELS[0], false, 30), seen(30));
    let mut groups = Groups::new(&scene);
    groups.adam[1].step(&mut scene.anchors.feature.clone(), &scene.anchors.feature, 0.1);
    statistics.opacity[4] = 0.3;
    // Too few views to tell.
    (statistics.opacity[5], statistics.views[5]) = (0.0, 50.0);
    let before = scene.clone();
    let changes = grow(&mut scene, &mut groups, &mut statistics, &RULES);
    assert_eq!((changes, scene.anchors.len()), (Changes { added: 0, pruned: 1 }, 29));
    assert!(!scene.anchors.position.contains(&before.anchors.position[4]));
    let [first, _] = groups.adam[1].moments();
    for (moment, value) in first.iter().zip(&scene.anchors.feature) {
        assert!((moment - 0.1 * value).abs() < 1e-6);
    }
    // Counters of all but the one with too few views start anew.
    assert_eq!(statistics.views.iter().filter(|views| **views > 0.0).count(), 1);
}

#[test]
fn the_least_opaque_anchors_make_room() {
    let (mut scene, mut statistics) = (scene(MODELS[0], false, 30), seen(30));
    let mut groups = Groups::new(&scene);
    statistics.gradient.fill(1.0);
    for (i, opacity) in [(3, 30.0), (9, 20.0), (12, 10.0), (20, 40.0)] {
        statistics.opacity[i] = opacity;
    }
    let before = scene.clone();
    // A tenth of 30.
    let changes = grow(&mut scene, &mut groups, &mut statistics, &GrowthRules { limit: 30, turnover: 0.1, ..RULES });
    assert_eq!((changes, scene.anchors.len()), (Changes { added: 3, pruned: 3 }, 30));
    let is_there = |i: usize| scene.anchors.position.contains(&before.anchors.position[i]);
    assert_eq!([3, 9, 12, 20].map(is_there), [false, false, false, true]);
}

#[test]
fn splats_are_bounded_in_size() {
    let (mut scene, mut statistics) = (scene(MODELS[0], false, 5), seen(5));
    let mut groups = Groups::new(&scene);
    grow(&mut scene, &mut groups, &mut statistics, &GrowthRules { largest: 0.3, ..RULES });
    let largest = scene.anchors.log_scale.chunks(6).flat_map(|scales| &scales[3..]).fold(f32::NEG_INFINITY, |a, b| a.max(*b));
    assert!((largest - 0.3f32.ln()).abs() < 1e-6, "{largest}");
}

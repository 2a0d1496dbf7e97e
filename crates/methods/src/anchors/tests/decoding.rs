//! Decoded splats, and gradients through the decoders, against the f64 version.

use luxel_core::engine::{ParameterRows, SPLATS_PER_BLOCK, SparseGradients, SplatArray};

use super::super::decode::CHUNK;
use super::super::gradients::{AnchorGradients, SplatGradients};
use super::super::groups::GROUPS;
use super::oracle::Point;
use super::{MODELS, normals, scene};
use crate::testing::camera_at;

/// Step of central differences: the skirts of splats are cut off where alpha is small, and a longer
/// one moves pixels across the cut-off.
const STEP: f64 = 1e-7;

/// Returns the gradients of all groups, in their order.
pub(super) fn of_groups(found: AnchorGradients) -> [Vec<f64>; GROUPS] {
    let wide = |values: Vec<f32>| values.into_iter().map(f64::from).collect();
    let AnchorGradients { by_offset, by_feature, by_log_scale, by_weights: [opacity, shape, color], by_context } = found;
    [wide(by_offset), wide(by_feature), wide(by_log_scale), opacity, shape, color, by_context]
}

/// Compares some of the gradients of all groups with central differences of a loss.
pub(super) fn check_groups(found: &[Vec<f64>; GROUPS], point: &Point, bound: f64, loss: impl Fn(&Point) -> f64) {
    for (group, found) in found.iter().enumerate() {
        assert_eq!(found.len(), point.groups[group].len());
        let largest = found.iter().fold(0.0f64, |most, g| most.max(g.abs()));
        let mut worst = 0.0f64;
        for at in (0..found.len()).step_by((found.len() / 50).max(1)) {
            let moved = |h: f64| {
                let mut point = point.clone();
                point.groups[group][at] += h;
                loss(&point)
            };
            let numeric = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            worst = worst.max((numeric - found[at]).abs() / largest);
            assert!((numeric - found[at]).abs() < bound * largest, "group {group}, {at}: {numeric:e} {:e} of {largest:e}", found[at]);
        }
        println!("group {group}: worst error {worst:.1e} of the largest");
    }
}

#[test]
fn splats_are_those_of_the_formulas() {
    for model in MODELS {
        let scene = scene(model, true, CHUNK + 5);
        let decoded = scene.decode(&camera_at([0.0; 3], [64, 64]), 0.2);
        assert_eq!(decoded.visible.len(), CHUNK + 5);
        let exact = Point::new(&scene).splats();
        assert_eq!(decoded.splats.len(), exact.len());
        assert!((decoded.splats.len() as f64) > 2.0 * CHUNK as f64, "{}", decoded.splats.len());
        decoded.splats.validate().unwrap();
        for (i, expected) in exact.iter().enumerate() {
            let mut row: Vec<f32> = Vec::new();
            for array in SplatArray::ALL.into_iter().filter(|array| *array != SplatArray::Smoothing) {
                let width = array.width(model);
                row.extend(&decoded.splats.array(array)[i * width..(i + 1) * width]);
            }
            for (found, expected) in row.iter().zip(&expected.row) {
                assert!((f64::from(*found) - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{i}: {row:?} {:?}", expected);
            }
            for (found, expected) in decoded.splats.radiance(i, [0.0, 0.0, 1.0]).iter().zip(expected.radiance) {
                assert!((f64::from(*found) - expected).abs() < 1e-4 * expected, "{i}: {found} {expected}");
            }
            for (found, expected) in decoded.context[4 * i..].iter().zip(expected.context) {
                assert!((f64::from(*found) - expected).abs() < 1e-5, "{i}: {found} {expected}");
            }
        }
    }
}

#[test]
fn gradients_through_the_decoders_are_those_of_differences() {
    for model in MODELS {
        let scene = scene(model, true, 40);
        let mut decoded = scene.decode(&camera_at([0.0; 3], [64, 64]), 0.2);
        let (count, rows) = (decoded.splats.len(), ParameterRows { color_model: model });
        // A loss that is linear in the splats' parameters and context features.
        let (weights, of_context) = (normals(7, count * rows.count()), normals(8, count * 4));
        let mut gradients = SparseGradients::none(rows);
        for block in 0..count.div_ceil(SPLATS_PER_BLOCK) {
            let values = gradients.push(block as u32);
            for row in 0..rows.count() {
                for lane in 0..SPLATS_PER_BLOCK.min(count - block * SPLATS_PER_BLOCK) {
                    values[row * SPLATS_PER_BLOCK + lane] = weights[(block * SPLATS_PER_BLOCK + lane) * rows.count() + row];
                }
            }
        }
        let by_splats = SplatGradients::new(&gradients, count);
        let found = of_groups(decoded.backward(&scene, &by_splats, &of_context));
        let loss = |point: &Point| {
            let mut sum = 0.0;
            for (i, splat) in point.splats().iter().enumerate() {
                sum += splat.row.iter().zip(&weights[i * rows.count()..]).map(|(x, w)| x * f64::from(*w)).sum::<f64>();
                sum += splat.context.iter().zip(&of_context[4 * i..]).map(|(x, w)| x * f64::from(*w)).sum::<f64>();
            }
            sum
        };
        check_groups(&found, &Point::new(&scene), 1e-4, loss);
    }
}

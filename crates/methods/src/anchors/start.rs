//! The first anchors: the first splats of any method, rounded to voxels.
//!
//! In: positions and colours of first splats. Out: an anchor in each voxel that holds some, and the
//! side of a voxel: the median spacing of the positions, or more where there would be more anchors
//! than the run may begin with. Published is a length that is given, which means something else in
//! every model. Degenerate: positions in one place are one anchor.

use std::collections::BTreeSet;

use luxel_core::{Splats, spatial_order};
use luxel_train::spacing;

use super::FEATURE;
use super::grow::{cell_of, center_of};
use super::scene::Anchors;

/// Factor by which voxels grow until there are few enough.
const GROWTH: f32 = 1.05;
/// Part of the largest number of anchors that a run begins with at most; the rest is for growth.
const FIRST_SHARE: f64 = 0.5;

/// Anchors, and the side of a voxel, world units.
pub(super) struct First {
    pub(super) anchors: Anchors,
    pub(super) voxel: f32,
}

/// Makes the first anchors of at most `limit` later ones.
pub(super) fn first_anchors(positions: &[[f32; 3]], limit: usize) -> First {
    let most = ((limit as f64 * FIRST_SHARE) as usize).max(1);
    let mut spacings = spacing(positions);
    let middle = spacings.len() / 2;
    let mut voxel = if spacings.is_empty() { 1.0 } else { *spacings.select_nth_unstable_by(middle, f32::total_cmp).1 };
    let cells = loop {
        let cells: BTreeSet<[i64; 3]> = positions.iter().map(|position| cell_of(*position, voxel)).collect();
        if cells.len() <= most {
            break cells;
        }
        voxel *= GROWTH;
    };
    let positions: Vec<[f32; 3]> = cells.into_iter().map(|cell| center_of(cell, voxel)).collect();
    let positions: Vec<[f32; 3]> = spatial_order(&positions).into_iter().map(|i| positions[i as usize]).collect();
    let mut anchors = Anchors::default();
    positions.iter().zip(spacing(&positions)).for_each(|(position, size)| anchors.push(*position, size, [0.0; FEATURE]));
    First { anchors, voxel }
}

/// Returns the median of the splats' radiance by channel, normalised units.
pub(super) fn median_color(splats: &Splats) -> [f32; 3] {
    let middle = splats.len() / 2;
    let colors: Vec<[f32; 3]> = (0..splats.len()).map(|i| splats.base_radiance(i)).collect();
    [0, 1, 2].map(|c: usize| {
        let mut values: Vec<f32> = colors.iter().map(|rgb| rgb[c]).collect();
        if values.is_empty() { 1.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_one_anchor_a_voxel_of_the_median_spacing_and_no_more_than_may_be() {
        let plane: Vec<[f32; 3]> = (0..1600).map(|i| [(i % 40) as f32 * 0.5, (i / 40) as f32 * 0.5, 3.0]).collect();
        let first = first_anchors(&plane, 100_000);
        assert!((first.voxel - 0.5).abs() < 0.01 && first.anchors.len() > 1500, "{} {}", first.voxel, first.anchors.len());
        let size = first.anchors.log_scale[700 * 6];
        assert!((size.exp() - 0.5).abs() < 0.1, "{size}");
        let few = first_anchors(&plane, 200);
        assert!(few.voxel > 1.5 && (50..=100).contains(&few.anchors.len()), "{} {}", few.voxel, few.anchors.len());
        // World units of another length change nothing but lengths.
        let larger: Vec<[f32; 3]> = plane.iter().map(|p| p.map(|v| 64.0 * v)).collect();
        assert_eq!(first_anchors(&larger, 200).anchors.len(), few.anchors.len());
        assert_eq!(first_anchors(&[[1.0; 3]; 50], 10).anchors.len(), 1);
    }
}

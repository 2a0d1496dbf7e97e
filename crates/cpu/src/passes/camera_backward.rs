//! Pass `camera_backward`: computes the gradient by the camera, for steps that ask for it.
//!
//! In: what pass `project_backward` reads, before the update. Out: [`CameraSums`]. It repeats
//! `project_backward` block by block and adds up what the camera's motion would change; no other
//! step pays for it. Sums are in f32 over the blocks of a chunk, then in f64 in the order of lanes
//! and chunks: the same bits for any number of threads. The derivation is core's
//! ([`luxel_core::engine::CameraSums`]). Degenerate: gradients that overflow count as zero.

use fearless_simd::Simd;
use luxel_core::each;
use luxel_core::engine::{CAMERA_SUMS, CameraSums, ParameterRows};
use luxel_lanes::Level;
use rayon::prelude::*;

use super::project_backward::{BlockSums, CameraParts, Inputs, camera_parts};
use crate::lanes::{Lanes, V, with_simd};
use crate::store::Block;
use crate::view::ScreenCamera;

/// Blocks of splats per chunk.
const CHUNK: usize = 16;

/// Computes the sums over all splats.
pub(crate) fn camera_backward(level: Level, camera: &ScreenCamera, inputs: &Inputs<'_>, parameters: &[Lanes]) -> CameraSums {
    let rows = inputs.shape.layout.count();
    let chunk_sums = |(chunk, parameters): (usize, &[Lanes])| {
        let mut gradient = vec![Lanes::ZERO; rows];
        let mut lanes = [Lanes::ZERO; CAMERA_SUMS];
        with_simd!(level, simd => {
            let mut totals = each!([0, 1, 2, 3, 4, 5, 6, 7] _i => V::splat(simd, 0.0));
            for (n, rows) in parameters.chunks(rows).enumerate() {
                let block = Block { index: chunk * CHUNK + n, rows };
                let mut sums = BlockSums::ZERO;
                sums.gather(simd, inputs, block.index);
                if let Some(parts) = camera_parts(simd, camera, inputs, block, &sums, &mut gradient) {
                    add_block(simd, camera, rows, &gradient, &parts, &mut totals);
                }
            }
            for (total, lanes) in totals.iter().zip(&mut lanes) {
                total.store(lanes);
            }
        });
        lanes.map(|Lanes(values)| values.iter().map(|v| f64::from(*v)).sum::<f64>())
    };
    let sums: Vec<[f64; CAMERA_SUMS]> = parameters.par_chunks(CHUNK * rows).enumerate().map(chunk_sums).collect();
    CameraSums::of_rows(sums)
}

/// Adds a block's parts: the moment of its gradients about the camera's centre with that of its
/// splats' own axes, the gradients themselves, and those by the focal lengths.
#[inline(always)]
fn add_block<S: Simd>(
    simd: S,
    camera: &ScreenCamera,
    rows: &[Lanes],
    gradient: &[Lanes],
    parts: &CameraParts<S>,
    totals: &mut [V<S>; CAMERA_SUMS],
) {
    let half = V::splat(simd, 0.5);
    let arm: [V<S>; 3] = each!([0, 1, 2] i => V::load(simd, &rows[ParameterRows::POSITION + i]) - camera.eye[i]);
    let [w, x, y, z]: [V<S>; 4] = each!([0, 1, 2, 3] i => V::load(simd, &rows[ParameterRows::ROTATION + i]));
    let [dw, dx, dy, dz]: [V<S>; 4] = each!([0, 1, 2, 3] i => V::load(simd, &gradient[ParameterRows::ROTATION + i]));
    // A rotation by r of the splat turns its quaternion q by r q / 2.
    let own = [w * dx - x * dw + y * dz - z * dy, w * dy - y * dw + z * dx - x * dz, w * dz - z * dw + x * dy - y * dx];
    let g = parts.by_projection;
    for i in 0..3 {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        totals[i] = totals[i] + (arm[j] * g[k] - arm[k] * g[j]) + half * own[i];
        totals[3 + i] = totals[3 + i] + V::load(simd, &gradient[ParameterRows::POSITION + i]);
    }
    for i in 0..2 {
        totals[6 + i] = totals[6 + i] + parts.by_focal_px[i];
    }
}

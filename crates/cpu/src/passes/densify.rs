//! Pass `densify`: rebuilds the scene from a plan.
//!
//! In: parameters, moments, smoothing, [`DensifyPlan`]. Out: the same with one splat per row of the
//! plan. The plan decides which splats are split or removed; this pass only copies, displaces and
//! scales rows. Degenerate: a plan that does not fit the scene is an error.

use luxel_core::engine::{DensifyPlan, ParameterRows, PlanRow};
use rayon::prelude::*;

use crate::lanes::{LANES, Lanes};
use crate::memory::Buffer;
use crate::store::{Store, blocks};

/// Replaces `parameters` by the plan's rows. `spare` may be any buffer; afterwards it holds the
/// memory of the old parameters.
pub(crate) fn apply(parameters: &mut Store, plan: &DensifyPlan, spare: &mut Buffer) {
    gather(parameters, plan, spare, |_| true);
    let rows = parameters.layout.count();
    parameters.lanes.par_chunks_mut(rows).zip(plan.rows.par_chunks(LANES)).for_each(|(block, rows)| {
        for (lane, row) in rows.iter().enumerate() {
            change(block, lane, row);
        }
    });
    if let Some(cap) = plan.opacity_logit_cap {
        for block in parameters.lanes.chunks_mut(rows) {
            for value in &mut block[ParameterRows::OPACITY].0 {
                *value = value.min(cap);
            }
        }
    }
}

/// Replaces `moments` by those of the plan's rows. `parameters` are those from before the plan:
/// where the cap lowers an opacity, its moment becomes zero.
pub(crate) fn apply_to_moments(moments: &mut Store, parameters: &Store, plan: &DensifyPlan, spare: &mut Buffer) {
    gather(moments, plan, spare, |row| row.keep_moments);
    if let Some(cap) = plan.opacity_logit_cap {
        let rows = moments.layout.count();
        for (i, row) in plan.rows.iter().enumerate() {
            let before = row.opacity_logit.unwrap_or_else(|| parameters.at(ParameterRows::OPACITY, row.source as usize));
            if before > cap {
                moments.lanes[i / LANES * rows + ParameterRows::OPACITY].0[i % LANES] = 0.0;
            }
        }
    }
}

/// Copies the sources of the rows that `wanted` accepts into `spare`, with zeros for the others,
/// and swaps it with the store's memory.
fn gather(store: &mut Store, plan: &DensifyPlan, spare: &mut Buffer, wanted: impl Fn(&PlanRow) -> bool + Sync) {
    let rows = store.layout.count();
    spare.resize(blocks(plan.rows.len()) * rows);
    let old: &[Lanes] = &store.lanes;
    spare.par_chunks_mut(rows).zip(plan.rows.par_chunks(LANES)).for_each(|(block, plan_rows)| {
        block.fill(Lanes::ZERO);
        for (lane, row) in plan_rows.iter().enumerate().filter(|(_, row)| wanted(row)) {
            let from = row.source as usize;
            let source = &old[from / LANES * rows..][..rows];
            for (to, from_lanes) in block.iter_mut().zip(source) {
                to.0[lane] = from_lanes.0[from % LANES];
            }
        }
    });
    std::mem::swap(&mut store.lanes, spare);
    store.count = plan.rows.len();
}

/// Displaces and scales one splat.
fn change(block: &mut [Lanes], lane: usize, row: &PlanRow) {
    let at = |r: usize| block[r].0[lane];
    if row.offset_sigma != [0.0; 3] {
        let q = glam::Quat::from_xyzw(
            at(ParameterRows::ROTATION + 1),
            at(ParameterRows::ROTATION + 2),
            at(ParameterRows::ROTATION + 3),
            at(ParameterRows::ROTATION),
        );
        // As in `project`: a quaternion of nearly no length rotates nothing.
        let q = if q.length_squared() > 1e-30 { q.normalize() } else { glam::Quat::IDENTITY };
        let sigma = glam::Vec3::from_array(std::array::from_fn(|i| at(ParameterRows::LOG_SCALE + i).exp()));
        let offset = q * (sigma * glam::Vec3::from_array(row.offset_sigma));
        for (i, d) in offset.to_array().into_iter().enumerate() {
            block[ParameterRows::POSITION + i].0[lane] += d;
        }
    }
    for i in 0..3 {
        block[ParameterRows::LOG_SCALE + i].0[lane] += row.log_scale_shift;
    }
    if let Some(logit) = row.opacity_logit {
        block[ParameterRows::OPACITY].0[lane] = logit;
    }
}

//! Pass `gain`: the light of edits, after `project` and only where a scene has any.
//!
//! In, out: footprints, whose cut-offs follow the radiance that the colour model gave; gains, one a
//! splat, or none at all. Degenerate: a splat whose light f32 does not hold is not seen.

use bytemuck::Zeroable;
use rayon::prelude::*;

use super::project::Footprint;

/// Multiplies each splat's radiance by its gain.
pub(crate) fn apply_gains(footprints: &mut [Footprint], gains: &[f32]) {
    footprints.par_iter_mut().zip(gains).with_min_len(1024).for_each(|(footprint, gain)| {
        footprint.radiance = footprint.radiance.map(|c| c * gain);
        if !footprint.radiance.iter().all(|c| c.is_finite()) {
            *footprint = Footprint::zeroed();
        }
    });
}

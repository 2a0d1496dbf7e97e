//! Checks that every reader of scenes makes before an engine gets the values.

use luxel_core::{MAX_SAMPLES, RasterConfig, Splats};

/// Returns whether a quaternion can be normalised in f32: neither zero (or so short that its square
/// is) nor too long.
pub(crate) fn is_normalizable(rotation: [f32; 4]) -> bool {
    rotation.iter().map(|q| q * q).sum::<f32>().is_normal()
}

/// Refuses splats whose size, written as a length instead of its logarithm, f32 does not hold.
pub(crate) fn check_lengths(splats: &Splats) -> Result<(), String> {
    match splats.log_scale.iter().position(|s| s.iter().any(|s| !s.exp().is_finite())) {
        None => Ok(()),
        Some(i) => Err(format!(
            "log scale of splat {i} is {:?}, expected sizes below 3.4e38; remove the splat or scale the scene",
            splats.log_scale[i]
        )),
    }
}

/// Returns whether an engine can work with these settings. Only `min_contribution` may be infinite.
pub(crate) fn is_usable(raster: &RasterConfig) -> bool {
    let c = raster.cutoffs;
    [c.min_alpha, c.alpha_floor, c.min_transmittance, c.max_alpha].iter().all(|v| (0.0..=1.0).contains(v))
        && c.min_contribution >= 0.0
        && (1..=MAX_SAMPLES).contains(&raster.samples)
        && c.near >= 0.0
        && c.near.is_finite()
}

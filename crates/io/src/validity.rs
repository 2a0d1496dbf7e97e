//! Checks that every reader of scenes makes before an engine gets the values.

use luxel_core::{MAX_SAMPLES, RasterConfig, Splats};

/// Returns whether a quaternion can be normalised in f32: neither zero (or so short that its square
/// is) nor too long.
pub(crate) fn is_normalizable(rotation: [f32; 4]) -> bool {
    rotation.iter().map(|q| q * q).sum::<f32>().is_normal()
}

/// Says how many of `count` splats were left out, since a number of theirs is not finite.
pub(crate) fn left_out_line(left_out: u64, count: u64) -> Option<String> {
    (left_out > 0).then(|| format!("left out, with a number that is NaN or infinite: {left_out} of {count} splats"))
}

/// Removes splats with a number that is not finite, unless all have one; returns how many.
pub(crate) fn leave_out_unfinite(splats: &mut Splats) -> u64 {
    let is_finite = |i: usize| {
        let own = [&splats.position[i][..], &splats.rotation[i], &splats.log_scale[i], &splats.opacity_logit[i..=i]];
        let colors = [splats.sh_of(i), splats.raw_luminance_of(i), splats.smoothing.get(i..=i).unwrap_or_default()];
        let colors = colors.into_iter().chain(splats.gain.get(i..=i));
        own.into_iter().chain(colors).flatten().all(|v| v.is_finite())
    };
    let kept: Vec<u32> = (0u32..).zip(0..splats.len()).filter(|(_, i)| is_finite(*i)).map(|(index, _)| index).collect();
    let left_out = splats.len() - kept.len();
    if left_out > 0 && !kept.is_empty() {
        *splats = splats.select(kept);
        return left_out as u64;
    }
    0
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

/// Returns whether a length in metres is one that a unit may have.
pub(crate) fn is_length(metres: &f64) -> bool {
    metres.is_normal() && *metres > 0.0
}

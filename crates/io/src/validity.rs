//! Checks that every reader of scenes makes before an engine gets the values.

use luxel_core::{MAX_SAMPLES, RasterConfig, Splats};

/// Returns whether a quaternion can be normalised in f32: neither zero (or so short that its square
/// is) nor too long.
pub(crate) fn is_normalizable(rotation: [f32; 4]) -> bool {
    rotation.iter().map(|q| q * q).sum::<f32>().is_normal()
}

/// Splats that a reader left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LeftOut {
    /// With a number that is NaN or infinite.
    pub(crate) unfinite: u64,
    /// With a rotation that is none: a quaternion of length 0, or too long for its square.
    pub(crate) unturned: u64,
}

impl LeftOut {
    /// Returns how many there are.
    pub(crate) fn total(self) -> u64 {
        self.unfinite + self.unturned
    }

    /// Adds those of another part of the file.
    pub(crate) fn add(&mut self, other: Self) {
        self.unfinite += other.unfinite;
        self.unturned += other.unturned;
    }

    /// Says how many of `count` splats were left out, and why.
    pub(crate) fn lines(self, count: u64) -> Vec<String> {
        let reasons = [
            (self.unfinite, "a number that is NaN or infinite"),
            (self.unturned, "a rotation that is no quaternion of length about 1, such as 0 0 0 0"),
        ];
        let mut lines: Vec<String> = reasons
            .into_iter()
            .filter(|(left_out, _)| *left_out > 0)
            .map(|(left_out, reason)| format!("left out, with {reason}: {left_out} of {count} splats"))
            .collect();
        if self.total() > count / 2
            && let Some(last) = lines.last_mut()
        {
            last.push_str("; most of the file is no splats: is it whole, or padded?");
        }
        lines
    }
}

/// Removes splats with a number that is not finite or without a rotation, unless all are such;
/// returns how many.
pub(crate) fn leave_out_unusable(splats: &mut Splats) -> LeftOut {
    let is_finite = |i: usize| {
        let own = [&splats.position[i][..], &splats.rotation[i], &splats.log_scale[i], &splats.opacity_logit[i..=i]];
        let colors = [splats.sh_of(i), splats.raw_luminance_of(i), splats.smoothing.get(i..=i).unwrap_or_default()];
        let colors = colors.into_iter().chain(splats.gain.get(i..=i));
        own.into_iter().chain(colors).flatten().all(|v| v.is_finite())
    };
    let mut left_out = LeftOut::default();
    let mut is_kept = |i: usize| {
        let (finite, turned) = (is_finite(i), is_normalizable(splats.rotation[i]));
        left_out.unfinite += u64::from(!finite);
        left_out.unturned += u64::from(finite && !turned);
        finite && turned
    };
    let kept: Vec<u32> = (0u32..).zip(0..splats.len()).filter(|(_, i)| is_kept(*i)).map(|(index, _)| index).collect();
    if kept.is_empty() || left_out.total() == 0 {
        return LeftOut::default();
    }
    *splats = splats.select(kept);
    left_out
}

/// Refuses splats of which one has no rotation: where none is left without them.
pub(crate) fn check_rotations(splats: &Splats) -> Result<(), String> {
    match splats.rotation.iter().position(|q| !is_normalizable(*q)) {
        None => Ok(()),
        Some(i) => Err(format!(
            "rotation of splat {i} is {:?}, expected a quaternion of length about 1; the file holds no splats, or is damaged: export it again",
            splats.rotation[i]
        )),
    }
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

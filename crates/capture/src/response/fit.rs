//! The least-squares fit of one channel's response curve (Debevec and Malik 1997).
//!
//! In: brackets of RGB frames. Out: signal by code, rising. Weights, gauge and the treatment of
//! motion are explained in [`super`]. Degenerate: codes that cover too little of the range, or
//! equations without a solution, are an error.

use super::{CODES, DARK_CODE, MIN_COVERED, ResponseError};
use crate::CapturedFrame;

/// Weight of smoothness against data.
const SMOOTHNESS: f64 = 60.0;
/// Code whose signal is fixed.
const MIDDLE: usize = 128;
/// Fits after the first, with weights by how well a sighting agrees with the one before.
const ROUNDS: usize = 8;
/// Disagreement that noise and rounding alone may cause, ln of signal.
const MIN_SCALE: f64 = 0.1;
/// Disagreement with the first fit beyond which something moved, ln of signal...
const MOVED: f64 = 1.0;
/// ...if it is this much of all weight.
const MOVED_SHARE: f64 = 0.01;
/// Pixels taken of each bracket.
const PIXELS_PER_BRACKET: usize = 400;
/// From this of 256 codes on, a curve is not fitted: JPEG leaves saturated pixels beside edges at
/// 244 and above, and they would make it steep.
const UNTRUSTED_CODE: usize = 244;
/// Codes whose slope continues the curve from there.
const SLOPE_CODES: usize = 8;

/// Codes of a pixel with the logarithms of the exposures.
type Sightings = Vec<(usize, f64)>;

/// Recovers the curve of one channel from brackets.
pub(super) fn recover_channel(brackets: &[&Vec<CapturedFrame>], channel: usize) -> Result<[f32; CODES], ResponseError> {
    let pixels: Vec<Sightings> = brackets.iter().flat_map(|frames| sample_pixels(frames, channel)).collect();
    let mut is_covered = [false; CODES];
    for &(code, _) in pixels.iter().flatten() {
        is_covered[code] |= hat(code) > 0.0;
    }
    // Smoothness bridges gaps: a code counts if one within 2 is seen.
    let covered = (0..CODES).filter(|&i| is_covered[i.saturating_sub(2)..(i + 3).min(CODES)].contains(&true)).count();
    if covered < MIN_COVERED {
        return Err(ResponseError::TooFewCodes { channel, covered });
    }
    let singular = || ResponseError::Contradiction(channel);
    let mut weights: Vec<Vec<f64>> = pixels.iter().map(|sightings| sightings.iter().map(|(code, _)| hat(*code)).collect()).collect();
    let mut log_signal = solve(&pixels, &weights).ok_or_else(singular)?;
    let rounds = if has_moved(&pixels, &log_signal) { ROUNDS } else { 0 };
    for _ in 0..rounds {
        weights = agreeing(&pixels, &log_signal);
        log_signal = solve(&pixels, &weights).ok_or_else(singular)?;
    }
    if log_signal[UNTRUSTED_CODE - 1] - log_signal[DARK_CODE + 1] < 1.0 {
        return Err(ResponseError::Contradiction(channel));
    }
    Ok(to_curve(&log_signal))
}

/// Returns the weight of a code: none at the ends.
fn hat(code: usize) -> f64 {
    code.saturating_sub(DARK_CODE).min(UNTRUSTED_CODE.saturating_sub(code)) as f64 / 128.0
}

/// Returns the code of a curve that is nearest to a code in `0..=last`.
fn nearest(code: usize, last: usize) -> usize {
    (code * (CODES - 1) + last / 2) / last
}

/// Samples pixels on a grid, those with information.
fn sample_pixels(frames: &[CapturedFrame], channel: usize) -> Vec<Sightings> {
    let Some(first) = frames.first() else { return Vec::new() };
    let step = ((first.width * first.height) as f64 / PIXELS_PER_BRACKET as f64).sqrt().max(1.0) as usize;
    let mut pixels = Vec::new();
    for y in (step / 2..first.height).step_by(step) {
        for x in (step / 2..first.width).step_by(step) {
            let i = (y * first.width + x) * 3 + channel;
            let sightings: Sightings = frames
                .iter()
                .map(|f| (nearest(f.samples.code(i), f.samples.levels() - 1), f64::from(f.signal_per_radiance).ln()))
                .collect();
            if sightings.iter().filter(|(code, _)| hat(*code) > 0.0).count() > 1 {
                pixels.push(sightings);
            }
        }
    }
    pixels
}

/// Returns how far each sighting is off its pixel's median by a curve, ln of signal.
fn disagreement(pixels: &[Sightings], log_signal: &[f64; CODES]) -> Vec<Vec<f64>> {
    let of_pixel = |sightings: &Sightings| {
        let known = |(code, t): &(usize, f64)| (hat(*code) > 0.0).then(|| log_signal[*code] - t);
        let middle = median(sightings.iter().filter_map(known).collect());
        sightings.iter().map(|seen| known(seen).map_or(0.0, |radiance| radiance - middle)).collect()
    };
    pixels.iter().map(of_pixel).collect()
}

/// Returns whether more contradicts a curve than noise in the dark explains.
fn has_moved(pixels: &[Sightings], log_signal: &[f64; CODES]) -> bool {
    let off = disagreement(pixels, log_signal);
    let (mut moved, mut all) = (0.0, 0.0);
    for ((code, _), off) in pixels.iter().flatten().zip(off.iter().flatten()) {
        all += hat(*code);
        moved += if off.abs() > MOVED { hat(*code) } else { 0.0 };
    }
    moved > MOVED_SHARE * all
}

/// Returns the weights of sightings: hats, and the less the further a sighting is off its pixel's
/// median by a curve.
fn agreeing(pixels: &[Sightings], log_signal: &[f64; CODES]) -> Vec<Vec<f64>> {
    let off = disagreement(pixels, log_signal);
    let worst = |pixel: &Vec<f64>| pixel.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let scale = (2.0 * median(off.iter().map(worst).collect())).max(MIN_SCALE);
    let weight = |(&(code, _), off): (&(usize, f64), &f64)| hat(code) / (1.0 + (off / scale).powi(2)).powi(2);
    pixels.iter().zip(&off).map(|(sightings, off)| sightings.iter().zip(off).map(weight).collect()).collect()
}

/// Returns the median; the mean of the two in the middle for an even number, 0 for none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    0.5 * (at(values.len() / 2) + at(values.len().saturating_sub(1) / 2))
}

/// Solves for ln signal by code, by least squares with these weights; `None` where the equations
/// are singular.
fn solve(pixels: &[Sightings], weights: &[Vec<f64>]) -> Option<[f64; CODES]> {
    let mut matrix = vec![[0.0f64; CODES]; CODES];
    let mut right = [0.0f64; CODES];
    for (sightings, weights) in pixels.iter().zip(weights) {
        // sum_j w_j (g_j - e - t_j)^2 with the best e = sum w (g - t) / sum w: the rest is a
        // quadratic form in g alone.
        let weighted: Vec<(usize, f64, f64)> =
            sightings.iter().zip(weights).map(|(&(code, t), w)| (code, t, *w)).filter(|(_, _, w)| *w > 0.0).collect();
        let total: f64 = weighted.iter().map(|(_, _, w)| w).sum();
        let mean_t: f64 = weighted.iter().map(|(_, t, w)| w * t).sum::<f64>() / total;
        for &(a, t, w) in &weighted {
            matrix[a][a] += w;
            right[a] += w * (t - mean_t);
            for &(b, _, v) in &weighted {
                matrix[a][b] -= w * v / total;
            }
        }
    }
    let scale = SMOOTHNESS * (pixels.len().max(1) as f64 / PIXELS_PER_BRACKET as f64);
    for i in 1..CODES - 1 {
        let weight = scale * (0.02 + hat(i).powi(2));
        let stencil = [(i - 1, 1.0), (i, -2.0), (i + 1, 1.0)];
        for (a, u) in stencil {
            for (b, v) in stencil {
                matrix[a][b] += weight * u * v;
            }
        }
    }
    // The gauge: g of the middle code is 0.
    matrix[MIDDLE][MIDDLE] += 1e3 * (1.0 + pixels.len() as f64);
    cholesky_solve(&mut matrix, right)
}

fn cholesky_solve(matrix: &mut [[f64; CODES]], mut right: [f64; CODES]) -> Option<[f64; CODES]> {
    for i in 0..CODES {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| matrix[i][k] * matrix[j][k]).sum();
            let rest = matrix[i][j] - dot;
            if i == j {
                if !(rest > 1e-12 && rest.is_finite()) {
                    return None;
                }
                matrix[i][i] = rest.sqrt();
            } else {
                matrix[i][j] = rest / matrix[j][j];
            }
        }
    }
    for i in 0..CODES {
        let dot: f64 = (0..i).map(|k| matrix[i][k] * right[k]).sum();
        right[i] = (right[i] - dot) / matrix[i][i];
    }
    for i in (0..CODES).rev() {
        let dot: f64 = (i + 1..CODES).map(|k| matrix[k][i] * right[k]).sum();
        right[i] = (right[i] - dot) / matrix[i][i];
    }
    Some(right)
}

/// Returns the signals, rising, through 0 at the darkest code, where no logarithm goes, and
/// absolute where sRGB's middle code is: which light saturates is not to be seen in a curve, so
/// that the middle of the range is taken to be exposed as the standard has it.
fn to_curve(log_signal: &[f64; CODES]) -> [f32; CODES] {
    let middle = f64::from(luxel_core::tone::srgb_decode(MIDDLE as f32 / 255.0));
    let mut curve = [0.0f32; CODES];
    let (first, last) = (DARK_CODE + 1, UNTRUSTED_CODE - 1);
    let log_slope = (log_signal[last] - log_signal[last - SLOPE_CODES]) / SLOPE_CODES as f64;
    for (code, out) in curve.iter_mut().enumerate() {
        let at = log_signal[code.clamp(first, last)].exp() * middle;
        *out = match code {
            _ if code < first => at * code as f64 / first as f64,
            // Beyond the trusted codes the curve continues straight in stops: shoulders, which rise
            // ever faster, are approximated better than by a tangent.
            _ if code > last => at * (log_slope * (code - last) as f64).exp(),
            _ => at,
        } as f32;
    }
    for code in 1..CODES {
        curve[code] = curve[code].max(curve[code - 1] + 1e-7);
    }
    curve
}

//! Response curves: what a camera's developer made of light, undone.
//!
//! [`ResponseCurve`] is a curve from code (0 to 1) to signal (1 at the largest code). [`recover_response`] finds it from brackets (Debevec and Malik
//! 1997): codes z of pixel i in frame j with exposure t give g(z) = ln E_i + ln t_j, solved for g at 256 codes and all E in least squares with
//! hat weights and a smooth g. The E are eliminated one by one, which leaves 256 unknowns. The curve is per channel; each is fixed by the
//! code in the middle, so that a neutral there stays neutral. What moved between two exposures contradicts the rest: where there is such a thing, the fit is repeated
//! with less weight for what is off by more than most (Geman and McClure's weights), so that a shifted bracket or a passer-by does not bend the curve. Where
//! there is not, the first fit stays: such weights favour what agrees with the curve before, right or wrong.
//!
//! Degenerate: fewer than two exposures, or codes that cover too little of the range, have no curve.

use crate::{CapturedFrame, CodeTransfer, SampleLayout};

/// Codes a recovered curve has.
const CODES: usize = 256;
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
/// Codes of the range that pixels must cover.
const MIN_COVERED: usize = 96;
/// From this of 256 codes on, a sample may be saturated: developers roll off.
const CLIP_CODE: usize = 250;
/// From this of 256 codes on, a curve is not fitted: JPEG leaves saturated pixels beside edges at 244 and above, and they would make it steep.
const UNTRUSTED_CODE: usize = 244;
/// Codes whose slope the curve goes on with from there.
const SLOPE_CODES: usize = 8;
/// Up to this code a sample may be crushed to black, of however many codes: what has more of them is no finished picture.
const DARK_CODE: usize = 3;
/// Uncertainty of a JPEG's code: rounding, quantisation of its blocks, and sharpening.
const CODE_SIGMA: f32 = 0.8;

/// From code to signal.
#[derive(Clone, Debug, PartialEq)]
pub enum ResponseCurve {
    /// Codes are proportional to light.
    Linear,
    /// IEC 61966-2-1.
    Srgb,
    /// Signal at 256 equidistant codes, per channel, rising to 1.
    Curve(Box<[[f32; CODES]; 3]>),
}

/// No curve could be found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// Not a bracket.
    #[error("expected brackets of at least two exposures, a stop or more apart, to find the curve from")]
    NoBracket,
    /// Too little to see.
    #[error("channel {channel}: the brackets show {covered} of 256 codes well exposed, expected at least {MIN_COVERED}")]
    TooFewCodes {
        /// 0 red, 1 green, 2 blue.
        channel: usize,
        /// How many.
        covered: usize,
    },
    /// The equations have no solution.
    #[error("channel {0}: the brackets contradict each other: is the exposure in EXIF that of the pictures?")]
    Contradiction(usize),
}

impl ResponseCurve {
    /// Tables of an RGB frame whose samples have this many codes.
    pub fn transfers(&self, codes: usize) -> Vec<CodeTransfer> {
        let last = codes.saturating_sub(1).max(1);
        let scale = last as f32 / 255.0;
        // Codes of more than 8 bits are rounded finer than a developer's curve is known.
        let sigma = CODE_SIGMA * scale.sqrt();
        let clip = (CLIP_CODE as f32 * scale) as usize;
        let of = |channel: usize| (0..codes).map(|code| self.signal(channel, code as f32 / last as f32)).collect();
        (0..3).map(|channel| CodeTransfer::new(of(channel), DARK_CODE, clip, sigma)).collect()
    }

    /// Signal of a code in 0 to 1.
    pub fn signal(&self, channel: usize, code: f32) -> f32 {
        match self {
            Self::Linear => code,
            Self::Srgb => luxel_core::tone::srgb_decode(code),
            Self::Curve(curves) => {
                let Some(curve) = curves.get(channel) else { return code };
                let at = code.clamp(0.0, 1.0) * (CODES - 1) as f32;
                let low = (at as usize).min(CODES - 2);
                curve[low] + (at - low as f32) * (curve[low + 1] - curve[low])
            }
        }
    }
}

/// The curve of one camera from brackets (frames of RGB, of one view each), whichever tables their frames have.
///
/// # Errors
/// See [`ResponseError`].
pub fn recover_response(brackets: &[Vec<CapturedFrame>]) -> Result<ResponseCurve, ResponseError> {
    let spread = |frames: &[CapturedFrame]| {
        let stops = frames.iter().map(|f| f.signal_per_radiance.log2());
        stops.clone().fold(f32::MIN, f32::max) - stops.fold(f32::MAX, f32::min)
    };
    let usable: Vec<&Vec<CapturedFrame>> = brackets
        .iter()
        .filter(|frames| {
            frames.len() > 1 && spread(frames) >= 0.9 && frames.iter().all(|f| f.layout == SampleLayout::Rgb && f.validate().is_ok())
        })
        .collect();
    if usable.is_empty() {
        return Err(ResponseError::NoBracket);
    }
    let mut curves = Box::new([[0.0f32; CODES]; 3]);
    for (channel, curve) in curves.iter_mut().enumerate() {
        *curve = recover_channel(&usable, channel)?;
    }
    Ok(ResponseCurve::Curve(curves))
}

/// Codes of a pixel with the logarithms of the exposures.
type Sightings = Vec<(usize, f64)>;

fn recover_channel(brackets: &[&Vec<CapturedFrame>], channel: usize) -> Result<[f32; CODES], ResponseError> {
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

/// Weight of a code: none at the ends.
fn hat(code: usize) -> f64 {
    code.saturating_sub(DARK_CODE).min(UNTRUSTED_CODE.saturating_sub(code)) as f64 / 128.0
}

/// Of the codes that a curve has the one nearest to a code in `0..=last`.
fn nearest(code: usize, last: usize) -> usize {
    (code * (CODES - 1) + last / 2) / last
}

/// Pixels on a grid, those that say something.
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

/// How far each sighting is off its pixel's median by a curve, ln of signal.
fn disagreement(pixels: &[Sightings], log_signal: &[f64; CODES]) -> Vec<Vec<f64>> {
    let of_pixel = |sightings: &Sightings| {
        let known = |(code, t): &(usize, f64)| (hat(*code) > 0.0).then(|| log_signal[*code] - t);
        let middle = median(sightings.iter().filter_map(known).collect());
        sightings.iter().map(|seen| known(seen).map_or(0.0, |radiance| radiance - middle)).collect()
    };
    pixels.iter().map(of_pixel).collect()
}

/// Whether more contradicts a curve than noise in the dark explains.
fn has_moved(pixels: &[Sightings], log_signal: &[f64; CODES]) -> bool {
    let off = disagreement(pixels, log_signal);
    let (mut moved, mut all) = (0.0, 0.0);
    for ((code, _), off) in pixels.iter().flatten().zip(off.iter().flatten()) {
        all += hat(*code);
        moved += if off.abs() > MOVED { hat(*code) } else { 0.0 };
    }
    moved > MOVED_SHARE * all
}

/// Weights of sightings: hats, and the less the further a sighting is off its pixel's median by a curve.
fn agreeing(pixels: &[Sightings], log_signal: &[f64; CODES]) -> Vec<Vec<f64>> {
    let off = disagreement(pixels, log_signal);
    let worst = |pixel: &Vec<f64>| pixel.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let scale = (2.0 * median(off.iter().map(worst).collect())).max(MIN_SCALE);
    let weight = |(&(code, _), off): (&(usize, f64), &f64)| hat(code) / (1.0 + (off / scale).powi(2)).powi(2);
    pixels.iter().zip(&off).map(|(sightings, off)| sightings.iter().zip(off).map(weight).collect()).collect()
}

/// Of an even number the mean of the two in the middle; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    0.5 * (at(values.len() / 2) + at(values.len().saturating_sub(1) / 2))
}

/// ln signal by code, by least squares with these weights; `None` where the equations are singular.
fn solve(pixels: &[Sightings], weights: &[Vec<f64>]) -> Option<[f64; CODES]> {
    let mut matrix = vec![[0.0f64; CODES]; CODES];
    let mut right = [0.0f64; CODES];
    for (sightings, weights) in pixels.iter().zip(weights) {
        // sum_j w_j (g_j - e - t_j)^2 with the best e = sum w (g - t) / sum w: what is left is a quadratic form in g alone.
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

/// Signals, rising, through 0 at the darkest code, where no logarithm goes, and absolute where sRGB's middle code is: which light saturates is
/// not to be seen in a curve, so that the middle of the range is taken to be exposed as the standard has it.
fn to_curve(log_signal: &[f64; CODES]) -> [f32; CODES] {
    let middle = f64::from(luxel_core::tone::srgb_decode(MIDDLE as f32 / 255.0));
    let mut curve = [0.0f32; CODES];
    let (first, last) = (DARK_CODE + 1, UNTRUSTED_CODE - 1);
    let log_slope = (log_signal[last] - log_signal[last - SLOPE_CODES]) / SLOPE_CODES as f64;
    for (code, out) in curve.iter_mut().enumerate() {
        let at = log_signal[code.clamp(first, last)].exp() * middle;
        *out = match code {
            _ if code < first => at * code as f64 / first as f64,
            // Beyond what is trusted the curve goes on straight in stops: shoulders, which rise ever faster, are met better than by a tangent.
            _ if code > last => at * (log_slope * (code - last) as f64).exp(),
            _ => at,
        } as f32;
    }
    for code in 1..CODES {
        curve[code] = curve[code].max(curve[code - 1] + 1e-7);
    }
    curve
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{Codes, SignalNoise, merge};

    /// A camera's curve: a gamma with a shoulder, not sRGB.
    fn camera_code(signal: f32, channel: usize) -> f32 {
        let exposed = signal * [1.0, 1.02, 0.97][channel];
        let light = (1.0 - (-2.2 * exposed).exp()) / (1.0 - (-2.2f32).exp());
        light.clamp(0.0, 1.0).powf(1.0 / 2.0)
    }

    fn bracket(exposures: &[f32], phase: f32) -> Vec<CapturedFrame> {
        bracket_of(exposures, phase, &|codes| Codes::U8(codes.iter().map(|code| (255.0 * code).round() as u8).collect()), camera_code)
    }

    /// Through a curve from signal and channel to code in 0 to 1.
    fn bracket_of(exposures: &[f32], phase: f32, samples: &dyn Fn(&[f32]) -> Codes, curve: fn(f32, usize) -> f32) -> Vec<CapturedFrame> {
        let radiance = |i: usize| 10f32.powf(-2.0 + 3.5 * ((i as f32 * 0.017 + phase).sin() * 0.5 + 0.5));
        let frame = |&exposure: &f32| CapturedFrame {
            width: 80,
            height: 60,
            layout: SampleLayout::Rgb,
            samples: samples(&(0..80 * 60 * 3).map(|i| curve(radiance(i / 3) * exposure, i % 3)).collect::<Vec<_>>()),
            transfers: Arc::from(ResponseCurve::Srgb.transfers(256)),
            signal_per_radiance: exposure,
            noise: SignalNoise::typical(100.0),
        };
        exposures.iter().map(frame).collect()
    }

    #[test]
    fn a_camera_curve_is_recovered_up_to_its_scale() {
        let exposures = [0.02, 0.08, 0.32, 1.28, 5.12];
        let response = recover_response(&[bracket(&exposures, 0.0), bracket(&exposures, 2.0)]).unwrap();
        for channel in 0..3 {
            let ratios: Vec<f32> = (1..=20)
                .map(|k| 0.9 * k as f32 / 20.0)
                .map(|s| response.signal(channel, (255.0 * camera_code(s, channel)).round() / 255.0) / s)
                .collect();
            let mean = ratios.iter().sum::<f32>() / ratios.len() as f32;
            for (k, ratio) in ratios.iter().enumerate() {
                assert!((ratio / mean - 1.0).abs() < 0.05, "channel {channel}, {k}: {ratio} of {mean}");
            }
        }
    }

    #[test]
    fn what_moved_between_exposures_does_not_bend_the_curve() {
        let exposures = [0.02, 0.08, 0.32, 1.28, 5.12];
        let brackets = [bracket(&exposures, 0.0), bracket(&exposures, 2.0), bracket(&exposures, 4.0)];
        let still = recover_response(&brackets).unwrap();
        let mut moved = brackets.clone();
        // One view's middle exposure is another picture, and somebody stands in a third of another one's.
        moved[1][2] = bracket(&exposures, 3.0).swap_remove(2);
        if let Codes::U8(codes) = &mut moved[2][3].samples {
            codes.iter_mut().skip(80 * 20 * 3).take(80 * 20 * 3).for_each(|code| *code = 90);
        }
        let found = recover_response(&moved).unwrap();
        for channel in 0..3 {
            let codes = (16..=240).step_by(16).map(|code| code as f32 / 255.0);
            let ratios: Vec<f32> = codes.map(|code| found.signal(channel, code) / still.signal(channel, code)).collect();
            // Half of the sightings of one view and a sixth of another's are wrong, by up to three decades.
            assert!(ratios.iter().all(|ratio| (ratio - 1.0).abs() < 0.12), "channel {channel}: {ratios:?}");
        }
    }

    #[test]
    fn sixteen_bits_have_the_curve_of_eight() {
        let exposures = [0.02, 0.08, 0.32, 1.28, 5.12];
        let deep = |codes: &[f32]| Codes::U16(codes.iter().map(|code| (65535.0 * code).round() as u16).collect());
        let of = |bracket: &dyn Fn(f32) -> Vec<CapturedFrame>| recover_response(&[bracket(0.0), bracket(2.0)]).unwrap();
        let found = of(&|phase| bracket_of(&exposures, phase, &deep, camera_code));
        let expected = of(&|phase| bracket(&exposures, phase));
        for channel in 0..3 {
            for code in [5, 8, 16, 32, 64, 128, 192, 230] {
                let code = code as f32 / 255.0;
                let ratio = found.signal(channel, code) / expected.signal(channel, code);
                assert!((ratio - 1.0).abs() < 0.03, "channel {channel}, code {}: {ratio}", 255.0 * code);
            }
        }
    }

    #[test]
    fn saturated_pixels_a_little_below_white_do_not_bend_the_curve() {
        // As JPEG leaves them beside edges: every third saturated sample comes at one of the codes 244 to 252.
        let ringing = |codes: &[f32]| {
            let code = |(i, code): (usize, &f32)| match (255.0 * code).round() as u8 {
                255 if i % 3 == i / 3 % 3 => 244 + (i / 3 * 7 % 9) as u8,
                code => code,
            };
            Codes::U8(codes.iter().enumerate().map(code).collect())
        };
        let srgb = |signal: f32, _| luxel_core::tone::srgb_encode(signal.min(1.0));
        let brackets: Vec<_> = (0..4).map(|phase| bracket_of(&[0.08, 0.32, 1.28], phase as f32, &ringing, srgb)).collect();
        let response = recover_response(&brackets).unwrap();
        for channel in 0..3 {
            for code in [96, 160, 200, 230, 240, 250, 255] {
                let code = code as f32 / 255.0;
                let ratio = response.signal(channel, code) / ResponseCurve::Srgb.signal(channel, code);
                // What is beyond the codes that are trusted is told from their slope.
                let bound = if code < 0.93 { 0.05 } else { 0.12 };
                assert!((ratio - 1.0).abs() < bound, "channel {channel}, code {}: {ratio}", 255.0 * code);
            }
        }
    }

    #[test]
    fn recovered_curves_merge_to_radiance() {
        let exposures = [0.02, 0.08, 0.32, 1.28, 5.12];
        let mut frames = bracket(&exposures, 1.0);
        let response = recover_response(&[frames.clone()]).unwrap();
        for frame in &mut frames {
            frame.transfers = Arc::from(response.transfers(256));
        }
        let merged = merge(&frames).unwrap();
        let truth: Vec<f32> = (0..80 * 60).map(|i| 10f32.powf(-2.0 + 3.5 * ((i as f32 * 0.017 + 1.0).sin() * 0.5 + 0.5))).collect();
        let log_ratio: Vec<f32> = truth.iter().zip(merged.radiance.chunks(3)).map(|(t, m)| (m[1] / t).ln()).collect();
        let mean = log_ratio.iter().sum::<f32>() / log_ratio.len() as f32;
        let rms = (log_ratio.iter().map(|r| (r - mean).powi(2)).sum::<f32>() / log_ratio.len() as f32).sqrt();
        assert!(rms < 0.04, "{rms}");
    }

    #[test]
    fn what_is_no_bracket_has_no_curve() {
        assert_eq!(recover_response(&[bracket(&[1.0], 0.0)]).unwrap_err(), ResponseError::NoBracket);
        assert_eq!(recover_response(&[]).unwrap_err(), ResponseError::NoBracket);
        let mut black = bracket(&[0.1, 1.0], 0.0);
        for frame in &mut black {
            frame.samples = Codes::U8(vec![0; 80 * 60 * 3]);
        }
        assert!(matches!(recover_response(&[black]).unwrap_err(), ResponseError::TooFewCodes { .. }));
    }

    #[test]
    fn named_curves_are_themselves() {
        let transfers = ResponseCurve::Srgb.transfers(256);
        assert!((transfers[0].signal(188) - 0.5).abs() < 0.01 && transfers[1].is_clipped(250) && transfers[2].is_dark(3));
        let linear = ResponseCurve::Linear.transfers(65536);
        assert!((linear[0].signal(32768) - 0.5).abs() < 1e-4 && linear[0].is_clipped(64_300));
    }

    #[test]
    fn what_is_dark_in_8_bits_is_sound_in_16() {
        // Code 300 of 65535 is rounded to a third of a per cent.
        for response in [ResponseCurve::Linear, ResponseCurve::Srgb] {
            let transfers = response.transfers(65536);
            assert!(transfers[0].is_dark(3) && !transfers[0].is_dark(300));
        }
    }
}

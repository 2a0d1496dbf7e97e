//! Response curves: the curve that a camera's developer applied to light, undone.
//!
//! [`ResponseCurve`] is a curve from code (0 to 1) to signal (1 at the largest code).
//! [`recover_response`] finds it from brackets (Debevec and Malik 1997): codes z of pixel i in
//! frame j with exposure t give g(z) = ln E_i + ln t_j, solved for g at 256 codes and all E in
//! least squares with hat weights and a smooth g. The E are eliminated one by one, which leaves 256
//! unknowns. The curve is per channel; each is fixed by the code in the middle, so that a neutral
//! there stays neutral. Things that moved between two exposures contradict the rest: where there
//! are any, the fit is repeated with less weight for samples that are off by more than most (Geman
//! and McClure's weights), so that a shifted bracket or a passer-by does not bend the curve. Where
//! there is not, the first fit stays: such weights favour samples that agree with the previous
//! curve, right or wrong.
//!
//! Degenerate: fewer than two exposures, or codes that cover too little of the range, have no
//! curve.

mod fit;

use fit::recover_channel;

use crate::{CapturedFrame, CodeTransfer, SampleLayout};

/// Codes a recovered curve has.
const CODES: usize = 256;
/// Codes of the range that pixels must cover.
const MIN_COVERED: usize = 96;
/// From this of 256 codes on, a sample may be saturated: developers roll off.
const CLIP_CODE: usize = 250;
/// Up to this code a sample may be crushed to black, of however many codes: an image with
/// more of them is not a finished picture.
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

/// Explains why no curve can be recovered.
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
    /// Returns the tables of an RGB frame whose samples have this many codes.
    pub fn transfers(&self, codes: usize) -> Vec<CodeTransfer> {
        let last = codes.saturating_sub(1).max(1);
        let scale = last as f32 / 255.0;
        // Codes of more than 8 bits are rounded finer than a developer's curve is known.
        let sigma = CODE_SIGMA * scale.sqrt();
        let clip = (CLIP_CODE as f32 * scale) as usize;
        let of = |channel: usize| (0..codes).map(|code| self.signal(channel, code as f32 / last as f32)).collect();
        (0..3).map(|channel| CodeTransfer::new(of(channel), DARK_CODE, clip, sigma)).collect()
    }

    /// Returns the signal of a code in 0 to 1.
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

/// Returns the curve of one camera from brackets (frames of RGB, of one view each), whichever
/// tables their frames have.
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{Codes, SignalNoise, merge};

    /// Returns a camera's curve: a gamma with a shoulder, not sRGB.
    fn camera_code(signal: f32, channel: usize) -> f32 {
        let exposed = signal * [1.0, 1.02, 0.97][channel];
        let light = (1.0 - (-2.2 * exposed).exp()) / (1.0 - (-2.2f32).exp());
        light.clamp(0.0, 1.0).powf(1.0 / 2.0)
    }

    fn bracket(exposures: &[f32], phase: f32) -> Vec<CapturedFrame> {
        bracket_of(exposures, phase, &|codes| Codes::U8(codes.iter().map(|code| (255.0 * code).round() as u8).collect()), camera_code)
    }

    /// Returns a bracket through a curve from signal and channel to code in 0 to 1.
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
            corrections: None,
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
        // One view's middle exposure is another picture, and somebody stands in a third of another
        // one's.
        moved[1][2] = bracket(&exposures, 3.0).swap_remove(2);
        if let Codes::U8(codes) = &mut moved[2][3].samples {
            codes.iter_mut().skip(80 * 20 * 3).take(80 * 20 * 3).for_each(|code| *code = 90);
        }
        let found = recover_response(&moved).unwrap();
        for channel in 0..3 {
            let codes = (16..=240).step_by(16).map(|code| code as f32 / 255.0);
            let ratios: Vec<f32> = codes.map(|code| found.signal(channel, code) / still.signal(channel, code)).collect();
            // Half of the sightings of one view and a sixth of another's are wrong, by up to three
            // decades.
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
        // As JPEG leaves them beside edges: every third saturated sample comes at one of the codes
        // 244 to 252.
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
                // Codes beyond the trusted ones follow from their slope.
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

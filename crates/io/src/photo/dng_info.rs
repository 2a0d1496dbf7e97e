//! Colours, levels and noise by the tags of a DNG.
//!
//! In: a file whose tags were read. Out: [`RawInfo`]; implausible values are left out. What the
//! file asks for and is not done is listed in [`RawInfo::not_applied`]: optional opcodes, profiles.

use luxel_core::photo::{LensStep, RawInfo};

use super::dng::Dng;
use super::dng_tags as tag;
use crate::IoError;

impl Dng<'_> {
    /// Reads colours, levels and noise from the tags. An opcode that the file requires and that is
    /// not known is an error.
    pub(super) fn info(&self) -> Result<RawInfo, IoError> {
        let plan = self.plan()?;
        let triple = |tag| self.first.numbers(tag).and_then(|v| <[f64; 3]>::try_from(v).ok());
        let matrix = |tag| self.first.numbers(tag).and_then(|v| <[f64; 9]>::try_from(v).ok()).filter(|m| m.iter().all(|v| v.is_finite()));
        let mut camera_from_xyz = Vec::new();
        let mut d50_from_balanced = Vec::new();
        for i in [0, 1] {
            let Some(found) = matrix(tag::COLOR_MATRIX[i]) else { continue };
            camera_from_xyz.push((illuminant_kelvin(self.first.unsigned(tag::ILLUMINANT[i])), found));
            d50_from_balanced.extend(matrix(tag::FORWARD_MATRIX[i]));
        }
        let noise = self.image.numbers(tag::NOISE_PROFILE).or_else(|| self.first.numbers(tag::NOISE_PROFILE));
        Ok(RawInfo {
            as_shot_neutral: triple(tag::AS_SHOT_NEUTRAL).filter(|n| n.iter().all(|v| v.is_finite() && *v > 0.0)),
            camera_from_xyz,
            d50_from_balanced,
            baseline_exposure_ev: self.first.number(tag::BASELINE_EXPOSURE).filter(|ev| ev.abs() < 16.0).unwrap_or(0.0),
            noise: noise.and_then(|n| noise_of(&n)),
            is_straightened: plan.steps.iter().any(|step| matches!(step, LensStep::Warp(_))),
            applied: plan.applied,
            not_applied: plan.left_out.into_iter().chain(self.not_applied()).collect(),
        })
    }

    fn not_applied(&self) -> Vec<String> {
        let has = |tag: u16| self.image.has(tag) || self.first.has(tag);
        let mut out = Vec::new();
        let named = [
            (52525, "profile gain table map"),
            (52544, "profile gain table map 2"),
            (50938, "hue and saturation map of its profile"),
            (50982, "look table of its profile"),
            (50940, "tone curve of its profile"),
            (tag::AS_SHOT_WHITE_XY, "as-shot white as xy"),
        ];
        if let Some([across, down]) = self.image.numbers(tag::DEFAULT_SCALE).as_deref()
            && (across / down - 1.0).abs() > 1e-3
        {
            out.push(format!("default scale of its pixels, {across:.3} by {down:.3}: they are not square and are read as if they were"));
        }
        out.extend(named.iter().filter(|(tag, _)| has(*tag)).map(|(_, what)| (*what).to_owned()));
        let any_but = |tag: u16, neutral: &dyn Fn(usize) -> f64| {
            let numbers = self.first.numbers(tag).or_else(|| self.image.numbers(tag)).unwrap_or_default();
            numbers.iter().enumerate().any(|(i, v)| *v != neutral(i))
        };
        let is_diagonal = |i: usize| if i.is_multiple_of(4) { 1.0 } else { 0.0 };
        if tag::CAMERA_CALIBRATION.iter().any(|t| any_but(*t, &is_diagonal)) || any_but(tag::ANALOG_BALANCE, &|_| 1.0) {
            out.push("calibration of the single camera".to_owned());
        }
        out
    }
}

/// Returns the temperature of Exif's light sources, kelvin.
fn illuminant_kelvin(code: Option<usize>) -> f64 {
    match code {
        Some(17 | 3) => 2856.0,
        Some(24) => 3200.0,
        Some(2 | 14) => 4200.0,
        Some(23) => 5003.0,
        Some(1 | 4 | 9 | 18 | 20) => 5503.0,
        Some(10 | 19) => 6774.0,
        Some(11 | 22) => 7504.0,
        Some(12) => 6430.0,
        Some(13) => 5000.0,
        Some(15) => 3450.0,
        // D65, and what files without a word mean.
        _ => 6504.0,
    }
}

/// Returns the mean over the colours of [scale, offset].
fn noise_of(numbers: &[f64]) -> Option<[f64; 2]> {
    let pairs = numbers.as_chunks::<2>().0;
    let mean = |i: usize| pairs.iter().map(|p| p[i]).sum::<f64>() / pairs.len() as f64;
    let noise = [mean(0), mean(1).max(0.0)];
    (noise[0].is_finite() && noise[1].is_finite() && noise[0] > 0.0).then_some(noise)
}

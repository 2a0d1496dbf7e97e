//! The schedule of the training resolution.
//!
//! In: the option's text, the number of steps that the run was planned for, and the smallest side
//! of the training images (px). Out: stages, each with its first step and a factor; images are
//! averaged over factor x factor pixels.
//!
//! Coarse stages are cheaper, because the work per pixel falls with the square of the factor; the
//! work per splat stays. They also let structure form before there is detail to fit. Source:
//! DashGaussian (Chen et al. 2025). [`crate::views`] describes how a reduced resolution affects
//! training.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Largest reduction; beyond it, an image is a thumbnail.
const MAX_FACTOR: u32 = 16;

/// Fraction of the steps after which `auto` is at full resolution. Densification ends at half of
/// the steps, so rounds at full resolution remain to add fine detail, and most of the run refines
/// it.
const AUTO_FULL_AFTER: f64 = 0.35;
/// Ratio of the ends of two successive stages of `auto`. Coarse stages are shorter: their steps are
/// cheaper, but there is less to learn from them.
const AUTO_STAGE_RATIO: f64 = 1.0 / 3.0;
/// The factors of `auto`. It starts with the largest that leaves [`AUTO_MIN_SIDE`].
const AUTO_FACTORS: [u32; 3] = [8, 4, 2];
/// Smallest side of a reduced image, pixels; below it, SSIM's window of 11 pixels spans objects
/// rather than texture.
const AUTO_MIN_SIDE: u32 = 96;
/// Smallest side of images that `auto` reduces at all, pixels. Smaller ones lose by it: their
/// detail is coarse already.
const AUTO_LEAST_SIDE: u32 = 384;

/// The resolution over a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ResolutionSchedule {
    /// Full resolution throughout.
    Off,
    /// Stages that depend on the number of steps and the size of the images.
    #[default]
    Auto,
    /// The given stages, in order; the first begins at step 0.
    Stages(Vec<Stage>),
}

/// A part of the run at one resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Factor by which the sides of the images are reduced; 1 is full resolution.
    pub factor: u32,
    /// Step after which the stage begins.
    pub after_step: u32,
}

impl ResolutionSchedule {
    /// Returns the stages of a run planned for `iterations` steps. Stages of `auto` begin after a
    /// round of densification (every `round_interval` steps), so that no round mixes the statistics
    /// of two resolutions.
    pub fn stages(&self, iterations: u32, round_interval: u32, smallest_side_px: u32) -> Vec<Stage> {
        match self {
            Self::Off => Vec::new(),
            Self::Stages(stages) => stages.clone(),
            Self::Auto => auto(iterations, round_interval.max(1), smallest_side_px),
        }
    }
}

fn auto(iterations: u32, round_interval: u32, smallest_side_px: u32) -> Vec<Stage> {
    let mut stages: Vec<Stage> = Vec::new();
    let mut after_step = 0;
    if smallest_side_px < AUTO_LEAST_SIDE {
        return stages;
    }
    for factor in AUTO_FACTORS.into_iter().filter(|factor| smallest_side_px / factor >= AUTO_MIN_SIDE) {
        let finer = f64::from(factor.ilog2()) - 1.0;
        let end = f64::from(iterations) * AUTO_FULL_AFTER * AUTO_STAGE_RATIO.powf(finer);
        let end = end as u32 / round_interval * round_interval;
        if end > after_step {
            stages.push(Stage { factor, after_step });
            after_step = end;
        }
    }
    if !stages.is_empty() {
        stages.push(Stage { factor: 1, after_step });
    }
    stages
}

/// Returns the reduction at `step` (1 for the first).
pub(crate) fn factor_at(stages: &[Stage], step: u32) -> u32 {
    stages.iter().rev().find(|stage| stage.after_step < step).map_or(1, |stage| stage.factor)
}

/// The work that a step does per splat, which does not depend on the resolution, as a part of what
/// it does per pixel at full resolution with one sample a pixel. Large images have fewer splats a
/// pixel than small ones, and runs begin with few: one number serves an estimate.
const WORK_PER_SPLAT: f64 = 0.2;

/// Returns the work of `steps` (1 for the first), in steps at full resolution with one sample a
/// pixel. `samples_per_pixel` is the mean over the pixels of a whole view.
pub(crate) fn work(stages: &[Stage], steps: RangeInclusive<u32>, samples_per_pixel: impl Fn(u32) -> f64) -> f64 {
    let of_step = |step: u32| {
        let samples = samples_per_pixel(step) / f64::from(factor_at(stages, step)).powi(2);
        (samples + WORK_PER_SPLAT) / (1.0 + WORK_PER_SPLAT)
    };
    // The sum of nothing is -0.
    steps.map(of_step).sum::<f64>() + 0.0
}

impl FromStr for ResolutionSchedule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "off" => return Ok(Self::Off),
            "auto" => return Ok(Self::Auto),
            _ => {}
        }
        let mut stages: Vec<Stage> = Vec::new();
        for part in text.split(',') {
            let stage = parse_stage(part.trim(), stages.is_empty())?;
            match stages.last() {
                None if stage.after_step != 0 => {
                    return Err(format!("\"{text}\" starts at step {}, expected the first part to be at step 0", stage.after_step));
                }
                Some(last) if stage.after_step <= last.after_step => {
                    return Err(format!(
                        "\"{text}\": step {} comes after step {}, expected steps to rise",
                        stage.after_step, last.after_step
                    ));
                }
                _ => stages.push(stage),
            }
        }
        Ok(Self::Stages(stages))
    }
}

/// Parses `4@1500`; the first stage may omit its step, which is 0.
fn parse_stage(part: &str, is_first: bool) -> Result<Stage, String> {
    let (factor, step) = match part.split_once('@') {
        Some((factor, step)) => (factor.trim(), step.trim()),
        None if is_first => (part, "0"),
        None => return Err(format!("\"{part}\" has no step, expected FACTOR@STEP such as 2@1500")),
    };
    let factor = factor.parse::<u32>().ok().filter(|factor| (1..=MAX_FACTOR).contains(factor));
    let factor = factor.ok_or_else(|| format!("\"{part}\": expected off, auto, or FACTOR@STEP with a factor of 1 to {MAX_FACTOR}"))?;
    let after_step = step.parse().map_err(|_| format!("\"{part}\": \"{step}\" is not a step, expected FACTOR@STEP such as 2@1500"))?;
    Ok(Stage { factor, after_step })
}

impl fmt::Display for ResolutionSchedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Auto => f.write_str("auto"),
            Self::Stages(stages) => {
                for (i, Stage { factor, after_step }) in stages.iter().enumerate() {
                    let comma = if i > 0 { "," } else { "" };
                    write!(f, "{comma}{factor}@{after_step}")?;
                }
                Ok(())
            }
        }
    }
}

impl TryFrom<String> for ResolutionSchedule {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<ResolutionSchedule> for String {
    fn from(schedule: ResolutionSchedule) -> Self {
        schedule.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn auto_stages(iterations: u32, side: u32) -> Vec<(u32, u32)> {
        ResolutionSchedule::Auto.stages(iterations, 100, side).iter().map(|stage| (stage.factor, stage.after_step)).collect()
    }

    #[test]
    fn text_and_schedule_are_one() {
        for text in ["off", "auto", "1@0", "4@0,2@1500,1@4000", "2@0,8@7"] {
            let schedule: ResolutionSchedule = text.parse().unwrap();
            assert_eq!(schedule.to_string(), text);
            let json = serde_json::to_string(&schedule).unwrap();
            assert_eq!(serde_json::from_str::<ResolutionSchedule>(&json).unwrap(), schedule, "{json}");
        }
        assert_eq!("4, 1@10".parse::<ResolutionSchedule>().unwrap().to_string(), "4@0,1@10");
        assert_eq!(ResolutionSchedule::default(), ResolutionSchedule::Auto);
    }

    #[test]
    fn invalid_schedules_are_refused_with_the_reason() {
        let cases = [
            ("", "1 to 16"),
            ("on", "1 to 16"),
            ("0@0", "1 to 16"),
            ("17@0", "1 to 16"),
            ("2.5@0", "1 to 16"),
            ("-2@0", "1 to 16"),
            ("4@100", "first part to be at step 0"),
            ("4@0,2", "no step"),
            ("4@0,2@", "is not a step"),
            ("4@0,2@x", "\"x\" is not a step"),
            ("4@0,2@-5", "is not a step"),
            ("4@0,2@9999999999", "is not a step"),
            ("4@0,2@10,1@10", "expected steps to rise"),
            ("4@0,,1@10", "no step"),
        ];
        for (text, expected) in cases {
            let error = text.parse::<ResolutionSchedule>().unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn a_stage_begins_after_its_step() {
        let stages = "4,2@1500,1@4000".parse::<ResolutionSchedule>().unwrap().stages(30_000, 100, 400);
        assert_eq!([1, 1500, 1501, 4000, 4001, u32::MAX].map(|step| factor_at(&stages, step)), [4, 4, 2, 2, 1, 1]);
        assert_eq!(factor_at(&[], 5), 1);
    }

    #[test]
    fn work_follows_the_pixels_of_each_step() {
        let stages = "8,4@100,1@200".parse::<ResolutionSchedule>().unwrap().stages(30_000, 100, 800);
        let work = |steps| work(&stages, steps, |step| if step > 900 { 4.0 } else { 1.0 });
        let of = |pixels: f64| (pixels + WORK_PER_SPLAT) / (1.0 + WORK_PER_SPLAT);
        assert!((work(1..=100) / 100.0 - of(1.0 / 64.0)).abs() < 1e-9);
        assert!((work(101..=200) / 100.0 - of(1.0 / 16.0)).abs() < 1e-9);
        assert!((work(201..=900) - 700.0).abs() < 1e-9);
        assert!((work(1..=1000) - work(1..=300) - work(301..=1000)).abs() < 1e-9 && work(901..=1000) > 300.0);
        assert_eq!(work(RangeInclusive::new(1001, 1000)), 0.0);
    }

    #[test]
    fn auto_ends_at_full_resolution_at_the_end_of_a_round() {
        assert_eq!(auto_stages(30_000, 400), [(4, 0), (2, 3500), (1, 10_500)]);
        assert_eq!(auto_stages(10_000, 2000), [(8, 0), (4, 300), (2, 1100), (1, 3500)]);
        assert_eq!(auto_stages(3000, 384), [(4, 0), (2, 300), (1, 1000)]);
        assert_eq!(auto_stages(30_000, 383), []);
        // Stages shorter than a round are left out.
        assert_eq!(auto_stages(1000, 2000), [(4, 0), (2, 100), (1, 300)]);
        assert_eq!(auto_stages(100, 2000), []);
    }
}

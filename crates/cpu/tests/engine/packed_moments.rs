//! Moments of sixteen bits: the same contract as in single precision, and steps near those of it.

use luxel_core::engine::{MomentFormat, SavedPart, SplatArray};
use luxel_core::{Activation, Antialias, ColorModel, Cutoffs, Engine, Moments, Splats, View};
use luxel_cpu::CpuEngine;

use crate::fixture;
use crate::oracle::flatten;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation: Activation::Softplus };

fn engine(format: MomentFormat, threads: usize, splats: &Splats, moments: Option<&Moments>) -> CpuEngine {
    let mut engine = CpuEngine::new(threads).unwrap();
    engine.set_moment_format(format).unwrap();
    engine.load(splats, moments).unwrap();
    engine
}

fn train(engine: &mut CpuEngine, view: &View, steps: std::ops::RangeInclusive<u32>) -> f32 {
    let render = fixture::options(Cutoffs::HDR, Antialias::Pixel);
    steps.map(|number| engine.train_step(view, &fixture::step(number, render)).unwrap().loss).last().unwrap()
}

fn bits(splats: &Splats) -> Vec<u64> {
    flatten(splats).into_iter().map(f64::to_bits).collect()
}

#[test]
fn a_run_has_the_same_bits_on_any_threads_and_when_it_is_broken() {
    let camera = fixture::camera(47, 33);
    let splats = fixture::splats(LCD, 700, &camera, 41);
    let view = fixture::view(&camera, false, 42);
    let mut unbroken = engine(MomentFormat::Bf16, 1, &splats, None);
    train(&mut unbroken, &view, 1..=8);
    let (expected, moments) = unbroken.save().unwrap();
    for (part, of) in [(SavedPart::FirstMoments, &moments.first), (SavedPart::SecondMoments, &moments.second)] {
        assert_eq!(unbroken.save_array(part, SplatArray::Sh, 0..700).unwrap(), of.sh);
    }
    assert!(flatten(&moments.first).iter().all(|value| (*value as f32).to_bits() & 0xffff == 0));
    assert!(flatten(&moments.second).iter().all(|value| (*value as f32).to_bits() & 0x7fff == 0 && *value >= 0.0));
    for (threads, broken_after) in [(2, 3), (3, 5)] {
        let mut first = engine(MomentFormat::Bf16, threads, &splats, None);
        train(&mut first, &view, 1..=broken_after);
        let (splats, moments) = first.save().unwrap();
        let mut second = engine(MomentFormat::Bf16, threads, &splats, Some(&moments));
        train(&mut second, &view, broken_after + 1..=8);
        let (found, found_moments) = second.save().unwrap();
        assert_eq!(bits(&found), bits(&expected), "{threads} threads");
        assert_eq!(bits(&found_moments.second), bits(&moments_of(&mut unbroken).second));
    }
}

fn moments_of(engine: &mut CpuEngine) -> Moments {
    engine.save().unwrap().1
}

#[test]
fn the_first_step_is_that_of_single_precision_and_many_steps_lose_as_much() {
    let camera = fixture::camera(47, 33);
    let splats = fixture::splats(LCD, 700, &camera, 41);
    let view = fixture::view(&camera, false, 42);
    let mut engines = [MomentFormat::F32, MomentFormat::Bf16].map(|format| engine(format, 2, &splats, None));
    for engine in &mut engines {
        train(engine, &view, 1..=1);
    }
    // Moments are rounded after the step that uses them.
    let after = engines.each_mut().map(|engine| bits(&engine.save().unwrap().0));
    assert_eq!(after[0], after[1]);
    let losses = engines.each_mut().map(|engine| train(engine, &view, 2..=150));
    assert!((losses[1] / losses[0] - 1.0).abs() < 0.05, "{losses:?}");
}

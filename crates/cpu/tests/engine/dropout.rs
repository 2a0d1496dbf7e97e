//! Splats that a step leaves out: the step is that of a scene without them.

use luxel_core::engine::{DensifyPlan, Dropout, PlanRow, StatsCollection, StepConfig};
use luxel_core::{Activation, Antialias, Camera, CameraProjection, ColorModel, Cutoffs, Engine, LossWeights, Splats, logit, sigmoid};
use luxel_cpu::CpuEngine;

use crate::fixture;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 0, activation: Activation::Softplus };
const DROPOUT: Dropout = Dropout { rate: 0.3, seed: 5 };

fn step(dropout: Option<Dropout>) -> StepConfig {
    let render = fixture::options(Cutoffs::HDR, Antialias::Pixel);
    StepConfig { dropout, loss: LossWeights::default(), stats: StatsCollection::Gradients, ..fixture::step(1, render) }
}

fn engine(splats: &Splats) -> CpuEngine {
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(splats, None).unwrap();
    engine
}

fn cameras() -> [Camera; 2] {
    [fixture::camera(45, 38), fixture::wide_camera(CameraProjection::Equirectangular, 46, 23)]
}

/// Returns splats whose opacities stay below 1 when they are divided by 1 - rate.
fn splats(camera: &Camera) -> Splats {
    let mut splats = fixture::splats(LCD, 90, camera, 3);
    for (i, opacity) in splats.opacity_logit.iter_mut().enumerate() {
        *opacity = logit(0.05 + 0.6 * (i % 10) as f32 / 10.0);
    }
    splats
}

#[test]
fn a_step_is_that_of_the_splats_it_keeps() {
    for camera in cameras() {
        let (all, view) = (splats(&camera), fixture::view(&camera, false, 4));
        let kept: Vec<u32> = (0..all.len() as u32).filter(|splat| DROPOUT.keeps(*splat)).collect();
        assert!((50..76).contains(&kept.len()), "{}", kept.len());
        let mut rest = engine(&all);
        let rows = kept.iter().map(|splat| PlanRow::keep(*splat)).collect();
        rest.densify(&DensifyPlan { rows, opacity_logit_cap: None, smoothing: None }).unwrap();
        let mut scaled = rest.save().unwrap().0;
        for opacity in &mut scaled.opacity_logit {
            *opacity = logit(sigmoid(*opacity) * DROPOUT.opacity_factor());
        }
        let (expected, expected_gradient) = engine(&scaled).gradients(&view, &step(None)).unwrap();
        let (found, gradient) = engine(&all).gradients(&view, &step(Some(DROPOUT))).unwrap();
        assert_eq!(found.visible, expected.visible);
        assert!((found.loss - expected.loss).abs() < 1e-5 * expected.loss, "{} {}", found.loss, expected.loss);
        for splat in 0..all.len() {
            let (position, opacity) = (gradient.position[splat], gradient.opacity_logit[splat]);
            let Some(n) = kept.iter().position(|kept| *kept as usize == splat) else {
                assert_eq!((position, opacity), ([0.0; 3], 0.0), "splat {splat} is left out");
                continue;
            };
            let close = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-4 * expected.abs() + 1e-8, "{found} {expected}");
            for (found, expected) in position.into_iter().zip(expected_gradient.position[n]) {
                close(found, expected);
            }
            // d ln(opacity) / d logit = 1 - opacity, of the opacity before and after the factor.
            let ratio = (1.0 - sigmoid(all.opacity_logit[splat])) / (1.0 - sigmoid(scaled.opacity_logit[n]));
            close(opacity, expected_gradient.opacity_logit[n] * ratio);
        }
    }
}

#[test]
fn another_seed_leaves_out_others_and_images_none() {
    let camera = fixture::camera(45, 38);
    let (all, view) = (splats(&camera), fixture::view(&camera, false, 4));
    let mut engine = engine(&all);
    let options = step(None).render;
    let image = engine.render(&camera, &options).unwrap();
    let losses = [5, 6].map(|seed| engine.gradients(&view, &step(Some(Dropout { seed, ..DROPOUT }))).unwrap().0.loss);
    assert_ne!(losses[0], losses[1]);
    assert_eq!(engine.render(&camera, &options).unwrap().pixels, image.pixels);
}

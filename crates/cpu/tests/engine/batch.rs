//! Batches: gradients of single views, and the update from them, against steps of one view.

use luxel_core::engine::{DensifyStats, PositionNoise, SPLATS_PER_BLOCK, SparseGradients, StatsCollection, StepConfig};
use luxel_core::{Activation, Antialias, ColorModel, Cutoffs, Engine, LossWeights, Moments, Splats};
use luxel_cpu::CpuEngine;

use crate::fixture;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 2, activation: Activation::Softplus };

/// A step without regularisers, so that splats out of view have no gradient.
fn step(number: u32) -> StepConfig {
    let step = fixture::step(number, fixture::options(Cutoffs::HDR, Antialias::Off));
    StepConfig { loss: LossWeights { opacity_weight: 0.0, scale_weight: 0.0, ..step.loss }, ..step }
}

fn engine(splats: &Splats) -> CpuEngine {
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(splats, None).unwrap();
    engine
}

fn state(engine: &mut CpuEngine) -> ((Splats, Moments), DensifyStats) {
    (engine.save().unwrap(), engine.densify_stats().unwrap())
}

#[test]
fn a_batch_of_one_view_makes_the_same_update_to_the_bit() {
    let camera = fixture::camera(40, 30);
    let view = fixture::view(&camera, true, 4);
    let noise = PositionNoise { scale: 0.3, seed: 11 };
    for (model, position_noise, stats) in
        [(LCD, None, StatsCollection::GradientsAndAbsolute), (ColorModel::Sh { degree: 3 }, Some(noise), StatsCollection::Gradients)]
    {
        // Not a whole number of blocks.
        let splats = fixture::splats(model, 83, &camera, 3);
        let (mut whole, mut halves) = (engine(&splats), engine(&splats));
        for number in 1..=4 {
            let plain = step(number);
            let regularised = fixture::step(number, plain.render);
            let step = StepConfig { position_noise, stats, loss: if number % 2 == 0 { plain.loss } else { regularised.loss }, ..plain };
            let expected = whole.train_step(&view, &step).unwrap();
            let (report, gradients) = halves.view_gradients(&view, &step).unwrap();
            assert_eq!(report, expected);
            halves.apply_gradients(&gradients, &step).unwrap();
            assert!(state(&mut halves) == state(&mut whole), "step {number} of {}", model.name());
        }
    }
}

#[test]
fn gradients_of_a_view_change_nothing_and_are_those_of_the_whole_scene() {
    let camera = fixture::camera(40, 30);
    let view = fixture::view(&camera, false, 4);
    let mut splats = fixture::splats(LCD, 120, &camera, 3);
    // Behind the camera: one block, and a part of another.
    let behind = camera.eye() - 10.0 * camera.camera_from_world.matrix3.row(2);
    splats.position[32..56].fill(behind.to_array().map(|v| v as f32));
    let mut engine = engine(&splats);
    let before = state(&mut engine);
    let (_, gradients) = engine.view_gradients(&view, &step(1)).unwrap();
    assert!(state(&mut engine) == before);
    let dense = engine.gradients(&view, &step(1)).unwrap().1;
    assert!(!gradients.blocks().contains(&2) && gradients.blocks().contains(&3), "{:?}", gradients.blocks());
    for i in 0..splats.len() {
        let at = |row: usize| {
            gradients.values_of((i / SPLATS_PER_BLOCK) as u32).map_or(0.0, |values| values[row * SPLATS_PER_BLOCK + i % SPLATS_PER_BLOCK])
        };
        assert_eq!((0..3).map(at).collect::<Vec<_>>(), dense.position[i], "{i}");
        assert_eq!((at(10), at(11)), (dense.opacity_logit[i], dense.sh_of(i)[0]), "{i}");
    }
    let views: f32 = gradients.iter().map(|(_, values)| values[values.len() - SPLATS_PER_BLOCK..].iter().sum::<f32>()).sum();
    assert_eq!(views as u32, engine.densify_stats().unwrap().views.iter().sum::<u32>());
}

#[test]
fn gradients_of_other_splats_are_refused() {
    let camera = fixture::camera(8, 8);
    let splats = fixture::splats(LCD, 17, &camera, 3);
    let mut engine = engine(&splats);
    let before = state(&mut engine);
    let rows = luxel_core::engine::ParameterRows { color_model: LCD };
    let mut beyond = SparseGradients::none(rows);
    beyond.push(2);
    assert!(engine.apply_gradients(&beyond, &step(1)).is_err());
    let other = SparseGradients::none(luxel_core::engine::ParameterRows { color_model: ColorModel::Sh { degree: 0 } });
    assert!(engine.apply_gradients(&other, &step(1)).is_err());
    assert!(state(&mut engine) == before);
}

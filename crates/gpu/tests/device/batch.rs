//! Batches: gradients of single views, and the update from them.

use std::sync::Arc;

use luxel_core::engine::{PositionNoise, SparseGradients, StatsCollection, StepConfig};
use luxel_core::{Antialias, Cutoffs, Engine};
use luxel_gpu::Gpu;

use crate::Body;
use crate::compare::assert_close;
use crate::fixture::{camera, options, splats, step, view};
use crate::parity::{engines, groups, models};

pub const ALL: &[(&str, Body)] = &[
    ("gradients_of_a_view_match_the_cpu_and_change_nothing", gradients_of_a_view_match_the_cpu_and_change_nothing),
    ("a_batch_of_one_view_makes_the_update_of_a_step", a_batch_of_one_view_makes_the_update_of_a_step),
];

fn training(number: u32) -> StepConfig {
    StepConfig { stats: StatsCollection::GradientsAndAbsolute, ..step(number, options(Cutoffs::HDR, Antialias::Off)) }
}

fn gradients_of_a_view_match_the_cpu_and_change_nothing(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let view = view(&camera, false, 4);
    for model in [models()[1], models()[4]] {
        let (mut cpu, mut engine) = engines(gpu, &splats(model, 75, &camera, 3));
        // Blocks of splats do not end where shards do.
        engine.split_shards(20);
        let scene = cpu.save().unwrap();
        engine.load(&scene.0, None).unwrap();
        let [expected, found] =
            [cpu.view_gradients(&view, &training(1)), engine.view_gradients(&view, &training(1))].map(|gradients| gradients.unwrap().1);
        assert_eq!(found.blocks(), expected.blocks());
        let parameters = found.parameters_len();
        let values = |gradients: &SparseGradients| -> [Vec<f32>; 2] {
            let parts =
                |range: fn(&[f32], usize) -> &[f32]| gradients.iter().flat_map(move |(_, values)| range(values, parameters).to_vec());
            [parts(|values, len| &values[..len]).collect(), parts(|values, len| &values[len..]).collect()]
        };
        let ([gradients, statistics], [expected_gradients, expected_statistics]) = (values(&found), values(&expected));
        assert_close(&format!("gradients of a view: {}", model.name()), &gradients, &expected_gradients, 1e-4);
        assert_close(&format!("statistics of a view: {}", model.name()), &statistics, &expected_statistics, 1e-4);
        assert!(engine.save().unwrap() == scene);
        assert!(engine.densify_stats().unwrap().views.iter().all(|views| *views == 0));
    }
}

fn a_batch_of_one_view_makes_the_update_of_a_step(gpu: &Arc<Gpu>) {
    let camera = camera(45, 38);
    let view = view(&camera, true, 4);
    let noise = PositionNoise { scale: 0.3, seed: 11 };
    for (model, position_noise) in [(models()[1], None), (models()[4], Some(noise))] {
        let (_, mut whole) = engines(gpu, &splats(model, 75, &camera, 3));
        let (_, mut halves) = engines(gpu, &splats(model, 75, &camera, 3));
        for number in 1..=3 {
            let step = StepConfig { position_noise, ..training(number) };
            whole.train_step(&view, &step).unwrap();
            let (_, gradients) = halves.view_gradients(&view, &step).unwrap();
            halves.apply_gradients(&gradients, &step).unwrap();
        }
        let [(expected, expected_moments), (found, found_moments)] = [whole.save().unwrap(), halves.save().unwrap()];
        let pairs = [
            ("parameters", &found, &expected),
            ("first moments", &found_moments.first, &expected_moments.first),
            ("second moments", &found_moments.second, &expected_moments.second),
        ];
        for (what, found, expected) in pairs {
            for ((name, found), (_, expected)) in groups(found).into_iter().zip(groups(expected)) {
                // Kernels may be contracted differently.
                assert_close(&format!("batch of one view, {what}: {name} {}", model.name()), found, expected, 1e-5);
            }
        }
        let [expected, found] = [whole.densify_stats().unwrap(), halves.densify_stats().unwrap()];
        assert_eq!(found.views, expected.views);
        assert_close("batch of one view, statistics", &found.gradient, &expected.gradient, 1e-5);
    }
}

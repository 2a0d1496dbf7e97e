//! Runs over ranks, which are threads here, against runs of one process.

use luxel_core::{Antialias, Dataset, Image, Point, Snapshot, Splats};
use luxel_cpu::CpuEngine;

use super::*;
use crate::config::ExposureCompensation;
use crate::reduce::RankViews;
use crate::testing::{camera_at, dataset_of, on_demand, on_ranks, view_of};

fn dataset() -> Dataset {
    let view = |i: usize| {
        let pixels = (0..32 * 24).map(|p| [0.1 + 0.02 * (p % 32) as f32, 0.3, 0.05 * ((p / 32 + i) % 7) as f32]).collect();
        view_of(&i.to_string(), camera_at([0.2 * i as f64, 0.0, -3.0], [32, 24]), Image::from_pixels(32, 24, pixels).unwrap())
    };
    let mut dataset = dataset_of((0..13).map(view).collect());
    let point = |i: u64| {
        let position = luxel_core::random::standard_normal(3, i).map(|v| 0.6 * v);
        Point { position, rgb8: None, observations: Vec::new() }
    };
    dataset.points = (0..150).map(point).collect();
    dataset
}

fn config(batch: u32) -> TrainConfig {
    TrainConfig {
        batch,
        iterations: 40,
        densify_interval: Some(10),
        densify_from: Some(5),
        densify_threshold: 1e-6,
        max_splats: Some(400),
        ..TrainConfig::default()
    }
}

fn engine() -> Box<CpuEngine> {
    Box::new(CpuEngine::new(1).unwrap())
}

/// Trains alone, and returns the states after 13 steps and at the end.
fn alone(config: &TrainConfig) -> [Snapshot; 2] {
    let mut trainer = Trainer::new(&dataset(), config.clone(), engine()).unwrap();
    for _ in 0..13 {
        trainer.step().unwrap();
    }
    let middle = trainer.snapshot().unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    [middle, trainer.snapshot().unwrap()]
}

/// Continues on ranks which hold the images of their own views alone, and returns their states.
fn over_ranks(ranks: usize, from: &Snapshot, batch: u32) -> Vec<Snapshot> {
    on_ranks(ranks, |exchange| {
        let mut own = dataset();
        let views = RankViews { batch, ranks, rank: exchange.rank() };
        for (i, view) in own.train.iter_mut().enumerate().filter(|(i, _)| !views.contain(*i)) {
            *view = on_demand(view);
            assert!(!view.is_in_memory(), "{i}");
        }
        let mut trainer = Trainer::resume(&own, from.clone(), engine()).unwrap().with_exchange(Box::new(exchange));
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        trainer.snapshot().unwrap()
    })
}

fn bits(splats: &Splats) -> Vec<u32> {
    let all = splats.position.as_flattened().iter().chain(splats.rotation.as_flattened()).chain(splats.log_scale.as_flattened());
    all.chain(&splats.opacity_logit).chain(&splats.sh).chain(&splats.raw_luminance).map(|v| v.to_bits()).collect()
}

#[test]
fn ranks_train_the_scene_of_one_process_to_the_bit() {
    let plain = config(3);
    let gains = TrainConfig { exposure_compensation: ExposureCompensation::Color, vignetting: true, ..config(2) };
    let poses = TrainConfig { refine_poses: true, antialias: Antialias::Mip, ..config(4) };
    let crops = TrainConfig { crop: Some(64), resolution_schedule: "2@0,1@20".parse().unwrap(), ..config(2) };
    for config in [plain, gains, poses, crops] {
        let [middle, end] = alone(&config);
        assert!(end.scene.splats.len() > 150, "no densification took place: {}", end.scene.splats.len());
        for ranks in [2, 3] {
            for (rank, snapshot) in over_ranks(ranks, &middle, config.batch).into_iter().enumerate() {
                assert!(bits(&snapshot.scene.splats) == bits(&end.scene.splats), "rank {rank} of {ranks}, batch {}", config.batch);
                assert!(snapshot == end, "rank {rank} of {ranks}, batch {}: state", config.batch);
            }
        }
    }
}

#[test]
fn a_batch_of_one_view_over_two_ranks_is_the_run_of_one_process() {
    let [middle, end] = alone(&config(1));
    for snapshot in over_ranks(2, &middle, 1) {
        assert!(bits(&snapshot.scene.splats) == bits(&end.scene.splats));
    }
}

#[test]
fn a_rank_that_is_asked_to_stop_stops_all_after_the_same_step() {
    let start = Trainer::new(&dataset(), config(2), engine()).unwrap().snapshot().unwrap();
    let stopped = on_ranks(2, |exchange| {
        let rank = exchange.rank();
        let mut trainer = Trainer::resume(&dataset(), start.clone(), engine()).unwrap().with_exchange(Box::new(exchange));
        while !trainer.is_asked_to_stop() {
            trainer.announce_stop(rank == 1 && trainer.iteration() >= 4);
            trainer.step().unwrap();
        }
        trainer.iteration()
    });
    assert_eq!(stopped, [5, 5]);
}

#[test]
fn ranks_with_different_scenes_are_an_error() {
    let start = Trainer::new(&dataset(), config(2), engine()).unwrap().snapshot().unwrap();
    let errors = on_ranks(2, |exchange| {
        let mut other = start.clone();
        if exchange.rank() == 1 {
            other.scene.splats.position[3][0] += 1e-4;
        }
        let mut trainer = Trainer::resume(&dataset(), other, engine()).unwrap().with_exchange(Box::new(exchange));
        loop {
            if let Err(error) = trainer.step() {
                return error.to_string();
            }
        }
    });
    assert!(errors.iter().all(|error| error.contains("rank 1 holds another scene than rank 0")), "{errors:?}");
}

#[test]
fn a_batch_larger_than_the_data_set_is_refused() {
    let error = Trainer::new(&dataset(), config(14), engine()).err().unwrap();
    assert_eq!(error.to_string(), "batch: found 14, expected at most 13, the number of training views");
}

#[test]
fn rates_follow_the_batch_by_their_rule() {
    let config = |batch, batch_rule| TrainConfig { batch, batch_rule, ..TrainConfig::default() };
    for rule in [BatchRule::Keep, BatchRule::Sqrt, BatchRule::Linear] {
        assert_eq!(rates_of_batch(&config(1, rule)), (1.0, AdamBetas::default()));
    }
    assert_eq!(rates_of_batch(&config(4, BatchRule::Keep)), (1.0, AdamBetas::default()));
    let (factor, betas) = rates_of_batch(&config(4, BatchRule::Sqrt));
    assert!(factor == 2.0 && (betas.first - 0.6561).abs() < 1e-6 && (betas.second - 0.996_006).abs() < 1e-6, "{betas:?}");
    assert_eq!(rates_of_batch(&config(4, BatchRule::Linear)), (4.0, betas));
}

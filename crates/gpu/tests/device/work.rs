//! The counts of a step's work: compared with the pairs counted one by one, and with those in
//! work.csv, so that a change of the work shows.
//!
//! `LUXEL_WRITE_WORK=1` writes work.csv; without it the test compares.

use std::sync::Arc;

use luxel_core::engine::{StatsCollection, StepConfig};
use luxel_core::{Antialias, Camera, Cutoffs, Engine, RenderOptions, Splats, synthetic};
use luxel_gpu::{Footprint, ForwardPasses, Gpu, GpuEngine, Work};

use crate::Body;
use crate::fixture::{options, step, view, wide_camera};

pub const ALL: &[(&str, Body)] = &[
    ("the_work_is_what_pairs_counted_one_by_one_make_it", the_work_is_what_pairs_counted_one_by_one_make_it),
    ("the_work_is_that_of_the_file", the_work_is_that_of_the_file),
];

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/device/work.csv");

/// Rounding at cut-offs may decide otherwise on another adapter.
const ROUNDING: f64 = 1e-4;

fn count(gpu: &Arc<Gpu>, scene: &Splats, camera: &Camera, options: RenderOptions) -> Work {
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(scene, None).unwrap();
    let view = view(camera, false, 4);
    let step = StepConfig { stats: StatsCollection::GradientsAndAbsolute, ..step(1, options) };
    let before = engine.save().unwrap().0;
    let work = engine.count_work(&view, &step).unwrap();
    assert_eq!(engine.save().unwrap().0, before, "counting has changed the scene");
    work
}

/// Returns alpha before its cap, if a splat reaches its threshold at a pixel.
fn alpha(f: &Footprint, pixel: [u32; 2]) -> Option<f32> {
    let (dx, dy) = (pixel[0] as f32 + 0.5 - f.mean_px[0], pixel[1] as f32 + 0.5 - f.mean_px[1]);
    let (u, v) = (f.root[0] * dx + f.root[1] * dy, f.root[2] * dy);
    let log2_alpha = f.log2_opacity - u * u - v * v;
    (log2_alpha >= f.log2_threshold).then_some(log2_alpha.exp2())
}

/// Counts by the results of the passes before, a pixel at a time: alive pairs, forward steps,
/// buckets, steps of pixels, of sums, rounds.
fn count_one_by_one(passes: &ForwardPasses, camera: &Camera, cutoffs: &Cutoffs) -> Work {
    let (side, [width, height], bucket) = (ForwardPasses::TILE_PX, ForwardPasses::BLOCK_PX, 32);
    let columns = side / width;
    let mut work = Work::default();
    for (tile, (list, blocks)) in passes.tile_splats.iter().zip(&passes.tile_blocks).enumerate() {
        let corner = [tile as u32 % passes.tiles[0] * side, tile as u32 / passes.tiles[0] * side];
        let mut runs = vec![false; list.len().div_ceil(bucket)];
        for block in 0..columns * side / height {
            let [left, top] = [corner[0] + block % columns * width, corner[1] + block / columns * height];
            let mine: Vec<usize> = (0..list.len()).filter(|n| blocks[*n] >> block & 1 == 1).collect();
            let (mut steps, mut last) = (0, 0);
            for n in 0..width * height {
                let pixel = [left + n % width, top + n / width];
                if pixel[0] >= camera.size_px[0] || pixel[1] >= camera.size_px[1] {
                    continue;
                }
                let (mut transmittance, mut looks) = (1f32, 0);
                for entry in &mine {
                    looks += 1;
                    let f = passes.footprints[list[*entry] as usize].as_ref().unwrap();
                    let Some(alpha) = alpha(f, pixel) else { continue };
                    let left = transmittance - alpha.min(cutoffs.max_alpha) * transmittance;
                    if left < cutoffs.min_transmittance {
                        break;
                    }
                    transmittance = left;
                    work.alive_pairs += 1;
                    last = last.max(entry + 1);
                }
                steps = steps.max(looks);
            }
            work.forward_steps += steps;
            for (number, runs) in runs.iter_mut().enumerate() {
                let rows = |from: usize, to: usize| mine.iter().filter(|entry| (from..to.min(last)).contains(*entry)).count() as u64;
                let (first, end) = (number * bucket, (number + 1) * bucket);
                let all = rows(first, end);
                let rounds = if all <= 16 { vec![all] } else { vec![rows(first, first + 16), rows(first + 16, end)] };
                for rows in rounds.into_iter().filter(|rows| *rows > 0) {
                    work.pixel_steps += rows;
                    work.sum_steps += if rows <= 8 { 8 } else { 16 };
                    work.rounds += 1;
                    *runs = true;
                }
            }
        }
        work.buckets += runs.iter().filter(|runs| **runs).count() as u64;
        work.entries += list.len() as u64;
        work.block_pairs += blocks.iter().map(|blocks| u64::from(blocks.count_ones())).sum::<u64>();
    }
    work
}

fn assert_equal_but_for_rounding(what: &str, found: u64, expected: u64) {
    let most = (ROUNDING * expected as f64).max(2.0);
    assert!(found.abs_diff(expected) as f64 <= most, "{what}: found {found}, expected {expected}, at most {most} apart");
}

fn room(count: usize) -> Splats {
    synthetic::room(count, 3)
}

fn the_work_is_what_pairs_counted_one_by_one_make_it(gpu: &Arc<Gpu>) {
    let (scene, camera) = (room(6000), synthetic::room_camera([83, 59]));
    for cutoffs in [Cutoffs::PARITY, Cutoffs::HDR] {
        let options = options(cutoffs, Antialias::Off);
        let mut engine = GpuEngine::new(gpu).unwrap();
        engine.load(&scene, None).unwrap();
        let passes = engine.forward_passes(&camera, &options).unwrap();
        let expected = count_one_by_one(&passes, &camera, &cutoffs);
        let found = count(gpu, &scene, &camera, options);
        let own = ["alive_pairs", "forward_steps", "buckets", "pixel_steps", "sum_steps", "rounds", "entries", "block_pairs"];
        for ((name, found), (_, expected)) in found.list().into_iter().zip(expected.list()).filter(|((name, _), _)| own.contains(name)) {
            assert_equal_but_for_rounding(name, found, expected);
        }
        assert!(found.alive_pairs > 100_000 && found.rounds > found.buckets, "{found:?}");
    }
}

/// Returns what is counted in the file: a pinhole, four samples a pixel, a fisheye.
fn cases() -> [(&'static str, Camera, RenderOptions); 3] {
    let camera = synthetic::room_camera([96, 64]);
    let plain = options(Cutoffs::PARITY, Antialias::Off);
    let mut sampled = plain;
    sampled.raster.samples = 2;
    let fisheye = luxel_core::CameraProjection::Fisheye(luxel_core::Fisheye::new([0.0; 4]));
    [("pinhole", camera.clone(), plain), ("samples", camera, sampled), ("fisheye", wide_camera(fisheye, 64, 64), plain)]
}

fn the_work_is_that_of_the_file(gpu: &Arc<Gpu>) {
    let scene = room(8000);
    let found: Vec<(String, u64)> = cases()
        .into_iter()
        .flat_map(|(case, camera, options)| {
            count(gpu, &scene, &camera, options).list().map(|(name, value)| (format!("{case},{name}"), value))
        })
        .collect();
    if std::env::var_os("LUXEL_WRITE_WORK").is_some() {
        let rows: String = found.iter().map(|(name, value)| format!("{name},{value}\n")).collect();
        std::fs::write(FILE, format!("case,count,value\n{rows}")).unwrap();
    }
    let text = std::fs::read_to_string(FILE).unwrap();
    let expected: Vec<(&str, u64)> =
        text.lines().skip(1).map(|line| line.rsplit_once(',').unwrap()).map(|(name, value)| (name, value.parse().unwrap())).collect();
    assert_eq!(found.len(), expected.len(), "{FILE} has other counts: run with LUXEL_WRITE_WORK=1");
    for ((name, found), (expected_name, expected)) in found.iter().zip(expected) {
        assert_eq!(name, expected_name);
        assert_equal_but_for_rounding(name, *found, expected);
    }
}

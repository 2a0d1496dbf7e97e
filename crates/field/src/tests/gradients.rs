//! Exact gradients against central differences of the oracle.

use fearless_simd::Level;
use luxel_core::{RadianceScale, sh};

use super::oracle::{self, difference};
use crate::field::Field;
use crate::grid::Grid;
use crate::lanes::{LANES, Lanes};
use crate::network::{Activations, Network};
use crate::networks::{Networks, position_blocks};
use crate::occupancy::Occupancy;
use crate::sampling::TrainingRay;
use crate::space::Ray;
use crate::task::{StepContext, Task};
use crate::volume::{Composited, Intervals, composite};
use crate::{FieldConfig, FieldShape, GridShape, PixelLoss, Space};
use luxel_core::random;

/// Dense and hashed levels, small enough for an oracle.
const SMALL: GridShape = GridShape { levels: 4, log2_entries: 10, coarsest: 4, finest: 64 };

fn numbers(seed: u64, count: usize, scale: f32) -> Vec<f32> {
    (0..count as u64).map(|i| scale * (2.0 * random::uniform(seed, i) - 1.0)).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|value| f64::from(*value)).collect()
}

/// Asserts that two gradients agree to a part of the largest number of the second.
#[track_caller]
fn assert_close(found: &[f64], expected: &[f64], tolerance: f64) {
    let largest = expected.iter().fold(0f64, |largest, value| largest.max(value.abs()));
    assert!(largest > 0.0, "no gradient to compare with");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= tolerance * largest, "number {i}: {found}, expected {expected} (largest {largest})");
    }
}

fn positions(count: usize) -> Vec<[f32; 3]> {
    numbers(3, 3 * count, 0.5).chunks_exact(3).map(|p| [p[0] + 0.5, p[1] + 0.5, p[2] + 0.5]).collect()
}

#[test]
fn features_are_those_of_the_oracle_and_so_are_their_gradients() {
    let grid = Grid::new(SMALL);
    let (table, places, width) = (numbers(1, grid.len(), 1.0), positions(37), grid.width());
    let (level, mut blocks) = (Level::new(), Vec::new());
    position_blocks(&places, &mut blocks);
    let mut features = vec![Lanes::ZERO; blocks.len() / 3 * width];
    fearless_simd::dispatch!(level, simd => grid.encode(simd, &table, &blocks, &mut features));
    for (i, place) in places.iter().enumerate() {
        let expected = oracle::encode(SMALL, &wide(&table), place.map(f64::from));
        let found: Vec<f64> = (0..width).map(|k| f64::from(features[i / LANES * width + k].0[i % LANES])).collect();
        // f32 places a position within a cell of the finest level to 1e-5.
        assert_close(&found, &expected, 1e-4);
    }
    let by: Vec<f32> = numbers(2, places.len() * width, 1.0);
    let mut by_features = vec![Lanes::ZERO; features.len()];
    for (i, value) in by.iter().enumerate() {
        by_features[i / width / LANES * width + i % width].0[i / width % LANES] = *value;
    }
    let mut gradient = vec![0.0; grid.len()];
    for number in 0..grid.levels() {
        let part = &mut gradient[grid.numbers(number)];
        fearless_simd::dispatch!(level, simd => grid.scatter(simd, number, &blocks, &by_features, part));
    }
    let total = |table: &[f64]| -> f64 {
        let of_place = |(place, by): (&[f32; 3], &[f32])| -> f64 {
            oracle::encode(SMALL, table, place.map(f64::from)).iter().zip(by).map(|(feature, by)| feature * f64::from(*by)).sum()
        };
        places.iter().zip(by.chunks_exact(width)).map(of_place).sum()
    };
    let chosen: Vec<usize> = (0..grid.len()).filter(|i| gradient[*i] != 0.0).step_by(17).collect();
    let expected: Vec<f64> = chosen.iter().map(|i| difference(&wide(&table), *i, total)).collect();
    assert_close(&chosen.iter().map(|i| f64::from(gradient[*i])).collect::<Vec<f64>>(), &expected, 1e-4);
}

#[test]
fn networks_of_any_sizes_have_the_oracles_outputs_and_gradients() {
    for sizes in [&[24, 32, 16][..], &[32, 32, 32, 3], &[1, 128, 1], &[5, 7, 6]] {
        let network = Network::new(sizes);
        let (weights, inputs, outputs) = (network.initial(4), sizes[0], sizes[sizes.len() - 1]);
        let (samples, blocks) = (3 * LANES, 3);
        let (x, by) = (numbers(5, samples * inputs, 1.0), numbers(6, samples * outputs, 1.0));
        let (level, mut room, mut gradient) = (Level::new(), Activations::default(), vec![0.0; network.len()]);
        let place = |i: usize, width: usize| (i / width / LANES * width + i % width, i / width % LANES);
        for (i, value) in x.iter().enumerate() {
            let (row, lane) = place(i, inputs);
            network.inputs(blocks, &mut room)[row].0[lane] = *value;
        }
        fearless_simd::dispatch!(level, simd => network.forward(simd, &weights, &mut room));
        let expected: Vec<f64> = x.chunks_exact(inputs).flat_map(|x| oracle::network(sizes, &wide(&weights), &wide(x))).collect();
        let read = |rows: &[Lanes], count: usize, width: usize| -> Vec<f64> {
            (0..count).map(|i| place(i, width)).map(|(row, lane)| f64::from(rows[row].0[lane])).collect()
        };
        assert_close(&read(room.outputs(), samples * outputs, outputs), &expected, 1e-5);
        for (i, value) in by.iter().enumerate() {
            let (row, lane) = place(i, outputs);
            room.by_outputs()[row].0[lane] = *value;
        }
        fearless_simd::dispatch!(level, simd => network.backward(simd, &weights, &mut room, &mut gradient));
        let total = |weights: &[f64], x: &[f64]| -> f64 {
            let outputs = x.chunks_exact(inputs).flat_map(|x| oracle::network(sizes, weights, x));
            outputs.zip(&by).map(|(y, by)| y * f64::from(*by)).sum()
        };
        let expected: Vec<f64> = (0..network.len()).map(|i| difference(&wide(&weights), i, |w| total(w, &wide(&x)))).collect();
        assert_close(&wide(&gradient), &expected, 1e-4);
        let expected: Vec<f64> = (0..x.len()).map(|i| difference(&wide(&x), i, |x| total(&wide(&weights), x))).collect();
        assert_close(&read(room.by_inputs(), x.len(), inputs), &expected, 1e-4);
    }
}

#[test]
fn a_rays_colour_and_its_gradients_are_the_oracles() {
    let (count, background, by_color) = (12, [0.3, 0.1, 0.7], [0.4, -1.1, 0.6]);
    let density: Vec<f32> = numbers(7, count, 20.0).iter().map(|d| d.abs()).collect();
    let length: Vec<f32> = numbers(8, count, 0.02).iter().map(|l| 0.005 + l.abs()).collect();
    let mut at = 0.1;
    let middle: Vec<f32> = length
        .iter()
        .map(|l| {
            at += l;
            at - 0.5 * l
        })
        .collect();
    let colors: Vec<f32> = numbers(9, 3 * count, 2.0);
    let distortion_weight = 0.8;
    let intervals = Intervals { density: &density, length: &length, middle: &middle, colors: &colors };
    let (mut weights, mut transmittance, mut color) = (vec![0.0; count], vec![0.0; count], [0.0; 3]);
    composite(intervals, &background, &mut weights, &mut transmittance, &mut color);
    let (mut by_density, mut by_colors) = (vec![0.0; count], vec![0.0; 3 * count]);
    let composited = Composited { intervals, background: &background, weights: &weights, transmittance: &transmittance };
    let value = composited.backward(&by_color, distortion_weight, &mut by_density, &mut by_colors);
    let ray = |density: &[f64], colors: &[f64]| oracle::Ray {
        density: density.to_vec(),
        length: wide(&length),
        middle: wide(&middle),
        colors: colors.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    };
    let (expected, expected_value) = ray(&wide(&density), &wide(&colors)).composite(background);
    assert_close(&wide(&color), &expected, 1e-5);
    assert_close(&[f64::from(value)], &[0.8 * expected_value], 1e-5);
    let total = |density: &[f64], colors: &[f64]| {
        let (color, distortion) = ray(density, colors).composite(background);
        0.8 * distortion + (0..3).map(|c| color[c] * f64::from(by_color[c])).sum::<f64>()
    };
    let expected: Vec<f64> = (0..count).map(|i| difference(&wide(&density), i, |d| total(d, &wide(&colors)))).collect();
    assert_close(&wide(&by_density), &expected, 1e-4);
    let expected: Vec<f64> = (0..3 * count).map(|i| difference(&wide(&colors), i, |c| total(&wide(&density), c))).collect();
    assert_close(&wide(&by_colors), &expected, 1e-4);
}

#[test]
fn losses_have_the_oracles_values_and_slopes() {
    let (prediction, target, mu) = ([0.002, 0.4, 7.0], [0.001, 0.9, 6.0], 5000.0);
    for loss in [PixelLoss::Linear, PixelLoss::Mulaw] {
        let mut by = [0.0; 3];
        let value = loss.pixel(&prediction, target, mu, &mut by);
        let of = |p: &[f64]| oracle::pixel_loss(loss, [p[0], p[1], p[2]], target, f64::from(mu));
        assert_close(&[f64::from(value)], &[of(&wide(&prediction))], 1e-5);
        let expected: Vec<f64> = (0..3).map(|c| difference(&wide(&prediction), c, of)).collect();
        assert_close(&wide(&by), &expected, 1e-4);
    }
}

/// A small field of dense fog, and options to train it with.
fn fog(loss: PixelLoss) -> (Field, FieldConfig) {
    let grid = Grid::new(SMALL);
    let networks = Networks::new(grid.width());
    let (table, weights) = (numbers(10, grid.len(), 1.0), networks.initial(11).iter().map(|w| 2.0 * w).collect());
    let space = Space { center: [0.0; 3], side: 1.0, near: 0.0 };
    let arrays = crate::FieldArrays { table, weights, occupancy: Occupancy::full(64).densities().to_vec() };
    let field = Field::from_arrays(FieldShape { grid: SMALL, space }, arrays).unwrap();
    (field, FieldConfig { iterations: 1, seed: 0, loss, mu: 5000.0, radiance_scale: RadianceScale::ONE, grid: SMALL })
}

#[test]
fn the_whole_step_has_the_oracles_loss_and_gradients() {
    for loss in [PixelLoss::Linear, PixelLoss::Mulaw] {
        let (mut field, options) = fog(loss);
        // Few cells, so that the oracle has few samples.
        field.occupancy.keep(|[x, y, z]| (x + 2 * y + 3 * z) % 23 == 0);
        let rays: Vec<TrainingRay> = (0..5)
            .map(|i| {
                let d = numbers(20 + i, 3, 1.0);
                let direction = glam::Vec3::new(d[0], d[1], d[2]).normalize().to_array();
                let target = [0.5, 0.1 + 0.1 * i as f32, 1.5];
                TrainingRay {
                    ray: Ray { origin: [0.5; 3], direction },
                    shift: 0.2 * i as f32,
                    target,
                    weight: 1.0 - 0.1 * i as f32,
                    background: [0.2, 0.5, 0.1],
                }
            })
            .collect();
        let context = StepContext { field: &field, options: &options, share: 0.2, distortion_weight: 0.05 };
        let (level, mut task) = (Level::new(), Task::default());
        fearless_simd::dispatch!(level, simd => task.run(simd, context, &rays));
        let mut by_table = vec![0.0; field.table.len()];
        for number in 0..field.grid.levels() {
            let part = &mut by_table[field.grid.numbers(number)];
            fearless_simd::dispatch!(level, simd => field.grid.scatter(simd, number, &task.samples.positions, &task.by_features, part));
        }
        let samples = &task.samples;
        assert!((20..2000).contains(&samples.len()), "{}", samples.len());
        let width = field.grid.width();
        let (density, color) = ([width, 32, 16], [32, 32, 32, 3]);
        let split = (width + 1) * 32 + 33 * 16;
        let total = |table: &[f64], weights: &[f64]| -> f64 {
            let of_ray = |(number, ray): (usize, &TrainingRay)| {
                let mut basis = [0f64; sh::MAX_COEFFICIENTS];
                sh::basis(3, ray.ray.direction.map(f64::from), &mut basis);
                let mut found = oracle::Ray { density: vec![], length: vec![], middle: vec![], colors: vec![] };
                for i in samples.of_ray(number) {
                    let at = [0, 1, 2].map(|axis| f64::from(samples.positions[3 * (i / LANES) + axis].0[i % LANES]));
                    let mut geometry = oracle::network(&density, &weights[..split], &oracle::encode(SMALL, table, at));
                    found.density.push(geometry[0].exp());
                    geometry.extend(&basis[..16]);
                    let raw = oracle::network(&color, &weights[split..], &geometry);
                    found.colors.push([0, 1, 2].map(|c| raw[c].exp().ln_1p()));
                    found.length.push(f64::from(samples.lengths[i]));
                    found.middle.push(f64::from(samples.middles[i]));
                }
                let (color, distortion) = found.composite(ray.background);
                f64::from(ray.weight) * 0.2 * (0.05 * distortion + oracle::pixel_loss(loss, color, ray.target, 5000.0))
            };
            rays.iter().enumerate().map(of_ray).sum()
        };
        let (table, weights) = (wide(&field.table), wide(&field.weights));
        let chosen: Vec<usize> = (0..weights.len()).step_by(61).collect();
        let expected: Vec<f64> = chosen.iter().map(|i| difference(&weights, *i, |w| total(&table, w))).collect();
        assert_close(&chosen.iter().map(|i| f64::from(task.gradient[*i])).collect::<Vec<f64>>(), &expected, 1e-3);
        let chosen: Vec<usize> = (0..table.len()).filter(|i| by_table[*i] != 0.0).step_by(29).collect();
        assert!(chosen.len() > 10, "{}", chosen.len());
        let expected: Vec<f64> = chosen.iter().map(|i| difference(&table, *i, |t| total(t, &weights))).collect();
        assert_close(&chosen.iter().map(|i| f64::from(by_table[*i])).collect::<Vec<f64>>(), &expected, 1e-3);
    }
}

//! Exact gradients against central differences of the oracle.

use luxel_lanes::{LANES, Lanes, Level};

use super::oracle::{self, difference};
use crate::field::PixelLoss;
use crate::field::grid::Grid;
use crate::field::networks::position_blocks;
use crate::field::tests::{SMALL, assert_close, numbers, wide};
use crate::field::volume::{Composited, Intervals, composite};
use crate::networks::{Activations, Network};

fn positions(count: usize) -> Vec<[f32; 3]> {
    numbers(3, 3 * count, 0.5).chunks_exact(3).map(|p| [p[0] + 0.5, p[1] + 0.5, p[2] + 0.5]).collect()
}

#[test]
fn features_are_those_of_the_oracle_and_so_are_their_gradients() {
    let grid = Grid::new(SMALL);
    let (table, places, width) = (numbers(1, grid.len(), 1.0), positions(37), grid.width());
    let (level, mut blocks) = (Level::best(), Vec::new());
    position_blocks(&places, &mut blocks);
    let mut features = vec![Lanes::ZERO; blocks.len() / 3 * width];
    luxel_lanes::dispatch!(level, simd => grid.encode(simd, &table, &blocks, &mut features));
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
        luxel_lanes::dispatch!(level, simd => grid.scatter(simd, number, &blocks, &by_features, part));
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
        let (level, mut room, mut gradient) = (Level::best(), Activations::default(), vec![0.0; network.len()]);
        let place = |i: usize, width: usize| (i / width / LANES * width + i % width, i / width % LANES);
        for (i, value) in x.iter().enumerate() {
            let (row, lane) = place(i, inputs);
            network.inputs(blocks, &mut room)[row].0[lane] = *value;
        }
        luxel_lanes::dispatch!(level, simd => network.forward(simd, &weights, &mut room));
        let expected: Vec<f64> = x.chunks_exact(inputs).flat_map(|x| oracle::network(sizes, &wide(&weights), &wide(x))).collect();
        let read = |rows: &[Lanes], count: usize, width: usize| -> Vec<f64> {
            (0..count).map(|i| place(i, width)).map(|(row, lane)| f64::from(rows[row].0[lane])).collect()
        };
        assert_close(&read(room.outputs(), samples * outputs, outputs), &expected, 1e-5);
        for (i, value) in by.iter().enumerate() {
            let (row, lane) = place(i, outputs);
            room.by_outputs()[row].0[lane] = *value;
        }
        luxel_lanes::dispatch!(level, simd => network.backward(simd, &weights, &mut room, &mut gradient));
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

//! A whole step of training against the oracle, for every objective and kind of network.

use luxel_core::{RadianceScale, sh};
use luxel_lanes::{LANES, Level};

use super::oracle::{self, difference};
use super::{SMALL, assert_close, numbers, wide};
use crate::field::networks::Networks;
use crate::field::occupancy::Occupancy;
use crate::field::radiance_field::Field;
use crate::field::sampling::TrainingRay;
use crate::field::space::Ray;
use crate::field::task::{StepContext, Task, TaskRoom};
use crate::field::{ColorHead, FieldArrays, FieldConfig, FieldNetwork, FieldShape, Objective, PixelLoss, Space};

const SHARE: f64 = 0.2;
const DISTORTION: f64 = 0.05;
const MU: f64 = 5000.0;
const UNITS: usize = 128;

/// A small field of dense fog in few cells, and options to train it with.
fn fog(objective: Objective, network: FieldNetwork) -> (Field, FieldConfig) {
    let (grid, head) = (network.grid(), objective.head());
    let networks = Networks::new(network, &grid, head);
    let mut weights: Vec<f32> = networks.initial(11).iter().map(|w| 2.0 * w).collect();
    // Random networks of heads as they begin: twice as steep, and their outputs would be flat.
    weights[networks.before_head()..].iter_mut().for_each(|w| *w *= 0.5);
    let table = numbers(10, grid.len(), 1.0);
    let space = Space { center: [0.0; 3], side: 1.0, near: 0.0 };
    let arrays = FieldArrays { table, weights, occupancy: Occupancy::full(64).densities().to_vec() };
    let mut field = Field::from_arrays(FieldShape { network, head, space }, arrays).unwrap();
    field.occupancy.keep(|[x, y, z]| (x + 2 * y + 3 * z) % 23 == 0);
    (field, FieldConfig { iterations: 1, seed: 0, objective, mu: MU as f32, radiance_scale: RadianceScale::ONE, network })
}

fn rays() -> Vec<TrainingRay> {
    let ray = |i: u64| {
        let d = numbers(20 + i, 3, 1.0);
        TrainingRay {
            ray: Ray { origin: [0.5; 3], direction: glam::Vec3::new(d[0], d[1], d[2]).normalize().to_array() },
            shift: 0.2 * i as f32,
            radiance: [0.5, 0.1 + 0.1 * i as f32, 1.5],
            captured: [0.9, 0.2, 0.15 * i as f32],
            log_exposure: i as f32 - 2.0,
            weight: 1.0 - 0.1 * i as f32,
            captured_weight: 0.5 + 0.1 * i as f32,
            background: [0.2, 0.5, 0.1, 0.3, 0.6, 0.9],
        }
    };
    (0..5).map(ray).collect()
}

/// Numbers that describe a direction or a position, by sines and cosines.
fn frequencies(values: [f64; 3], count: i32) -> Vec<f64> {
    let of_k = |k: i32| values.map(|v| (2f64.powi(k) * v).sin()).into_iter().chain(values.map(|v| (2f64.powi(k) * v).cos()));
    values.into_iter().chain((0..count).flat_map(of_k)).collect()
}

/// ln density and raw colours at a place; the weights of the head are left over.
fn raw<'w>(network: FieldNetwork, table: &[f64], weights: &'w [f64], at: [f64; 3], toward: [f64; 3]) -> (f64, Vec<f64>, &'w [f64]) {
    let len = |sizes: &[usize]| sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum();
    let (mut numbers, direction, rest, sizes) = match network {
        FieldNetwork::Grid(shape) => {
            let features = oracle::encode(shape, table, at);
            let sizes = [features.len(), 32, 16];
            let (own, rest) = weights.split_at(len(&sizes));
            let mut basis = [0f64; sh::MAX_COEFFICIENTS];
            sh::basis(3, toward, &mut basis);
            (oracle::network(&sizes, own, &features), basis[..16].to_vec(), rest, vec![32, 32, 32, 3])
        }
        FieldNetwork::Layers { units, .. } => {
            let units = units as usize;
            let position = frequencies(at.map(|p| 2.0 * p - 1.0), 10);
            // Four layers: the position is joined to the input of the last.
            let (front, behind) = ([63, units, units, units], [63 + units, units, 1 + units]);
            let (of_front, rest) = weights.split_at(len(&front));
            let (of_behind, rest) = rest.split_at(len(&behind));
            let hidden = oracle::network(&front, of_front, &position).into_iter().map(|h| h.max(0.0));
            let joined: Vec<f64> = position.iter().copied().chain(hidden).collect();
            let numbers = oracle::network(&behind, of_behind, &joined);
            (numbers, frequencies(toward, 4), rest, vec![units + 27, units / 2, 3])
        }
    };
    let log_density = numbers[0];
    if let FieldNetwork::Layers { .. } = network {
        numbers.remove(0);
    }
    numbers.extend(direction);
    let (own, rest) = rest.split_at(len(&sizes));
    (log_density, oracle::network(&sizes, own, &numbers), rest)
}

fn logistic(x: f64) -> f64 {
    (1.0 + (-x).exp()).recip()
}

fn softplus(x: f64) -> f64 {
    x.exp().ln_1p()
}

/// Radiance and captured value of a raw colour.
fn channels(head: ColorHead, of_head: &[f64], c: usize, raw: f64) -> (f64, f64) {
    match head {
        ColorHead::Softplus => (softplus(raw), 0.0),
        ColorHead::Log => (raw.exp(), 0.0),
        ColorHead::Lifted => {
            let count = of_head.len() / 3;
            let value = logistic(raw);
            let [x, r, y] = oracle::network(&[1, UNITS, 3], &of_head[c * count..][..count], &[value]).try_into().unwrap();
            (softplus(value + x.max(0.0) * r.max(0.0) + y), value)
        }
    }
}

/// The loss of a step, with everything that its gradient is taken by.
fn total(field: &Field, options: &FieldConfig, task: &Task, table: &[f64], weights: &[f64]) -> f64 {
    let (network, head, samples) = (options.network, options.objective.head(), &task.samples);
    let mut total = 0.0;
    for (number, ray) in rays().iter().enumerate() {
        let empty = || oracle::Ray { density: vec![], length: vec![], middle: vec![], colors: vec![] };
        let (mut radiance, mut captured, of_head) = (empty(), empty(), &weights[field.networks.before_head()..]);
        for i in samples.of_ray(number) {
            let at = [0, 1, 2].map(|axis| f64::from(samples.positions[3 * (i / LANES) + axis].0[i % LANES]));
            let (log_density, raw, rest) = raw(network, table, weights, at, ray.ray.direction.map(f64::from));
            assert_eq!(rest.len(), of_head.len());
            let colors = [0, 1, 2].map(|c| channels(head, of_head, c, raw[c]));
            for (of, colors) in [(&mut radiance, colors.map(|c| c.0)), (&mut captured, colors.map(|c| c.1))] {
                of.density.push(log_density.exp());
                of.length.push(f64::from(samples.lengths[i]));
                of.middle.push(f64::from(samples.middles[i]));
                of.colors.push(colors);
            }
        }
        let [b0, b1, b2, b3, b4, b5] = ray.background;
        let ((radiance, distortion), (captured, _)) = (radiance.composite([b0, b1, b2]), captured.composite([b3, b4, b5]));
        let (weight, captured_weight) = (f64::from(ray.weight), f64::from(ray.captured_weight));
        total += SHARE * DISTORTION * weight * distortion;
        total += SHARE
            * match options.objective {
                Objective::Radiance { loss } => weight * oracle::pixel_loss(loss, radiance, ray.radiance, MU),
                Objective::Pairs { captured_weight: of_captured, radiance_weight } => {
                    weight * f64::from(radiance_weight) * oracle::pixel_loss(PixelLoss::Mulaw, radiance, ray.radiance, MU)
                        + captured_weight * f64::from(of_captured) * oracle::pixel_loss(PixelLoss::Linear, captured, ray.captured, MU)
                }
                Objective::Captured { .. } => {
                    let count = of_head.len() / 3;
                    let value = |c: usize| {
                        let s = radiance[c].ln() + f64::from(ray.log_exposure);
                        logistic(oracle::network(&[1, UNITS, 1], &of_head[c * count..][..count], &[s])[0])
                    };
                    weight * oracle::pixel_loss(PixelLoss::Linear, [0, 1, 2].map(value), ray.captured, MU)
                }
            };
    }
    total
}

#[track_caller]
fn check(objective: Objective, network: FieldNetwork) {
    let (field, options) = fog(objective, network);
    let lifts = field.networks.head.lifts(field.networks.of_head(&field.weights));
    let context =
        StepContext { field: &field, options: &options, lifts: lifts.as_ref(), share: SHARE as f32, distortion_weight: DISTORTION as f32 };
    let (level, mut task, rays) = (Level::best(), Task::default(), rays());
    // Memory that another part of a step used before.
    let mut room = TaskRoom::default();
    luxel_lanes::dispatch!(level, simd => task.run(simd, context, &rays[..2], &mut room));
    luxel_lanes::dispatch!(level, simd => task.run(simd, context, &rays, &mut room));
    assert!((20..2000).contains(&task.samples.len()), "{}", task.samples.len());
    let (table, weights) = (wide(&field.table), wide(&field.weights));
    let head = field.networks.before_head();
    for (part, step) in [(0..head, 61), (head..weights.len(), 13)] {
        if part.is_empty() {
            continue;
        }
        let chosen: Vec<usize> = part.step_by(step).collect();
        let expected: Vec<f64> = chosen.iter().map(|i| difference(&weights, *i, |w| total(&field, &options, &task, &table, w))).collect();
        assert_close(&chosen.iter().map(|i| f64::from(task.gradient[*i])).collect::<Vec<f64>>(), &expected, 2e-3);
    }
    if let FieldNetwork::Layers { .. } = network {
        return assert!(table.is_empty() && task.by_features.is_empty());
    }
    let mut by_table = vec![0.0; field.table.len()];
    for number in 0..field.grid.levels() {
        let part = &mut by_table[field.grid.numbers(number)];
        luxel_lanes::dispatch!(level, simd => field.grid.scatter(simd, number, &task.samples.positions, &task.by_features, part));
    }
    let chosen: Vec<usize> = (0..table.len()).filter(|i| by_table[*i] != 0.0).step_by(29).collect();
    assert!(chosen.len() > 10, "{}", chosen.len());
    let expected: Vec<f64> = chosen.iter().map(|i| difference(&table, *i, |t| total(&field, &options, &task, t, &weights))).collect();
    assert_close(&chosen.iter().map(|i| f64::from(by_table[*i])).collect::<Vec<f64>>(), &expected, 2e-3);
}

const LAYERS: FieldNetwork = FieldNetwork::Layers { layers: 4, units: 16 };
const CAPTURED: Objective = Objective::Captured { unit_value: 0.5 };
const PAIRS: Objective = Objective::Pairs { captured_weight: 1.0, radiance_weight: 0.6 };

#[test]
fn a_step_on_radiance_has_the_oracles_gradients() {
    for loss in [PixelLoss::Linear, PixelLoss::Mulaw] {
        check(Objective::Radiance { loss }, FieldNetwork::Grid(SMALL));
    }
}

#[test]
fn a_step_on_captured_images_has_the_oracles_gradients() {
    check(CAPTURED, FieldNetwork::Grid(SMALL));
}

#[test]
fn a_step_on_pairs_has_the_oracles_gradients() {
    check(PAIRS, FieldNetwork::Grid(SMALL));
}

#[test]
fn steps_of_a_deep_network_have_the_oracles_gradients() {
    for objective in [Objective::Radiance { loss: PixelLoss::Mulaw }, CAPTURED, PAIRS] {
        check(objective, LAYERS);
    }
}

//! GaussHDR's tone networks, which splats and pixels share.
//!
//! In: items of ln exposure s [3] and a context feature f [4]. Out, by channel: the global value
//! g_c(s_c), the local shift r_c(s_c, f), both through a logistic, and the uncertainty
//! max(softplus(u(s_c, f)), [`LEAST_UNCERTAINTY`]), of which one network serves all channels; and
//! the gradients by the items and by the networks' numbers. Items have no gradient by their
//! uncertainty, as published. Items come in blocks of sixteen, are taken in chunks of constant
//! size, and their sums are added in order: the same bits for any number of threads.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_lanes::functions::{exp, sigmoid, softplus};
use luxel_lanes::{LANES, Level};
use luxel_train::TrainError;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::soft_network::{Pair, SoftNetwork, add};
use crate::captured::arithmetic::adam::Adam;
use crate::captured::arithmetic::blocks::{Block, CHUNK};

/// Smallest uncertainty.
pub(super) const LEAST_UNCERTAINTY: f32 = 0.1;
/// Numbers of an item: ln exposure by channel, and the feature.
pub(super) const INPUTS: usize = 3 + FEATURES;
/// Numbers of a context feature.
pub(super) const FEATURES: usize = 4;
/// Values of an item: global, local shift and uncertainty, by channel each.
pub(super) const OUTPUTS: usize = 9;
/// Constant that separates the random stream of the networks from others of the same seed.
const STREAM: u64 = 0x6c75_7865_6c07;
/// Weight of the loss that draws the global networks to their value at the unit exposure.
const UNIT_WEIGHT: f64 = 0.5;
/// First fit of the global networks: steps, rate, samples a step, range of ln exposure.
const FIT_STEPS: usize = 1000;
const FIT_RATE: f64 = 5e-4;
const FIT_SAMPLES: usize = 1024;
const FIT_RANGE: f32 = 3.0;

type Global = SoftNetwork<1>;
type Local = SoftNetwork<{ 1 + FEATURES }>;
/// Sixteen items.
pub(super) type Items = Block<INPUTS>;
/// Values of sixteen items, or the gradient by them.
pub(super) type Values = Block<OUTPUTS>;

/// The networks, with the state of their optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct GaussTone {
    global: [Global; 3],
    local: [Local; 3],
    uncertainty: Local,
    adam: [Adam; 7],
}

/// The gradients of some items.
pub(super) struct ItemGradient {
    pub(super) by_item: Vec<Items>,
    /// Gradient by the numbers of all networks, one after another.
    pub(super) by_numbers: Vec<f64>,
}

/// Places of the networks' numbers: three global, three local, one of uncertainty.
const GLOBAL_NUMBERS: usize = Global::NUMBERS;
const LOCAL_NUMBERS: usize = Local::NUMBERS;
const NUMBERS: usize = 3 * GLOBAL_NUMBERS + 4 * LOCAL_NUMBERS;

/// Loads rows of two blocks.
#[inline(always)]
fn load<const R: usize, S: Simd>(simd: S, blocks: [&Block<R>; 2]) -> Pair<S, R> {
    let mut rows = [[f32x16::splat(simd, 0.0); R]; 2];
    for (rows, block) in rows.iter_mut().zip(blocks) {
        for (row, numbers) in rows.iter_mut().zip(block) {
            *row = f32x16::load_array_ref(simd, numbers);
        }
    }
    rows
}

/// Returns the ln exposures.
#[inline(always)]
fn exposures<S: Simd>(items: &Pair<S, INPUTS>) -> Pair<S, 3> {
    [[items[0][0], items[0][1], items[0][2]], [items[1][0], items[1][1], items[1][2]]]
}

/// Returns the input of the networks of a channel that see the feature.
#[inline(always)]
fn with_feature<S: Simd>(items: &Pair<S, INPUTS>, channel: usize) -> Pair<S, { 1 + FEATURES }> {
    let mut inputs = [[items[0][channel]; 1 + FEATURES]; 2];
    for (inputs, items) in inputs.iter_mut().zip(items) {
        inputs[0] = items[channel];
        inputs[1..].copy_from_slice(&items[3..]);
    }
    inputs
}

/// Returns the captured value of a global value and a local shift, and whether its gradient passes.
#[inline(always)]
pub(super) fn local_value(global: f32, shift: f32) -> (f32, bool) {
    let y = global + shift - 0.5;
    (y.clamp(0.0, 1.0), (0.0..=1.0).contains(&y))
}

/// Returns ln(1 + e^s), cut to 1: the curve that global networks begin with.
fn first_curve(s: f32) -> f32 {
    luxel_core::softplus(s).min(1.0)
}

impl GaussTone {
    /// Makes the networks at the start of a run, the global ones fitted to ln(1 + e^s), cut to 0 to
    /// 1.
    pub(crate) fn new(seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ STREAM);
        let (global, local) = ([(); 3].map(|()| Global::random(&mut rng)), [(); 3].map(|()| Local::random(&mut rng)));
        let mut tone = Self { global, local, uncertainty: Local::random(&mut rng), adam: Self::moments() };
        tone.fit(&mut rng);
        tone.adam = Self::moments();
        tone
    }

    fn moments() -> [Adam; 7] {
        std::array::from_fn(|i| Adam::new(if i < 3 { GLOBAL_NUMBERS } else { LOCAL_NUMBERS }))
    }

    fn fit(&mut self, rng: &mut impl Rng) {
        for _ in 0..FIT_STEPS {
            let mut samples = || std::array::from_fn(|_| rng.random_range(-FIT_RANGE..FIT_RANGE));
            let items: Vec<Items> = (0..FIT_SAMPLES / LANES)
                .map(|_| {
                    let s: [f32; LANES] = samples();
                    std::array::from_fn(|k| if k < 3 { s } else { [0.0; LANES] })
                })
                .collect();
            let by_value = |(item, value): (&Items, &Values)| {
                let mut by = [[0.0; LANES]; OUTPUTS];
                for lane in 0..LANES {
                    let target = first_curve(item[0][lane]);
                    let d = [0, 1, 2].map(|c| value[c][lane] - target);
                    let norm = d.iter().map(|d| d * d).sum::<f32>().sqrt().max(1e-12) * FIT_SAMPLES as f32;
                    (0..3).for_each(|c| by[c][lane] = d[c] / norm);
                }
                by
            };
            let values = self.apply(&items);
            let by_values: Vec<Values> = items.iter().zip(&values).map(by_value).collect();
            let by_numbers = self.backward(&items, &values, &by_values).by_numbers;
            for c in 0..3 {
                self.adam[c].step(self.global[c].numbers_mut(), &by_numbers[c * GLOBAL_NUMBERS..][..GLOBAL_NUMBERS], FIT_RATE);
            }
        }
    }

    /// Checks networks read from a file.
    pub(crate) fn validate(&self) -> Result<(), TrainError> {
        self.global.iter().try_for_each(Global::validate)?;
        self.local.iter().chain([&self.uncertainty]).try_for_each(Local::validate)?;
        self.adam.iter().enumerate().try_for_each(|(i, adam)| adam.validate(if i < 3 { GLOBAL_NUMBERS } else { LOCAL_NUMBERS }))
    }

    #[inline(always)]
    fn apply_chunk<S: Simd>(&self, simd: S, items: &[Items], values: &mut [Values]) {
        for (items, values) in items.chunks(2).zip(values.chunks_mut(2)) {
            let last = items.len() - 1;
            let items = load(simd, [&items[0], &items[last]]);
            // Loops in place of closures, which would not be inlined.
            let uncertainty = self.uncertainty.apply_each(simd, &exposures(&items), &with_feature(&items, 0));
            for c in 0..3 {
                let global = self.global[c].apply(simd, &[[items[0][c]], [items[1][c]]]);
                let local = self.local[c].apply(simd, &with_feature(&items, c));
                for (b, values) in values.iter_mut().enumerate() {
                    sigmoid(global[b]).store_array(&mut values[c]);
                    sigmoid(local[b]).store_array(&mut values[3 + c]);
                    softplus(uncertainty[b][c]).max(f32x16::splat(simd, LEAST_UNCERTAINTY)).store_array(&mut values[6 + c]);
                }
            }
        }
    }

    /// Returns the values of items.
    pub(super) fn apply(&self, items: &[Items]) -> Vec<Values> {
        let mut values = vec![[[0.0; LANES]; OUTPUTS]; items.len()];
        values.par_chunks_mut(CHUNK).zip(items.par_chunks(CHUNK)).for_each(|(values, items)| {
            luxel_lanes::dispatch!(Level::best(), simd => self.apply_chunk(simd, items, values));
        });
        values
    }

    /// Writes the gradient by a chunk of items, and returns that by the numbers.
    #[inline(always)]
    fn backward_chunk<S: Simd>(&self, simd: S, given: Given<'_>, out: &mut [Items]) -> Vec<f64> {
        let mut sums = vec![[0.0; LANES]; NUMBERS];
        let mut by_raw = vec![[[0.0; LANES]; OUTPUTS]; out.len()];
        for ((by_raw, values), by_value) in by_raw.iter_mut().zip(given.values).zip(given.by_value) {
            differentiate_outputs(simd, values, by_value, by_raw);
        }
        let (global_sums, rest) = sums.split_at_mut(3 * GLOBAL_NUMBERS);
        let (local_sums, uncertainty_sums) = rest.split_at_mut(3 * LOCAL_NUMBERS);
        // Network by network: the sums of one stay in the core's first cache.
        for c in 0..3 {
            let global_sums = &mut global_sums[c * GLOBAL_NUMBERS..][..GLOBAL_NUMBERS];
            let local_sums = &mut local_sums[c * LOCAL_NUMBERS..][..LOCAL_NUMBERS];
            for ((items, by_raw), out) in given.items.chunks(2).zip(by_raw.chunks(2)).zip(out.chunks_mut(2)) {
                let (items, by_raw) = load_pair(simd, items, by_raw);
                let of_global = self.global[c].backward(simd, &[[items[0][c]], [items[1][c]]], [by_raw[0][c], by_raw[1][c]], global_sums);
                let by_local = [by_raw[0][3 + c], by_raw[1][3 + c]];
                let of_local = self.local[c].backward(simd, &with_feature(&items, c), by_local, local_sums);
                for (b, out) in out.iter_mut().enumerate() {
                    add(simd, &mut out[c], of_global[b][0] + of_local[b][0]);
                    for k in 0..FEATURES {
                        add(simd, &mut out[3 + k], of_local[b][1 + k]);
                    }
                }
            }
        }
        // The gradient by the item ends at uncertainty.
        for (items, by_raw) in given.items.chunks(2).zip(by_raw.chunks(2)) {
            let (items, by_raw) = load_pair(simd, items, by_raw);
            let by = [[by_raw[0][6], by_raw[0][7], by_raw[0][8]], [by_raw[1][6], by_raw[1][7], by_raw[1][8]]];
            self.uncertainty.add_gradient_of_each(simd, &exposures(&items), &with_feature(&items, 0), &by, uncertainty_sums);
        }
        sums.iter().map(|lanes| f64::from(lanes.iter().sum::<f32>())).collect()
    }

    /// Returns the gradients by the items and by the networks' numbers, from that by the items'
    /// values.
    pub(super) fn backward(&self, items: &[Items], values: &[Values], by_value: &[Values]) -> ItemGradient {
        let mut by_item = vec![[[0.0; LANES]; INPUTS]; items.len()];
        let inputs = items.par_chunks(CHUNK).zip(values.par_chunks(CHUNK)).zip(by_value.par_chunks(CHUNK));
        let parts: Vec<Vec<f64>> = by_item
            .par_chunks_mut(CHUNK)
            .zip(inputs)
            .map(|(out, ((items, values), by_value))| {
                let given = Given { items, values, by_value };
                luxel_lanes::dispatch!(Level::best(), simd => self.backward_chunk(simd, given, out))
            })
            .collect();
        let mut by_numbers = vec![0.0; NUMBERS];
        for part in &parts {
            by_numbers.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        ItemGradient { by_item, by_numbers }
    }

    /// Adds the gradient of the unit exposure's loss to that by the numbers, and returns the loss.
    pub(super) fn add_unit_loss(&self, by_numbers: &mut [f64], unit_value: f32) -> f32 {
        // All items of the block are the unit exposure; one counts.
        let items = [[[0.0; LANES]; INPUTS]];
        let values = self.apply(&items);
        let difference = |c: usize| f64::from(values[0][c][0]) - f64::from(unit_value);
        let mut by_value = [[[0.0; LANES]; OUTPUTS]];
        (0..3).for_each(|c| by_value[0][c][0] = (2.0 * UNIT_WEIGHT / 3.0 * difference(c)) as f32);
        let part = self.backward(&items, &values, &by_value).by_numbers;
        by_numbers.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        ((0..3).map(|c| difference(c).powi(2)).sum::<f64>() * UNIT_WEIGHT / 3.0) as f32
    }

    /// Returns the numbers of all networks, one after another.
    #[cfg(test)]
    pub(crate) fn numbers(&self) -> Vec<&[f32]> {
        let locals = self.local.iter().chain([&self.uncertainty]).map(Local::numbers);
        self.global.iter().map(Global::numbers).chain(locals).collect()
    }

    /// Updates the networks.
    pub(crate) fn update(&mut self, by_numbers: &[f64], rate: f64) {
        let Self { global, local, uncertainty, adam } = self;
        let numbers = global.iter_mut().map(Global::numbers_mut).chain(local.iter_mut().map(Local::numbers_mut));
        let mut rest = by_numbers;
        for (numbers, adam) in numbers.chain([uncertainty.numbers_mut()]).zip(adam) {
            let (own, others) = rest.split_at(numbers.len());
            adam.step(numbers, own, rate);
            rest = others;
        }
    }
}

/// A chunk of items, their values, and the gradient by those.
#[derive(Clone, Copy)]
struct Given<'a> {
    items: &'a [Items],
    values: &'a [Values],
    by_value: &'a [Values],
}

/// Loads one or two blocks of items, and the gradient by the networks' outputs. A block without a
/// second has itself as one, without gradient.
#[inline(always)]
fn load_pair<S: Simd>(simd: S, items: &[Items], by_raw: &[Values]) -> (Pair<S, INPUTS>, Pair<S, OUTPUTS>) {
    let last = items.len() - 1;
    let mut by = load(simd, [&by_raw[0], &by_raw[last]]);
    if last == 0 {
        by[1] = [f32x16::splat(simd, 0.0); OUTPUTS];
    }
    (load(simd, [&items[0], &items[last]]), by)
}

/// Writes the gradient by the networks' outputs.
#[inline(always)]
fn differentiate_outputs<S: Simd>(simd: S, values: &Values, by_value: &Values, out: &mut Values) {
    let (one, zero) = (f32x16::splat(simd, 1.0), f32x16::splat(simd, 0.0));
    let least = f32x16::splat(simd, LEAST_UNCERTAINTY);
    for (k, ((out, value), by)) in out.iter_mut().zip(values).zip(by_value).enumerate() {
        let (value, by) = (f32x16::load_array_ref(simd, value), f32x16::load_array_ref(simd, by));
        let slope = if k < 6 {
            value * (one - value)
        } else {
            // The logistic of the output is 1 - e^-softplus.
            value.simd_gt(least).select(one - exp(-value), zero)
        };
        (by * slope).store_array(out);
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    fn items(count: u64) -> Vec<Items> {
        let item = |i: u64| {
            let [a, b, c] = standard_normal(3, i).map(|v: f32| v);
            let [d, e, f] = standard_normal(4, i).map(|v: f32| 0.5 * v);
            [a, b, c, d, e, f, 0.3 * a]
        };
        (0..count.div_ceil(16))
            .map(|n| {
                let lanes: [[f32; INPUTS]; LANES] = std::array::from_fn(|lane| item(16 * n + lane as u64));
                std::array::from_fn(|k| lanes.map(|item| item[k]))
            })
            .collect()
    }

    fn weight(i: usize) -> f64 {
        f64::from(0.7 * i as f32).sin()
    }

    fn loss(tone: &GaussTone, items: &[Items], of: std::ops::Range<usize>) -> f64 {
        let values = tone.apply(items);
        let rows = values.iter().flatten().enumerate().filter(|(row, _)| of.contains(&(row % OUTPUTS)));
        rows.flat_map(|(row, lanes)| lanes.iter().enumerate().map(move |(lane, v)| f64::from(*v) * weight(16 * row + lane))).sum()
    }

    fn by(blocks: usize, of: std::ops::Range<usize>) -> Vec<Values> {
        let number = |row: usize, lane: usize| if of.contains(&(row % OUTPUTS)) { weight(16 * row + lane) as f32 } else { 0.0 };
        (0..blocks).map(|n| std::array::from_fn(|k| std::array::from_fn(|lane| number(OUTPUTS * n + k, lane)))).collect()
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let (items, tone) = (items(48), GaussTone::new(4));
        // Uncertainty has no gradient by items.
        let exact = tone.backward(&items, &tone.apply(&items), &by(3, 0..6));
        for (block, k, lane) in [(0, 0, 0), (0, 1, 7), (2, 2, 4), (0, 3, 5), (1, 6, 12), (2, 4, 15)] {
            let moved = |h: f32| {
                let mut items = items.clone();
                items[block][k][lane] += h;
                loss(&tone, &items, 0..6)
            };
            let (numeric, found) = ((moved(4e-3) - moved(-4e-3)) / 8e-3, f64::from(exact.by_item[block][k][lane]));
            assert!((numeric - found).abs() < 1e-3 + 1e-2 * found.abs(), "{block}, {k}, {lane}: {numeric} {found}");
        }
        let exact = tone.backward(&items, &tone.apply(&items), &by(3, 0..OUTPUTS));
        type Numbers = fn(&mut GaussTone) -> &mut [f32];
        let networks: [(usize, Numbers); 3] = [
            (GLOBAL_NUMBERS, |tone| tone.global[1].numbers_mut()),
            (3 * GLOBAL_NUMBERS + 2 * LOCAL_NUMBERS, |tone| tone.local[2].numbers_mut()),
            (3 * GLOBAL_NUMBERS + 3 * LOCAL_NUMBERS, |tone| tone.uncertainty.numbers_mut()),
        ];
        for (first, numbers) in networks {
            let count = numbers(&mut tone.clone()).len();
            for at in (0..count).step_by(29).chain([count - 1]) {
                let moved = |h: f32| {
                    let mut tone = tone.clone();
                    numbers(&mut tone)[at] += h;
                    loss(&tone, &items, 0..OUTPUTS)
                };
                let (numeric, found) = ((moved(4e-3) - moved(-4e-3)) / 8e-3, exact.by_numbers[first + at]);
                assert!((numeric - found).abs() < 3e-3 + 2e-2 * found.abs(), "{first} + {at}: {numeric} {found}");
            }
        }
    }

    #[test]
    fn the_first_global_networks_are_near_their_curve_and_any_number_of_threads_gives_the_same_bits() {
        let tone = GaussTone::new(9);
        for s in [-2.5f32, -1.0, 0.0, 0.4] {
            let item: Items = std::array::from_fn(|k| [if k < 3 { s } else { 0.0 }; LANES]);
            let value = tone.apply(&[item])[0][1][3];
            assert!((value - first_curve(s)).abs() < 0.1, "{s}: {value}");
        }
        let items = items(9000);
        let gradient = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut tone = tone.clone();
                let found = tone.backward(&items, &tone.apply(&items), &by(563, 0..OUTPUTS));
                tone.update(&found.by_numbers, 1e-3);
                (tone, found.by_item)
            })
        };
        assert!(gradient(1) == gradient(3));
    }
}

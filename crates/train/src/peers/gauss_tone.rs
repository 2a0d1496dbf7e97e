//! GaussHDR's tone networks, which splats and pixels share.
//!
//! In: items of ln exposure s [3] and a context feature f [4]. Out, by channel: the global value
//! g_c(s_c), the local shift r_c(s_c, f), both through a logistic, and the uncertainty
//! max(softplus(u(s_c, f)), [`LEAST_UNCERTAINTY`]), of which one network serves all channels; and
//! the gradients by the items and by the networks' numbers. Items have no gradient by their
//! uncertainty, as published. Items are taken in chunks of constant size, and their sums are added
//! in order: the same bits for any number of threads.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x16};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::soft_network::{LANES, SoftNetwork};
use crate::TrainError;

/// Smallest uncertainty.
pub(super) const LEAST_UNCERTAINTY: f32 = 0.1;
/// Numbers of an item: ln exposure by channel, and the feature.
pub(super) const INPUTS: usize = 3 + FEATURES;
/// Numbers of a context feature.
pub(super) const FEATURES: usize = 4;
/// Values of an item: global, local shift and uncertainty, by channel each.
pub(super) const OUTPUTS: usize = 9;
/// Items of a chunk.
const CHUNK: usize = 2048;
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
/// An item.
pub(super) type Item = [f32; INPUTS];
/// Values of an item, or the gradient by them.
pub(super) type Values = [f32; OUTPUTS];

/// The networks, with the state of their optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GaussTone {
    global: [Global; 3],
    local: [Local; 3],
    uncertainty: Local,
    adam: [Adam; 7],
}

/// Sums of the gradient by the numbers of all networks, one after another, by lane.
pub(super) struct ToneSums(Vec<[f32; LANES]>);

/// The gradients of some items.
pub(super) struct ItemGradient {
    pub(super) by_item: Vec<Item>,
    /// Gradient by the numbers of all networks, one after another.
    pub(super) by_numbers: Vec<f64>,
}

/// Places of the networks' numbers: three global, three local, one of uncertainty.
const GLOBAL_NUMBERS: usize = Global::NUMBERS;
const LOCAL_NUMBERS: usize = Local::NUMBERS;
const NUMBERS: usize = 3 * GLOBAL_NUMBERS + 4 * LOCAL_NUMBERS;

/// Loads the rows of at most sixteen items.
#[inline(always)]
fn load<const N: usize, S: Simd>(simd: S, items: &[[f32; N]]) -> [f32x16<S>; N] {
    let mut rows = [[0.0; LANES]; N];
    for (lane, item) in items.iter().enumerate() {
        (0..N).for_each(|c| rows[c][lane] = item[c]);
    }
    rows.map(|row| f32x16::load_array_ref(simd, &row))
}

/// Stores rows as items.
#[inline(always)]
fn store<const N: usize, S: Simd>(rows: [f32x16<S>; N], items: &mut [[f32; N]]) {
    let rows = rows.map(|row| {
        let mut values = [0.0; LANES];
        row.store_array(&mut values);
        values
    });
    for (lane, item) in items.iter_mut().enumerate() {
        (0..N).for_each(|c| item[c] = rows[c][lane]);
    }
}

/// Returns the input of the networks of a channel that see the feature.
#[inline(always)]
fn with_feature<S: Simd>(item: &[f32x16<S>; INPUTS], channel: usize) -> [f32x16<S>; 1 + FEATURES] {
    std::array::from_fn(|k| if k == 0 { item[channel] } else { item[2 + k] })
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

impl GaussTone {
    /// Makes the networks at the start of a run, the global ones fitted to ln(1 + e^s), cut to 0 to
    /// 1.
    pub(super) fn new(seed: u64) -> Self {
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
            let items: Vec<Item> = (0..FIT_SAMPLES)
                .map(|_| {
                    let s = rng.random_range(-FIT_RANGE..FIT_RANGE);
                    std::array::from_fn(|k| if k < 3 { s } else { 0.0 })
                })
                .collect();
            let by_value = |(item, value): (&Item, &Values)| {
                let target = softplus(item[0]).min(1.0);
                let d = [0, 1, 2].map(|c| value[c] - target);
                let norm = d.iter().map(|d| d * d).sum::<f32>().sqrt().max(1e-12) * FIT_SAMPLES as f32;
                std::array::from_fn(|k| if k < 3 { d[k] / norm } else { 0.0 })
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
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        self.global.iter().try_for_each(Global::validate)?;
        self.local.iter().chain([&self.uncertainty]).try_for_each(Local::validate)?;
        self.adam.iter().enumerate().try_for_each(|(i, adam)| adam.validate(if i < 3 { GLOBAL_NUMBERS } else { LOCAL_NUMBERS }))
    }

    #[inline(always)]
    fn apply_chunk<S: Simd>(&self, simd: S, items: &[Item], values: &mut [Values]) {
        for (items, values) in items.chunks(LANES).zip(values.chunks_mut(LANES)) {
            let item = load(simd, items);
            // Loops in place of closures, which would not be inlined.
            let mut raw = [f32x16::splat(simd, 0.0); OUTPUTS];
            for c in 0..3 {
                let input = with_feature(&item, c);
                raw[c] = self.global[c].apply(simd, &[item[c]]);
                raw[3 + c] = self.local[c].apply(simd, &input);
                raw[6 + c] = self.uncertainty.apply(simd, &input);
            }
            store(raw, values);
            for value in values.iter_mut() {
                let raw = *value;
                *value = std::array::from_fn(|k| if k < 6 { sigmoid(raw[k]) } else { softplus(raw[k]).max(LEAST_UNCERTAINTY) });
            }
        }
    }

    /// Returns the values of items.
    pub(super) fn apply(&self, items: &[Item]) -> Vec<Values> {
        let mut values = vec![[0.0; OUTPUTS]; items.len()];
        values.par_chunks_mut(CHUNK).zip(items.par_chunks(CHUNK)).for_each(|(values, items)| {
            fearless_simd::dispatch!(Level::new(), simd => self.apply_chunk(simd, items, values));
        });
        values
    }

    #[inline(always)]
    fn backward_chunk<S: Simd>(&self, simd: S, given: Given<'_>, out: &mut [Item], sums: &mut [[f32; LANES]]) {
        let (global_sums, sums) = sums.split_at_mut(3 * GLOBAL_NUMBERS);
        let (local_sums, uncertainty_sums) = sums.split_at_mut(3 * LOCAL_NUMBERS);
        let blocks = given.items.chunks(LANES).zip(given.values.chunks(LANES)).zip(given.by_value.chunks(LANES));
        for (((items, values), by_value), out) in blocks.zip(out.chunks_mut(LANES)) {
            let by_raw: Vec<Values> = values.iter().zip(by_value).map(|(value, by)| by_raw(value, by)).collect();
            let (item, by_raw) = (load(simd, items), load(simd, &by_raw));
            let mut by_item = [f32x16::splat(simd, 0.0); INPUTS];
            for c in 0..3 {
                let [by_s] = self.global[c].backward(simd, &[item[c]], by_raw[c], &mut global_sums[c * GLOBAL_NUMBERS..][..GLOBAL_NUMBERS]);
                let input = with_feature(&item, c);
                let by = self.local[c].backward(simd, &input, by_raw[3 + c], &mut local_sums[c * LOCAL_NUMBERS..][..LOCAL_NUMBERS]);
                by_item[c] = by_item[c] + by_s + by[0];
                (0..FEATURES).for_each(|k| by_item[3 + k] += by[1 + k]);
                // The gradient by the item ends here.
                self.uncertainty.backward(simd, &input, by_raw[6 + c], uncertainty_sums);
            }
            store(by_item, out);
        }
    }

    /// Returns the gradients by the items and by the networks' numbers, from that by the items'
    /// values.
    pub(super) fn backward(&self, items: &[Item], values: &[Values], by_value: &[Values]) -> ItemGradient {
        let mut by_item = vec![[0.0; INPUTS]; items.len()];
        let inputs = items.par_chunks(CHUNK).zip(values.par_chunks(CHUNK)).zip(by_value.par_chunks(CHUNK));
        let parts: Vec<ToneSums> = by_item
            .par_chunks_mut(CHUNK)
            .zip(inputs)
            .map(|(out, ((items, values), by_value))| {
                let mut sums = ToneSums(vec![[0.0; LANES]; NUMBERS]);
                let given = Given { items, values, by_value };
                fearless_simd::dispatch!(Level::new(), simd => self.backward_chunk(simd, given, out, &mut sums.0));
                sums
            })
            .collect();
        let mut by_numbers = vec![0.0; NUMBERS];
        for part in &parts {
            for (sum, lanes) in by_numbers.iter_mut().zip(&part.0) {
                *sum += lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
            }
        }
        ItemGradient { by_item, by_numbers }
    }

    /// Adds the gradient of the unit exposure's loss to that by the numbers, and returns the loss.
    pub(super) fn add_unit_loss(&self, by_numbers: &mut [f64], unit_value: f32) -> f32 {
        let items = [[0.0; INPUTS]];
        let values = self.apply(&items);
        let difference = |c: usize| f64::from(values[0][c]) - f64::from(unit_value);
        let by = |c: usize| (2.0 * UNIT_WEIGHT / 3.0 * difference(c)) as f32;
        let by_value = [std::array::from_fn(|k| if k < 3 { by(k) } else { 0.0 })];
        let part = self.backward(&items, &values, &by_value).by_numbers;
        by_numbers.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        ((0..3).map(|c| difference(c).powi(2)).sum::<f64>() * UNIT_WEIGHT / 3.0) as f32
    }

    /// Updates the networks.
    pub(super) fn update(&mut self, by_numbers: &[f64], rate: f64) {
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
    items: &'a [Item],
    values: &'a [Values],
    by_value: &'a [Values],
}

/// Returns the gradient by the networks' outputs.
fn by_raw(value: &Values, by: &Values) -> Values {
    std::array::from_fn(|k| match k {
        0..6 => by[k] * value[k] * (1.0 - value[k]),
        // The logistic of the output is 1 - e^-softplus.
        _ if value[k] > LEAST_UNCERTAINTY => by[k] * (1.0 - (-value[k]).exp()),
        _ => 0.0,
    })
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    fn items(count: u64) -> Vec<Item> {
        (0..count)
            .map(|i| {
                let [a, b, c] = standard_normal(3, i).map(|v: f32| v);
                let [d, e, f] = standard_normal(4, i).map(|v: f32| 0.5 * v);
                [a, b, c, d, e, f, 0.3 * a]
            })
            .collect()
    }

    fn weight(i: usize) -> f64 {
        f64::from(0.7 * i as f32).sin()
    }

    fn loss(tone: &GaussTone, items: &[Item], of: std::ops::Range<usize>) -> f64 {
        let values = tone.apply(items);
        values.as_flattened().iter().enumerate().filter(|(i, _)| of.contains(&(i % OUTPUTS))).map(|(i, v)| f64::from(*v) * weight(i)).sum()
    }

    fn by(count: usize, of: std::ops::Range<usize>) -> Vec<Values> {
        let number = |i: usize| if of.contains(&(i % OUTPUTS)) { weight(i) as f32 } else { 0.0 };
        (0..count).map(|i| std::array::from_fn(|k| number(OUTPUTS * i + k))).collect()
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let (items, tone) = (items(37), GaussTone::new(4));
        // Uncertainty has no gradient by items.
        let exact = tone.backward(&items, &tone.apply(&items), &by(37, 0..6));
        for (i, k) in [(0, 0), (7, 1), (36, 2), (5, 3), (12, 6), (20, 4)] {
            let moved = |h: f32| {
                let mut items = items.clone();
                items[i][k] += h;
                loss(&tone, &items, 0..6)
            };
            let (numeric, found) = ((moved(4e-3) - moved(-4e-3)) / 8e-3, f64::from(exact.by_item[i][k]));
            assert!((numeric - found).abs() < 1e-3 + 1e-2 * found.abs(), "{i}, {k}: {numeric} {found}");
        }
        let exact = tone.backward(&items, &tone.apply(&items), &by(37, 0..OUTPUTS));
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
            let value = tone.apply(&[[s, s, s, 0.0, 0.0, 0.0, 0.0]])[0][1];
            assert!((value - softplus(s).min(1.0)).abs() < 0.1, "{s}: {value}");
        }
        let items = items(9000);
        let gradient = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut tone = tone.clone();
                let found = tone.backward(&items, &tone.apply(&items), &by(9000, 0..OUTPUTS));
                tone.update(&found.by_numbers, 1e-3);
                (tone, found.by_item)
            })
        };
        assert!(gradient(1) == gradient(3));
    }
}

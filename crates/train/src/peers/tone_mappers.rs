//! HDR-GS's tone mappers: from the logarithm of radiance and of exposure time to the values of
//! captured images.
//!
//! In: radiance of splats in normalised units, exposure in seconds. Out: captured values y_c =
//! sigmoid(u_c(ln x_c + ln(t / t_0))), where u_c is a [`ReluLine`] of the channel and t_0 the
//! geometric mean of the training exposures, so that a unit of time does not change how the
//! networks begin. The gradient by radiance and by the networks' numbers is exact.
//!
//! Splats are taken in chunks of constant size, and their sums are added in order: the same bits
//! for any number of threads. Degenerate: black has no logarithm; radiance below [`DARKEST`] counts
//! as that and has no gradient.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::relu_line::{LineSums, LineTable, ReluLine};
use crate::TrainError;

/// Radiance that black counts as, far below every cut-off.
const DARKEST: f32 = 1e-30;
/// Splats of a chunk.
const CHUNK: usize = 2048;
/// Constant that separates the random stream of the networks from others of the same seed.
const STREAM: u64 = 0x6c75_7865_6c04;

/// The networks of a run, with the state of their optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ToneMappers {
    /// Exposure whose logarithm is 0, seconds.
    reference_s: f32,
    lines: [ReluLine; 3],
    adam: [Adam; 3],
}

/// The tone mappers of a run, for people and other programs: y_c = sigmoid(bias + sum of
/// outgoing_j max(weight_j s + bias_j, 0)) with s = ln(radiance / radiance_unit) + ln(exposure /
/// reference_s).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToneMapperRecord {
    /// Radiance whose logarithm is 0, in the units of the data set.
    pub radiance_unit: f32,
    /// Exposure whose logarithm is 0, seconds.
    pub reference_s: f32,
    /// Numbers of the networks, red, green and blue: weights of the units, biases of the units,
    /// outgoing weights of the units, bias.
    pub numbers: [Vec<f32>; 3],
}

/// The networks at one step and exposure.
pub(crate) struct ToneTables {
    tables: [LineTable; 3],
    log_exposure: f64,
}

/// The gradients of a step.
pub(crate) struct ToneGradient {
    /// By the splats' radiance.
    pub(crate) by_color: Vec<[f32; 3]>,
    sums: [LineSums; 3],
}

impl ToneMappers {
    /// Makes the networks at the start of a run.
    pub(crate) fn new(units: u32, exposures_s: impl Iterator<Item = f32>, seed: u64) -> Self {
        let units = units as usize;
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ STREAM);
        let (sum, count) = exposures_s.fold((0.0f64, 0usize), |(sum, count), t| (sum + f64::from(t).ln(), count + 1));
        let lines = [(); 3].map(|()| ReluLine::random(units, 1, &mut rng));
        let adam = lines.each_ref().map(|line| Adam::new(line.numbers().len()));
        Self { reference_s: (sum / count.max(1) as f64).exp() as f32, lines, adam }
    }

    /// Returns the tables for an exposure.
    pub(crate) fn tables(&self, exposure_s: f32) -> ToneTables {
        let log_exposure = f64::from(exposure_s).ln() - f64::from(self.reference_s).ln();
        ToneTables { tables: self.lines.each_ref().map(ReluLine::table), log_exposure }
    }

    /// Updates the networks by a step's gradient.
    pub(crate) fn update(&mut self, tables: &ToneTables, gradient: &ToneGradient, rate: f64) {
        for (c, (line, adam)) in self.lines.iter_mut().zip(&mut self.adam).enumerate() {
            let by_numbers = line.gradient(&tables.tables[c], &gradient.sums[c]);
            adam.step(line.numbers_mut(), &by_numbers, rate);
        }
    }

    /// Checks networks read from a file.
    pub(crate) fn validate(&self, units: u32) -> Result<(), TrainError> {
        if !(self.reference_s.is_finite() && self.reference_s > 0.0) {
            return Err(TrainError::State(format!("tone mappers for exposures around {} s", self.reference_s)));
        }
        for (line, adam) in self.lines.iter().zip(&self.adam) {
            line.validate(units as usize, 1)?;
            adam.validate(line.numbers().len())?;
        }
        Ok(())
    }

    /// Returns the record of the networks, where a normalised unit is `radiance_unit`.
    pub(crate) fn record(&self, radiance_unit: f32) -> ToneMapperRecord {
        ToneMapperRecord {
            radiance_unit,
            reference_s: self.reference_s,
            numbers: self.lines.each_ref().map(|line| line.numbers().to_vec()),
        }
    }
}

fn sigmoid(u: f64) -> f64 {
    1.0 / (1.0 + (-u).exp())
}

impl ToneTables {
    /// Returns the input of a network for a radiance.
    fn input(&self, radiance: f32) -> f64 {
        f64::from(radiance.max(DARKEST)).ln() + self.log_exposure
    }

    /// Returns the captured values of splats; 0 for those that are not visible.
    pub(crate) fn apply(&self, colors: &[[f32; 3]], visible: &[bool]) -> Vec<[f32; 3]> {
        let value = |c: usize, radiance: f32| {
            let s = self.input(radiance);
            let table = &self.tables[c];
            sigmoid(table.value(0, table.piece(s), s).value) as f32
        };
        let splat = |(rgb, visible): (&[f32; 3], &bool)| if *visible { [0, 1, 2].map(|c| value(c, rgb[c])) } else { [0.0; 3] };
        colors.par_iter().zip(visible).with_min_len(CHUNK).map(splat).collect()
    }

    /// Returns the gradient by radiance and the sums by the networks' numbers, from the gradient by
    /// the captured values.
    pub(crate) fn backward(&self, colors: &[[f32; 3]], visible: &[bool], by_value: &[[f32; 3]]) -> ToneGradient {
        let mut by_color = vec![[0.0; 3]; colors.len()];
        let zero = || self.tables.each_ref().map(LineTable::sums);
        let of_chunk = |(chunk, out): (usize, &mut [[f32; 3]])| {
            let at = chunk * CHUNK..chunk * CHUNK + out.len();
            let (colors, visible, by_value) = (&colors[at.clone()], &visible[at.clone()], &by_value[at]);
            let mut sums = zero();
            for (i, out) in out.iter_mut().enumerate().filter(|(i, _)| visible[*i]) {
                for c in 0..3 {
                    let (radiance, gradient) = (colors[i][c], f64::from(by_value[i][c]));
                    if gradient == 0.0 {
                        continue;
                    }
                    let (s, table) = (self.input(radiance), &self.tables[c]);
                    let piece = table.piece(s);
                    let line = table.value(0, piece, s);
                    let y = sigmoid(line.value);
                    let by_line = gradient * y * (1.0 - y);
                    sums[c].add(0, piece, s, by_line);
                    if radiance > DARKEST {
                        out[c] = (by_line * line.slope / f64::from(radiance)) as f32;
                    }
                }
            }
            sums
        };
        let parts: Vec<[LineSums; 3]> = by_color.par_chunks_mut(CHUNK).enumerate().map(of_chunk).collect();
        let mut sums = zero();
        for part in &parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| sum.merge(part));
        }
        ToneGradient { by_color, sums }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    fn colors(count: u64) -> Vec<[f32; 3]> {
        (0..count).map(|i| standard_normal(3, i).map(|v: f32| (2.0 * v).exp())).collect()
    }

    fn loss(mappers: &ToneMappers, colors: &[[f32; 3]], visible: &[bool]) -> f64 {
        let values = mappers.tables(0.5).apply(colors, visible);
        values.as_flattened().iter().zip(0..).map(|(y, i)| f64::from(*y) * f64::from(0.7 * i as f32).sin()).sum()
    }

    fn by_value(count: usize) -> Vec<[f32; 3]> {
        (0..count).map(|i| [0, 1, 2].map(|c| f64::from(0.7 * (3 * i + c) as f32).sin() as f32)).collect()
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let (colors, mappers) = (colors(40), ToneMappers::new(16, [0.5, 2.0].into_iter(), 5));
        let visible: Vec<bool> = (0..40).map(|i| i % 7 != 3).collect();
        let tables = mappers.tables(0.5);
        let exact = tables.backward(&colors, &visible, &by_value(40));
        for (i, c) in [(0, 0), (5, 1), (39, 2), (12, 0)] {
            let moved = |h: f32| {
                let mut colors = colors.clone();
                colors[i][c] *= 1.0 + h;
                loss(&mappers, &colors, &visible)
            };
            let numeric = (moved(1e-3) - moved(-1e-3)) / (2e-3 * f64::from(colors[i][c]));
            let found = f64::from(exact.by_color[i][c]);
            assert!((numeric - found).abs() < 1e-3 + 1e-2 * found.abs(), "{i}, {c}: {numeric:e} {found:e}");
        }
        assert_eq!(exact.by_color[3], [0.0; 3]);
        let by_numbers = mappers.lines[1].gradient(&tables.tables[1], &exact.sums[1]);
        for at in [0, 9, 20, 30, 40, 48] {
            let moved = |h: f32| {
                let mut mappers = mappers.clone();
                mappers.lines[1].numbers_mut()[at] += h;
                loss(&mappers, &colors, &visible)
            };
            let numeric = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            assert!((numeric - by_numbers[at]).abs() < 2e-3 + 1e-2 * by_numbers[at].abs(), "{at}: {numeric:e} {:e}", by_numbers[at]);
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let (colors, mappers) = (colors(9000), ToneMappers::new(64, [1.0].into_iter(), 5));
        let (visible, tables) = (vec![true; 9000], mappers.tables(2.0));
        let numbers = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut mappers = mappers.clone();
                let gradient = tables.backward(&colors, &visible, &by_value(9000));
                mappers.update(&tables, &gradient, 1e-3);
                (mappers, gradient.by_color)
            })
        };
        assert!(numbers(1) == numbers(3));
    }

    #[test]
    fn a_known_response_is_learned() {
        let truth = |x: f64| (x / (x + 1.0)).powf(1.0 / 2.2);
        let mut mappers = ToneMappers::new(128, [0.125, 2.0, 32.0].into_iter(), 1);
        let colors: Vec<[f32; 3]> = (0..600).map(|i| [(-7.0 + 0.0167 * i as f32).exp(); 3]).collect();
        let visible = vec![true; colors.len()];
        for step in 0..9000 {
            let exposure_s = [0.125f32, 2.0, 32.0][step % 3];
            let tables = mappers.tables(exposure_s);
            let values = tables.apply(&colors, &visible);
            let by = |(y, x): (&[f32; 3], &[f32; 3])| {
                [0, 1, 2].map(|c| (f64::from(y[c]) - truth(f64::from(x[c]) * f64::from(exposure_s))).signum() as f32 / 600.0)
            };
            let by_value: Vec<[f32; 3]> = values.iter().zip(&colors).map(by).collect();
            let gradient = tables.backward(&colors, &visible, &by_value);
            mappers.update(&tables, &gradient, 5e-4);
        }
        for (exposure_s, x) in [(0.125f32, 0.5f32), (2.0, 0.05), (2.0, 1.0), (32.0, 0.01), (32.0, 0.1)] {
            let expected = truth(f64::from(x) * f64::from(exposure_s));
            let found = f64::from(mappers.tables(exposure_s).apply(&[[x; 3]], &[true])[0][1]);
            assert!((found - expected).abs() < 0.02, "{exposure_s} s, {x}: {found} {expected}");
        }
    }
}

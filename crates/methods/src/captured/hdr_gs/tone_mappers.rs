//! HDR-GS's tone mappers: from the logarithm of radiance and of exposure time to the values of
//! captured images.
//!
//! In: radiance of splats in normalised units, exposure in seconds. Out: captured values y_c =
//! sigmoid(u_c(ln x_c + ln(t / t_0))), where u_c is a [`ReluLine`] of the channel and t_0 the
//! geometric mean of the training exposures, so that a unit of time does not change how the
//! networks begin. The gradient by radiance and by the networks' numbers is exact.
//!
//! Degenerate: black has no logarithm; radiance below [`DARKEST`] counts as that and has no
//! gradient.

use luxel_train::{ToneMapperRecord, TrainError};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::captured::arithmetic::adam::Adam;
use crate::captured::arithmetic::color_map::{ColorMap, LinePlace};
use crate::captured::arithmetic::elementwise::{LnAbove, Sigmoid, map_all};
use crate::networks::relu_line::{LineSums, LineTable, ReluLine};

/// Radiance that black counts as, far below every cut-off.
const DARKEST: f32 = 1e-30;
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

/// The networks at one step and exposure.
pub(crate) struct ToneTables {
    tables: [LineTable; 3],
    log_exposure: f32,
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
        ToneTables { tables: self.lines.each_ref().map(ReluLine::table), log_exposure: log_exposure as f32 }
    }

    /// Returns the numbers of the networks.
    #[cfg(test)]
    pub(crate) fn numbers(&self) -> [&[f32]; 3] {
        self.lines.each_ref().map(ReluLine::numbers)
    }

    /// Returns the gradient by the networks' numbers.
    pub(crate) fn gradient(&self, tables: &ToneTables, sums: &[LineSums; 3]) -> [Vec<f64>; 3] {
        [0, 1, 2].map(|c| self.lines[c].gradient(&tables.tables[c], &sums[c]))
    }

    /// Updates the networks by a step's gradient.
    pub(crate) fn update(&mut self, tables: &ToneTables, sums: &[LineSums; 3], rate: f64) {
        let gradient = self.gradient(tables, sums);
        for ((line, adam), by_numbers) in self.lines.iter_mut().zip(&mut self.adam).zip(gradient) {
            adam.step(line.numbers_mut(), &by_numbers, rate);
        }
    }

    /// Checks networks read from a file.
    pub(crate) fn validate(&self, units: u32) -> Result<(), TrainError> {
        if !(self.reference_s.is_finite() && self.reference_s > 0.0) {
            return Err(TrainError::State(format!("tone mappers for exposures around {} s", self.reference_s)));
        }
        for (line, adam) in self.lines.iter().zip(&self.adam) {
            line.validate(units as usize, 1).map_err(TrainError::State)?;
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

impl ColorMap for ToneTables {
    #[inline]
    fn tables(&self) -> &[LineTable; 3] {
        &self.tables
    }

    fn inputs(&self, colors: &mut [f32]) {
        map_all(&LnAbove { floor: DARKEST }, colors);
        colors.iter_mut().for_each(|s| *s += self.log_exposure);
    }

    #[inline]
    fn argument(&self, table: &LineTable, piece: usize, input: f64) -> f64 {
        table.value(0, piece, input).value
    }

    fn colors(&self, arguments: &mut [f32], slopes: &mut [f32]) {
        map_all(&Sigmoid, arguments);
        slopes.iter_mut().zip(arguments).for_each(|(slope, y)| *slope = *y * (1.0 - *y));
    }

    #[inline]
    fn backward(&self, table: &LineTable, sums: &mut LineSums, LinePlace { piece, input }: LinePlace, by_argument: f64) -> f64 {
        sums.add(0, piece, input, by_argument);
        by_argument * table.value(0, piece, input).slope
    }

    #[inline]
    fn input_slope(&self, color: f32) -> f64 {
        if color > DARKEST { f64::from(color).recip() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::engine::SeenSplats;
    use luxel_core::random::standard_normal;

    use super::*;
    use crate::captured::arithmetic::color_map::{SplatRows, mapped, mapped_backward};

    fn colors(count: u64) -> Vec<[f32; 3]> {
        (0..count).map(|i| standard_normal(3, i).map(|v: f32| (2.0 * v).exp())).collect()
    }

    fn values(tables: &ToneTables, colors: &[[f32; 3]], visible: &[bool]) -> Vec<[f32; 3]> {
        mapped(tables, &SeenSplats { radiance: colors, visible }).colors
    }

    /// Returns the gradient by the colours, and the sums by the networks' numbers.
    fn backward(tables: &ToneTables, colors: &[[f32; 3]], visible: &[bool], by: &[[f32; 3]]) -> (Vec<[f32; 3]>, [LineSums; 3]) {
        let splats = SeenSplats { radiance: colors, visible };
        let rows = SplatRows { values: by.as_flattened(), stride: 3, first: 0 };
        let mut by_color = vec![[0.0; 3]; colors.len()];
        let sums = mapped_backward(tables, &splats, &mapped(tables, &splats), rows, &mut by_color);
        (by_color, sums)
    }

    fn loss(mappers: &ToneMappers, colors: &[[f32; 3]], visible: &[bool]) -> f64 {
        let values = values(&mappers.tables(0.5), colors, visible);
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
        let (by_color, sums) = backward(&tables, &colors, &visible, &by_value(40));
        for (i, c) in [(0, 0), (5, 1), (39, 2), (12, 0)] {
            let moved = |h: f32| {
                let mut colors = colors.clone();
                colors[i][c] *= 1.0 + h;
                loss(&mappers, &colors, &visible)
            };
            let numeric = (moved(1e-3) - moved(-1e-3)) / (2e-3 * f64::from(colors[i][c]));
            let found = f64::from(by_color[i][c]);
            assert!((numeric - found).abs() < 1e-3 + 1e-2 * found.abs(), "{i}, {c}: {numeric:e} {found:e}");
        }
        assert_eq!(by_color[3], [0.0; 3]);
        let [_, by_numbers, _] = mappers.gradient(&tables, &sums);
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
                let (by_color, sums) = backward(&tables, &colors, &visible, &by_value(9000));
                mappers.update(&tables, &sums, 1e-3);
                (mappers, by_color)
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
            let values = values(&tables, &colors, &visible);
            let by = |(y, x): (&[f32; 3], &[f32; 3])| {
                [0, 1, 2].map(|c| (f64::from(y[c]) - truth(f64::from(x[c]) * f64::from(exposure_s))).signum() as f32 / 600.0)
            };
            let by_value: Vec<[f32; 3]> = values.iter().zip(&colors).map(by).collect();
            let (_, sums) = backward(&tables, &colors, &visible, &by_value);
            mappers.update(&tables, &sums, 5e-4);
        }
        for (exposure_s, x) in [(0.125f32, 0.5f32), (2.0, 0.05), (2.0, 1.0), (32.0, 0.01), (32.0, 0.1)] {
            let expected = truth(f64::from(x) * f64::from(exposure_s));
            let found = f64::from(values(&mappers.tables(exposure_s), &[[x; 3]], &[true])[0][1]);
            assert!((found - expected).abs() < 0.02, "{exposure_s} s, {x}: {found} {expected}");
        }
    }
}

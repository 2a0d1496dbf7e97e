//! Mono-HDR-GS's lift: from the colour of splats in captured images to their radiance.
//!
//! In: LDR colours l >= 0. Out: radiance x_c = softplus(l_c + max(X, 0) max(R, 0) + Y), where X, R
//! and Y are the outputs of one [`ReluLine`] of the channel at l_c. The gradient by the colours and
//! by the networks' numbers is exact.

use luxel_core::softplus;
use luxel_train::TrainError;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::captured::arithmetic::adam::Adam;
use crate::captured::arithmetic::color_map::{ColorMap, LinePlace};
use crate::captured::arithmetic::elementwise::{Sigmoid, Softplus, map_all};
use crate::networks::relu_line::{LineSums, LineTable, LineValue, ReluLine};

/// Outputs of a network.
const OUTPUTS: usize = 3;
/// Constant that separates the random stream of the networks from others of the same seed.
const STREAM: u64 = 0x6c75_7865_6c05;

/// The networks of the channels, with the state of their optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Lift {
    lines: [ReluLine; 3],
    adam: [Adam; 3],
}

/// The networks at one step.
#[derive(Clone, Debug)]
pub(crate) struct LiftTables([LineTable; 3]);

/// The lift of one value: the argument of the softplus, and its parts.
struct Lifted {
    argument: f64,
    x: LineValue,
    r: LineValue,
    y: LineValue,
}

impl Lift {
    /// Makes the networks at the start of a run.
    pub(crate) fn new(units: u32, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ STREAM);
        let lines = [(); 3].map(|()| ReluLine::random(units as usize, OUTPUTS, &mut rng));
        let adam = lines.each_ref().map(|line| Adam::new(line.numbers().len()));
        Self { lines, adam }
    }

    /// Returns the tables of the networks.
    pub(crate) fn tables(&self) -> LiftTables {
        LiftTables(self.lines.each_ref().map(ReluLine::table))
    }

    /// Returns the numbers of the networks.
    #[cfg(test)]
    pub(crate) fn numbers(&self) -> [&[f32]; 3] {
        self.lines.each_ref().map(ReluLine::numbers)
    }

    /// Returns the gradient by the networks' numbers.
    pub(crate) fn gradient(&self, tables: &LiftTables, sums: &[LineSums; 3]) -> [Vec<f64>; 3] {
        [0, 1, 2].map(|c| self.lines[c].gradient(&tables.0[c], &sums[c]))
    }

    /// Updates the networks by a step's gradient.
    pub(crate) fn update(&mut self, tables: &LiftTables, sums: &[LineSums; 3], rate: f64) {
        let gradient = self.gradient(tables, sums);
        for ((line, adam), by_numbers) in self.lines.iter_mut().zip(&mut self.adam).zip(gradient) {
            adam.step(line.numbers_mut(), &by_numbers, rate);
        }
    }

    /// Checks networks read from a file.
    pub(crate) fn validate(&self, units: u32) -> Result<(), TrainError> {
        for (line, adam) in self.lines.iter().zip(&self.adam) {
            line.validate(units as usize, OUTPUTS).map_err(TrainError::State)?;
            adam.validate(line.numbers().len())?;
        }
        Ok(())
    }
}

#[inline]
fn lifted(table: &LineTable, piece: usize, l: f64) -> Lifted {
    let [x, r, y] = [0, 1, 2].map(|output| table.value(output, piece, l));
    Lifted { argument: l + x.value.max(0.0) * r.value.max(0.0) + y.value, x, r, y }
}

impl LiftTables {
    /// Returns the radiance of a colour.
    pub(crate) fn radiance(&self, ldr: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|c| {
            let (table, l) = (&self.0[c], f64::from(ldr[c]));
            let z = lifted(table, table.piece(l), l).argument;
            softplus(z) as f32
        })
    }
}

impl ColorMap for LiftTables {
    #[inline]
    fn tables(&self) -> &[LineTable; 3] {
        &self.0
    }

    fn inputs(&self, _: &mut [f32]) {}

    #[inline]
    fn argument(&self, table: &LineTable, piece: usize, input: f64) -> f64 {
        lifted(table, piece, input).argument
    }

    fn colors(&self, arguments: &mut [f32], slopes: &mut [f32]) {
        slopes.copy_from_slice(arguments);
        map_all(&Sigmoid, slopes);
        map_all(&Softplus, arguments);
    }

    #[inline]
    fn backward(&self, table: &LineTable, sums: &mut LineSums, LinePlace { piece, input }: LinePlace, by_argument: f64) -> f64 {
        let Lifted { x, r, y, .. } = lifted(table, piece, input);
        let active = |line: LineValue, other: LineValue| if line.value > 0.0 { other.value.max(0.0) } else { 0.0 };
        let (by_x, by_r) = (by_argument * active(x, r), by_argument * active(r, x));
        for (output, by) in [by_x, by_r, by_argument].into_iter().enumerate() {
            sums.add(output, piece, input, by);
        }
        by_argument + by_x * x.slope + by_r * r.slope + by_argument * y.slope
    }

    #[inline]
    fn input_slope(&self, _: f32) -> f64 {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::engine::SeenSplats;
    use luxel_core::random::standard_normal;

    use super::*;
    use crate::captured::arithmetic::color_map::{SplatRows, mapped, mapped_backward};

    #[test]
    fn gradients_are_those_of_differences() {
        let colors: Vec<[f32; 3]> = (0..40).map(|i| standard_normal(3, i).map(|v: f32| v.abs())).collect();
        let weight = |i: usize| f64::from(0.7 * i as f32).sin();
        let loss = |lift: &Lift, colors: &[[f32; 3]]| -> f64 {
            let radiance = mapped(&lift.tables(), &SeenSplats { radiance: colors, visible: &[true; 40] }).colors;
            radiance.as_flattened().iter().enumerate().map(|(i, x)| f64::from(*x) * weight(i)).sum()
        };
        let lift = Lift::new(16, 5);
        let by: Vec<[f32; 3]> = (0..40).map(|i| [0, 1, 2].map(|c| weight(3 * i + c) as f32)).collect();
        let (tables, splats) = (lift.tables(), SeenSplats { radiance: &colors, visible: &[true; 40] });
        let rows = SplatRows { values: by.as_flattened(), stride: 3, first: 0 };
        let mut by_color = vec![[0.0; 3]; 40];
        let sums = mapped_backward(&tables, &splats, &mapped(&tables, &splats), rows, &mut by_color);
        for (i, c) in [(0, 0), (7, 1), (39, 2)] {
            let moved = |h: f32| {
                let mut colors = colors.clone();
                colors[i][c] += h;
                loss(&lift, &colors)
            };
            let (numeric, found) = ((moved(1e-3) - moved(-1e-3)) / 2e-3, f64::from(by_color[i][c]));
            assert!((numeric - found).abs() < 3e-3 + 1e-2 * found.abs(), "{i}, {c}: {numeric} {found}");
        }
        let [.., by_numbers] = lift.gradient(&tables, &sums);
        for at in (0..by_numbers.len()).step_by(7) {
            let moved = |h: f32| {
                let mut lift = lift.clone();
                lift.lines[2].numbers_mut()[at] += h;
                loss(&lift, &colors)
            };
            let numeric = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            assert!((numeric - by_numbers[at]).abs() < 5e-3 + 2e-2 * by_numbers[at].abs(), "{at}: {numeric} {}", by_numbers[at]);
        }
    }
}

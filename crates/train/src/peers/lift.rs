//! Mono-HDR-GS's lift: from the colour of splats in captured images to their radiance.
//!
//! In: LDR colours l >= 0. Out: radiance x_c = softplus(l_c + max(X, 0) max(R, 0) + Y), where X, R
//! and Y are the outputs of one [`ReluLine`] of the channel at l_c. The gradient by the colours and
//! by the networks' numbers is exact.
//!
//! Splats are taken in chunks of constant size, and their sums are added in order: the same bits
//! for any number of threads.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::relu_line::{LineSums, LineTable, LineValue, ReluLine};
use crate::TrainError;

/// Splats of a chunk.
const CHUNK: usize = 2048;
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

/// The gradients of a step.
pub(crate) struct LiftGradient {
    /// By the colours.
    pub(crate) by_color: Vec<[f32; 3]>,
    sums: [LineSums; 3],
}

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

    /// Updates the networks by a step's gradient.
    pub(crate) fn update(&mut self, tables: &LiftTables, gradient: &LiftGradient, rate: f64) {
        for (c, (line, adam)) in self.lines.iter_mut().zip(&mut self.adam).enumerate() {
            let by_numbers = line.gradient(&tables.0[c], &gradient.sums[c]);
            adam.step(line.numbers_mut(), &by_numbers, rate);
        }
    }

    /// Checks networks read from a file.
    pub(crate) fn validate(&self, units: u32) -> Result<(), TrainError> {
        for (line, adam) in self.lines.iter().zip(&self.adam) {
            line.validate(units as usize, OUTPUTS)?;
            adam.validate(line.numbers().len())?;
        }
        Ok(())
    }
}

fn softplus(z: f64) -> f64 {
    z.max(0.0) + (-z.abs()).exp().ln_1p()
}

fn sigmoid(z: f64) -> f64 {
    1.0 / (1.0 + (-z).exp())
}

fn lifted(table: &LineTable, l: f64) -> Lifted {
    let piece = table.piece(l);
    let [x, r, y] = [0, 1, 2].map(|output| table.value(output, piece, l));
    Lifted { argument: l + x.value.max(0.0) * r.value.max(0.0) + y.value, x, r, y }
}

/// Part of the splats in the backward pass: gradient by colours, colours, visibility, gradient by
/// radiance.
type BackwardChunk<'a> = (((&'a mut [[f32; 3]], &'a [[f32; 3]]), &'a [bool]), &'a [[f32; 3]]);

impl LiftTables {
    /// Returns the radiance of a colour.
    pub(crate) fn radiance(&self, ldr: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|c| softplus(lifted(&self.0[c], ldr[c].into()).argument) as f32)
    }

    /// Returns the radiance of splats; 0 for those that are not visible.
    pub(crate) fn apply(&self, colors: &[[f32; 3]], visible: &[bool]) -> Vec<[f32; 3]> {
        let splat = |(rgb, visible): (&[f32; 3], &bool)| if *visible { self.radiance(*rgb) } else { [0.0; 3] };
        colors.par_iter().zip(visible).with_min_len(CHUNK).map(splat).collect()
    }

    /// Returns the gradient by the colours and the sums by the networks' numbers, from the gradient
    /// by radiance.
    pub(crate) fn backward(&self, colors: &[[f32; 3]], visible: &[bool], by_radiance: &[[f32; 3]]) -> LiftGradient {
        let mut by_color = vec![[0.0; 3]; colors.len()];
        let zero = || self.0.each_ref().map(LineTable::sums);
        let chunks = by_color.par_chunks_mut(CHUNK).zip(colors.par_chunks(CHUNK)).zip(visible.par_chunks(CHUNK));
        let of_chunk = |(((out, colors), visible), by_radiance): BackwardChunk<'_>| {
            let mut sums = zero();
            for (i, out) in out.iter_mut().enumerate().filter(|(i, _)| visible[*i]) {
                for c in 0..3 {
                    let (l, table) = (f64::from(colors[i][c]), &self.0[c]);
                    let Lifted { argument, x, r, y } = lifted(table, l);
                    let d = f64::from(by_radiance[i][c]) * sigmoid(argument);
                    let active = |line: LineValue, other: LineValue| if line.value > 0.0 { other.value.max(0.0) } else { 0.0 };
                    let (by_x, by_r) = (d * active(x, r), d * active(r, x));
                    let piece = table.piece(l);
                    for (output, by) in [by_x, by_r, d].into_iter().enumerate() {
                        sums[c].add(output, piece, l, by);
                    }
                    out[c] = (d + by_x * x.slope + by_r * r.slope + d * y.slope) as f32;
                }
            }
            sums
        };
        let parts: Vec<[LineSums; 3]> = chunks.zip(by_radiance.par_chunks(CHUNK)).map(of_chunk).collect();
        let mut sums = zero();
        for part in &parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| sum.merge(part));
        }
        LiftGradient { by_color, sums }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::random::standard_normal;

    use super::*;

    #[test]
    fn gradients_are_those_of_differences() {
        let colors: Vec<[f32; 3]> = (0..40).map(|i| standard_normal(3, i).map(|v: f32| v.abs())).collect();
        let weight = |i: usize| f64::from(0.7 * i as f32).sin();
        let loss = |lift: &Lift, colors: &[[f32; 3]]| -> f64 {
            let radiance = lift.tables().apply(colors, &[true; 40]);
            radiance.as_flattened().iter().enumerate().map(|(i, x)| f64::from(*x) * weight(i)).sum()
        };
        let lift = Lift::new(16, 5);
        let by: Vec<[f32; 3]> = (0..40).map(|i| [0, 1, 2].map(|c| weight(3 * i + c) as f32)).collect();
        let exact = lift.tables().backward(&colors, &[true; 40], &by);
        for (i, c) in [(0, 0), (7, 1), (39, 2)] {
            let moved = |h: f32| {
                let mut colors = colors.clone();
                colors[i][c] += h;
                loss(&lift, &colors)
            };
            let (numeric, found) = ((moved(1e-3) - moved(-1e-3)) / 2e-3, f64::from(exact.by_color[i][c]));
            assert!((numeric - found).abs() < 3e-3 + 1e-2 * found.abs(), "{i}, {c}: {numeric} {found}");
        }
        let by_numbers = lift.lines[2].gradient(&lift.tables().0[2], &exact.sums[2]);
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

//! Networks of one input, one hidden layer of ReLU units and one or more outputs, as tables of
//! straight pieces.
//!
//! In: inputs s. Out: u(s) = c + sum over units j of v_j max(w_j s + b_j, 0) for each output, and
//! the gradient by all numbers. Such a network is a straight line between the break points
//! -b_j / w_j. A table of the pieces' slopes and offsets therefore is the network itself, roundings
//! apart: a value is a search and one multiplication. For the gradient two sums are kept per piece,
//! of dL/du and of s dL/du; each unit is active on the pieces on one side of its break point, so
//! sums over them from one end give its gradient.
//!
//! Sums are in f64, in the order in which they are added. Degenerate: a unit with w_j = 0 is a
//! constant; at its break point a unit is inactive.

use std::hint::select_unpredictable;

use rand::Rng;
use serde::{Deserialize, Serialize};

/// A network: its numbers are the units' weights, the units' biases, and for each output the
/// units' outgoing weights and a bias.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReluLine {
    units: usize,
    outputs: usize,
    numbers: Vec<f32>,
}

/// A straight piece: slope s + offset.
#[derive(Clone, Copy, Debug, Default)]
struct Piece {
    slope: f64,
    offset: f64,
}

/// A break point, and its unit.
#[derive(Clone, Copy, Debug)]
struct Break {
    at: f64,
    unit: usize,
}

/// The network as pieces.
#[derive(Clone, Debug)]
pub(crate) struct LineTable {
    /// In ascending order.
    breaks: Vec<Break>,
    /// Their places, filled up with infinity to a power of two.
    places: Vec<f64>,
    /// `[outputs, breaks + 1]`.
    pieces: Vec<Vec<Piece>>,
}

/// A value of an output, and its derivative by the input.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineValue {
    /// The value.
    pub(crate) value: f64,
    /// Its derivative.
    pub(crate) slope: f64,
}

/// Sums of the gradient by an output's values on one piece.
#[derive(Clone, Copy, Debug, Default)]
struct PieceSums {
    /// Sum of dL/du.
    gradient: f64,
    /// Sum of s dL/du.
    moment: f64,
}

/// Sums for all pieces of all outputs.
#[derive(Clone, Debug)]
pub(crate) struct LineSums(Vec<Vec<PieceSums>>);

impl ReluLine {
    /// Makes a network whose numbers are uniform within 1 / sqrt(inputs of their layer), as
    /// PyTorch's linear layers begin.
    pub(crate) fn random(units: usize, outputs: usize, rng: &mut impl Rng) -> Self {
        let layer = (units as f32).sqrt().recip();
        let bounds = std::iter::repeat_n(1.0, 2 * units).chain(std::iter::repeat_n(layer, outputs * (units + 1)));
        let numbers = bounds.map(|bound: f32| rng.random_range(-bound..bound)).collect();
        Self { units, outputs, numbers }
    }

    /// Returns a network of these numbers, in the order of the type.
    pub(crate) fn from_numbers(units: usize, outputs: usize, numbers: Vec<f32>) -> Self {
        debug_assert_eq!(numbers.len(), 2 * units + outputs * (units + 1));
        Self { units, outputs, numbers }
    }

    /// Returns the numbers.
    pub(crate) fn numbers(&self) -> &[f32] {
        &self.numbers
    }

    /// Returns the numbers, to be changed.
    pub(crate) fn numbers_mut(&mut self) -> &mut [f32] {
        &mut self.numbers
    }

    /// Checks a network read from a file.
    ///
    /// # Errors
    /// Other sizes than these, a number that is not finite: what is expected.
    pub(crate) fn validate(&self, units: usize, outputs: usize) -> Result<(), String> {
        let expected = 2 * units + outputs * (units + 1);
        let is_whole = self.units == units && self.outputs == outputs && self.numbers.len() == expected;
        if is_whole && self.numbers.iter().all(|v| v.is_finite()) {
            return Ok(());
        }
        Err(format!("a network of {units} units and {outputs} outputs has other numbers than its {expected}"))
    }

    fn weight(&self, unit: usize) -> f64 {
        self.numbers[unit].into()
    }

    fn bias(&self, unit: usize) -> f64 {
        self.numbers[self.units + unit].into()
    }

    /// Returns the place of an output's first number.
    fn first_of(&self, output: usize) -> usize {
        2 * self.units + output * (self.units + 1)
    }

    fn outgoing(&self, output: usize, unit: usize) -> f64 {
        self.numbers[self.first_of(output) + unit].into()
    }

    /// Returns the table.
    pub(crate) fn table(&self) -> LineTable {
        let bending = (0..self.units).filter(|unit| self.weight(*unit) != 0.0);
        let mut breaks: Vec<Break> = bending.map(|unit| Break { at: -self.bias(unit) / self.weight(unit), unit }).collect();
        breaks.sort_by(|a, b| a.at.total_cmp(&b.at).then(a.unit.cmp(&b.unit)));
        let pieces = (0..self.outputs).map(|output| self.pieces(output, &breaks)).collect();
        let mut places: Vec<f64> = breaks.iter().map(|b| b.at).collect();
        places.resize((breaks.len() + 1).next_power_of_two(), f64::INFINITY);
        LineTable { breaks, places, pieces }
    }

    fn pieces(&self, output: usize, breaks: &[Break]) -> Vec<Piece> {
        let mut piece = Piece { slope: 0.0, offset: self.numbers[self.first_of(output) + self.units].into() };
        for unit in 0..self.units {
            let v = self.outgoing(output, unit);
            match self.weight(unit) {
                // Active to the left of its break point.
                w if w < 0.0 => {
                    piece.slope += v * w;
                    piece.offset += v * self.bias(unit);
                }
                0.0 => piece.offset += v * self.bias(unit).max(0.0),
                _ => {}
            }
        }
        let mut pieces = vec![piece];
        for Break { unit, .. } in breaks.iter().copied() {
            let (v, sign) = (self.outgoing(output, unit), self.weight(unit).signum());
            piece.slope += sign * v * self.weight(unit);
            piece.offset += sign * v * self.bias(unit);
            pieces.push(piece);
        }
        pieces
    }

    /// Returns the gradient by the numbers.
    pub(crate) fn gradient(&self, table: &LineTable, sums: &LineSums) -> Vec<f64> {
        let mut gradient = vec![0.0; self.numbers.len()];
        for (output, sums) in sums.0.iter().enumerate() {
            // Sums over the pieces before each one, and over all at the end.
            let mut before = vec![PieceSums::default()];
            for sum in sums {
                let last = before.last().copied().unwrap_or_default();
                before.push(PieceSums { gradient: last.gradient + sum.gradient, moment: last.moment + sum.moment });
            }
            let all = before.last().copied().unwrap_or_default();
            let mut add = |unit: usize, active: PieceSums| {
                let PieceSums { gradient: d, moment: e } = active;
                let (w, b, v) = (self.weight(unit), self.bias(unit), self.outgoing(output, unit));
                gradient[self.first_of(output) + unit] = w * e + b * d;
                gradient[unit] += v * e;
                gradient[self.units + unit] += v * d;
            };
            for (place, Break { unit, .. }) in table.breaks.iter().copied().enumerate() {
                let left = before[place + 1];
                let right = PieceSums { gradient: all.gradient - left.gradient, moment: all.moment - left.moment };
                add(unit, if self.weight(unit) > 0.0 { right } else { left });
            }
            for unit in (0..self.units).filter(|j| self.weight(*j) == 0.0 && self.bias(*j) > 0.0) {
                add(unit, all);
            }
            gradient[self.first_of(output) + self.units] = all.gradient;
        }
        gradient
    }
}

impl LineTable {
    /// Returns the piece of an input.
    #[inline]
    pub(crate) fn piece(&self, s: f64) -> usize {
        self.pieces(&[s])[0]
    }

    /// Returns the pieces of inputs, whose searches do not wait for one another.
    #[inline]
    pub(crate) fn pieces<const N: usize>(&self, inputs: &[f64; N]) -> [usize; N] {
        let (mut first, mut len) = ([0; N], self.places.len());
        while len > 1 {
            len /= 2;
            for (first, s) in first.iter_mut().zip(inputs) {
                // Without a branch, which would be guessed wrong every other time.
                *first += select_unpredictable(self.places[*first + len - 1] < *s, len, 0);
            }
        }
        first
    }

    /// Returns an output at an input on `piece`.
    #[inline]
    pub(crate) fn value(&self, output: usize, piece: usize, s: f64) -> LineValue {
        let Piece { slope, offset } = self.pieces[output][piece];
        LineValue { value: slope * s + offset, slope }
    }

    /// Returns sums of zero.
    pub(crate) fn sums(&self) -> LineSums {
        LineSums(self.pieces.iter().map(|pieces| vec![PieceSums::default(); pieces.len()]).collect())
    }
}

impl LineSums {
    /// Adds the gradient by an output's value at an input on `piece`.
    #[inline]
    pub(crate) fn add(&mut self, output: usize, piece: usize, s: f64, gradient: f64) {
        let sum = &mut self.0[output][piece];
        sum.gradient += gradient;
        sum.moment += gradient * s;
    }

    /// Adds the sums of others.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (sum, part) in self.0.iter_mut().flatten().zip(other.0.iter().flatten()) {
            sum.gradient += part.gradient;
            sum.moment += part.moment;
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// The network as its definition has it.
    fn plain(line: &ReluLine, numbers: &[f64], output: usize, s: f64) -> f64 {
        let (h, first) = (line.units, line.first_of(output));
        (0..h).map(|j| numbers[first + j] * (numbers[j] * s + numbers[h + j]).max(0.0)).sum::<f64>() + numbers[first + h]
    }

    fn network(seed: u64) -> ReluLine {
        let mut line = ReluLine::random(37, 3, &mut Pcg64Mcg::seed_from_u64(seed));
        // Constants, on and off, and two units with one break point.
        (line.numbers[4], line.numbers[5]) = (0.0, 0.0);
        (line.numbers[37 + 4], line.numbers[37 + 5]) = (0.3, -0.3);
        (line.numbers[8], line.numbers[37 + 8]) = (0.5, 0.25);
        (line.numbers[9], line.numbers[37 + 9]) = (-0.5, -0.25);
        line
    }

    fn inputs() -> impl Iterator<Item = f64> {
        (0..400).map(|i| -9.0 + 0.0451 * f64::from(i))
    }

    #[test]
    fn the_table_is_the_network() {
        for seed in 0..5 {
            let line = network(seed);
            let (table, numbers) = (line.table(), line.numbers.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
            for (s, output) in inputs().flat_map(|s| (0..3).map(move |output| (s, output))) {
                let found = table.value(output, table.piece(s), s);
                let expected = plain(&line, &numbers, output, s);
                assert!((found.value - expected).abs() < 1e-12 * (1.0 + s.abs()), "{s}: {} {expected}", found.value);
                let slope = (plain(&line, &numbers, output, s + 1e-7) - plain(&line, &numbers, output, s - 1e-7)) / 2e-7;
                assert!((found.slope - slope).abs() < 1e-6, "{s}: {} {slope}", found.slope);
            }
        }
    }

    #[test]
    fn gradients_are_those_of_differences() {
        let line = network(7);
        let (table, mut sums) = (line.table(), line.table().sums());
        let weight = |s: f64, output: usize| (1.3 * s + output as f64).sin();
        for (s, output) in inputs().flat_map(|s| (0..3).map(move |output| (s, output))) {
            sums.add(output, table.piece(s), s, weight(s, output));
        }
        let exact = line.gradient(&table, &sums);
        let numbers: Vec<f64> = line.numbers.iter().map(|v| f64::from(*v)).collect();
        let loss = |numbers: &[f64]| {
            inputs()
                .flat_map(|s| (0..3).map(move |output| (s, output)))
                .map(|(s, o)| weight(s, o) * plain(&line, numbers, o, s))
                .sum::<f64>()
        };
        for i in 0..numbers.len() {
            if i == 5 || i == 4 {
                // A constant's weight has one slope to the left and another to the right of 0.
                continue;
            }
            let moved = |h: f64| {
                let mut numbers = numbers.clone();
                numbers[i] += h;
                loss(&numbers)
            };
            let numeric = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((numeric - exact[i]).abs() < 1e-5 * (1.0 + exact[i].abs()), "{i}: {numeric} {}", exact[i]);
        }
    }

    #[test]
    fn numbers_survive_json_bit_for_bit() {
        let line = network(3);
        let json = serde_json::to_string(&line).unwrap();
        assert_eq!(serde_json::from_str::<ReluLine>(&json).unwrap(), line);
        line.validate(37, 3).unwrap();
        assert!(line.validate(37, 1).is_err());
    }
}

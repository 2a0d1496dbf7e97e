//! The lift from captured values to radiance, of Mono-HDR-NeRF.
//!
//! In: raw colours of samples, whose logistic is the captured value l. Out: radiance
//! softplus(l + max(X, 0) max(R, 0) + Y), where (X, R, Y) are the outputs of a network of one
//! hidden layer of the channel at l (Mono-HDR-GS, Mono-HDR-NeRF), and the exact gradient by raw
//! colours and weights. The networks are tables of straight pieces
//! ([`crate::networks::relu_line`]): a value is a search, not a sum over the units.

use luxel_core::{sigmoid, softplus};

use crate::field::raw::{ColoredSamples, RAW};
use crate::networks::relu_line::{LineTable, LineValue, ReluLine};

/// Hidden units of a network of one channel, of the lift and of the tone mapper.
pub(crate) const UNITS: usize = 128;
/// Outputs of a lift.
pub(crate) const LIFT: usize = 3;
/// Channels of a sample: radiance, then captured values.
const CHANNELS: usize = 2 * RAW;
/// Numbers of a lift: those of [`crate::networks::Network`] with a hidden layer.
const NUMBERS: usize = 2 * UNITS + LIFT * (UNITS + 1);

/// The lifts of the channels at one step.
pub(crate) struct Lifts {
    lines: [ReluLine; RAW],
    tables: [LineTable; RAW],
}

impl Lifts {
    /// Returns the lifts of these weights, `[3, NUMBERS]`.
    pub(crate) fn new(weights: &[f32]) -> Self {
        let lines = [0, 1, 2].map(|c| line(&weights[c * NUMBERS..(c + 1) * NUMBERS]));
        let tables = lines.each_ref().map(ReluLine::table);
        Self { lines, tables }
    }

    /// Writes the channels of samples, `[samples, 6]`, and the pieces of the tables, `[samples,
    /// 3]`, given raw colours, `[samples, 3]`.
    pub(crate) fn forward(&self, raw: &[f32], pieces: &mut [usize], channels: &mut [f32]) {
        let samples = raw.as_chunks::<RAW>().0.iter().zip(pieces.as_chunks_mut::<RAW>().0);
        for ((raw, pieces), channels) in samples.zip(channels.as_chunks_mut::<CHANNELS>().0) {
            for c in 0..RAW {
                let value = sigmoid(raw[c]);
                let (table, at) = (&self.tables[c], f64::from(value));
                pieces[c] = table.piece(at);
                let [x, r, y] = outputs(table, pieces[c], at).map(|output| output.value as f32);
                channels[c] = softplus(value + x.max(0.0) * r.max(0.0) + y);
                channels[RAW + c] = value;
            }
        }
    }

    /// Writes the gradient by raw colours, `[samples, 3]`, and adds that by the weights.
    pub(crate) fn backward(&self, samples: ColoredSamples<'_>, by_raw: &mut [f32], gradient: &mut [f32]) {
        let ColoredSamples { pieces, channels, by_channels, .. } = samples;
        let mut sums = self.tables.each_ref().map(LineTable::sums);
        let found = channels.as_chunks::<CHANNELS>().0.iter().zip(by_channels.as_chunks::<CHANNELS>().0);
        let rows = by_raw.as_chunks_mut::<RAW>().0.iter_mut().zip(pieces.as_chunks::<RAW>().0);
        for ((channels, by_channels), (by_raw, pieces)) in found.zip(rows) {
            for c in 0..RAW {
                let (radiance, value) = (channels[c], channels[RAW + c]);
                let (piece, at) = (pieces[c], f64::from(value));
                let [x, r, y] = outputs(&self.tables[c], piece, at);
                // The derivative of a softplus is 1 - exp of its negative value.
                let by_exponent = f64::from(by_channels[c] * -(-radiance).exp_m1());
                let by_x = if x.value > 0.0 { by_exponent * r.value.max(0.0) } else { 0.0 };
                let by_r = if r.value > 0.0 { by_exponent * x.value.max(0.0) } else { 0.0 };
                for (output, by) in [by_x, by_r, by_exponent].into_iter().enumerate() {
                    sums[c].add(output, piece, at, by);
                }
                let by_input = by_x * x.slope + by_r * r.slope + by_exponent * y.slope;
                let by_value = (by_exponent + by_input) as f32 + by_channels[RAW + c];
                by_raw[c] = by_value * value * (1.0 - value);
            }
        }
        for ((line, table), (sums, gradient)) in
            self.lines.iter().zip(&self.tables).zip(sums.iter().zip(gradient.chunks_exact_mut(NUMBERS)))
        {
            let by_numbers = line.gradient(table, sums);
            gradient.iter_mut().enumerate().for_each(|(i, gradient)| *gradient += by_numbers[place_in_line(i)] as f32);
        }
    }
}

/// Returns the outputs of a lift at a value on a piece.
#[inline]
fn outputs(table: &LineTable, piece: usize, at: f64) -> [LineValue; LIFT] {
    [0, 1, 2].map(|output| table.value(output, piece, at))
}

/// Returns the network of these weights.
fn line(weights: &[f32]) -> ReluLine {
    let mut numbers = vec![0.0; NUMBERS];
    weights.iter().enumerate().for_each(|(i, weight)| numbers[place_in_line(i)] = *weight);
    ReluLine::from_numbers(UNITS, LIFT, numbers)
}

/// Returns the place in a [`ReluLine`] of a number of a network. Both begin with the units' weights
/// and biases; those of the last layer are `[units, outputs]` and biases here, and there the units'
/// and the bias of one output after another.
fn place_in_line(i: usize) -> usize {
    let Some(i) = i.checked_sub(2 * UNITS) else { return i };
    let (unit, output) = (i / LIFT, i % LIFT);
    2 * UNITS + output * (UNITS + 1) + unit
}

//! Layers of a convolutional network: convolution with ReLU, max pooling, and feature distance.
//!
//! Features have the layout `[H][C][W]`. A row of the output depends on a few rows of the input,
//! which stay in the cache while all of its channels are computed. Rows are computed in parallel.
//! The result does not depend on the number of threads.

use rayon::prelude::*;

/// Pixels of a row that are computed together, in registers.
const TILE: usize = 16;
/// Output channels that share the loaded input values.
const PAIR: usize = 2;

/// Features `[H][C][W]`.
#[derive(Clone, Debug)]
pub(super) struct Features {
    channels: usize,
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Features {
    /// Returns whether all values are finite.
    pub(super) fn is_finite(&self) -> bool {
        self.values.iter().all(|value| value.is_finite())
    }

    /// Returns the features that `value` gives for channel, column and row.
    pub(super) fn from_fn([channels, width, height]: [usize; 3], value: impl Fn(usize, usize, usize) -> f32) -> Self {
        let rows = (0..height).flat_map(|y| (0..channels).map(move |c| (c, y)));
        let values = rows.flat_map(|(c, y)| (0..width).map(move |x| (c, x, y))).map(|(c, x, y)| value(c, x, y)).collect();
        Self { channels, width, height, values }
    }

    /// Returns all channels of a row.
    fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.channels * self.width..][..self.channels * self.width]
    }

    /// Returns the mean over pixels of the sum over channels of the weighted squared difference of
    /// features that are scaled to unit length.
    pub(super) fn distance(&self, other: &Self, weights: &[f32], length_floor: f64) -> f64 {
        let of_row = |y: usize| {
            let (a, b) = (self.row(y), other.row(y));
            let (length_a, length_b) = (self.lengths(a), other.lengths(b));
            let mut sum = 0.0;
            for ((a, b), &weight) in a.chunks_exact(self.width).zip(b.chunks_exact(self.width)).zip(weights) {
                for ((&a, &b), (la, lb)) in a.iter().zip(b).zip(length_a.iter().zip(&length_b)) {
                    let difference = f64::from(a) / (la + length_floor) - f64::from(b) / (lb + length_floor);
                    sum += f64::from(weight) * difference * difference;
                }
            }
            sum
        };
        // Rows are collected first, so that the order of the sum is fixed.
        let rows: Vec<f64> = (0..self.height).into_par_iter().map(of_row).collect();
        rows.iter().sum::<f64>() / (self.width * self.height) as f64
    }

    /// Returns the Euclidean length of each pixel's features.
    fn lengths(&self, row: &[f32]) -> Vec<f64> {
        let mut squares = vec![0f64; self.width];
        for channel in row.chunks_exact(self.width) {
            for (sum, &value) in squares.iter_mut().zip(channel) {
                *sum += f64::from(value) * f64::from(value);
            }
        }
        squares.into_iter().map(f64::sqrt).collect()
    }
}

/// A step of the network.
#[derive(Clone, Debug)]
pub(super) enum Layer {
    /// A convolution followed by a ReLU.
    Convolve(Convolution),
    /// Max pooling over the square windows that lie inside the image.
    Pool { window: usize, stride: usize },
}

impl Layer {
    /// Applies the layer. The input must be at least as large as the window or kernel.
    pub(super) fn apply(&self, input: &Features) -> Features {
        match self {
            Self::Convolve(convolution) => convolution.apply(input),
            Self::Pool { window, stride } => pool(input, *window, *stride),
        }
    }
}

fn pool(input: &Features, window: usize, stride: usize) -> Features {
    let (width, height) = ((input.width - window) / stride + 1, (input.height - window) / stride + 1);
    let mut values = vec![f32::NEG_INFINITY; height * input.channels * width];
    values.par_chunks_exact_mut(input.channels * width).enumerate().for_each(|(y, out)| {
        for row in y * stride..y * stride + window {
            for (from, out) in input.row(row).chunks_exact(input.width).zip(out.chunks_exact_mut(width)) {
                for (x, out) in out.iter_mut().enumerate() {
                    *out = from[x * stride..x * stride + window].iter().copied().fold(*out, f32::max);
                }
            }
        }
    });
    Features { channels: input.channels, width, height, values }
}

/// A convolution in the sense of neural networks: cross-correlation, with zeros beyond the border.
#[derive(Clone, Debug)]
pub(super) struct Convolution {
    /// Numbers of input and output channels.
    pub(super) channels: [usize; 2],
    /// Side of the kernel, pixels.
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
    /// Weights `[output, input, kernel, kernel]`.
    pub(super) weights: Vec<f32>,
    /// Bias `[output]`.
    pub(super) bias: Vec<f32>,
}

/// Input rows with zero padding, each split by column modulo the stride, so that neighbouring
/// outputs read neighbouring values.
struct Padded {
    /// Columns of one remainder of the stride.
    phase_width: usize,
    channels: usize,
    stride: usize,
    /// Values `[H][C][stride][phase_width]`.
    values: Vec<f32>,
}

impl Padded {
    fn new(input: &Features, convolution: &Convolution, out_width: usize) -> Self {
        let Convolution { kernel, stride, padding, .. } = *convolution;
        let phase_width = out_width.next_multiple_of(TILE) + kernel.div_ceil(stride);
        let (channels, height) = (input.channels, input.height + 2 * padding);
        let mut values = vec![0f32; height * channels * stride * phase_width];
        let rows = values.par_chunks_exact_mut(channels * stride * phase_width).enumerate();
        rows.skip(padding).take(input.height).for_each(|(y, out)| {
            for (from, out) in input.row(y - padding).chunks_exact(input.width).zip(out.chunks_exact_mut(stride * phase_width)) {
                for (x, &value) in from.iter().enumerate() {
                    let (at, phase) = ((x + padding) / stride, (x + padding) % stride);
                    // Columns that no output depends on are left out.
                    if at < phase_width {
                        out[phase * phase_width + at] = value;
                    }
                }
            }
        });
        Self { phase_width, channels, stride, values }
    }

    /// Returns all remainders of a row of a channel.
    fn row(&self, y: usize, channel: usize) -> &[f32] {
        let length = self.stride * self.phase_width;
        &self.values[(y * self.channels + channel) * length..][..length]
    }
}

impl Convolution {
    fn apply(&self, input: &Features) -> Features {
        let outputs = self.channels[1];
        let side = |side: usize| (side + 2 * self.padding - self.kernel) / self.stride + 1;
        let (width, height) = (side(input.width), side(input.height));
        let padded = Padded::new(input, self, width);
        let mut values = vec![0f32; height * outputs * width];
        values.par_chunks_exact_mut(outputs * width).enumerate().for_each(|(y, row)| {
            for (i, out) in row.chunks_mut(PAIR * width).enumerate() {
                for x in (0..width).step_by(TILE) {
                    let tile = self.tile(&padded, [PAIR * i, (PAIR * i + 1).min(outputs - 1)], x, y);
                    for (out, tile) in out.chunks_exact_mut(width).zip(&tile) {
                        for (out, value) in out[x..].iter_mut().zip(tile) {
                            // A sum beyond f32 may be NaN, which is not to be taken for 0.
                            *out = if value.is_nan() { *value } else { value.max(0.0) };
                        }
                    }
                }
            }
        });
        Features { channels: outputs, width, height, values }
    }

    /// Computes outputs `x` to `x + TILE` of row `y` in two channels.
    #[inline]
    fn tile(&self, padded: &Padded, outputs: [usize; PAIR], x: usize, y: usize) -> [[f32; TILE]; PAIR] {
        let mut sums = outputs.map(|output| [self.bias[output]; TILE]);
        let taps = self.kernel * self.kernel;
        let weights = outputs.map(|output| &self.weights[output * self.channels[0] * taps..][..self.channels[0] * taps]);
        for channel in 0..self.channels[0] {
            for ky in 0..self.kernel {
                let row = padded.row(y * self.stride + ky, channel);
                for kx in 0..self.kernel {
                    let from = (kx % self.stride) * padded.phase_width + kx / self.stride + x;
                    let Some(inputs) = row[from..].first_chunk::<TILE>() else { continue };
                    let tap = channel * taps + ky * self.kernel + kx;
                    for (sums, weights) in sums.iter_mut().zip(weights) {
                        let weight = weights[tap];
                        for (sum, input) in sums.iter_mut().zip(inputs) {
                            *sum += weight * input;
                        }
                    }
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(i: usize) -> f32 {
        ((i as f32 * 0.754_877).sin() * 43_758.547).fract()
    }

    /// Computes an output by the definition.
    fn brute_force(c: &Convolution, input: &Features, output: usize, x: usize, y: usize) -> f32 {
        let mut sum = f64::from(c.bias[output]);
        for (channel, ky, kx) in
            (0..c.channels[0]).flat_map(|channel| (0..c.kernel).flat_map(move |ky| (0..c.kernel).map(move |kx| (channel, ky, kx))))
        {
            let (column, row) = ((x * c.stride + kx).wrapping_sub(c.padding), (y * c.stride + ky).wrapping_sub(c.padding));
            if column < input.width && row < input.height {
                let weight = c.weights[((output * c.channels[0] + channel) * c.kernel + ky) * c.kernel + kx];
                sum += f64::from(weight) * f64::from(input.row(row)[channel * input.width + column]);
            }
        }
        sum.max(0.0) as f32
    }

    #[test]
    fn convolutions_are_their_definition() {
        for (kernel, stride, padding, width, height) in [(3, 1, 1, 33, 5), (11, 4, 2, 45, 39), (5, 1, 2, 7, 9), (3, 1, 1, 1, 1)] {
            let channels = [3, 5];
            let weights = (0..5 * 3 * kernel * kernel).map(value).collect();
            let convolution = Convolution { channels, kernel, stride, padding, weights, bias: (0..5).map(|i| value(i + 99)).collect() };
            let input = Features::from_fn([3, width, height], |c, x, y| value(c * 7919 + y * 101 + x));
            let found = convolution.apply(&input);
            assert_eq!(
                (found.width, found.height),
                ((width + 2 * padding - kernel) / stride + 1, (height + 2 * padding - kernel) / stride + 1)
            );
            for (y, c, x) in
                (0..found.height).flat_map(|y| (0..5).flat_map(move |c| [0, found.width / 2, found.width - 1].map(|x| (y, c, x))))
            {
                let (found, expected) = (found.row(y)[c * found.width + x], brute_force(&convolution, &input, c, x, y));
                assert!((found - expected).abs() < 1e-4, "kernel {kernel}, channel {c}, column {x}, row {y}: {found} {expected}");
            }
        }
    }

    #[test]
    fn pooling_takes_the_maximum_of_whole_windows() {
        let input = Features::from_fn([1, 6, 5], |_, x, y| if (x, y) == (2, 2) { 9.0 } else { x as f32 });
        let found = pool(&input, 3, 2);
        assert_eq!((found.width, found.height, found.values), (2, 2, vec![9.0, 9.0, 9.0, 9.0]));
        let found = pool(&input, 2, 2);
        assert_eq!((found.width, found.height, found.values), (3, 2, vec![1.0, 3.0, 5.0, 1.0, 9.0, 5.0]));
    }
}

//! Dense networks: layers with biases, ReLU between them, nothing after the last or a ReLU there,
//! too.
//!
//! In: blocks of sixteen samples, `[blocks, inputs]` vectors. Out: `[blocks, outputs]`, and on the
//! way back the gradient by the inputs and by the weights. Weights of a layer are `[inputs,
//! outputs]`, then its biases `[outputs]`. The gradient by a weight is summed over the blocks lane
//! by lane, then over the lanes: one fixed order.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::random;
use luxel_lanes::Lanes;
use luxel_lanes::sums::sum;

/// The sizes of a network's layers, inputs first.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Network {
    sizes: Vec<usize>,
    ends_in_relu: bool,
}

/// Inputs and outputs of all layers of a network for some blocks of samples. Vector number 0 holds
/// the network's inputs; hidden layers are stored after their ReLU.
#[derive(Debug, Default)]
pub(crate) struct Activations {
    layers: Vec<Vec<Lanes>>,
    /// Gradients by the activations, of the same shapes.
    gradients: Vec<Vec<Lanes>>,
}

/// One layer at work.
#[derive(Clone, Copy)]
struct Layer<'a> {
    inputs: usize,
    outputs: usize,
    weights: &'a [f32],
}

impl Network {
    /// Returns a network of these sizes, with nothing after its last layer.
    pub(crate) fn new(sizes: &[usize]) -> Self {
        Self { sizes: sizes.to_vec(), ends_in_relu: false }
    }

    /// Returns a network with a ReLU after its last layer.
    pub(crate) fn ending_in_relu(sizes: &[usize]) -> Self {
        Self { sizes: sizes.to_vec(), ends_in_relu: true }
    }

    /// Returns the number of outputs.
    pub(crate) fn outputs(&self) -> usize {
        self.sizes.last().copied().unwrap_or(0)
    }

    /// Returns the number of weights and biases.
    pub(crate) fn len(&self) -> usize {
        self.sizes.windows(2).map(|pair| (pair[0] + 1) * pair[1]).sum()
    }

    /// Returns weights and biases that are uniform within one over the root of a layer's inputs.
    pub(crate) fn initial(&self, seed: u64) -> Vec<f32> {
        let bounds = self.sizes.windows(2).flat_map(|pair| std::iter::repeat_n((pair[0] as f32).sqrt().recip(), (pair[0] + 1) * pair[1]));
        bounds.zip(0u64..).map(|(bound, index)| bound * (2.0 * random::uniform(seed, index) - 1.0)).collect()
    }

    /// Makes room for `blocks` blocks, and returns the rows of the inputs.
    pub(crate) fn inputs<'a>(&self, blocks: usize, room: &'a mut Activations) -> &'a mut [Lanes] {
        room.layers.resize_with(self.sizes.len(), Vec::new);
        room.gradients.resize_with(self.sizes.len(), Vec::new);
        for (k, size) in self.sizes.iter().enumerate() {
            room.layers[k].resize(blocks * size, Lanes::ZERO);
            room.gradients[k].resize(blocks * size, Lanes::ZERO);
        }
        &mut room.layers[0]
    }

    /// Computes the outputs of the inputs in `room`.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(&self, simd: S, weights: &[f32], room: &mut Activations) {
        let mut weights = weights;
        for k in 0..self.sizes.len() - 1 {
            let (inputs, outputs) = (self.sizes[k], self.sizes[k + 1]);
            let (own, rest) = weights.split_at((inputs + 1) * outputs);
            weights = rest;
            let layer = Layer { inputs, outputs, weights: own };
            let (before, after) = room.layers.split_at_mut(k + 1);
            layer.forward(simd, &before[k], &mut after[0], self.ends_in_relu || k + 2 < self.sizes.len());
        }
    }

    /// Adds the gradient by the weights to `gradient`, given the gradient by the outputs in
    /// [`Activations::by_outputs`]; leaves the gradient by the inputs in
    /// [`Activations::by_inputs`].
    #[inline(always)]
    pub(crate) fn backward<S: Simd>(&self, simd: S, weights: &[f32], room: &mut Activations, gradient: &mut [f32]) {
        if self.ends_in_relu {
            room.mask_outputs();
        }
        let mut end = self.len();
        for k in (0..self.sizes.len() - 1).rev() {
            let (inputs, outputs) = (self.sizes[k], self.sizes[k + 1]);
            let start = end - (inputs + 1) * outputs;
            let layer = Layer { inputs, outputs, weights: &weights[start..end] };
            let (before, after) = room.gradients.split_at_mut(k + 1);
            layer.by_weights(simd, &room.layers[k], &after[0], &mut gradient[start..end]);
            layer.by_inputs(simd, &room.layers[k], &after[0], &mut before[k], k > 0);
            end = start;
        }
    }
}

impl Activations {
    /// Returns the rows of the inputs.
    pub(crate) fn inputs(&self) -> &[Lanes] {
        self.layers.first().map_or(&[], Vec::as_slice)
    }

    /// Returns the rows of the outputs.
    pub(crate) fn outputs(&self) -> &[Lanes] {
        self.layers.last().map_or(&[], Vec::as_slice)
    }

    /// Returns the rows of the gradient by the outputs, to be written before the way back.
    pub(crate) fn by_outputs(&mut self) -> &mut [Lanes] {
        self.gradients.last_mut().map_or(&mut [], Vec::as_mut_slice)
    }

    /// Returns the rows of the gradient by the inputs.
    pub(crate) fn by_inputs(&self) -> &[Lanes] {
        self.gradients.first().map_or(&[], Vec::as_slice)
    }

    /// Removes the gradient by outputs that are 0 behind a ReLU.
    fn mask_outputs(&mut self) {
        let (Some(outputs), Some(by_outputs)) = (self.layers.last(), self.gradients.last_mut()) else { return };
        for (by, output) in by_outputs.iter_mut().zip(outputs) {
            by.0.iter_mut().zip(output.0).filter(|(_, output)| *output <= 0.0).for_each(|(by, _)| *by = 0.0);
        }
    }
}

impl Layer<'_> {
    #[inline(always)]
    fn forward<S: Simd>(&self, simd: S, x: &[Lanes], y: &mut [Lanes], is_hidden: bool) {
        let mut first = 0;
        while first < self.outputs {
            first += match self.outputs - first {
                8.. => self.forward_tile::<S, 8>(simd, first, x, y, is_hidden),
                4.. => self.forward_tile::<S, 4>(simd, first, x, y, is_hidden),
                _ => self.forward_tile::<S, 1>(simd, first, x, y, is_hidden),
            };
        }
    }

    /// Computes outputs `first..first + T` of all blocks, and returns T.
    #[inline(always)]
    fn forward_tile<S: Simd, const T: usize>(&self, simd: S, first: usize, x: &[Lanes], y: &mut [Lanes], is_hidden: bool) -> usize {
        let (matrix, biases) = self.weights.split_at(self.inputs * self.outputs);
        let zero = f32x16::splat(simd, 0.0);
        // Two blocks at a time share the weights' loads.
        for (x, y) in x.chunks(2 * self.inputs).zip(y.chunks_mut(2 * self.outputs)) {
            let second = x.len() - self.inputs;
            let mut sums = [[zero; T]; 2];
            for j in 0..T {
                let bias = f32x16::splat(simd, biases[first + j]);
                sums[0][j] = bias;
                sums[1][j] = bias;
            }
            for i in 0..self.inputs {
                let (a, b) = (x[i].load(simd), x[second + i].load(simd));
                let row = &matrix[i * self.outputs + first..][..T];
                for j in 0..T {
                    let weight = f32x16::splat(simd, row[j]);
                    sums[0][j] = a.mul_add(weight, sums[0][j]);
                    sums[1][j] = b.mul_add(weight, sums[1][j]);
                }
            }
            let second = y.len() - self.outputs;
            for j in 0..T {
                let [a, b] = if is_hidden { [sums[0][j].max(zero), sums[1][j].max(zero)] } else { [sums[0][j], sums[1][j]] };
                y[second + first + j].store(b);
                y[first + j].store(if second == 0 { b } else { a });
            }
        }
        T
    }

    #[inline(always)]
    fn by_inputs<S: Simd>(&self, simd: S, x: &[Lanes], by_y: &[Lanes], by_x: &mut [Lanes], is_hidden: bool) {
        let mut first = 0;
        while first < self.inputs {
            first += match self.inputs - first {
                8.. => self.by_inputs_tile::<S, 8>(simd, first, x, by_y, by_x, is_hidden),
                _ => self.by_inputs_tile::<S, 1>(simd, first, x, by_y, by_x, is_hidden),
            };
        }
    }

    #[inline(always)]
    fn by_inputs_tile<S: Simd, const T: usize>(
        &self,
        simd: S,
        first: usize,
        x: &[Lanes],
        by_y: &[Lanes],
        by_x: &mut [Lanes],
        is_hidden: bool,
    ) -> usize {
        let zero = f32x16::splat(simd, 0.0);
        let blocks = x.chunks_exact(self.inputs).zip(by_y.chunks_exact(self.outputs)).zip(by_x.chunks_exact_mut(self.inputs));
        for ((x, by_y), by_x) in blocks {
            let mut sums = [zero; T];
            for (j, by) in by_y.iter().enumerate() {
                let by = by.load(simd);
                for (i, sum) in sums.iter_mut().enumerate() {
                    *sum = by.mul_add(f32x16::splat(simd, self.weights[(first + i) * self.outputs + j]), *sum);
                }
            }
            for i in 0..T {
                // Behind a ReLU, what is 0 has no gradient.
                let by = if is_hidden { x[first + i].load(simd).simd_gt(zero).select(sums[i], zero) } else { sums[i] };
                by_x[first + i].store(by);
            }
        }
        T
    }

    /// Adds the gradient by weights and biases.
    #[inline(always)]
    fn by_weights<S: Simd>(&self, simd: S, x: &[Lanes], by_y: &[Lanes], gradient: &mut [f32]) {
        let (matrix, biases) = gradient.split_at_mut(self.inputs * self.outputs);
        let mut i = 0;
        while i < self.inputs {
            let rows = if self.inputs - i >= 4 { 4 } else { 1 };
            let mut j = 0;
            while j < self.outputs {
                let columns = if self.outputs - j >= 4 { 4 } else { 1 };
                match (rows, columns) {
                    (4, 4) => self.by_weights_tile::<S, 4, 4>(simd, [i, j], x, by_y, matrix),
                    (4, _) => self.by_weights_tile::<S, 4, 1>(simd, [i, j], x, by_y, matrix),
                    (_, 4) => self.by_weights_tile::<S, 1, 4>(simd, [i, j], x, by_y, matrix),
                    _ => self.by_weights_tile::<S, 1, 1>(simd, [i, j], x, by_y, matrix),
                }
                j += columns;
            }
            i += rows;
        }
        for (j, bias) in biases.iter_mut().enumerate() {
            let mut total = f32x16::splat(simd, 0.0);
            for by_y in by_y.chunks_exact(self.outputs) {
                total += by_y[j].load(simd);
            }
            *bias += sum(total.to_array());
        }
    }

    #[inline(always)]
    fn by_weights_tile<S: Simd, const I: usize, const J: usize>(
        &self,
        simd: S,
        [i, j]: [usize; 2],
        x: &[Lanes],
        by_y: &[Lanes],
        matrix: &mut [f32],
    ) {
        let zero = f32x16::splat(simd, 0.0);
        let mut sums = [[zero; J]; I];
        for (x, by_y) in x.chunks_exact(self.inputs).zip(by_y.chunks_exact(self.outputs)) {
            let (x, by_y) = (&x[i..i + I], &by_y[j..j + J]);
            let mut by = [zero; J];
            for c in 0..J {
                by[c] = by_y[c].load(simd);
            }
            for r in 0..I {
                let value = x[r].load(simd);
                for c in 0..J {
                    sums[r][c] = value.mul_add(by[c], sums[r][c]);
                }
            }
        }
        for r in 0..I {
            for c in 0..J {
                matrix[(i + r) * self.outputs + j + c] += sum(sums[r][c].to_array());
            }
        }
    }
}

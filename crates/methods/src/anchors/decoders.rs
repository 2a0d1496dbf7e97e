//! The networks that decode splats from an anchor's feature and the direction to it.
//!
//! In: blocks of sixteen anchors, rows of the feature and the unit direction from the camera. Out:
//! per splat an opacity before tanh, the logits of three sizes and a quaternion, and the colour:
//! raw luminance and chromaticity of the colour model LCD, or ln radiance of log harmonics. For
//! methods with a context feature of splats, a linear map of the anchor's feature, the same for its
//! ten splats. Each network has 32 ReLU units; weights begin uniform within one over the root of a
//! layer's inputs, as PyTorch's linear layers do.

use fearless_simd::Simd;
use luxel_core::{ColorModel, random, sh};
use luxel_lanes::{LANES, Lanes, Level};
use luxel_train::TrainError;

use super::numbers::check_numbers;
use super::{FEATURE, SPLATS_PER_ANCHOR};
use crate::networks::{Activations, Network};

/// Inputs of the networks: the feature and the direction.
pub(super) const INPUTS: usize = FEATURE + 3;
/// Hidden units.
const UNITS: usize = 32;
/// Numbers of the shape of a splat: three sizes, a quaternion.
pub(super) const SHAPE: usize = 7;
/// Numbers of a splat's context feature.
pub(super) const CONTEXT: usize = 4;
/// Constant that separates the random stream of the networks from others of the same seed.
const STREAM: u64 = 0x6c75_7865_6c08;

/// Networks of opacity, shape and colour, in this order.
pub(super) const NETWORKS: usize = 3;

/// The networks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoders {
    color_model: ColorModel,
    networks: [Network; NETWORKS],
    /// Weights of the networks.
    pub(super) weights: [Vec<f32>; NETWORKS],
    /// Map to the context feature, `[4, 32]`; empty for methods without one.
    pub(super) context: Vec<f32>,
}

/// Returns the number of a splat's colour outputs.
pub(super) fn color_outputs(color_model: ColorModel) -> usize {
    color_model.parameters()
}

impl Decoders {
    /// Makes the networks at the start of a run; `rgb` is the colour that splats begin around.
    pub(super) fn new(color_model: ColorModel, has_context: bool, rgb: [f32; 3], seed: u64) -> Self {
        let networks = Self::networks(color_model);
        let mut weights = [0, 1, 2].map(|n: usize| networks[n].initial(random::bits(seed ^ STREAM, n as u64)));
        let colors = SPLATS_PER_ANCHOR * color_outputs(color_model);
        let biases = weights[2].len() - colors;
        let (dc, raw_luminance) = color_model.constant(rgb);
        let mut first = Vec::new();
        write_outputs(color_model, dc, raw_luminance, &mut first);
        weights[2][biases..].iter_mut().zip(first.iter().cycle()).for_each(|(bias, first)| *bias += first);
        let bound = (FEATURE as f32).sqrt().recip();
        let of_context = if has_context { CONTEXT * FEATURE } else { 0 };
        let stream = random::bits(seed ^ STREAM, NETWORKS as u64);
        let context = (0..of_context as u64).map(|i| bound * (2.0 * random::uniform(stream, i) - 1.0)).collect();
        Self { color_model, networks, weights, context }
    }

    /// Makes the networks of some weights.
    pub(super) fn from_weights(color_model: ColorModel, weights: [Vec<f32>; NETWORKS], context: Vec<f32>) -> Self {
        Self { color_model, networks: Self::networks(color_model), weights, context }
    }

    fn networks(color_model: ColorModel) -> [Network; NETWORKS] {
        [1, SHAPE, color_outputs(color_model)].map(|outputs| Network::new(&[INPUTS, UNITS, SPLATS_PER_ANCHOR * outputs]))
    }

    pub(super) fn color_model(&self) -> ColorModel {
        self.color_model
    }

    /// Returns the number of weights.
    pub(super) fn len(&self) -> usize {
        self.weights.iter().map(Vec::len).sum::<usize>() + self.context.len()
    }

    pub(super) fn validate(&self) -> Result<(), TrainError> {
        let names = ["decoders.opacity", "decoders.shape", "decoders.color"];
        for ((name, weights), network) in names.iter().zip(&self.weights).zip(&self.networks) {
            check_numbers(name, weights, network.len())?;
        }
        let of_context = if self.context.is_empty() { 0 } else { CONTEXT * FEATURE };
        check_numbers("decoders.context", &self.context, of_context)
    }

    /// Computes the outputs of blocks of anchors, whose rows `fill` writes, `[blocks, 35]`.
    pub(super) fn forward(&self, blocks: usize, rooms: &mut [Activations; NETWORKS], fill: impl FnOnce(&mut [Lanes])) {
        let [first, rest @ ..] = rooms;
        fill(self.networks[0].inputs(blocks, first));
        for (network, room) in self.networks[1..].iter().zip(rest) {
            network.inputs(blocks, room).copy_from_slice(first.inputs());
        }
        luxel_lanes::dispatch!(Level::best(), simd => self.forward_with(simd, rooms));
    }

    #[inline(always)]
    fn forward_with<S: Simd>(&self, simd: S, rooms: &mut [Activations; NETWORKS]) {
        for (n, room) in rooms.iter_mut().enumerate() {
            self.networks[n].forward(simd, &self.weights[n], room);
        }
    }

    /// Returns the gradient by the weights, from that by the outputs, which lies in `rooms`; leaves
    /// that by the inputs there.
    pub(super) fn backward(&self, rooms: &mut [Activations; NETWORKS]) -> [Vec<f32>; NETWORKS] {
        let mut by_weights = [0, 1, 2].map(|n: usize| vec![0.0; self.weights[n].len()]);
        luxel_lanes::dispatch!(Level::best(), simd => self.backward_with(simd, rooms, &mut by_weights));
        by_weights
    }

    #[inline(always)]
    fn backward_with<S: Simd>(&self, simd: S, rooms: &mut [Activations; NETWORKS], by_weights: &mut [Vec<f32>; NETWORKS]) {
        for (n, (room, by_weights)) in rooms.iter_mut().zip(by_weights).enumerate() {
            self.networks[n].backward(simd, &self.weights[n], room, by_weights);
        }
    }

    /// Returns the context feature of an anchor's feature.
    pub(super) fn context_of(&self, feature: &[f32]) -> [f32; CONTEXT] {
        let row = |k: usize| self.context[k * FEATURE..(k + 1) * FEATURE].iter().zip(feature).map(|(w, f)| w * f).sum();
        [0, 1, 2, 3].map(row)
    }
}

/// Appends what the colour network puts out for a splat of these coefficients.
fn write_outputs(color_model: ColorModel, dc: [f32; 3], raw_luminance: f32, out: &mut Vec<f32>) {
    match color_model {
        ColorModel::LogSh { .. } => out.extend(dc.map(|k| k * sh::C0 + luxel_core::SH_OFFSET)),
        _ => {
            out.push(raw_luminance);
            out.extend(dc.map(|k| k * sh::C0));
        }
    }
}

/// Returns harmonics and raw luminance of a splat from its colour outputs. The raw luminance is
/// meaningless for colour models without one.
pub(super) fn coefficients(color_model: ColorModel, outputs: &[f32]) -> ([f32; 3], f32) {
    match color_model {
        ColorModel::LogSh { .. } => ([0, 1, 2].map(|c: usize| (outputs[c] - luxel_core::SH_OFFSET) / sh::C0), 0.0),
        _ => ([1, 2, 3].map(|c: usize| outputs[c] / sh::C0), outputs[0]),
    }
}

/// Writes the gradient by a splat's colour outputs, from that by harmonics and raw luminance.
pub(super) fn by_outputs(color_model: ColorModel, by_dc: [f32; 3], by_raw_luminance: f32, out: &mut [f32]) {
    let by_dc = by_dc.map(|by| by / sh::C0);
    match color_model {
        ColorModel::LogSh { .. } => out.copy_from_slice(&by_dc),
        _ => {
            out[0] = by_raw_luminance;
            out[1..].copy_from_slice(&by_dc);
        }
    }
}

/// Returns a number of an anchor in rows of blocks.
#[inline(always)]
pub(super) fn at(rows: &[Lanes], width: usize, item: usize, row: usize) -> f32 {
    rows[item / LANES * width + row].0[item % LANES]
}

/// Returns the place of a number of an anchor in rows of blocks.
#[inline(always)]
pub(super) fn at_mut(rows: &mut [Lanes], width: usize, item: usize, row: usize) -> &mut f32 {
    &mut rows[item / LANES * width + row].0[item % LANES]
}

//! From gradients by decoded splats to those by anchors and networks.
//!
//! In: the gradients of a view by its splats' parameters, as the engine returns them. Out: the
//! gradient by all that is trained, and statistics by splat. The derivatives are those of
//! [`super::decode`]'s formulas: with p = tanh z, d logit(p) / dz = (1 + p) / p. Directions have no
//! gradient, because positions of anchors stay as they are.

use crate::networks::Activations;
use luxel_core::engine::{ParameterRows, SPLATS_PER_BLOCK, SparseGradients};
use rayon::prelude::*;

use super::decode::{Chunk, Decoded};
use super::decoders::{CONTEXT, NETWORKS, SHAPE, at, at_mut, by_outputs, color_outputs};
use super::scene::AnchorScene;
use super::{FEATURE, OFFSETS, SCALES, SPLATS_PER_ANCHOR};

/// The gradient by everything that is trained.
#[derive(Default)]
pub(super) struct AnchorGradients {
    pub(super) by_offset: Vec<f32>,
    pub(super) by_feature: Vec<f32>,
    pub(super) by_log_scale: Vec<f32>,
    pub(super) by_weights: [Vec<f64>; NETWORKS],
    pub(super) by_context: Vec<f64>,
}

/// The gradients by splats, with access by number.
pub(super) struct SplatGradients {
    rows: ParameterRows,
    block_len: usize,
    values: Vec<f32>,
}

impl SplatGradients {
    /// Takes the gradients of a view of `count` splats.
    pub(super) fn new(gradients: &SparseGradients, count: usize) -> Self {
        let block_len = gradients.block_len();
        let mut values = vec![0.0; count.div_ceil(SPLATS_PER_BLOCK) * block_len];
        for (block, of_block) in gradients.iter() {
            values[block as usize * block_len..][..block_len].copy_from_slice(of_block);
        }
        Self { rows: gradients.rows(), block_len, values }
    }

    fn at(&self, splat: usize, row: usize) -> f32 {
        self.values[splat / SPLATS_PER_BLOCK * self.block_len + row * SPLATS_PER_BLOCK + splat % SPLATS_PER_BLOCK]
    }

    fn three(&self, splat: usize, row: usize) -> [f32; 3] {
        [0, 1, 2].map(|c| self.at(splat, row + c))
    }

    /// Returns the norm of the gradient by a splat's centre, NDC units, and whether the view shows
    /// the splat.
    pub(super) fn statistics(&self, splat: usize) -> (f32, bool) {
        let first = self.rows.count();
        (self.at(splat, first), self.at(splat, first + 2) > 0.0)
    }
}

/// The gradients of a chunk of anchors.
struct ChunkGradients {
    by_offset: Vec<f32>,
    by_log_scale: Vec<f32>,
    by_weights: [Vec<f32>; NETWORKS],
    by_context: Vec<f64>,
    /// By the features, `[anchors, 32]`.
    by_feature: Vec<f32>,
}

impl Decoded {
    /// Returns the gradient by what is trained, from that by splats and by their context features,
    /// `[splats, 4]`, which may be empty.
    pub(super) fn backward(&mut self, scene: &AnchorScene, by_splats: &SplatGradients, by_context: &[f32]) -> AnchorGradients {
        let Self { visible, chunks, slots, .. } = self;
        let (visible, slots) = (&*visible, &*slots);
        let parts: Vec<ChunkGradients> =
            chunks.par_iter_mut().map(|chunk| scene.chunk_backward(chunk, visible, slots, by_splats, by_context)).collect();
        let count = scene.anchors.len();
        let mut all = AnchorGradients {
            by_offset: vec![0.0; count * OFFSETS],
            by_feature: vec![0.0; count * FEATURE],
            by_log_scale: vec![0.0; count * SCALES],
            by_weights: [0, 1, 2].map(|n: usize| vec![0.0; scene.decoders.weights[n].len()]),
            by_context: vec![0.0; scene.decoders.context.len()],
        };
        for (chunk, part) in chunks.iter().zip(parts) {
            for (item, anchor) in visible[chunk.anchors.clone()].iter().map(|anchor| *anchor as usize).enumerate() {
                let copy = |all: &mut [f32], part: &[f32], width: usize| {
                    all[anchor * width..(anchor + 1) * width].copy_from_slice(&part[item * width..(item + 1) * width]);
                };
                copy(&mut all.by_offset, &part.by_offset, OFFSETS);
                copy(&mut all.by_feature, &part.by_feature, FEATURE);
                copy(&mut all.by_log_scale, &part.by_log_scale, SCALES);
            }
            for (sums, part) in all.by_weights.iter_mut().zip(&part.by_weights) {
                sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += f64::from(*part));
            }
            all.by_context.iter_mut().zip(&part.by_context).for_each(|(sum, part)| *sum += part);
        }
        all
    }
}

impl AnchorScene {
    fn chunk_backward(
        &self,
        chunk: &mut Chunk,
        visible: &[u32],
        slots: &[u32],
        by_splats: &SplatGradients,
        by_context: &[f32],
    ) -> ChunkGradients {
        let Self { anchors, decoders } = self;
        let (model, of_color) = (self.color_model(), color_outputs(self.color_model()));
        let (first, count) = (chunk.anchors.start, chunk.anchors.len());
        let mut out = ChunkGradients {
            by_offset: vec![0.0; count * OFFSETS],
            by_log_scale: vec![0.0; count * SCALES],
            by_weights: Default::default(),
            by_context: vec![0.0; decoders.context.len()],
            by_feature: vec![0.0; count * FEATURE],
        };
        chunk.rooms.iter_mut().for_each(|room| room.by_outputs().fill(luxel_lanes::Lanes::ZERO));
        let rows = by_splats.rows;
        for splat in chunk.splats.clone() {
            let (item, k) = (slots[splat] as usize / SPLATS_PER_ANCHOR - first, slots[splat] as usize % SPLATS_PER_ANCHOR);
            let anchor = visible[first + item] as usize;
            let scales = &anchors.log_scale[anchor * SCALES..(anchor + 1) * SCALES];
            let (by_position, by_size) =
                (by_splats.three(splat, ParameterRows::POSITION), by_splats.three(splat, ParameterRows::LOG_SCALE));
            let [opacities, shapes, colors] = &mut chunk.rooms;
            for c in 0..3 {
                let (unit, offset) = (scales[c].exp(), anchors.offset[anchor * OFFSETS + 3 * k + c]);
                out.by_offset[item * OFFSETS + 3 * k + c] = by_position[c] * unit;
                out.by_log_scale[item * SCALES + c] += by_position[c] * offset * unit;
                out.by_log_scale[item * SCALES + 3 + c] += by_size[c];
                let size = at(shapes.outputs(), SPLATS_PER_ANCHOR * SHAPE, item, SHAPE * k + c);
                // d ln sigmoid(s) / ds = sigmoid(-s).
                *at_mut(shapes.by_outputs(), SPLATS_PER_ANCHOR * SHAPE, item, SHAPE * k + c) = by_size[c] / (1.0 + size.exp());
            }
            for c in 0..4 {
                let by = by_splats.at(splat, ParameterRows::ROTATION + c);
                *at_mut(shapes.by_outputs(), SPLATS_PER_ANCHOR * SHAPE, item, SHAPE * k + 3 + c) = by;
            }
            let opacity = at(opacities.outputs(), SPLATS_PER_ANCHOR, item, k).tanh();
            let by_logit = by_splats.at(splat, ParameterRows::OPACITY);
            *at_mut(opacities.by_outputs(), SPLATS_PER_ANCHOR, item, k) = by_logit * ((1.0 + opacity) / opacity);
            let by_luminance = if model.luminance_coefficients() > 0 { by_splats.at(splat, rows.luminance()) } else { 0.0 };
            let mut by_color = vec![0.0; of_color];
            by_outputs(model, by_splats.three(splat, ParameterRows::SH), by_luminance, &mut by_color);
            for (row, by) in by_color.into_iter().enumerate() {
                *at_mut(colors.by_outputs(), SPLATS_PER_ANCHOR * of_color, item, of_color * k + row) = by;
            }
        }
        out.by_weights = decoders.backward(&mut chunk.rooms);
        add_by_inputs(&chunk.rooms, &mut out.by_feature);
        self.context_backward(chunk, visible, slots, by_context, &mut out);
        out
    }

    /// Adds the gradient through the context features.
    fn context_backward(&self, chunk: &Chunk, visible: &[u32], slots: &[u32], by_context: &[f32], out: &mut ChunkGradients) {
        if by_context.is_empty() {
            return;
        }
        let mut by_anchor = vec![[0.0f32; CONTEXT]; chunk.anchors.len()];
        for splat in chunk.splats.clone() {
            let item = slots[splat] as usize / SPLATS_PER_ANCHOR - chunk.anchors.start;
            by_anchor[item].iter_mut().zip(&by_context[splat * CONTEXT..]).for_each(|(sum, by)| *sum += by);
        }
        for (item, by) in by_anchor.into_iter().enumerate() {
            let anchor = visible[chunk.anchors.start + item] as usize;
            let feature = &self.anchors.feature[anchor * FEATURE..(anchor + 1) * FEATURE];
            for (k, by) in by.into_iter().enumerate() {
                for (f, value) in feature.iter().enumerate() {
                    out.by_context[k * FEATURE + f] += f64::from(by * value);
                    out.by_feature[item * FEATURE + f] += by * self.decoders.context[k * FEATURE + f];
                }
            }
        }
    }
}

/// Adds the gradient by the networks' inputs to that by the features.
fn add_by_inputs(rooms: &[Activations; NETWORKS], by_feature: &mut [f32]) {
    for room in rooms {
        for (item, by) in by_feature.chunks_exact_mut(FEATURE).enumerate() {
            by.iter_mut().enumerate().for_each(|(row, by)| *by += at(room.by_inputs(), FEATURE + 3, item, row));
        }
    }
}

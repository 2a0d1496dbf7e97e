//! From anchors to the splats that a camera sees.
//!
//! In: a scene of anchors, a camera. Out: [`Decoded`]. Splat k of an anchor at a lies at
//! a + o_k exp(u) with u the first three scales; its standard deviations are those of the other
//! three times a logistic of the network's sizes; its opacity is tanh of the network's output, and
//! if that is not above 0 the splat is left out of this view. Splats follow the order of their
//! anchors.

use std::ops::Range;

use glam::DVec3;
use luxel_core::{Camera, Splat, Splats, softplus};
use luxel_lanes::{LANES, Lanes};
use rayon::prelude::*;

use super::decoders::{CONTEXT, INPUTS, NETWORKS, SHAPE, at, at_mut, coefficients, color_outputs};
use super::scene::{AnchorScene, Anchors};
use super::visible::visible;
use super::{FEATURE, OFFSETS, SCALES, SPLATS_PER_ANCHOR};
use crate::networks::Activations;

/// Anchors that a thread takes at once. A constant, on which sums depend.
pub(super) const CHUNK: usize = 16 * LANES;

/// The splats of a view, with what the way back needs.
pub(super) struct Decoded {
    /// Anchors that the camera may see, ascending.
    pub(super) visible: Vec<u32>,
    pub(super) chunks: Vec<Chunk>,
    pub(super) splats: Splats,
    /// Context features, `[splats, 4]`; empty without a context map.
    pub(super) context: Vec<f32>,
    /// Splat by splat, ten times its anchor's place in `visible`, and its number within the anchor.
    pub(super) slots: Vec<u32>,
}

/// Some of the visible anchors.
pub(super) struct Chunk {
    /// Inputs and outputs of the networks.
    pub(super) rooms: [Activations; NETWORKS],
    /// The chunk's anchors, places in [`Decoded::visible`].
    pub(super) anchors: Range<usize>,
    /// Their splats that are drawn.
    pub(super) splats: Range<usize>,
}

/// The splats of a chunk.
struct Part {
    rooms: [Activations; NETWORKS],
    splats: Splats,
    context: Vec<f32>,
    slots: Vec<u32>,
}

/// Returns the logit of an opacity; that of 1, which f32 rounds tanh to, is that of the largest
/// number below.
fn logit_of(opacity: f32) -> f32 {
    let rest = (1.0 - opacity).max(f32::EPSILON / 2.0);
    (opacity / rest).ln()
}

/// Returns ln of the logistic function.
fn ln_sigmoid(x: f32) -> f32 {
    -softplus(-x)
}

impl AnchorScene {
    /// Decodes the splats that a camera sees; `near` is the distance below which they are culled.
    pub(super) fn decode(&self, camera: &Camera, near: f32) -> Decoded {
        let (visible, eye) = (visible(&self.anchors, camera, near), camera.eye());
        let first = |chunk: usize| chunk * CHUNK;
        let parts: Vec<Part> =
            visible.par_chunks(CHUNK).enumerate().map(|(chunk, anchors)| self.decode_chunk(anchors, first(chunk), eye)).collect();
        let mut decoded = Decoded {
            chunks: Vec::with_capacity(parts.len()),
            splats: Splats::empty(self.color_model()),
            context: Vec::new(),
            slots: Vec::new(),
            visible,
        };
        for (chunk, part) in parts.into_iter().enumerate() {
            let anchors = first(chunk)..decoded.visible.len().min(first(chunk + 1));
            let splats = decoded.slots.len()..decoded.slots.len() + part.slots.len();
            decoded.chunks.push(Chunk { rooms: part.rooms, anchors, splats });
            decoded.splats.append(part.splats);
            decoded.context.extend(part.context);
            decoded.slots.extend(part.slots);
        }
        decoded
    }

    /// Decodes the splats of some anchors, of which the first has place `first` among the visible.
    fn decode_chunk(&self, chosen: &[u32], first: usize, eye: DVec3) -> Part {
        let Self { anchors, decoders } = self;
        let mut rooms: [Activations; NETWORKS] = Default::default();
        decoders.forward(chosen.len().div_ceil(LANES), &mut rooms, |rows| write_inputs(anchors, chosen, eye, rows));
        let [opacities, shapes, colors] = [&rooms[0], &rooms[1], &rooms[2]].map(Activations::outputs);
        let (model, of_color) = (self.color_model(), color_outputs(self.color_model()));
        let mut part = Part { splats: Splats::empty(model), context: Vec::new(), slots: Vec::new(), rooms: Default::default() };
        let mut outputs = vec![0.0; of_color];
        for (item, anchor) in chosen.iter().map(|anchor| *anchor as usize).enumerate() {
            let context = if decoders.context.is_empty() {
                [0.0; CONTEXT]
            } else {
                decoders.context_of(&anchors.feature[anchor * FEATURE..(anchor + 1) * FEATURE])
            };
            let scales = &anchors.log_scale[anchor * SCALES..(anchor + 1) * SCALES];
            let unit = [0, 1, 2].map(|c: usize| scales[c].exp());
            for k in 0..SPLATS_PER_ANCHOR {
                let opacity = at(opacities, SPLATS_PER_ANCHOR, item, k).tanh();
                if opacity.is_nan() || opacity <= 0.0 {
                    continue;
                }
                let shape = |row: usize| at(shapes, SPLATS_PER_ANCHOR * SHAPE, item, SHAPE * k + row);
                let offset = &anchors.offset[anchor * OFFSETS + 3 * k..][..3];
                for (row, output) in outputs.iter_mut().enumerate() {
                    *output = at(colors, SPLATS_PER_ANCHOR * of_color, item, of_color * k + row);
                }
                let (dc, raw_luminance) = coefficients(model, &outputs);
                part.splats.push(&Splat {
                    position: [0, 1, 2].map(|c: usize| anchors.position[anchor][c] + offset[c] * unit[c]),
                    rotation: [3, 4, 5, 6].map(shape),
                    log_scale: [0, 1, 2].map(|c: usize| scales[3 + c] + ln_sigmoid(shape(c))),
                    opacity_logit: logit_of(opacity),
                    sh: &dc,
                    raw_luminance: &[raw_luminance][..model.luminance_coefficients()],
                });
                part.slots.push(((first + item) * SPLATS_PER_ANCHOR + k) as u32);
                if !decoders.context.is_empty() {
                    part.context.extend(context);
                }
            }
        }
        Part { rooms, ..part }
    }
}

/// Writes the networks' inputs of some anchors, `[blocks, 35]`.
fn write_inputs(anchors: &Anchors, chosen: &[u32], eye: DVec3, rows: &mut [Lanes]) {
    rows.fill(Lanes::ZERO);
    for (item, anchor) in chosen.iter().map(|anchor| *anchor as usize).enumerate() {
        let feature = &anchors.feature[anchor * FEATURE..(anchor + 1) * FEATURE];
        let direction = (DVec3::from_array(anchors.position[anchor].map(f64::from)) - eye).normalize_or_zero();
        for (row, value) in feature.iter().copied().chain(direction.to_array().map(|v| v as f32)).enumerate() {
            *at_mut(rows, INPUTS, item, row) = value;
        }
    }
}

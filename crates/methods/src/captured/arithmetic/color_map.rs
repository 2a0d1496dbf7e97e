//! Second colours of splats: each channel of the first ones through a network of one input.
//!
//! In: colours `[N, 3]`, a [`ColorMap`]. Out: mapped colours, and the gradient by the first colours
//! and by the networks' numbers, both exact. Inputs and outputs of networks are functions of
//! sixteen numbers at a time; pieces of the networks' tables are found splat by splat, once a step.
//!
//! Splats are taken in chunks of constant size, and their sums are added in order: the same bits
//! for any number of threads. Degenerate: splats that the view does not show have no colour and no
//! gradient.

use luxel_core::engine::SeenSplats;
use rayon::prelude::*;

use crate::networks::relu_line::{LineSums, LineTable};

/// Splats of a chunk.
const CHUNK: usize = 2048;
/// Splats whose pieces are looked for at once.
const TOGETHER: usize = 8;

/// A map of colours, channel by channel.
pub(crate) trait ColorMap: Send + Sync {
    /// Returns the tables of the channels' networks.
    fn tables(&self) -> &[LineTable; 3];

    /// Turns colours into inputs of the networks.
    fn inputs(&self, colors: &mut [f32]);

    /// Returns what the outputs of a network at an input make up.
    fn argument(&self, table: &LineTable, piece: usize, input: f64) -> f64;

    /// Turns arguments into mapped colours, and writes their derivatives by the arguments.
    fn colors(&self, arguments: &mut [f32], slopes: &mut [f32]);

    /// Adds the gradient by an argument to the sums of its network, and returns that by the input.
    fn backward(&self, table: &LineTable, sums: &mut LineSums, at: LinePlace, by_argument: f64) -> f64;

    /// Returns the derivative of the input by the colour.
    fn input_slope(&self, color: f32) -> f64;
}

/// An input of a network, and its piece.
#[derive(Clone, Copy)]
pub(crate) struct LinePlace {
    pub(crate) piece: usize,
    pub(crate) input: f64,
}

/// Mapped colours, and what their gradient needs.
pub(crate) struct MappedColors {
    /// 0 where the view does not show the splat.
    pub(crate) colors: Vec<[f32; 3]>,
    slopes: Vec<[f32; 3]>,
    pieces: Vec<[u16; 3]>,
}

/// Some numbers of each splat among others, `[N, stride]`.
#[derive(Clone, Copy)]
pub(crate) struct SplatRows<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) stride: usize,
    pub(crate) first: usize,
}

impl SplatRows<'_> {
    /// Returns the three numbers of a splat.
    pub(crate) fn row(&self, i: usize) -> [f32; 3] {
        std::array::from_fn(|c| self.values[i * self.stride + self.first + c])
    }
}

/// Returns mapped colours.
pub(crate) fn mapped(map: &impl ColorMap, splats: &SeenSplats<'_>) -> MappedColors {
    let count = splats.radiance.len();
    let mut out = MappedColors { colors: vec![[0.0; 3]; count], slopes: vec![[0.0; 3]; count], pieces: vec![[0; 3]; count] };
    let outs = (out.colors.par_chunks_mut(CHUNK), out.slopes.par_chunks_mut(CHUNK), out.pieces.par_chunks_mut(CHUNK));
    let inputs = splats.radiance.par_chunks(CHUNK).zip(splats.visible.par_chunks(CHUNK));
    outs.into_par_iter().zip(inputs).for_each(|((colors, slopes, pieces), (first, visible))| {
        colors.copy_from_slice(first);
        map.inputs(colors.as_flattened_mut());
        for (colors, pieces) in colors.chunks_mut(TOGETHER).zip(pieces.chunks_mut(TOGETHER)) {
            map_together(map, colors, pieces);
        }
        map.colors(colors.as_flattened_mut(), slopes.as_flattened_mut());
        colors.iter_mut().zip(visible).filter(|(_, visible)| !**visible).for_each(|(color, _)| *color = [0.0; 3]);
    });
    out
}

/// Turns inputs of at most [`TOGETHER`] splats into arguments, and finds their pieces.
#[inline]
fn map_together(map: &impl ColorMap, colors: &mut [[f32; 3]], pieces: &mut [[u16; 3]]) {
    for (c, table) in map.tables().iter().enumerate() {
        let mut inputs = [0.0; TOGETHER];
        inputs.iter_mut().zip(&*colors).for_each(|(input, color)| *input = f64::from(color[c]));
        let found = table.pieces(&inputs);
        for (((color, pieces), piece), input) in colors.iter_mut().zip(&mut *pieces).zip(found).zip(inputs) {
            pieces[c] = piece as u16;
            color[c] = map.argument(table, piece, input) as f32;
        }
    }
}

/// Adds the gradient by the first colours to `out`, from that by the mapped ones, and returns the
/// sums by the networks' numbers.
pub(crate) fn mapped_backward(
    map: &impl ColorMap,
    splats: &SeenSplats<'_>,
    kept: &MappedColors,
    by_mapped: SplatRows<'_>,
    out: &mut [[f32; 3]],
) -> [LineSums; 3] {
    let zero = || map.tables().each_ref().map(LineTable::sums);
    let of_chunk = |(chunk, out): (usize, &mut [[f32; 3]])| {
        let start = chunk * CHUNK;
        let (colors, slopes) = (&splats.radiance[start..start + out.len()], &kept.slopes[start..]);
        let mut inputs = colors.to_vec();
        map.inputs(inputs.as_flattened_mut());
        let mut sums = zero();
        for (i, out) in out.iter_mut().enumerate().filter(|(i, _)| splats.visible[start + i]) {
            let by = by_mapped.row(start + i);
            for (c, out) in out.iter_mut().enumerate() {
                let by_argument = f64::from(by[c]) * f64::from(slopes[i][c]);
                if by_argument == 0.0 {
                    continue;
                }
                let at = LinePlace { piece: kept.pieces[start + i][c].into(), input: inputs[i][c].into() };
                let by_input = map.backward(&map.tables()[c], &mut sums[c], at, by_argument);
                *out += (by_input * map.input_slope(colors[i][c])) as f32;
            }
        }
        sums
    };
    let parts: Vec<[LineSums; 3]> = out.par_chunks_mut(CHUNK).enumerate().map(of_chunk).collect();
    let mut sums = zero();
    for part in &parts {
        sums.iter_mut().zip(part).for_each(|(sum, part)| sum.merge(part));
    }
    sums
}

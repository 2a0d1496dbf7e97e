//! Numbers of items in blocks of sixteen, as small networks read them: row r of a block holds
//! number r of its sixteen items.
//!
//! In and out: planes `[R, N]`. Degenerate: items behind the last one are 0.

use luxel_lanes::LANES;
use rayon::prelude::*;

/// `R` numbers of sixteen items.
pub(crate) type Block<const R: usize> = [[f32; LANES]; R];

/// Blocks that a thread takes at once: 4096 items. A constant, on which sums depend.
pub(crate) const CHUNK: usize = 256;

/// Reads planes.
pub(crate) fn from_planes<const R: usize>(planes: &[f32]) -> Vec<Block<R>> {
    let len = planes.len() / R;
    let mut blocks = vec![[[0.0; LANES]; R]; len.div_ceil(LANES)];
    blocks.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(n, block)| {
        let first = n * LANES;
        for (r, row) in block.iter_mut().enumerate() {
            let rest = &planes[r * len + first..(r + 1) * len];
            match rest.first_chunk() {
                Some(numbers) => *row = *numbers,
                None => row[..rest.len()].copy_from_slice(rest),
            }
        }
    });
    blocks
}

/// Writes rows `first..first + planes` of blocks to as many planes of `len` numbers.
pub(crate) fn to_planes<const R: usize>(blocks: &[Block<R>], first: usize, len: usize, planes: &mut [f32]) {
    planes.par_chunks_mut(len.max(1)).enumerate().for_each(|(r, plane)| {
        let (whole, rest) = plane.as_chunks_mut::<LANES>();
        whole.iter_mut().zip(blocks).for_each(|(out, block)| *out = block[first + r]);
        if let Some(last) = blocks.get(whole.len()) {
            rest.copy_from_slice(&last[first + r][..rest.len()]);
        }
    });
}

//! Channels of splats that are not the radiance of their footprints: any number of any numbers.
//!
//! In: an array `[N, K]`. Out: the first three in a tile's entries, the others beside them.

use luxel_core::each;

use super::bin::Bins;
use super::sort::{Entry, TileList};

/// Channels that an entry carries.
pub(crate) const FIRST: usize = 3;

/// The channels of all splats towards a camera.
#[derive(Clone, Copy)]
pub(crate) struct SplatChannels<'a> {
    /// `[N, K]`.
    pub(crate) values: &'a [f32],
    /// K.
    pub(crate) count: usize,
    /// `[K]`; empty if it is zero.
    pub(crate) background: &'a [f32],
}

impl<'a> SplatChannels<'a> {
    /// Returns the number of channels beyond the first.
    pub(crate) fn more(&self) -> usize {
        self.count.saturating_sub(FIRST)
    }

    /// Returns a splat's channels.
    fn row(&self, splat: usize) -> &'a [f32] {
        &self.values[splat * self.count..][..self.count]
    }

    /// Returns the background of the first three channels.
    pub(crate) fn first_background(&self) -> [f32; FIRST] {
        each!([0, 1, 2] c => self.background.get(c).copied().unwrap_or(0.0))
    }

    /// Returns the background of the other channels.
    pub(crate) fn more_background(&self) -> Vec<f32> {
        (FIRST..self.count).map(|c| self.background.get(c).copied().unwrap_or(0.0)).collect()
    }

    /// Writes the first three channels to the entries of a tile.
    pub(crate) fn color_entries(&self, bins: &Bins, tile: usize, list: &mut TileList) {
        let start = bins.range(tile).start;
        for entry in &mut list.entries {
            let row = self.row(bins.splat(start + entry.place as usize));
            entry.radiance = each!([0, 1, 2] c => row.get(c).copied().unwrap_or(0.0));
        }
    }

    /// Collects the other channels of a tile's entries, `[entries, E]`.
    pub(crate) fn collect_more(&self, bins: &Bins, tile: usize, entries: &[Entry], out: &mut Vec<f32>) {
        let (more, start) = (self.more(), bins.range(tile).start);
        out.resize(entries.len() * more, 0.0);
        for (out, entry) in out.chunks_exact_mut(more.max(1)).zip(entries) {
            let row = &self.row(bins.splat(start + entry.place as usize))[FIRST..];
            out.iter_mut().zip(row).for_each(|(out, number)| *out = *number);
        }
    }
}

//! Keeps the gradients of a step by the screen: one for each entry of a tile, or their sums by
//! splat.
//!
//! In: gradients of entries, those of all tiles or of one band of tiles after another. Out:
//! [`ByScreen`] for the passes behind.
//!
//! The entries of a large image are gigabytes. Where they do not fit into the memory for them, the
//! tiles are differentiated in bands, and the gradients of a band are added to those of their
//! splats before the next band takes their place. A splat's entries are added in the order of its
//! list both ways, so the bits are the same; therefore bands are for pinholes, whose lists are in
//! the order of tiles.

use std::ops::Range;

use bytemuck::cast_ref;
use rayon::prelude::*;

use super::bin::Bins;
use super::sums::{ENTRY_LEN, EntryGradient};
use crate::lanes::LANES;

/// The most bands of an image: each goes through the lists of all splats.
const MAX_BANDS: usize = 16;

/// Gradients by the screen, as the passes behind read them.
#[derive(Clone, Copy)]
pub(crate) enum ByScreen<'a> {
    /// Gradients of the entries of all tiles, in the order of the bins.
    Entries(&'a [EntryGradient]),
    /// Gradients of splats, summed over their tiles.
    Splats(&'a [EntryGradient]),
}

/// The gradients by the screen of a step.
#[derive(Default)]
pub(crate) struct ScreenGradients {
    /// Gradients of the entries of all tiles, or of the last band.
    entries: Vec<EntryGradient>,
    /// Sums by splat where there are bands.
    by_splat: Vec<EntryGradient>,
}

impl ScreenGradients {
    /// Returns the gradients of the last step.
    pub(crate) fn by_screen(&self) -> ByScreen<'_> {
        if self.by_splat.is_empty() { ByScreen::Entries(&self.entries) } else { ByScreen::Splats(&self.by_splat) }
    }

    /// Returns the memory that is held, bytes.
    pub(crate) fn capacity_bytes(&self) -> usize {
        (self.entries.capacity() + self.by_splat.capacity()) * size_of::<EntryGradient>()
    }

    /// Begins with gradients of all entries, whose contents are arbitrary.
    pub(crate) fn all(&mut self, bins: &Bins) -> &mut [EntryGradient] {
        self.by_splat = Vec::new();
        resize(&mut self.entries, bins.len());
        &mut self.entries
    }

    /// Begins with sums of zero for so many splats.
    pub(crate) fn begin_bands(&mut self, splats: usize) {
        self.by_splat.clear();
        self.by_splat.resize(splats, EntryGradient::default());
    }

    /// Returns gradients of so many entries of a band, whose contents are arbitrary.
    pub(crate) fn band(&mut self, entries: usize) -> &mut [EntryGradient] {
        resize(&mut self.entries, entries);
        &mut self.entries
    }

    /// Adds the gradients of the band with these entries to those of their splats.
    pub(crate) fn add_band(&mut self, bins: &Bins, band: Range<usize>) {
        let entries = &self.entries;
        self.by_splat.par_chunks_mut(LANES).enumerate().for_each(|(block, sums)| {
            let lists = bins.entries(block * LANES, sums.len());
            for (sum, list) in sums.iter_mut().zip(lists) {
                let sum: &mut [f32; ENTRY_LEN] = bytemuck::cast_mut(sum);
                for entry in list.iter().map(|entry| *entry as usize).filter(|entry| band.contains(entry)) {
                    let gradient: &[f32; ENTRY_LEN] = cast_ref(&entries[entry - band.start]);
                    for (sum, part) in sum.iter_mut().zip(gradient) {
                        *sum += part;
                    }
                }
            }
        });
    }
}

/// Returns the bands of so many tiles: one where the gradients of all entries take no more than
/// `limit_bytes`, else bands that take no more each, or a part in [`MAX_BANDS`] of all, or what
/// their one tile takes.
pub(crate) fn bands(bins: &Bins, tiles: usize, limit_bytes: usize) -> Vec<Range<usize>> {
    let most = (limit_bytes / size_of::<EntryGradient>()).max(bins.len().div_ceil(MAX_BANDS - 1));
    let mut bands = Vec::new();
    let (mut first, mut entries) = (0, 0);
    for tile in 0..tiles {
        let of_tile = bins.range(tile).len();
        if tile > first && entries + of_tile > most {
            bands.push(first..tile);
            (first, entries) = (tile, 0);
        }
        entries += of_tile;
    }
    bands.push(first..tiles);
    bands
}

/// Makes room for so many gradients, whose contents are arbitrary.
pub(crate) fn resize<T: Clone + Default>(out: &mut Vec<T>, len: usize) {
    if out.capacity() < len {
        // The old memory is freed before the new is allocated.
        *out = Vec::new();
        out.reserve_exact(len + len / 8);
    }
    out.resize(len, T::default());
}

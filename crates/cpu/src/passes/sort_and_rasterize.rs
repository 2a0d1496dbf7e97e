//! Passes `sort` and `rasterize` together, tile by tile: from lists of splats to pixels.
//!
//! In: [`TileInputs`]. Out, per tile: its pixels and, if wanted, its record.
//!
//! A tile is rasterised as soon as it is sorted, because its list is then still in the core's cache
//! and its blocks read it in random order. If all tiles were sorted first, rasterisation would wait
//! for memory.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::pass_times::PassTimes;
use super::rasterize::TilePixels;
use super::tile_records::{Recording, TileInputs, TileRecords, Workbench};

/// Sorts and rasterises all tiles, and keeps what is wanted of them. Returns the time spent in
/// `sort` and in `rasterize`, summed over threads.
pub(crate) fn sort_and_rasterize(inputs: &TileInputs<'_>, records: &mut TileRecords, pixels: &mut Vec<TilePixels>) -> [Duration; 2] {
    let TileInputs { level, camera, splats, recording, .. } = *inputs;
    let [across, down] = camera.tiles();
    pixels.resize(across * down, TilePixels::default());
    let (slots, shelf) = records.begin(across * down, recording);
    let times = PassTimes::default();
    // Work is taken tile by tile. By default rayon halves it twice, and again only when a thread
    // steals; a thread that finishes first would wait long.
    slots.par_iter_mut().zip(pixels).enumerate().with_max_len(1).for_each(|(index, (slot, pixels))| {
        let Workbench { buffers, record: of_thread, .. } = &mut *shelf.bench();
        let start = Instant::now();
        let record = slot.record(of_thread, recording);
        record.list.sort(level, camera, splats, index, buffers);
        let middle = Instant::now();
        inputs.rasterize(index, record, pixels);
        if recording != Recording::Nothing {
            slot.keep(of_thread, shelf);
        }
        times.add([start, middle]);
    });
    times.totals()
}

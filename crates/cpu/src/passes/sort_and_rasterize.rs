//! Passes `sort` and `rasterize` together, tile by tile: from lists of splats to pixels.
//!
//! In: [`ScreenSplats`]. Out, per tile: its sorted list, its pixels and, if wanted, their
//! [`Changes`].
//!
//! A tile is rasterised as soon as it is sorted, because its list is then still in the core's cache
//! and its blocks read it in random order. If all tiles were sorted first, rasterisation would wait
//! for memory.

use std::time::{Duration, Instant};

use fearless_simd::Level;
use rayon::prelude::*;

use super::bin::ScreenSplats;
use super::changes::Changes;
use super::pass_times::PassTimes;
use super::rasterize::{TilePixels, rasterize};
use super::sort::{Tile, TileList};
use crate::view::ScreenCamera;

/// Buffers that the passes fill, one element per tile.
pub(crate) struct TileBuffers<'a> {
    pub(crate) lists: &'a mut Vec<TileList>,
    pub(crate) pixels: &'a mut Vec<TilePixels>,
    /// Which splats changed the pixels, if that is wanted.
    pub(crate) changes: Option<&'a mut Vec<Changes>>,
}

/// The elements of one tile.
struct TileSlots<'a> {
    /// Number of the tile.
    index: usize,
    list: &'a mut TileList,
    pixels: &'a mut TilePixels,
    changes: Option<&'a mut Changes>,
}

/// Sorts and rasterises all tiles, and records what changed their pixels if the buffers ask for it.
/// Returns the time spent in `sort` and in `rasterize`, summed over threads.
pub(crate) fn sort_and_rasterize(
    level: Level,
    camera: &ScreenCamera,
    splats: ScreenSplats<'_>,
    TileBuffers { lists, pixels, changes }: TileBuffers<'_>,
) -> [Duration; 2] {
    let [across, down] = camera.tiles();
    lists.resize_with(across * down, TileList::default);
    pixels.resize(across * down, TilePixels::default());
    let times = PassTimes::default();
    // Work is taken tile by tile. By default rayon halves it twice, and again only when a thread
    // steals; a thread that finishes first would wait long.
    let tiles = lists.par_iter_mut().zip(pixels);
    let work = |TileSlots { index, list, pixels, changes }: TileSlots<'_>| {
        let start = Instant::now();
        list.sort(level, camera, splats, index);
        let middle = Instant::now();
        rasterize(level, camera, Tile { index, list }, pixels, changes);
        times.add([start, middle]);
    };
    match changes {
        Some(changes) => {
            changes.resize_with(across * down, Changes::default);
            tiles.zip(changes).enumerate().with_max_len(1).for_each(|(index, ((list, pixels), changes))| {
                work(TileSlots { index, list, pixels, changes: Some(changes) });
            });
        }
        None => tiles.enumerate().with_max_len(1).for_each(|(index, (list, pixels))| {
            work(TileSlots { index, list, pixels, changes: None });
        }),
    }
    times.totals()
}

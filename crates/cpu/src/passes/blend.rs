//! From lists of splats to pixels: `sort` and `rasterize`, tile by tile.
//!
//! A tile is blended as soon as it is sorted: its list is still in the core's cache then, from which the blocks fetch here and there. With
//! all tiles sorted first, rasterising waited for memory a third of its time.

use std::time::{Duration, Instant};

use fearless_simd::Level;
use rayon::prelude::*;

use super::bin::Bins;
use super::changes::Changes;
use super::project::Footprint;
use super::rasterize::{TilePixels, rasterize};
use super::shares::Shares;
use super::sort::TileList;
use crate::view::ScreenCamera;

/// A tile's list and pixels.
type Tile<'a> = (&'a mut TileList, &'a mut TilePixels);

/// Sorts and blends all tiles, and notes what changed their pixels for who asks for it. Returns the time spent in `sort` and in `rasterize`, summed
/// over threads.
pub(crate) fn sort_and_rasterize(
    level: Level,
    camera: &ScreenCamera,
    (bins, footprints): (&Bins, &[Footprint]),
    (lists, pixels, changes): (&mut Vec<TileList>, &mut Vec<TilePixels>, Option<&mut Vec<Changes>>),
) -> [Duration; 2] {
    let [across, down] = camera.tiles();
    lists.resize_with(across * down, TileList::default);
    pixels.resize(across * down, TilePixels::default());
    let shares = Shares::default();
    // Tile by tile: left to itself rayon halves the work twice, and again only for a thread that takes some of another's. Whoever is done first then
    // waits for up to a quarter.
    let tiles = lists.par_iter_mut().zip(pixels);
    let work = |(tile, ((list, pixels), changes)): (usize, (Tile<'_>, Option<&mut Changes>))| {
        let start = Instant::now();
        list.sort(level, camera, (bins, tile), footprints);
        let middle = Instant::now();
        rasterize(level, camera, (list, tile), (pixels, changes));
        shares.add([start, middle]);
    };
    match changes {
        Some(changes) => {
            changes.resize_with(across * down, Changes::default);
            tiles.zip(changes.par_iter_mut().map(Some)).enumerate().with_max_len(1).for_each(work);
        }
        None => tiles.map(|tile| (tile, None)).enumerate().with_max_len(1).for_each(work),
    }
    shares.totals()
}

//! The results of the passes up to the image, for tests that compare them pass by pass.
//!
//! In: camera, options. Out: [`ForwardPasses`].

use luxel_core::{Camera, Engine, EngineError, RenderOptions};

use crate::engine::GpuEngine;
use crate::frame::tile_digits;
use crate::layout::{BLOCK_PX, DEPTH_DIGITS, Entry, Footprint, State, TILE_PX};
use crate::screen::tiles;

/// The results of the passes of a render.
#[derive(Clone, Debug, Default)]
pub struct ForwardPasses {
    /// `project` and `color`, by splat: `None` if the splat touches no tile.
    pub footprints: Vec<Option<Footprint>>,
    /// `sort` by depth: visible splats front to back.
    pub depth_order: Vec<u32>,
    /// `bin` and `sort` by tile: each tile's splats, front to back. Rows of tiles one after the
    /// other.
    pub tile_splats: Vec<Vec<u32>>,
    /// `bin`: for each of [`Self::tile_splats`], a bit for each block of the tile's pixels that the
    /// splat touches, rows of blocks one after the other.
    pub tile_blocks: Vec<Vec<u32>>,
    /// Tiles across and down.
    pub tiles: [u32; 2],
}

impl ForwardPasses {
    /// Side of a tile, pixels.
    pub const TILE_PX: u32 = TILE_PX;
    /// Size of a block of pixels.
    pub const BLOCK_PX: [u32; 2] = BLOCK_PX;
}

impl GpuEngine {
    /// Renders, and reads back the results of each pass.
    ///
    /// # Errors
    /// The errors of [`Engine::render`].
    pub fn forward_passes(&mut self, camera: &Camera, options: &RenderOptions) -> Result<ForwardPasses, EngineError> {
        self.render(camera, options)?;
        let (gpu, frame, count) = (self.gpu(), self.frame(), self.len());
        let tiles = tiles(camera.size_px);
        let tile_count = tiles[0] * tiles[1];
        let numbers = |buffer, len: usize| gpu.read::<u32>(buffer, len);
        let footprints: Vec<Footprint> = gpu.read(&frame.splats.footprints, count)?;
        let places = numbers(&frame.splats.places, 2 * count)?;
        let state = gpu.read::<State>(&frame.state, 1)?.first().copied().unwrap_or_default();
        let entries = state.entries as usize;
        let emitted: Vec<Entry> = gpu.read(&frame.entries.emitted, entries)?;
        let order = numbers(&frame.entries.order[tile_digits(tile_count) % 2], entries)?;
        let ranges = numbers(&frame.pixels.ranges, 2 * tile_count as usize)?;
        let pair = |entry: &u32| emitted.get(*entry as usize).map(|Entry { splat, blocks }| (*splat, *blocks));
        let list = |range: &[u32]| -> Vec<(u32, u32)> {
            order.get(range[0] as usize..range[1] as usize).unwrap_or_default().iter().filter_map(pair).collect()
        };
        let lists: Vec<_> = ranges.chunks(2).map(list).collect();
        let column = |pick: fn(&(u32, u32)) -> u32| lists.iter().map(|list| list.iter().map(pick).collect()).collect();
        Ok(ForwardPasses {
            footprints: footprints.into_iter().zip(places.chunks(2)).map(|(f, place)| (place[1] > 0).then_some(f)).collect(),
            depth_order: numbers(&frame.splats.order[DEPTH_DIGITS as usize % 2], state.visible as usize)?,
            tile_splats: column(|pair| pair.0),
            tile_blocks: column(|pair| pair.1),
            tiles,
        })
    }
}

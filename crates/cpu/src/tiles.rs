//! Tiles of an image and blocks of a tile: their sizes.

/// Side of a block, pixels: its 16 pixels are a vector of [`crate::lanes::LANES`], row-major.
pub(crate) const BLOCK_PX: usize = 4;
/// Blocks along the side of a tile.
pub(crate) const TILE_BLOCKS: usize = 8;
/// Side of a tile, pixels.
pub(crate) const TILE_PX: usize = BLOCK_PX * TILE_BLOCKS;
/// Blocks of a tile, row-major.
pub(crate) const BLOCKS: usize = TILE_BLOCKS * TILE_BLOCKS;

// The pixels of a block fill a vector.
const _: () = assert!(BLOCK_PX * BLOCK_PX == crate::lanes::LANES);

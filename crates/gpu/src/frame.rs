//! The buffers of a step, kept between steps and enlarged when a step needs more.
//!
//! In: [`Sizes`]. Out: [`StepBuffers`].
//!
//! Sizes follow from splats, pixels and entries (pairs of a splat and a tile). The device finds the
//! number of entries: buffers have a capacity, and a step that needs more changes nothing and
//! reports it (see `engine.rs`).

use luxel_core::EngineError;
use wgpu::BufferUsages;

use crate::device::{Buffer, Gpu};
use crate::layout::{
    BUCKET, BUCKET_PIXELS_BYTES, BUCKETS_HEAD_BYTES, Bucket, CameraUniform, DEPTH_DIGITS, DIGIT_BITS, DIGITS, Dispatches,
    ENTRY_GRADIENT_BYTES, Footprint, LossUniform, OptimizerUniform, SORT_BLOCK, SORT_ENTRIES, SORT_IDENTITY, SortUniform, State,
};

/// Greatest number of digits in a tile's number: 2^27 tiles.
const TILE_DIGITS: u32 = 3;
/// Initial capacity for entries.
const FIRST_ENTRIES: u64 = 1 << 16;
/// Expected number of entries per splat.
const EXPECTED_TILES: u64 = 6;

/// The sizes that buffers must hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Sizes {
    pub(crate) splats: u64,
    pub(crate) tiles: u64,
    pub(crate) pixels: u64,
    pub(crate) entries: u64,
    /// Tiles and pixels of frames with a backward pass, which needs more memory for each than an
    /// image does; 0 without one.
    pub(crate) training_tiles: u64,
    pub(crate) training_pixels: u64,
}

/// All buffers of a step except the scene and the target.
pub(crate) struct StepBuffers {
    pub(crate) sizes: Sizes,
    pub(crate) camera: Buffer,
    pub(crate) loss: Buffer,
    pub(crate) optimizer: Buffer,
    pub(crate) state: Buffer,
    pub(crate) dispatches: Buffer,
    /// Uniforms, one for each digit.
    pub(crate) depth_sorts: Vec<Buffer>,
    pub(crate) tile_sorts: Vec<Buffer>,
    pub(crate) digit_totals: Buffer,
    pub(crate) splats: SplatBuffers,
    pub(crate) entries: EntryBuffers,
    pub(crate) pixels: PixelBuffers,
    pub(crate) digit_counts: Buffer,
}

/// Buffers with elements for each splat.
pub(crate) struct SplatBuffers {
    pub(crate) footprints: Buffer,
    pub(crate) depth_keys: [Buffer; 2],
    pub(crate) order: [Buffer; 2],
    pub(crate) places: Buffer,
    pub(crate) block_sums: Buffer,
}

/// Buffers with elements for each entry or bucket of entries.
pub(crate) struct EntryBuffers {
    pub(crate) tiles: [Buffer; 2],
    pub(crate) order: [Buffer; 2],
    pub(crate) splats: Buffer,
    pub(crate) gradients: Buffer,
    pub(crate) buckets: Buffer,
    pub(crate) bucket_pixels: Buffer,
}

/// Buffers with elements for each pixel or tile.
pub(crate) struct PixelBuffers {
    pub(crate) ranges: Buffer,
    pub(crate) image: Buffer,
    pub(crate) last_entries: Buffer,
    pub(crate) derivatives: Buffer,
    pub(crate) gradients: Buffer,
    pub(crate) group_sums: Buffer,
}

/// Returns the number of slots for buckets: the last bucket of each tile may be partly empty,
/// including that of the tile behind the last (see bin.wgsl).
fn slots(entries: u64, tiles: u64) -> u64 {
    entries / u64::from(BUCKET) + tiles + 1
}

/// Returns how many entries bindings of `bytes` can hold.
pub(crate) fn most_entries(bytes: u64, training_tiles: u64) -> u64 {
    let by_order = bytes / 4;
    if training_tiles == 0 {
        return by_order;
    }
    let by_gradients = bytes / ENTRY_GRADIENT_BYTES;
    let slots = (bytes / BUCKET_PIXELS_BYTES).saturating_sub(training_tiles + 1);
    by_order.min(by_gradients).min(slots * u64::from(BUCKET))
}

/// Returns the number of entries to begin with.
pub(crate) fn expected_entries(splats: u64) -> u64 {
    (splats * EXPECTED_TILES).max(FIRST_ENTRIES)
}

impl SplatBuffers {
    fn new(gpu: &Gpu, sizes: Sizes) -> Result<Self, EngineError> {
        let numbers = |label| gpu.storage(label, 4 * sizes.splats);
        Ok(Self {
            footprints: gpu.storage("footprints", size_of::<Footprint>() as u64 * sizes.splats)?,
            depth_keys: [numbers("depth keys")?, numbers("depth keys")?],
            order: [numbers("depth order")?, numbers("depth order")?],
            places: gpu.storage("places", 8 * sizes.splats)?,
            block_sums: gpu.storage("block sums", 8 * sizes.splats.div_ceil(256))?,
        })
    }
}

impl EntryBuffers {
    fn new(gpu: &Gpu, sizes: Sizes) -> Result<Self, EngineError> {
        let numbers = |label| gpu.storage(label, 4 * sizes.entries);
        let training = u64::from(sizes.training_tiles > 0);
        let slots_of = |tiles| slots(sizes.entries, tiles);
        Ok(Self {
            tiles: [numbers("entries' tiles")?, numbers("entries' tiles")?],
            order: [numbers("entries' order")?, numbers("entries' order")?],
            splats: numbers("entries' splats")?,
            gradients: gpu.storage("entries' gradients", training * ENTRY_GRADIENT_BYTES * sizes.entries)?,
            buckets: gpu.storage("buckets", BUCKETS_HEAD_BYTES + size_of::<Bucket>() as u64 * slots_of(sizes.tiles))?,
            bucket_pixels: gpu.storage("buckets' pixels", training * BUCKET_PIXELS_BYTES * slots_of(sizes.training_tiles))?,
        })
    }
}

impl PixelBuffers {
    fn new(gpu: &Gpu, sizes: Sizes) -> Result<Self, EngineError> {
        Ok(Self {
            ranges: gpu.storage("ranges", 8 * sizes.tiles)?,
            image: gpu.storage("image", 12 * sizes.pixels)?,
            last_entries: gpu.storage("last entries", 4 * sizes.pixels)?,
            derivatives: gpu.storage("derivatives of SSIM", 36 * sizes.training_pixels)?,
            gradients: gpu.storage("pixels' gradients", 16 * sizes.training_pixels)?,
            group_sums: gpu.storage("sums of the loss", 16 * sizes.tiles)?,
        })
    }
}

fn digit_counts(gpu: &Gpu, sizes: Sizes) -> Result<Buffer, EngineError> {
    let blocks = sizes.splats.max(sizes.entries).div_ceil(u64::from(SORT_BLOCK));
    gpu.storage("digit counts", 4 * u64::from(DIGITS) * blocks)
}

impl StepBuffers {
    /// Makes buffers of the least sizes.
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, EngineError> {
        let sizes = Sizes::default();
        let uniform = |label, bytes| gpu.buffer(label, bytes as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let sorts = |digits: u32, flags: u32| -> Result<Vec<Buffer>, EngineError> {
            let config = |digit: u32| SortUniform {
                shift: digit * DIGIT_BITS,
                count: 0,
                flags: flags | if digit == 0 { SORT_IDENTITY } else { 0 },
                padding: 0,
            };
            (0..digits).map(|digit| gpu.uniform("digit", &config(digit))).collect()
        };
        Ok(Self {
            sizes,
            camera: uniform("camera", size_of::<CameraUniform>())?,
            loss: uniform("loss", size_of::<LossUniform>())?,
            optimizer: uniform("optimizer", size_of::<OptimizerUniform>())?,
            state: gpu.storage("state", size_of::<State>() as u64)?,
            dispatches: gpu.buffer("dispatches", size_of::<Dispatches>() as u64, BufferUsages::STORAGE | BufferUsages::INDIRECT)?,
            depth_sorts: sorts(DEPTH_DIGITS, 0)?,
            tile_sorts: sorts(TILE_DIGITS, SORT_ENTRIES)?,
            digit_totals: gpu.storage("digit totals", 4 * u64::from(DIGITS))?,
            splats: SplatBuffers::new(gpu, sizes)?,
            entries: EntryBuffers::new(gpu, sizes)?,
            pixels: PixelBuffers::new(gpu, sizes)?,
            digit_counts: digit_counts(gpu, sizes)?,
        })
    }

    /// Returns sizes that are at least the present ones and at least `wanted`, with at most
    /// `most_entries` entries.
    pub(crate) fn grown(&self, wanted: Sizes, most_entries: u64) -> Sizes {
        let have = self.sizes;
        Sizes {
            splats: have.splats.max(wanted.splats),
            tiles: have.tiles.max(wanted.tiles),
            pixels: have.pixels.max(wanted.pixels),
            // A render may have used more than training has room for.
            entries: have.entries.max(wanted.entries).min(most_entries.max(1)),
            training_tiles: have.training_tiles.max(wanted.training_tiles),
            training_pixels: have.training_pixels.max(wanted.training_pixels),
        }
    }

    /// Makes buffers of the [`Self::grown`] `sizes`. The old ones are freed first, unless bindings
    /// refer to them or the device still uses them.
    pub(crate) fn grow(&mut self, gpu: &Gpu, sizes: Sizes) -> Result<(), EngineError> {
        let have = self.sizes;
        let grown = |pick: fn(Sizes) -> u64| pick(sizes) != pick(have);
        // If there is too little memory, the sizes still describe the existing buffers.
        if grown(|s| s.splats) {
            self.sizes.splats = 0;
            self.splats = SplatBuffers::new(gpu, Sizes::default())?;
            self.splats = SplatBuffers::new(gpu, sizes)?;
        }
        if grown(|s| s.entries) || grown(|s| s.tiles) || grown(|s| s.training_tiles) {
            self.sizes.entries = 0;
            self.entries = EntryBuffers::new(gpu, Sizes::default())?;
            self.entries = EntryBuffers::new(gpu, sizes)?;
        }
        if grown(|s| s.pixels) || grown(|s| s.tiles) || grown(|s| s.training_pixels) {
            (self.sizes.pixels, self.sizes.training_pixels) = (0, 0);
            self.pixels = PixelBuffers::new(gpu, Sizes::default())?;
            self.pixels = PixelBuffers::new(gpu, sizes)?;
        }
        self.digit_counts = digit_counts(gpu, sizes)?;
        self.sizes = sizes;
        Ok(())
    }

    /// Sets the number of splats for the sort by depth.
    pub(crate) fn set_count(&self, gpu: &Gpu, count: u32) {
        for sort in &self.depth_sorts {
            gpu.queue.write_buffer(&sort.raw, std::mem::offset_of!(SortUniform, count) as u64, bytemuck::bytes_of(&count));
        }
    }
}

/// Returns the number of digits for the numbers of tiles, and one beyond.
pub(crate) fn tile_digits(tiles: u32) -> usize {
    (32 - tiles.leading_zeros()).div_ceil(DIGIT_BITS).max(1) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adapter::MOST_BINDING_BYTES;

    #[test]
    fn digits_hold_the_number_beyond_the_last_tile() {
        for (tiles, digits) in [(1, 1), (49, 1), (511, 1), (512, 2), (2500, 2), ((1 << 18) - 1, 2), (1 << 18, 3), ((1 << 27) - 1, 3)] {
            assert_eq!(tile_digits(tiles), digits, "{tiles} tiles");
        }
    }

    #[test]
    fn as_many_entries_as_are_promised_fit_into_a_binding() {
        for (bytes, tiles) in [(1u64 << 27, 2500), (1 << 20, 49), (MOST_BINDING_BYTES, 32_400)] {
            let entries = most_entries(bytes, tiles);
            assert!(slots(entries, tiles) * BUCKET_PIXELS_BYTES <= bytes, "{bytes} {tiles}");
            assert!(entries * ENTRY_GRADIENT_BYTES <= bytes);
            assert!(most_entries(bytes, 0) * 4 <= bytes);
        }
        assert_eq!(most_entries(4096, 49), 0);
    }
}

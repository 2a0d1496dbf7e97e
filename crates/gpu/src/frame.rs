//! The buffers of a step, kept between steps and enlarged when a step needs more.
//!
//! In: [`Sizes`]. Out: [`StepBuffers`].
//!
//! Sizes follow from splats, pixels and entries (pairs of a splat and a tile). The device finds the
//! number of entries: buffers have a capacity, and a step that needs more changes nothing and
//! reports it (see `engine.rs`).

use bytemuck::Zeroable;
use luxel_core::EngineError;
use wgpu::BufferUsages;

use crate::device::{Buffer, Gpu};
use crate::forward::{Count, Extent, Resource};
use crate::layout::{
    BUCKET, BUCKET_PIXELS_BYTES, CameraUniform, DEPTH_DIGITS, DIGIT_BITS, ENTRY_GRADIENT_BYTES, Entry, GROUP_SUMS_BYTES, LensUniform,
    LossUniform, OptimizerUniform, SORT_COMPACT, SORT_ENTRIES, SORT_IDENTITY, SORT_VISIBLE, SortUniform,
};
use crate::scene::Shard;

/// Greatest number of digits in a tile's number: 2^27 tiles.
pub(crate) const TILE_DIGITS: u32 = 3;
/// Initial capacity for entries.
pub(crate) const FIRST_ENTRIES: u64 = 1 << 16;
/// Expected number of entries per splat.
pub(crate) const EXPECTED_TILES: u64 = 6;

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

impl Sizes {
    /// Returns the size of a storage buffer of the passes up to the image.
    pub(crate) fn bytes(&self, resource: Resource) -> u64 {
        let count = |count: &Count| match count {
            Count::Splats => self.splats,
            Count::Entries => self.entries,
            Count::Tiles => self.tiles,
            Count::Pixels => self.pixels,
        };
        let Extent { bytes, terms } = resource.extent();
        terms.iter().fold(bytes, |sum, term| {
            let largest = term.largest_of.iter().map(count).max().unwrap_or(0);
            sum + term.bytes * largest.div_ceil(term.per)
        })
    }
}

/// All buffers of a step except the scene and the target.
pub(crate) struct StepBuffers {
    pub(crate) sizes: Sizes,
    pub(crate) camera: Buffer,
    pub(crate) lens: Buffer,
    pub(crate) loss: Buffer,
    pub(crate) optimizer: Buffer,
    pub(crate) state: Buffer,
    pub(crate) dispatches: Buffer,
    /// Uniforms, one for each digit.
    pub(crate) depth_sorts: Vec<Buffer>,
    pub(crate) tile_sorts: Vec<Buffer>,
    /// Bits of the tiles' numbers that these uniforms are of.
    tile_bits: u32,
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
    pub(crate) emitted: Buffer,
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
    let by_pairs = bytes / size_of::<Entry>() as u64;
    if training_tiles == 0 {
        return by_pairs;
    }
    let by_gradients = bytes / ENTRY_GRADIENT_BYTES;
    let slots = (bytes / BUCKET_PIXELS_BYTES).saturating_sub(training_tiles + 1);
    by_pairs.min(by_gradients).min(slots * u64::from(BUCKET))
}

/// Returns the number of entries to begin with.
pub(crate) fn expected_entries(splats: u64) -> u64 {
    (splats * EXPECTED_TILES).max(FIRST_ENTRIES)
}

impl SplatBuffers {
    fn new(gpu: &Gpu, sizes: Sizes) -> Result<Self, EngineError> {
        let storage = |label, resource| gpu.storage(label, sizes.bytes(resource));
        Ok(Self {
            footprints: storage("footprints", Resource::Footprints)?,
            depth_keys: [storage("depth keys", Resource::DepthKeys(0))?, storage("depth keys", Resource::DepthKeys(1))?],
            order: [storage("depth order", Resource::DepthOrder(0))?, storage("depth order", Resource::DepthOrder(1))?],
            places: storage("places", Resource::Places)?,
            block_sums: storage("block sums", Resource::BlockSums)?,
        })
    }
}

impl EntryBuffers {
    fn new(gpu: &Gpu, sizes: Sizes) -> Result<Self, EngineError> {
        let storage = |label, resource| gpu.storage(label, sizes.bytes(resource));
        let training = u64::from(sizes.training_tiles > 0);
        Ok(Self {
            tiles: [storage("entries' tiles", Resource::EntryTiles(0))?, storage("entries' tiles", Resource::EntryTiles(1))?],
            order: [storage("entries' order", Resource::EntryOrder(0))?, storage("entries' order", Resource::EntryOrder(1))?],
            emitted: storage("entries", Resource::Entries)?,
            gradients: gpu.storage("entries' gradients", training * ENTRY_GRADIENT_BYTES * sizes.entries)?,
            buckets: storage("buckets", Resource::Buckets)?,
            bucket_pixels: gpu.storage("buckets' pixels", training * BUCKET_PIXELS_BYTES * slots(sizes.entries, sizes.training_tiles))?,
        })
    }
}

impl PixelBuffers {
    fn new(gpu: &Gpu, sizes: Sizes) -> Result<Self, EngineError> {
        Ok(Self {
            ranges: gpu.storage("ranges", sizes.bytes(Resource::Ranges))?,
            image: gpu.storage("image", sizes.bytes(Resource::Image))?,
            last_entries: gpu.storage("last entries", sizes.bytes(Resource::LastEntries))?,
            derivatives: gpu.storage("derivatives of SSIM", 36 * sizes.training_pixels)?,
            gradients: gpu.storage("pixels' gradients", 16 * sizes.training_pixels)?,
            group_sums: gpu.storage("sums of the loss", GROUP_SUMS_BYTES * sizes.tiles)?,
        })
    }
}

fn digit_counts(gpu: &Gpu, sizes: Sizes) -> Result<Buffer, EngineError> {
    gpu.storage("digit counts", sizes.bytes(Resource::DigitCounts))
}

impl StepBuffers {
    /// Makes buffers of the least sizes.
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, EngineError> {
        let sizes = Sizes::default();
        let uniform = |label, bytes| gpu.buffer(label, bytes as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let uniforms =
            |sorts: &[SortUniform]| -> Result<Vec<Buffer>, EngineError> { sorts.iter().map(|sort| gpu.uniform("digit", sort)).collect() };
        Ok(Self {
            sizes,
            camera: uniform("camera", size_of::<CameraUniform>())?,
            lens: uniform("lens", size_of::<LensUniform>())?,
            loss: uniform("loss", size_of::<LossUniform>())?,
            optimizer: uniform("optimizer", size_of::<OptimizerUniform>())?,
            state: gpu.storage("state", sizes.bytes(Resource::State))?,
            dispatches: gpu.buffer("dispatches", sizes.bytes(Resource::Dispatches), BufferUsages::STORAGE | BufferUsages::INDIRECT)?,
            depth_sorts: uniforms(&depth_sorts())?,
            tile_sorts: uniforms(&vec![Zeroable::zeroed(); TILE_DIGITS as usize])?,
            tile_bits: 0,
            digit_totals: gpu.storage("digit totals", sizes.bytes(Resource::DigitTotals))?,
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

    /// Returns a buffer of the passes up to the image; those of a shard need one.
    pub(crate) fn resource<'a>(&'a self, resource: Resource, shard: Option<&'a Shard>) -> Option<&'a Buffer> {
        let Self { splats, entries, pixels, .. } = self;
        Some(match resource {
            Resource::Camera => &self.camera,
            Resource::Lens => &self.lens,
            Resource::Shard => &shard?.uniform,
            Resource::Parameters => &shard?.parameters,
            Resource::State => &self.state,
            Resource::Dispatches => &self.dispatches,
            Resource::DepthSort(digit) => self.depth_sorts.get(digit)?,
            Resource::TileSort(digit) => self.tile_sorts.get(digit)?,
            Resource::DigitCounts => &self.digit_counts,
            Resource::DigitTotals => &self.digit_totals,
            Resource::Footprints => &splats.footprints,
            Resource::DepthKeys(n) => splats.depth_keys.get(n)?,
            Resource::DepthOrder(n) => splats.order.get(n)?,
            Resource::Places => &splats.places,
            Resource::BlockSums => &splats.block_sums,
            Resource::EntryTiles(n) => entries.tiles.get(n)?,
            Resource::EntryOrder(n) => entries.order.get(n)?,
            Resource::Entries => &entries.emitted,
            Resource::Buckets => &entries.buckets,
            Resource::BucketPixels => &entries.bucket_pixels,
            Resource::Ranges => &pixels.ranges,
            Resource::Image => &pixels.image,
            Resource::LastEntries => &pixels.last_entries,
        })
    }

    /// Sets the digits of the sort by tile for so many tiles.
    pub(crate) fn set_tiles(&mut self, gpu: &Gpu, tiles: u32) {
        let bits = tile_bits(tiles);
        if std::mem::replace(&mut self.tile_bits, bits) == bits {
            return;
        }
        for (buffer, sort) in self.tile_sorts.iter().zip(tile_sorts(bits)) {
            gpu.queue.write_buffer(&buffer.raw, 0, bytemuck::bytes_of(&sort));
        }
    }

    /// Sets the number of splats for the sort by depth.
    pub(crate) fn set_count(&self, gpu: &Gpu, count: u32) {
        for sort in &self.depth_sorts {
            gpu.queue.write_buffer(&sort.raw, std::mem::offset_of!(SortUniform, count) as u64, bytemuck::bytes_of(&count));
        }
    }
}

/// Returns the uniforms of the sort by depth; the number of splats is set later.
pub(crate) fn depth_sorts() -> Vec<SortUniform> {
    let flags = |digit| if digit == 0 { SORT_IDENTITY | SORT_COMPACT } else { SORT_VISIBLE };
    (0..DEPTH_DIGITS).map(|digit| SortUniform { shift: digit * DIGIT_BITS, count: 0, flags: flags(digit), bits: DIGIT_BITS }).collect()
}

/// Returns the uniforms of the sort by tile, one for each digit, where the numbers of tiles have so
/// many bits: as few digits as hold them, all of one length.
pub(crate) fn tile_sorts(tile_bits: u32) -> Vec<SortUniform> {
    let digits = tile_bits.div_ceil(DIGIT_BITS).max(1);
    let bits = tile_bits.div_ceil(digits).max(1);
    let flags = |digit| SORT_ENTRIES | if digit == 0 { SORT_IDENTITY } else { 0 };
    (0..digits).map(|digit| SortUniform { shift: digit * bits, count: 0, flags: flags(digit), bits }).collect()
}

/// Returns the number of bits of the numbers of tiles, and one beyond.
pub(crate) fn tile_bits(tiles: u32) -> u32 {
    32 - tiles.leading_zeros()
}

/// Returns the number of digits for the numbers of tiles, and one beyond.
pub(crate) fn tile_digits(tiles: u32) -> usize {
    tile_sorts(tile_bits(tiles)).len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adapter::MOST_BINDING_BYTES;

    #[test]
    fn digits_hold_the_number_beyond_the_last_tile() {
        for (tiles, digits) in [(1, 1), (49, 1), (511, 1), (512, 2), (2500, 2), ((1 << 18) - 1, 2), (1 << 18, 3), ((1 << 27) - 1, 3)] {
            assert_eq!(tile_digits(tiles), digits, "{tiles} tiles");
            let sorts = tile_sorts(tile_bits(tiles));
            let [shift, bits] = sorts.last().map(|last| [last.shift, last.bits]).unwrap();
            assert!(sorts.iter().zip(0..).all(|(sort, n)| sort.shift == n * bits && sort.bits <= DIGIT_BITS), "{tiles} tiles");
            assert!(u64::from(tiles) < 1 << (shift + bits), "{tiles} tiles");
        }
        // 1600x1200 pixels: two digits of seven bits, not of nine.
        assert_eq!(tile_sorts(tile_bits(7500)).iter().map(|sort| sort.bits).collect::<Vec<_>>(), [7, 7]);
    }

    #[test]
    fn as_many_entries_as_are_promised_fit_into_a_binding() {
        for (bytes, tiles) in [(1u64 << 27, 2500), (1 << 20, 49), (MOST_BINDING_BYTES, 32_400)] {
            let entries = most_entries(bytes, tiles);
            assert!(slots(entries, tiles) * BUCKET_PIXELS_BYTES <= bytes, "{bytes} {tiles}");
            assert!(entries * ENTRY_GRADIENT_BYTES <= bytes);
            assert!(most_entries(bytes, 0) * size_of::<Entry>() as u64 <= bytes);
        }
        assert_eq!(most_entries(4096, 49), 0);
    }
}

//! The passes up to the image as data: kernels in order, their buffers, their workgroups, and the
//! sizes of the buffers.
//!
//! In: the colour model, digits of the sort by tile. Out: [`Dispatch`]es. The engine records from
//! them (`step.rs`) and allocates by them (`frame.rs`); the viewer's page, which runs the same
//! shaders in the browser, has them as JSON (`forward/page.rs`), so the two cannot drift apart.

use luxel_core::{ColorModel, Pass};

use crate::kernels::KernelId;
use crate::layout::{BUCKET, BUCKETS_HEAD_BYTES, Bucket, DEPTH_DIGITS, DIGITS, Dispatches, Entry, Footprint, SORT_BLOCK, State};

#[cfg(test)]
mod page;

/// Splats per workgroup of the kernels that run over them.
pub(crate) const SPLATS: u64 = 256;
/// Tiles per workgroup of `bin_ranges`.
const TILES: u64 = 64;

/// A buffer of the passes up to the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Resource {
    Camera,
    /// The uniform of the shard.
    Shard,
    /// The parameters of the shard.
    Parameters,
    State,
    Dispatches,
    /// The uniform of a digit of the sort by depth.
    DepthSort(usize),
    /// The uniform of a digit of the sort by tile.
    TileSort(usize),
    DigitCounts,
    DigitTotals,
    Footprints,
    DepthKeys(usize),
    DepthOrder(usize),
    Places,
    BlockSums,
    EntryTiles(usize),
    EntryOrder(usize),
    Entries,
    Buckets,
    /// For training; of the least size for an image.
    BucketPixels,
    Ranges,
    Image,
    LastEntries,
    /// The uniform of the lens, for cameras whose pixels are rays.
    Lens,
}

/// The pixels of a camera, which decide the kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PixelKind {
    /// Places on the image plane of a pinhole.
    Places,
    /// Rays.
    Rays,
}

impl PixelKind {
    /// Returns the kernel for these pixels; those of rays read the lens.
    fn dispatch(self, pinhole: Dispatch, rays: KernelId) -> Dispatch {
        match self {
            Self::Places => pinhole,
            Self::Rays => {
                let mut bindings = pinhole.bindings;
                bindings.push(at(LENS_SLOT, Resource::Lens));
                Dispatch { kernel: rays, bindings, ..pinhole }
            }
        }
    }
}

/// The number of the lens after `@binding`.
pub(crate) const LENS_SLOT: u32 = 15;

/// A number that sizes follow from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Count {
    Splats,
    Entries,
    Tiles,
    Pixels,
}

/// The size of a buffer: a constant, and so many bytes for each `per` of the largest of some
/// counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Extent {
    pub(crate) bytes: u64,
    pub(crate) terms: &'static [Term],
}

/// A part of an [`Extent`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Term {
    pub(crate) largest_of: &'static [Count],
    pub(crate) per: u64,
    pub(crate) bytes: u64,
}

/// The number of workgroups of a [`Dispatch`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Workgroups {
    /// This many.
    Fixed(u64),
    /// One for each `per` of a count and `plus` more.
    Per { count: Count, plus: u64, per: u64 },
    /// Written by the device at an offset of [`Resource::Dispatches`].
    Indirect(usize),
}

/// A kernel with its buffers, by their number in the shader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Dispatch {
    pub(crate) pass: Pass,
    pub(crate) kernel: KernelId,
    pub(crate) bindings: Vec<Bound>,
    pub(crate) workgroups: Workgroups,
}

/// A buffer at the number after `@binding`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bound {
    pub(crate) slot: u32,
    pub(crate) resource: Resource,
}

fn at(slot: u32, resource: Resource) -> Bound {
    Bound { slot, resource }
}

impl Resource {
    /// Returns the size of a storage buffer.
    pub(crate) fn extent(self) -> Extent {
        /// Bytes for each splat, entry, tile or pixel.
        macro_rules! each {
            ($count:ident, $per:expr, $bytes:expr) => {
                &[Term { largest_of: &[Count::$count], per: $per as u64, bytes: $bytes as u64 }]
            };
        }
        let none: &[Term] = &[];
        let (bytes, terms) = match self {
            Self::Camera | Self::Lens | Self::Shard | Self::Parameters | Self::DepthSort(_) | Self::TileSort(_) | Self::BucketPixels => {
                (0, none)
            }
            Self::State => (size_of::<State>() as u64, none),
            Self::Dispatches => (size_of::<Dispatches>() as u64, none),
            Self::DigitTotals => (4 * u64::from(DIGITS), none),
            Self::DigitCounts => {
                let blocks: &[Term] =
                    &[Term { largest_of: &[Count::Splats, Count::Entries], per: SORT_BLOCK as u64, bytes: 4 * DIGITS as u64 }];
                (0, blocks)
            }
            Self::Footprints => (0, each!(Splats, 1, size_of::<Footprint>()) as &[Term]),
            Self::DepthKeys(_) | Self::DepthOrder(_) => (0, each!(Splats, 1, 4) as &[Term]),
            Self::Places => (0, each!(Splats, 1, 8) as &[Term]),
            Self::BlockSums => (0, each!(Splats, SPLATS, 8) as &[Term]),
            Self::EntryTiles(_) | Self::EntryOrder(_) => (0, each!(Entries, 1, 4) as &[Term]),
            Self::Entries => (0, each!(Entries, 1, size_of::<Entry>()) as &[Term]),
            Self::Buckets => {
                // The last bucket of each tile may be partly empty, including that of the tile
                // behind the last (see bin.wgsl).
                let slot = size_of::<Bucket>() as u64;
                let slots: &[Term] = &[
                    Term { largest_of: &[Count::Entries], per: BUCKET as u64, bytes: size_of::<Bucket>() as u64 },
                    Term { largest_of: &[Count::Tiles], per: 1, bytes: size_of::<Bucket>() as u64 },
                ];
                (BUCKETS_HEAD_BYTES + slot, slots)
            }
            Self::Ranges => (0, each!(Tiles, 1, 8) as &[Term]),
            Self::Image => (0, each!(Pixels, 1, 12) as &[Term]),
            Self::LastEntries => (0, each!(Pixels, 1, 4) as &[Term]),
        };
        Extent { bytes, terms }
    }
}

/// Returns pass `project`, which runs once for each shard; its number of splats is the shard's.
pub(crate) fn project(model: ColorModel, light: usize, pixels: PixelKind) -> Dispatch {
    let bindings = vec![
        at(0, Resource::Camera),
        at(1, Resource::Shard),
        at(2, Resource::Parameters),
        at(3, Resource::Footprints),
        at(4, Resource::DepthKeys(0)),
        at(5, Resource::Places),
    ];
    let workgroups = per(Count::Splats, SPLATS);
    let pinhole = Dispatch { pass: Pass::Project, kernel: KernelId::Project(model, light), bindings, workgroups };
    pixels.dispatch(pinhole, KernelId::ProjectRays(model, light))
}

fn per(count: Count, per: u64) -> Workgroups {
    Workgroups::Per { count, plus: 0, per }
}

/// The buffers of one digit of a sort.
struct Digit {
    config: Resource,
    keys: [Resource; 2],
    values: [Resource; 2],
    workgroups: Workgroups,
}

impl Digit {
    /// Sorts from the first of each pair of buffers to the second.
    fn dispatches(&self) -> [Dispatch; 3] {
        let Self { config, keys, values, workgroups } = *self;
        let [config, state] = [at(0, config), at(1, Resource::State)];
        let [counts, totals] = [at(6, Resource::DigitCounts), at(7, Resource::DigitTotals)];
        let [from, to] = keys;
        let sort = |kernel, bindings, workgroups| Dispatch { pass: Pass::Sort, kernel, bindings, workgroups };
        [
            sort(KernelId::SortCount, vec![config, state, at(2, from), counts], workgroups),
            sort(KernelId::SortScan, vec![config, state, counts, totals], Workgroups::Fixed(DIGITS.into())),
            sort(
                KernelId::SortScatter,
                vec![config, state, at(2, from), at(3, values[0]), at(4, to), at(5, values[1]), counts, totals],
                workgroups,
            ),
        ]
    }
}

/// Returns the pair of the buffers that digit number `digit` reads and writes.
fn turned(buffers: fn(usize) -> Resource, digit: usize) -> [Resource; 2] {
    [buffers(digit % 2), buffers(1 - digit % 2)]
}

/// Returns the sort of splats by depth.
pub(crate) fn sort_by_depth() -> Vec<Dispatch> {
    let digit = |digit| Digit {
        config: Resource::DepthSort(digit),
        keys: turned(Resource::DepthKeys, digit),
        values: turned(Resource::DepthOrder, digit),
        workgroups: per(Count::Splats, SORT_BLOCK.into()),
    };
    (0..DEPTH_DIGITS as usize).flat_map(|n| digit(n).dispatches()).collect()
}

/// Returns pass `bin`.
pub(crate) fn bin(pixels: PixelKind) -> Vec<Dispatch> {
    let order = at(2, Resource::DepthOrder(DEPTH_DIGITS as usize % 2));
    let [camera, state] = [at(0, Resource::Camera), at(1, Resource::State)];
    let [places, sums] = [at(3, Resource::Places), at(4, Resource::BlockSums)];
    let blocks = per(Count::Splats, SPLATS);
    let bin = |kernel, bindings, workgroups| Dispatch { pass: Pass::Bin, kernel, bindings, workgroups };
    let emitted = [at(5, Resource::Footprints), at(6, Resource::EntryTiles(0)), at(7, Resource::Entries)];
    vec![
        bin(KernelId::BinSum, vec![camera, state, order, places, sums], blocks),
        bin(KernelId::BinScan, vec![camera, state, sums, at(8, Resource::Dispatches)], Workgroups::Fixed(1)),
        pixels.dispatch(
            bin(KernelId::BinEmit, [camera, state, order, places, sums].into_iter().chain(emitted).collect(), blocks),
            KernelId::BinEmitRays,
        ),
    ]
}

/// Returns the sort of entries by tile, of so many digits, which keeps the order of depths.
pub(crate) fn sort_by_tile(digits: usize) -> Vec<Dispatch> {
    let digit = |digit| Digit {
        config: Resource::TileSort(digit),
        keys: turned(Resource::EntryTiles, digit),
        values: turned(Resource::EntryOrder, digit),
        workgroups: Workgroups::Indirect(std::mem::offset_of!(Dispatches, sort)),
    };
    let ranges = vec![
        at(0, Resource::Camera),
        at(1, Resource::State),
        at(9, Resource::EntryTiles(digits % 2)),
        at(10, Resource::Ranges),
        at(11, Resource::Buckets),
    ];
    // One beyond the last tile: see the remark on rounding in bin.wgsl.
    let workgroups = Workgroups::Per { count: Count::Tiles, plus: 1, per: TILES };
    let ranges = Dispatch { pass: Pass::Sort, kernel: KernelId::BinRanges, bindings: ranges, workgroups };
    (0..digits).flat_map(|n| digit(n).dispatches()).chain([ranges]).collect()
}

/// Returns pass `rasterize` after a sort of so many digits.
pub(crate) fn rasterize(digits: usize, pixels: PixelKind) -> Dispatch {
    let bindings = vec![
        at(0, Resource::Camera),
        at(1, Resource::Footprints),
        at(2, Resource::Ranges),
        at(3, Resource::EntryOrder(digits % 2)),
        at(4, Resource::Entries),
        at(5, Resource::Image),
        at(6, Resource::LastEntries),
        at(7, Resource::BucketPixels),
    ];
    let workgroups = per(Count::Tiles, 1);
    let pinhole = Dispatch { pass: Pass::Rasterize, kernel: KernelId::Rasterize, bindings, workgroups };
    pixels.dispatch(pinhole, KernelId::RasterizeRays)
}

//! Keeps what the passes of a step know about each tile: its sorted list, and what changed its
//! pixels.
//!
//! In: [`TileInputs`], and the memory that may be kept. Out: a [`TileRecord`] for each tile.
//!
//! The records of a large image are gigabytes. Those that fit into the memory are kept from one
//! pass to the next. For the other tiles each thread has one record, which its next tile
//! overwrites, and a later pass makes them again. Both ways give the same bits: no result depends
//! on the memory, nor on which tile came first.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use luxel_lanes::Level;

use super::bin::ScreenSplats;
use super::changes::Changes;
use super::rasterize::{TilePixels, rasterize};
use super::sort::{SortBuffers, Tile, TileList};
use super::splat_channels::SplatChannels;
use crate::view::ScreenCamera;

/// The records that passes after the image want.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Recording {
    /// None: the image is all that is wanted.
    Nothing,
    /// Sorted lists.
    Lists,
    /// Sorted lists and changes, for the backward pass.
    Changes,
}

/// The inputs of a tile's record.
#[derive(Clone, Copy)]
pub(crate) struct TileInputs<'a> {
    pub(crate) level: Level,
    pub(crate) camera: &'a ScreenCamera,
    pub(crate) splats: ScreenSplats<'a>,
    pub(crate) recording: Recording,
    /// The splats' channels, where they are not the radiance of their footprints.
    pub(crate) channels: Option<&'a SplatChannels<'a>>,
}

impl TileInputs<'_> {
    /// Blends a tile by its list, and records what changed its pixels if that is wanted.
    pub(crate) fn rasterize(&self, index: usize, record: &mut TileRecord, pixels: &mut TilePixels) {
        let TileRecord { list, changes } = record;
        if let Some(channels) = self.channels {
            channels.color_entries(self.splats.bins, index, list);
        }
        let changes = (self.recording == Recording::Changes).then_some(changes);
        rasterize(self.level, self.camera, Tile { index, list }, pixels, changes);
    }
}

/// A tile's sorted list, and what changed its pixels.
#[derive(Default)]
pub(crate) struct TileRecord {
    pub(crate) list: TileList,
    pub(crate) changes: Changes,
}

impl TileRecord {
    /// Returns the memory that the record holds, bytes.
    fn capacity_bytes(&self) -> usize {
        self.list.capacity_bytes() + self.changes.capacity_bytes()
    }

    /// Returns the memory that a copy takes, bytes.
    fn used_bytes(&self) -> usize {
        self.list.used_bytes() + self.changes.used_bytes()
    }

    /// Returns a copy with no more memory than it needs.
    fn exact_copy(&self) -> Self {
        Self { list: self.list.exact_copy(), changes: self.changes.exact_copy() }
    }
}

/// The place of a tile's record.
#[derive(Default)]
pub(crate) struct Slot {
    record: TileRecord,
    /// Whether the record is that of the last pass.
    is_kept: bool,
}

/// The buffers of a thread.
#[derive(Default)]
pub(crate) struct Workbench {
    pub(crate) buffers: SortBuffers,
    /// The record of the last tile without room for its own.
    pub(crate) record: TileRecord,
    /// Other channels of a tile's entries.
    pub(crate) colors: Vec<f32>,
    pixels: TilePixels,
}

/// The records of all tiles.
pub(crate) struct TileRecords {
    slots: Vec<Slot>,
    shelf: Shelf,
}

/// The memory for records, as threads share it.
#[derive(Default)]
pub(crate) struct Shelf {
    /// One for each thread. No thread waits for another's.
    benches: Vec<Mutex<Workbench>>,
    limit_bytes: usize,
    /// Bytes of the records that the last passes kept.
    kept_bytes: AtomicUsize,
}

impl TileRecords {
    /// Returns no records, and room for so many bytes of them.
    pub(crate) fn with_limit(limit_bytes: usize) -> Self {
        Self { slots: Vec::new(), shelf: Shelf { limit_bytes, ..Shelf::default() } }
    }

    /// Changes the room for records, and forgets those that are there.
    pub(crate) fn set_limit(&mut self, limit_bytes: usize) {
        *self = Self::with_limit(limit_bytes);
    }

    /// Changes the room for records that are made from now on.
    pub(crate) fn limit(&mut self, limit_bytes: usize) {
        self.shelf.limit_bytes = limit_bytes;
    }

    /// Returns the room for records, bytes.
    pub(crate) fn limit_bytes(&self) -> usize {
        self.shelf.limit_bytes
    }

    /// Gives all memory back.
    pub(crate) fn release(&mut self) {
        self.set_limit(self.shelf.limit_bytes);
    }

    /// Returns the memory of the records that the last passes kept, bytes.
    pub(crate) fn kept_bytes(&mut self) -> usize {
        *self.shelf.kept_bytes.get_mut()
    }

    /// Begins to make the records of so many tiles.
    pub(crate) fn begin(&mut self, tiles: usize, recording: Recording) -> (&mut [Slot], &Shelf) {
        self.slots.resize_with(tiles, Slot::default);
        self.shelf.benches.resize_with(rayon::current_num_threads(), Mutex::default);
        if recording != Recording::Nothing {
            *self.shelf.kept_bytes.get_mut() = 0;
        }
        (&mut self.slots, &self.shelf)
    }

    /// Calls `read` with a tile's record, which is made again if it was not kept.
    pub(crate) fn read<R>(&self, inputs: &TileInputs<'_>, tile: usize, read: impl FnOnce(&TileRecord) -> R) -> R {
        let slot = &self.slots[tile];
        if slot.is_kept {
            return read(&slot.record);
        }
        let Workbench { buffers, record, pixels, .. } = &mut *self.shelf.bench();
        record.list.sort(inputs.level, inputs.camera, inputs.splats, tile, buffers);
        if inputs.recording == Recording::Changes {
            inputs.rasterize(tile, record, pixels);
        }
        read(record)
    }
}

impl Shelf {
    /// Returns the buffers of the thread. Nothing that is done with it may wait for other tiles.
    pub(crate) fn bench(&self) -> MutexGuard<'_, Workbench> {
        self.benches[rayon::current_thread_index().unwrap_or(0)].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether there is room for so many bytes more, and takes it.
    fn take(&self, bytes: usize) -> bool {
        let is_there = self.kept_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes <= self.limit_bytes;
        if !is_there {
            self.kept_bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
        is_there
    }
}

impl Slot {
    /// Returns the record to fill: the tile's own, or that of the thread where it has none.
    pub(crate) fn record<'a>(&'a mut self, of_thread: &'a mut TileRecord, recording: Recording) -> &'a mut TileRecord {
        self.is_kept = false;
        if recording != Recording::Nothing && self.record.capacity_bytes() > 0 { &mut self.record } else { of_thread }
    }

    /// Keeps the record that was filled, if there is room for it.
    pub(crate) fn keep(&mut self, of_thread: &TileRecord, shelf: &Shelf) {
        let own_bytes = self.record.capacity_bytes();
        let bytes = if own_bytes > 0 { own_bytes } else { of_thread.used_bytes() };
        self.is_kept = shelf.take(bytes);
        if !self.is_kept {
            self.record = TileRecord::default();
        } else if own_bytes == 0 {
            self.record = of_thread.exact_copy();
        }
    }
}

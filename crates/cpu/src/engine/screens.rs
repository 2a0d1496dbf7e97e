//! The data of projected splats and of their images, and the buffers that they give back.

use std::sync::Arc;

use luxel_lanes::Level;

use super::spare::{Spare, SpareNumbers};
use crate::passes::activated::ActivatedStore;
use crate::passes::bin::{Bins, ScreenSplats};
use crate::passes::blend::{ChannelGradient, ChannelPixels, EntrySums};
use crate::passes::project::Footprint;
use crate::passes::tile_records::TileRecords;
use crate::view::ScreenCamera;

/// The part of the engine that its handles share.
pub(super) struct Shared {
    pub(super) pool: Arc<rayon::ThreadPool>,
    pub(super) level: Level,
    /// Memory for the records of all tiles of a handle, bytes.
    pub(super) record_bytes: usize,
    pub(super) spare: Arc<SpareBuffers>,
}

/// Buffers of handles that were dropped.
#[derive(Default)]
pub(super) struct SpareBuffers {
    pub(super) views: Spare<ViewBuffers>,
    pub(super) blends: Spare<BlendBuffers>,
    pub(super) gradients: Spare<GradientBuffers>,
    pub(super) numbers: SpareNumbers,
}

/// Splats on the screens of cameras, which blended images keep alive.
pub(super) struct Screens {
    pub(super) shared: Shared,
    pub(super) splats: ActivatedStore,
    pub(super) size_px: [usize; 2],
    pub(super) views: Vec<ScreenView>,
}

/// The screen of a camera.
pub(super) struct ScreenView {
    pub(super) camera: ScreenCamera,
    pub(super) buffers: ViewBuffers,
}

/// The buffers of a screen.
#[derive(Default)]
pub(super) struct ViewBuffers {
    pub(super) footprints: Vec<Footprint>,
    pub(super) bins: Bins,
    /// For each block a bit for each splat that is not culled.
    pub(super) visible: Vec<u16>,
}

impl ScreenView {
    /// Returns the splats in their bins.
    pub(super) fn splats(&self) -> ScreenSplats<'_> {
        ScreenSplats { bins: &self.buffers.bins, footprints: &self.buffers.footprints }
    }
}

impl Drop for Screens {
    fn drop(&mut self) {
        for view in self.views.drain(..) {
            self.shared.spare.views.give_back(view.buffers);
        }
    }
}

/// The buffers of an image.
pub(super) struct BlendBuffers {
    pub(super) records: TileRecords,
    pub(super) pixels: ChannelPixels,
}

impl Default for BlendBuffers {
    fn default() -> Self {
        Self { records: TileRecords::with_limit(0), pixels: ChannelPixels::default() }
    }
}

/// The buffers of a backward pass.
#[derive(Default)]
pub(super) struct GradientBuffers {
    pub(super) pixels: ChannelGradient,
    pub(super) entries: EntrySums,
}

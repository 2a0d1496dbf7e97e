//! A cache of target images on the device, because training uses the same views again and again.
//!
//! In: views. Out: their images as buffers. Degenerate: if memory runs out, the cache is emptied.
//!
//! A view is identified by its image and mask: by their allocations, or by what they are read from,
//! which weak references keep from being reused. Images are kept in the order in which they come
//! until the cache is full; those that come later are uploaded each time they are used. Views come
//! in a new order each epoch, so that this fixed part is found as often as its share of the images,
//! and removing the least recently used would find far fewer. All are removed if other buffers
//! would not fit.

use std::sync::Arc;

use luxel_core::{EngineError, Identity, Image, Mask, View};

use crate::device::{Buffer, Gpu};

/// Capacity of the cache unless another is set, bytes.
const BUDGET_BYTES: u64 = 2 << 30;

/// The image of a view.
pub(crate) struct Target {
    image: Identity<Image>,
    mask: Option<Identity<Mask>>,
    bytes: u64,
    /// `[H*W,3]`.
    pub(crate) pixels: Arc<Buffer>,
    /// One weight per pixel, if the view has a mask.
    pub(crate) weights: Option<Arc<Buffer>>,
    /// Sum of the weights.
    pub(crate) total: f64,
}

/// The cache of images on the device.
pub(crate) struct Targets {
    kept: Vec<Target>,
    /// The last image that found no room among the kept.
    passing: Option<Target>,
    budget_bytes: u64,
    dropped: bool,
    uploaded_bytes: u64,
}

impl Default for Targets {
    fn default() -> Self {
        Self { kept: Vec::new(), passing: None, budget_bytes: BUDGET_BYTES, dropped: false, uploaded_bytes: 0 }
    }
}

impl Target {
    fn is_of(&self, view: &View) -> bool {
        let same_mask = match (&self.mask, &view.mask) {
            (None, None) => true,
            (Some(kept), Some(wanted)) => kept.is_of(wanted),
            _ => false,
        };
        same_mask && self.image.is_of(&view.image)
    }

    fn is_alive(&self) -> bool {
        self.image.is_alive() && self.mask.as_ref().is_none_or(Identity::is_alive)
    }
}

impl Targets {
    /// Lowers the capacity; images beyond it are removed.
    pub(crate) fn set_budget(&mut self, bytes: u64) {
        self.budget_bytes = bytes.min(BUDGET_BYTES);
        if self.bytes() > self.budget_bytes {
            self.clear();
        }
    }

    /// Returns the bytes that are kept.
    pub(crate) fn bytes(&self) -> u64 {
        self.kept.iter().map(|target| target.bytes).sum()
    }

    /// Returns the image of a view, and uploads it if it is not cached.
    pub(crate) fn get(&mut self, gpu: &Gpu, view: &View) -> Result<&Target, EngineError> {
        if let Some(at) = self.kept.iter().position(|target| target.is_of(view)) {
            return Ok(&self.kept[at]);
        }
        if !self.passing.as_ref().is_some_and(|target| target.is_of(view)) {
            self.remove_unreachable();
            let bytes = bytes_of(view);
            let target = upload(gpu, view)?;
            self.uploaded_bytes += bytes;
            if self.bytes() + bytes <= self.budget_bytes {
                self.kept.push(target);
                return Ok(&self.kept[self.kept.len() - 1]);
            }
            self.dropped |= self.passing.is_some();
            self.passing = Some(target);
        }
        self.passing.as_ref().ok_or_else(|| EngineError::invalid("a target image was not kept"))
    }

    /// Removes images whose views no longer exist: they cannot be requested again.
    fn remove_unreachable(&mut self) {
        let before = self.kept.len();
        self.kept.retain(Target::is_alive);
        self.dropped |= self.kept.len() < before;
    }

    /// Returns the number of bytes uploaded since the last call.
    pub(crate) fn take_uploaded(&mut self) -> u64 {
        std::mem::take(&mut self.uploaded_bytes)
    }

    /// Removes all images.
    pub(crate) fn clear(&mut self) {
        self.dropped |= !self.kept.is_empty() || self.passing.is_some();
        self.kept.clear();
        self.passing = None;
    }

    /// Reports whether images were removed since the last call. Cached bindings that refer to them
    /// must then be dropped.
    pub(crate) fn take_dropped(&mut self) -> bool {
        std::mem::take(&mut self.dropped)
    }
}

/// Returns the size of an image with its weights, bytes.
fn bytes_of(view: &View) -> u64 {
    12 * view.image.pixels.len() as u64 + view.mask.as_ref().map_or(0, |mask| 4 * mask.weights.len() as u64)
}

fn upload(gpu: &Gpu, view: &View) -> Result<Target, EngineError> {
    let values: &[f32] = view.image.pixels.as_flattened();
    let pixels = gpu.storage("target image", 4 * values.len() as u64)?;
    gpu.queue.write_buffer(&pixels.raw, 0, bytemuck::cast_slice(values));
    let mut total = view.image.pixels.len() as f64;
    let weights = match &view.mask {
        None => None,
        Some(mask) => {
            total = mask.weights.iter().map(|weight| f64::from(*weight)).sum();
            let buffer = gpu.storage("mask", 4 * mask.weights.len() as u64)?;
            gpu.queue.write_buffer(&buffer.raw, 0, bytemuck::cast_slice(&mask.weights));
            Some(Arc::new(buffer))
        }
    };
    gpu.check()?;
    Ok(Target {
        image: view.image.identity(),
        mask: view.mask.as_ref().map(|mask| mask.identity()),
        bytes: bytes_of(view),
        pixels: Arc::new(pixels),
        weights,
        total,
    })
}

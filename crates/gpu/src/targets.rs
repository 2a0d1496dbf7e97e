//! A cache of target images on the device, because training uses the same views again and again.
//!
//! In: views. Out: their images as buffers. Degenerate: if memory runs out, the cache is emptied.
//!
//! A view is identified by the allocations of its image and mask, which weak references keep from
//! being reused. The least recently used images are removed when the cache is full, and all of them
//! if other buffers would not fit.

use std::sync::{Arc, Weak};

use luxel_core::{EngineError, Image, Mask, View};

use crate::device::{Buffer, Gpu};

/// Capacity of the cache, bytes.
const BUDGET_BYTES: u64 = 2 << 30;

/// The image of a view.
pub(crate) struct Target {
    image: Weak<Image>,
    mask: Option<Weak<Mask>>,
    bytes: u64,
    last_used: u64,
    /// `[H*W,3]`.
    pub(crate) pixels: Arc<Buffer>,
    /// One weight per pixel, if the view has a mask.
    pub(crate) weights: Option<Arc<Buffer>>,
    /// Sum of the weights.
    pub(crate) total: f64,
}

/// The cache of images on the device.
#[derive(Default)]
pub(crate) struct Targets {
    kept: Vec<Target>,
    clock: u64,
    dropped: bool,
    uploaded_bytes: u64,
}

fn is_same<T>(kept: &Weak<T>, wanted: &Arc<T>) -> bool {
    std::ptr::eq(kept.as_ptr(), Arc::as_ptr(wanted))
}

impl Targets {
    /// Returns the image of a view, and uploads it if it is not cached.
    pub(crate) fn get(&mut self, gpu: &Gpu, view: &View) -> Result<&Target, EngineError> {
        self.clock += 1;
        let at = self.kept.iter().position(|target| {
            let same_mask = match (&target.mask, &view.mask) {
                (None, None) => true,
                (Some(kept), Some(wanted)) => is_same(kept, wanted),
                _ => false,
            };
            same_mask && is_same(&target.image, &view.image)
        });
        let at = match at {
            Some(at) => at,
            None => {
                self.make_room(bytes_of(view));
                self.kept.push(upload(gpu, view)?);
                self.uploaded_bytes += bytes_of(view);
                self.kept.len() - 1
            }
        };
        let target = &mut self.kept[at];
        target.last_used = self.clock;
        Ok(target)
    }

    fn make_room(&mut self, bytes: u64) {
        // Images whose views no longer exist cannot be requested again.
        let before = self.kept.len();
        self.kept.retain(|target| target.image.strong_count() > 0);
        while self.kept.iter().map(|target| target.bytes).sum::<u64>() + bytes > BUDGET_BYTES {
            let oldest = self.kept.iter().enumerate().min_by_key(|(_, target)| target.last_used).map(|(at, _)| at);
            match oldest {
                Some(at) => drop(self.kept.swap_remove(at)),
                None => break,
            }
        }
        self.dropped |= self.kept.len() < before;
    }

    /// Returns the number of bytes uploaded since the last call.
    pub(crate) fn take_uploaded(&mut self) -> u64 {
        std::mem::take(&mut self.uploaded_bytes)
    }

    /// Removes all images.
    pub(crate) fn clear(&mut self) {
        self.dropped |= !self.kept.is_empty();
        self.kept.clear();
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
        image: Arc::downgrade(&view.image),
        mask: view.mask.as_ref().map(Arc::downgrade),
        bytes: bytes_of(view),
        last_used: 0,
        pixels: Arc::new(pixels),
        weights,
        total,
    })
}

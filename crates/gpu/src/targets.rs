//! Target images on the device, kept from step to step: training goes through the same views again and again.
//!
//! A view is recognised by its image's and mask's allocations, which weak references keep from being given to others. The least recently used
//! make way when the cache is full, and all of them where anything else would not fit.

use std::sync::{Arc, Weak};

use luxel_core::{EngineError, Image, Mask, View};

use crate::device::{Buffer, Gpu};

/// Bytes of images that are kept.
const BUDGET_BYTES: u64 = 2 << 30;

/// A view's image.
pub(crate) struct Target {
    image: Weak<Image>,
    mask: Option<Weak<Mask>>,
    bytes: u64,
    last_used: u64,
    /// `[H*W,3]`.
    pub(crate) pixels: Arc<Buffer>,
    /// One number a pixel, if the view is masked.
    pub(crate) weights: Option<Arc<Buffer>>,
    /// Sum of the weights.
    pub(crate) total: f64,
}

/// Images that are on the device.
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
    /// The view's image, uploaded if it is not there.
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
        // Images that nobody has any more can't be asked for again.
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

    /// Bytes uploaded since this was asked last.
    pub(crate) fn take_uploaded(&mut self) -> u64 {
        std::mem::take(&mut self.uploaded_bytes)
    }

    /// Gives all images up.
    pub(crate) fn clear(&mut self) {
        self.dropped |= !self.kept.is_empty();
        self.kept.clear();
    }

    /// Whether images went since this was asked last: bindings that still hold them are to be forgotten.
    pub(crate) fn take_dropped(&mut self) -> bool {
        std::mem::take(&mut self.dropped)
    }
}

/// Room of an image and its weights.
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

//! The image on its way from the device to the host.
//!
//! In: the device's image, behind the pass that makes it. Out: the pixels of an [`Image`]. The copy
//! is part of the submission that renders, so that the host waits once. It goes into a buffer that
//! is kept, and from its mapping straight into the pixels of the caller's image: where that image
//! has the size already, nothing is allocated. Degenerate: what a submission copied and nobody read
//! is given up before the next.

use luxel_core::{EngineError, Image};

use crate::device::{Buffer, Gpu, mapping};

/// Bytes of a pixel: RGB.
const PIXEL_BYTES: u64 = size_of::<[f32; 3]>() as u64;
/// Pixels for each thread that copies, 4 MiB, and the greatest number of threads: they share the
/// memory, so that half of the cores are enough.
const PIXELS_PER_THREAD: usize = (4 << 20) / PIXEL_BYTES as usize;
const MOST_THREADS: usize = 4;

/// A buffer that the host reads images from, kept between frames.
#[derive(Default)]
pub(crate) struct ImageCopy {
    buffer: Option<Buffer>,
    /// Whether the buffer is mapped, or about to be.
    is_mapped: bool,
    /// The last supersampled image.
    samples: Image,
}

/// Returns the size of an image on the device, bytes.
pub(crate) fn image_bytes(size_px: [u32; 2]) -> u64 {
    PIXEL_BYTES * u64::from(size_px[0]) * u64::from(size_px[1])
}

impl ImageCopy {
    /// Appends a copy of the first `bytes` of `image` to `encoder`.
    pub(crate) fn record(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, image: &Buffer, bytes: u64) -> Result<(), EngineError> {
        self.give_up();
        if self.buffer.as_ref().is_none_or(|buffer| buffer.raw.size() < bytes) {
            // The old buffer is freed first.
            self.buffer = None;
            self.buffer = Some(gpu.buffer("image on the host", bytes, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST)?);
        }
        if let Some(buffer) = &self.buffer {
            encoder.copy_buffer_to_buffer(&image.raw, 0, &buffer.raw, 0, bytes);
        }
        Ok(())
    }

    /// Asks for the mapping of the copy, after its submission.
    pub(crate) fn map(&mut self, bytes: u64) {
        if let Some(buffer) = &self.buffer {
            buffer.raw.slice(..bytes).map_async(wgpu::MapMode::Read, |_| {});
            self.is_mapped = true;
        }
    }

    /// Reads an image whose pixels are the means of `samples` x `samples` of the device's, once its
    /// submission is done. `size_px` is the device's.
    pub(crate) fn read_into(&mut self, gpu: &Gpu, size_px: [u32; 2], samples: usize, image: &mut Image) -> Result<(), EngineError> {
        if samples == 1 {
            return self.read(gpu, size_px, image);
        }
        let mut sampled = std::mem::take(&mut self.samples);
        self.read(gpu, size_px, &mut sampled)?;
        *image = sampled.block_means(samples);
        self.samples = sampled;
        Ok(())
    }

    fn read(&mut self, gpu: &Gpu, size_px: [u32; 2], image: &mut Image) -> Result<(), EngineError> {
        [image.width, image.height] = size_px.map(|side| side as usize);
        if let Some(buffer) = &self.buffer {
            let view = mapping(&buffer.raw, image_bytes(size_px), gpu)?;
            match bytemuck::try_cast_slice(&view) {
                Ok(pixels) => copy(pixels, &mut image.pixels),
                // Mappings are aligned to more than a number; without that they are collected.
                Err(_) => image.pixels = bytemuck::pod_collect_to_vec(&view),
            }
        }
        self.give_up();
        Ok(())
    }

    /// Unmaps the buffer, so that it can be copied to again.
    pub(crate) fn give_up(&mut self) {
        if let Some(buffer) = self.buffer.as_ref().filter(|_| self.is_mapped) {
            buffer.raw.unmap();
        }
        self.is_mapped = false;
    }
}

/// Replaces `to` by a copy of `from`. Memory that is there already is written by several threads,
/// without being cleared first.
fn copy(from: &[[f32; 3]], to: &mut Vec<[f32; 3]>) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = (from.len() / PIXELS_PER_THREAD).clamp(1, MOST_THREADS.min((cores / 2).max(1)));
    if to.len() != from.len() || threads == 1 {
        to.clear();
        to.extend_from_slice(from);
        return;
    }
    let part = from.len().div_ceil(threads);
    std::thread::scope(|scope| {
        let mut parts = from.chunks(part).zip(to.chunks_mut(part));
        let own = parts.next();
        for (from, to) in parts {
            scope.spawn(move || to.copy_from_slice(from));
        }
        if let Some((from, to)) = own {
            to.copy_from_slice(from);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_whole_whatever_was_there_and_however_many_threads_copy() {
        for len in [0, 1, 7, PIXELS_PER_THREAD - 1, 2 * PIXELS_PER_THREAD + 5] {
            let from: Vec<[f32; 3]> = (0..len).map(|i| [i as f32, 0.5, -1.0]).collect();
            for before in [0, 3, len] {
                let mut to = vec![[7.0; 3]; before];
                copy(&from, &mut to);
                assert_eq!(to, from, "{len} pixels, {before} before");
            }
        }
    }
}

//! Guards against hostile files: plausible sizes, fallible allocation, contained panics of
//! decoders.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Once;

use luxel_core::MAX_SIDE_PX;

use crate::IoError;
use crate::input::Input;
use crate::memory::check_memory;

/// Pixels that any file may claim, however short: a black 4096 x 4096 image in DWAB is a few
/// kilobytes.
const FREE_PIXELS: u64 = 1 << 24;

/// Pixels that a byte of file may encode beyond that: deflate reaches 1032 bytes per byte, of eight
/// pixels a byte where they are one bit; flat blocks of DWAB and JPEG XL are as small. Memory for
/// pixels is the system's untouched pages, so that a header that lies costs none.
const PIXELS_PER_BYTE: u64 = 1 << 14;

/// Bytes of samples that a byte of file may encode, by the same reasoning.
const BYTES_PER_BYTE: u64 = 2000;

/// Memory for a pixel while an image is decoded: f32 of three channels and of alpha, beside the
/// samples of the file.
const BYTES_PER_PIXEL: u64 = 24;

/// Memory for one block of a compressed file, by the same reasoning.
const FREE_BLOCK_BYTES: u64 = 64 << 20;

/// Refuses empty images, sides above [`MAX_SIDE_PX`], and more pixels than a file of `file_bytes`
/// can plausibly hold or the limit of memory allows.
pub(crate) fn check_size(name: &Path, [width, height]: [u64; 2], file_bytes: u64) -> Result<(), IoError> {
    check_plausible([width, height], file_bytes).map_err(|message| IoError::invalid(name, message))?;
    check_memory(name, width * height * BYTES_PER_PIXEL)
}

/// Refuses what no file of `file_bytes` can hold, on any machine.
fn check_plausible([width, height]: [u64; 2], file_bytes: u64) -> Result<(), String> {
    let side = u64::from(MAX_SIDE_PX);
    if width == 0 || height == 0 || width > side || height > side {
        return Err(format!("header: size {width} x {height}, expected 1 to {side} pixels per side"));
    }
    if width * height > FREE_PIXELS.saturating_add(file_bytes.saturating_mul(PIXELS_PER_BYTE)) {
        return Err(format!(
            "header: claims {width} x {height} pixels in a file of {file_bytes} bytes; the file is damaged or cut short, export it again"
        ));
    }
    Ok(())
}

impl Input<'_> {
    /// Refuses sizes that [`check_size`] refuses for a file of this length.
    pub(crate) fn check_size(self, size: [u64; 2]) -> Result<(), IoError> {
        check_size(self.name, size, self.length())
    }

    /// Refuses blocks (tiles, groups of lines) that would decompress to more than a file of this
    /// length can plausibly hold.
    pub(crate) fn check_block(self, block_bytes: u64) -> Result<(), IoError> {
        let file_bytes = self.length();
        if block_bytes > FREE_BLOCK_BYTES.saturating_add(file_bytes.saturating_mul(BYTES_PER_BYTE)) {
            return Err(self.invalid(format!(
                "header: claims blocks of {block_bytes} bytes in a file of {file_bytes} bytes; the file is damaged, export it again"
            )));
        }
        // The compressed bytes, their parts and the block, which decoders hold at the same time.
        check_memory(self.name, block_bytes.saturating_mul(4))
    }

    /// Allocates `count` zeros, or returns an error where memory is short. Large requests are
    /// served by untouched pages of the system.
    pub(crate) fn zeroed<T: Clone + Default>(self, count: usize) -> Result<Vec<T>, IoError> {
        zeros(count).map_err(|message| self.unsupported(message))
    }
}

/// Allocates as [`Input::zeroed`] does, for decoders that know no name.
pub(crate) fn zeros<T: Clone + Default>(count: usize) -> Result<Vec<T>, String> {
    let mut probe = Vec::<T>::new();
    if probe.try_reserve_exact(count).is_err() {
        let bytes = count.saturating_mul(size_of::<T>());
        return Err(format!("needs {bytes} bytes of memory, which the system refuses; use a smaller image"));
    }
    drop(probe);
    Ok(vec![T::default(); count])
}

thread_local! {
    /// Whether this thread is inside [`contain`].
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Runs a decoder; its panic becomes an error and is not printed. Decoders run on the calling
/// thread only.
pub(crate) fn contain<T>(name: &Path, decode: impl FnOnce() -> Result<T, IoError>) -> Result<T, IoError> {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let report = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !CONTAINED.get() {
                report(info);
            }
        }));
    });
    let outer = CONTAINED.replace(true);
    // The closure owns or only reads its data; a half-written result is dropped with the
    // panic.
    let result = catch_unwind(AssertUnwindSafe(decode));
    CONTAINED.set(outer);
    result.unwrap_or_else(|panic| {
        let reason = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("no reason given");
        Err(IoError::invalid(name, format!("the decoder failed on this file ({reason}); it is probably damaged, export it again")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panic_of_a_decoder_is_an_error() {
        let result: Result<(), _> = contain(Path::new("a.exr"), || panic!("index out of bounds"));
        let message = result.unwrap_err().to_string();
        assert!(message.starts_with("a.exr: the decoder failed on this file (index out of bounds)"), "{message}");
    }

    #[test]
    fn absurd_sizes_are_refused() {
        let name = Path::new("a.exr");
        for size in [[1 << 31, 1 << 31], [1 << 20, 1 << 20], [0, 5], [1 << 16, 1 << 16], [u64::MAX, 1]] {
            assert!(check_size(name, size, 1000).is_err(), "{size:?}");
        }
        assert!(check_size(name, [4096, 4096], 300).is_ok());
        assert!(check_plausible([1 << 16, 1 << 16], 1 << 22).is_ok());
        assert!(Input::new(name, &[0; 1000]).check_block(u64::MAX).is_err());
    }
}

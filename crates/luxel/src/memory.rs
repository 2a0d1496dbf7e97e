//! Memory that work takes, in bytes: of a render, a step, a run.

mod needs;

use luxel_core::Remedy;
use luxel_core::engine::DeepSample;

pub use self::needs::RunMemory;
pub(crate) use self::needs::engine_bytes;
use crate::{Error, Result};

/// Bytes per sample of a pixel in the engines' tiles: radiance and transmittance.
const SAMPLE_BYTES: u64 = 16;

/// Bytes per pixel of an image, with coverage and depth, and of its file before it is written.
const PIXEL_BYTES: u64 = 40;

/// Refuses an image whose rendering takes more memory than reading a file may
/// ([`luxel_io::memory_limit`]): a size that the user gives is not a size that the machine has.
///
/// # Errors
/// It takes more; with the numbers.
pub fn check_render(size_px: [u32; 2], samples: u8) -> Result<()> {
    let [width, height] = size_px;
    let pixels = u64::from(width) * u64::from(height);
    let bytes = pixels.saturating_mul(SAMPLE_BYTES * u64::from(samples) * u64::from(samples) + PIXEL_BYTES);
    check(&format!("rendering {width} x {height} pixels"), bytes, "render a smaller image")
}

/// Refuses a deep image whose samples could take more memory than reading a file may.
///
/// # Errors
/// They could; with the numbers.
pub fn check_deep(size_px: [u32; 2], most_samples: u16) -> Result<()> {
    let [width, height] = size_px;
    // While pixels are listed and encoded.
    let sample_bytes = 2 * size_of::<DeepSample>() as u64;
    let bytes = (u64::from(width) * u64::from(height)).saturating_mul(u64::from(most_samples) * sample_bytes + PIXEL_BYTES);
    let work = format!("a deep image of {width} x {height} pixels with {most_samples} samples each");
    check(&work, bytes, "render a smaller image, or one with fewer samples a pixel")
}

/// Refuses work that takes more memory than reading a file may; `work` names it, and `instead` what
/// to do in its place.
///
/// # Errors
/// It takes more; with the numbers.
pub fn check(work: &str, bytes: u64, instead: &'static str) -> Result<()> {
    let limit = luxel_io::memory_limit();
    if bytes <= limit {
        return Ok(());
    }
    let mebibytes = |bytes: u64| bytes.div_ceil(1 << 20);
    let message = format!("{work} takes about {} MiB of memory, the limit is {} MiB", mebibytes(bytes), mebibytes(limit));
    Err(Error::new(message).with_remedy(Remedy::advice(instead).or(Remedy::raise("memory"))))
}

/// Asks the system for the memory of work at once, and gives it back: an allocation that fails in
/// the middle of it would end the process. `work` names it, `instead` says what to do in its place.
///
/// # Errors
/// The system refuses; with the number.
pub fn check_room(work: &str, bytes: u64, instead: &'static str) -> Result<()> {
    if usize::try_from(bytes).is_ok_and(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok()) {
        return Ok(());
    }
    let message = format!("{work} takes about {} of memory, which the system refuses", luxel_core::text::bytes(bytes));
    Err(Error::new(message).with_remedy(Remedy::advice(instead)))
}

/// Returns what a step on the processor may keep about tiles of the image, bytes: an eighth of the
/// memory that the system allows, within limits. A limit for images lowers it
/// ([`luxel_core::engine::tile_memory`]).
pub fn tile_bytes() -> u64 {
    luxel_io::system_memory().map_or(1 << 30, |bytes| (bytes / 8).clamp(256 << 20, 8 << 30))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renders_beyond_the_memory_are_refused() {
        check_render([1920, 1080], 2).unwrap();
        let error = check_render([u32::MAX, u32::MAX], 1).unwrap_err();
        assert!(error.to_string().starts_with("rendering 4294967295 x 4294967295 pixels takes about"), "{error}");
    }

    #[test]
    fn memory_that_the_system_refuses_is_an_error() {
        check_room("a small thing", 1 << 20, "wait").unwrap();
        let error = check_room("a large thing", u64::MAX / 4, "do without").unwrap_err();
        assert!(error.to_string().starts_with("a large thing takes about"), "{error}");
    }

    #[test]
    fn deep_images_beyond_the_memory_are_refused() {
        check_deep([640, 480], 16).unwrap();
        let error = check_deep([u32::MAX, 8], u16::MAX).unwrap_err();
        assert!(error.to_string().starts_with("a deep image of 4294967295 x 8 pixels with 65535 samples each takes about"), "{error}");
    }
}

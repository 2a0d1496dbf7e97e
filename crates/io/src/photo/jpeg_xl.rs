//! JPEG XL tiles of a DNG, by `jxl-oxide`. Out: integer samples on the scale of 8 bits, or of 16
//! where the tile has more. Threads are the caller's business. Without the feature `jpeg-xl` tiles
//! are refused.

#[cfg(feature = "jpeg-xl")]
use jxl_oxide::{AllocTracker, JxlImage, JxlThreadPool};

#[cfg(feature = "jpeg-xl")]
use crate::image::guard::zeros;

/// Memory that decoding a tile may take beside a fixed share, bytes per pixel.
#[cfg(feature = "jpeg-xl")]
const BYTES_PER_PIXEL: usize = 256;
/// The fixed share.
#[cfg(feature = "jpeg-xl")]
const FREE_BYTES: usize = 64 << 20;

/// Returns the code of 1.0 in tiles of `bits` bits. Adobe's SDK asks its decoder for 8 or for 16
/// bits, whatever the depth, and programs that write JPEG XL into a DNG
/// state its levels on that scale.
pub(super) fn largest_code(bits: usize) -> u32 {
    if bits <= 8 { u8::MAX.into() } else { u16::MAX.into() }
}

/// Returns the samples `[H * W * per_pixel]` of a tile of `size` pixels.
#[cfg(feature = "jpeg-xl")]
pub(super) fn decode(bytes: &[u8], size: [usize; 2], per_pixel: usize) -> Result<Vec<u16>, String> {
    let [width, height] = size;
    let limit = (width * height).saturating_mul(BYTES_PER_PIXEL).saturating_add(FREE_BYTES);
    let image = JxlImage::builder()
        .pool(JxlThreadPool::none())
        .alloc_tracker(AllocTracker::with_limit(limit))
        .read(bytes)
        .map_err(|e| format!("JPEG XL: {e}"))?;
    let found = [image.width() as usize, image.height() as usize];
    let bits = image.image_header().metadata.bit_depth.bits_per_sample();
    let channels = if image.pixel_format().is_grayscale() { 1 } else { 3 };
    if found != size || channels != per_pixel || !(1..=16).contains(&bits) {
        return Err(format!(
            "JPEG XL of {} x {} pixels, {channels} samples per pixel and {bits} bits; expected {width} x {height}, {per_pixel} and up to 16",
            found[0], found[1]
        ));
    }
    let render = image.render_frame(0).map_err(|e| format!("JPEG XL: {e}"))?;
    let mut stream = render.stream_no_alpha();
    let mut samples = zeros::<f32>(width * height * per_pixel)?;
    let written = stream.write_to_buffer(&mut samples);
    if written != samples.len() {
        return Err(format!("JPEG XL: {written} samples, expected {}", samples.len()));
    }
    let largest = largest_code(bits as usize) as f32;
    Ok(samples.iter().map(|v| (v * largest + 0.5).clamp(0.0, largest) as u16).collect())
}

/// Refuses a tile.
#[cfg(not(feature = "jpeg-xl"))]
pub(super) fn decode(_: &[u8], _: [usize; 2], _: usize) -> Result<Vec<u16>, String> {
    Err("JPEG XL, which this program was built without; build it with the feature jpeg-xl, or convert the file to lossless JPEG".into())
}

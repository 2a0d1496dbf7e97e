//! Conversion of renders to captured values, in which they are compared with captured LDR images.
//!
//! In: a render `[H,W,3]` in normalised units and the response of a camera. Out: captured values, 0
//! to 1.

use luxel_core::{Image, Response};
use rayon::prelude::*;

/// Returns the image that a camera with this response captures of a render in normalised units. Its
/// values are from 0 to 1.
pub fn render_as_captured(render: &Image, response: &Response) -> Image {
    let value = |c: usize, p: f32| response.apply(c, p).value.clamp(0.0, 1.0);
    let pixels = render.pixels.par_iter().map(|pixel| [value(0, pixel[0]), value(1, pixel[1]), value(2, pixel[2])]).collect();
    Image { width: render.width, height: render.height, pixels }
}

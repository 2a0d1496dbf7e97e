//! Channels beside radiance for compositing: the splat that a pixel shows, motion from frame to
//! frame, and mattes of selections as Cryptomatte.
//!
//! In: cameras and depths in the scene's local coordinates; an engine. Out: [`ExrPlane`]s, `[H*W]`
//! each, row by row from the top. Coverage, depth and normals are channels of [`crate::Renderer`].
//! Degenerate: a pixel that no splat touches has the number [`NO_SPLAT`], moves as what is
//! infinitely far away does, and has no matte.

mod cryptomatte;
mod mattes;
mod motion;

use luxel_core::{Camera, Engine, RasterConfig, RenderOptions};
use luxel_io::{ExrPlane, PlaneValues};

pub use self::cryptomatte::Cryptomatte;
pub use self::mattes::{Matte, MatteRenderer};
pub use self::motion::{Motion, motion};
use crate::Result;
use crate::error::Context;

/// Number of a pixel that no splat touches.
pub const NO_SPLAT: f32 = -1.0;
/// Numbers that a float holds exactly.
const EXACT: u32 = 1 << 24;

/// Returns channel `id`: the number of the splat with the greatest weight in each pixel, counted
/// from 0 in the order of the scene's file. Numbers are floats, as programs that read all channels
/// as floats divide whole numbers by the largest. Where one is above 16,777,216, which a float
/// rounds, all are whole, and [`u32::MAX`] is that of nothing.
///
/// # Errors
/// A camera that is no pinhole; an engine without surface images, such as the GPU's.
pub fn splat_ids(camera: &Camera, options: &RenderOptions, engine: &mut dyn Engine) -> Result<ExrPlane> {
    // Numbers have no mean.
    let once = RenderOptions { raster: RasterConfig { samples: 1, ..options.raster }, ..*options };
    let surface = engine.render_surface(camera, &once).context("cannot render the splats' numbers")?;
    let numbers = || surface.pixels.iter().map(|pixel| pixel.splat);
    let is_exact = numbers().flatten().all(|number| number <= EXACT);
    let values = match is_exact {
        true => PlaneValues::Float(numbers().map(|number| number.map_or(NO_SPLAT, |number| number as f32)).collect()),
        false => PlaneValues::Whole(numbers().map(|number| number.unwrap_or(u32::MAX)).collect()),
    };
    Ok(ExrPlane { name: "id".to_owned(), values })
}

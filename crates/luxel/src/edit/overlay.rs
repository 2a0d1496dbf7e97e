//! The selection as a picture: a grey render, and in orange the share that selected splats have in
//! each pixel.
//!
//! In: a scene, the weight of each splat, a camera. Out: a PNG.

use std::path::Path;

use luxel_core::edit::{MaskShares, ShMap};
use luxel_core::tone::{Tonemap, display_rgb8, rec709_of};
use luxel_core::{Camera, ColorModel, Edit, Engine, Image, RenderOptions, Splats};

use crate::Result;
use crate::error::Context;

/// Display colour of the selection.
const SELECTION_RGB: [f32; 3] = [255.0, 96.0, 0.0];
/// Opacity of that colour in a pixel of selected splats alone.
const OPACITY: f32 = 0.7;

/// Returns the strongest of the edits' selections for each splat, 0 to 1. Each edit sees the scene
/// as the edits before it leave it.
///
/// # Errors
/// An edit that does not go with the scene.
pub fn selection_weights(edits: &[Edit], scene: &luxel_core::Scene, masks: &MaskShares, sh_map: ShMap) -> Result<Vec<f32>> {
    let mut scene = scene.clone();
    let mut strongest = vec![0.0f32; scene.splats.len()];
    for edit in edits {
        let applied = edit.apply(&mut scene, masks, sh_map).with_context(|| format!("cannot apply \"{edit}\""))?;
        strongest.iter_mut().zip(&applied.weights).for_each(|(a, b)| *a = a.max(*b));
    }
    Ok(strongest)
}

/// A selection to be drawn.
#[derive(Clone, Copy, Debug)]
pub struct Overlay<'a> {
    /// The scene before the edits.
    pub scene: &'a luxel_core::Scene,
    /// Weight of each splat, from [`selection_weights`].
    pub weights: &'a [f32],
    /// Camera of the picture.
    pub camera: &'a Camera,
    /// Radiance behind everything, normalised units.
    pub background: [f32; 3],
}

/// Draws a selection, and writes it as PNG.
///
/// # Errors
/// A device that gave up; the file system's refusal.
pub fn draw_overlay(path: &Path, overlay: Overlay<'_>, engine: &mut dyn Engine) -> Result<()> {
    let bytes = overlay_png(overlay, engine)?;
    luxel_io::write_bytes(path, &bytes).context("cannot write the overlay")
}

/// Draws a selection, and returns the PNG.
///
/// # Errors
/// A device that gave up.
pub fn overlay_png(overlay: Overlay<'_>, engine: &mut dyn Engine) -> Result<Vec<u8>> {
    let Overlay { scene, weights, camera, background } = overlay;
    let options = RenderOptions { background, ..scene.render_options() };
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let render = engine.render(camera, &options).context("cannot render the view")?;
    engine.load(&with_radiance(&scene.splats, weights.iter().map(|weight| [*weight; 3])), None).context("cannot load the selection")?;
    let selected = engine.render(camera, &RenderOptions { background: [0.0; 3], ..options }).context("cannot render the selection")?;
    let rgb8 = blend(scene, &render, &selected);
    luxel_io::encode_png(render.width, render.height, rgb8.as_flattened()).context("cannot encode the overlay")
}

/// Returns the splats with a radiance each, the same in every direction.
pub(crate) fn with_radiance(splats: &Splats, radiance: impl Iterator<Item = [f32; 3]>) -> Splats {
    let color_model = ColorModel::Sh { degree: 0 };
    let sh = radiance.flat_map(|radiance| color_model.constant(radiance).0).collect();
    Splats { color_model, sh, raw_luminance: Vec::new(), gain: Vec::new(), ..splats.clone() }
}

fn blend(scene: &luxel_core::Scene, render: &Image, selected: &Image) -> Vec<[u8; 3]> {
    let pixel = |(&radiance, &[share, ..]): (&[f32; 3], &[f32; 3])| {
        let [r, g, b] = display_rgb8(Tonemap::Mulaw, 0.0, rec709_of(scene.color_space, radiance)).map(f32::from);
        let grey = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        let part = OPACITY * share.clamp(0.0, 1.0);
        SELECTION_RGB.map(|mark| (grey + part * (mark - grey) + 0.5) as u8)
    };
    render.pixels.iter().zip(&selected.pixels).map(pixel).collect()
}

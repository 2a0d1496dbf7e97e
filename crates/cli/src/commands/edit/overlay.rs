//! The selection as a picture: a render in grey, and over it what is selected, as strong as it makes up each pixel.

use std::path::Path;

use anyhow::{Context, Result};
use luxel_core::edit::{MaskShares, ShMap};
use luxel_core::tone::{Tonemap, display_rgb8, rec709_of};
use luxel_core::{Camera, ColorModel, Edit, Engine, Image, RenderOptions, Scene, Splats};

/// Display colour of what is selected.
const MARK: [f32; 3] = [255.0, 96.0, 0.0];
/// Part of it in a pixel that is selected splats alone.
const STRENGTH: f32 = 0.7;

/// The strongest of the edits' selections, splat by splat. Each looks at the scene as the edits before it leave it.
pub(super) fn weights(edits: &[Edit], scene: &Scene, masks: &MaskShares, sh_map: ShMap) -> Result<Vec<f32>> {
    let mut scene = scene.clone();
    let mut strongest = vec![0.0f32; scene.splats.len()];
    for edit in edits {
        let applied = edit.apply(&mut scene, masks, sh_map).with_context(|| format!("cannot apply \"{edit}\""))?;
        strongest.iter_mut().zip(&applied.weights).for_each(|(a, b)| *a = a.max(*b));
    }
    Ok(strongest)
}

/// Draws the selection in the image of a camera.
pub(super) fn draw(
    path: &Path,
    scene: &Scene,
    weights: &[f32],
    (engine, camera, background): (&mut dyn Engine, &Camera, [f32; 3]),
) -> Result<()> {
    let options = RenderOptions { background, ..scene.render_options() };
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let render = engine.render(camera, &options).context("cannot render the view")?;
    engine.load(&shining(&scene.splats, weights), None).context("cannot load the selection")?;
    let marked = engine.render(camera, &RenderOptions { background: [0.0; 3], ..options }).context("cannot render the selection")?;
    let rgb8 = blend(scene, &render, &marked);
    luxel_io::write_png(path, render.width, render.height, rgb8.as_flattened()).context("cannot write the overlay")
}

/// The same splats with radiance `weights` in every direction.
fn shining(splats: &Splats, weights: &[f32]) -> Splats {
    let color_model = ColorModel::Sh { degree: 0 };
    let sh = weights.iter().flat_map(|weight| color_model.constant([*weight; 3]).0).collect();
    Splats { color_model, sh, raw_luminance: Vec::new(), ..splats.clone() }
}

fn blend(scene: &Scene, render: &Image, marked: &Image) -> Vec<[u8; 3]> {
    let pixel = |(&radiance, &[share, ..]): (&[f32; 3], &[f32; 3])| {
        let [r, g, b] = display_rgb8(Tonemap::Mulaw, 0.0, rec709_of(scene.color_space, radiance)).map(f32::from);
        let grey = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        let part = STRENGTH * share.clamp(0.0, 1.0);
        MARK.map(|mark| (grey + part * (mark - grey) + 0.5) as u8)
    };
    render.pixels.iter().zip(&marked.pixels).map(pixel).collect()
}

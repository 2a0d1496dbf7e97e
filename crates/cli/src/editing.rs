//! Edits of light on their way from the command line to a scene: painted masks found and projected,
//! changes told.

use std::path::Path;

use anyhow::{Context, Result, bail};
use luxel::text;
use luxel_core::edit::{Applied, MaskName, MaskShares, SelectionSummary, ShMap};
use luxel_core::{Dataset, Edit, Engine, Image, Scene, View};

use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;

/// Shares of all masks that the edits look at, for the scene as it is. Reads the data set only if
/// there are any.
pub(crate) fn mask_shares(
    edits: &[Edit],
    source: &SceneSource,
    request: DataRequest<'_>,
    engine: &mut dyn Engine,
    console: &Console,
) -> Result<MaskShares> {
    let names: Vec<&MaskName> = edits.iter().flat_map(|edit| edit.selection.masks()).collect();
    if names.is_empty() {
        return Ok(MaskShares::new());
    }
    let Some(dataset) = source.dataset(request, console)? else {
        bail!("a mask is painted over a view of a data set; give --data DATASET");
    };
    project_masks(&names, &source.scene, &dataset, engine)
}

/// Shares of the named masks.
pub(crate) fn project_masks(names: &[&MaskName], scene: &Scene, dataset: &Dataset, engine: &mut dyn Engine) -> Result<MaskShares> {
    let mut shares = MaskShares::new();
    if names.is_empty() {
        return Ok(shares);
    }
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    for name in names {
        let view = view(dataset, &name.view)?;
        let mask = read_mask(Path::new(&name.file), view)?;
        let contributions = engine.contributions(&view.camera, &options, &mask).context("cannot project a mask")?;
        shares.insert((*name).clone(), contributions.shares());
    }
    Ok(shares)
}

/// A view by its name, or by its name's last part if only one has it.
pub(crate) fn view<'d>(dataset: &'d Dataset, name: &str) -> Result<&'d View> {
    let views = || dataset.train.iter().chain(&dataset.test);
    if let Some(view) = views().find(|view| view.name == name) {
        return Ok(view);
    }
    let mut named = views().filter(|view| view.stem() == name);
    match (named.next(), named.next()) {
        (Some(view), None) => Ok(view),
        (Some(a), Some(b)) => bail!("view {name}: may be {} or {}; give the whole name", a.name, b.name),
        (None, _) => {
            /// Names told.
            const TOLD: usize = 5;
            let some: Vec<&str> = views().take(TOLD).map(|view| view.name.as_str()).collect();
            bail!("view {name}: not in the data set, which has {}, ...", some.join(", "))
        }
    }
}

/// `[H*W]` of the view's size, 0 to 1: the brightest channel as it is stored, times opacity where
/// that is not in it. NaN is 0. Larger pictures by whole factors are averaged.
fn read_mask(path: &Path, view: &View) -> Result<Vec<f32>> {
    let decoded = luxel_io::read_codes(path).context("cannot read a mask")?;
    let alpha = decoded.alpha.filter(|_| !decoded.is_premultiplied);
    let opacity = |i: usize| alpha.as_ref().and_then(|alpha| alpha.get(i)).map_or(1.0, |alpha| alpha.clamp(0.0, 1.0));
    let value = |(i, rgb): (usize, &[f32; 3])| [rgb.iter().copied().fold(0.0, f32::max).min(1.0) * opacity(i); 3];
    let pixels = decoded.image.pixels.iter().enumerate().map(value).collect();
    let mask = Image { width: decoded.image.width, height: decoded.image.height, pixels };
    let [width, height] = view.camera.size_px.map(|side| side as usize);
    let factor = mask.width / width;
    if factor == 0 || [mask.width / factor, mask.height / factor] != [width, height] {
        bail!(
            "{}: {} x {} pixels, expected {width} x {height} as view {}, or a whole multiple; paint over a render of the view",
            path.display(),
            mask.width,
            mask.height,
            view.name
        );
    }
    Ok(luxel_io::downscale(&mask, factor).pixels.iter().map(|rgb| rgb[0]).collect())
}

/// Applies the edits in order, and tells what each selected and whether hues shifted.
pub(crate) fn apply(
    edits: &[Edit],
    scene: &mut Scene,
    masks: &MaskShares,
    sh_map: ShMap,
    console: &Console,
) -> Result<Vec<(Applied, SelectionSummary)>> {
    let mut done = Vec::with_capacity(edits.len());
    for edit in edits {
        let before = scene.clone();
        let applied = edit.apply(scene, masks, sh_map).with_context(|| format!("cannot apply \"{edit}\""))?;
        let summary = SelectionSummary::of(&before, &applied.weights);
        console.note(&format!(
            "{}: {} of {}, {} % of the scene's light",
            applied.edit,
            text::count(summary.count),
            text::plural(scene.splats.len(), "splat"),
            text::number(100.0 * summary.light_share)
        ));
        if summary.count == 0 {
            console.warn(&format!("\"{}\" selects no splats", applied.edit.selection));
        }
        if let Some(shift) = applied.hue_shift {
            console.warn(&format!(
                "hues shift: spherical harmonics do not hold luminance apart from colour; chromaticity moved by {} on average (0 none, 2 \
                 from one primary to another); scenes trained with --method lcd keep theirs",
                text::number(shift)
            ));
        }
        done.push((applied, summary));
    }
    Ok(done)
}

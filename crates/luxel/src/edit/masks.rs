//! Painted masks: images that are white where a view is selected, projected onto the splats.
//!
//! In: names of masks in edits, a data set, and an engine. Out: for each mask the share of each
//! splat's contribution that lies in it. Degenerate: no masks, no shares. A mask has the size of
//! its view or a whole multiple, which is averaged.

use std::path::Path;

use luxel_core::edit::{MaskName, MaskShares};
use luxel_core::{Dataset, Edit, Engine, Image, View};

use crate::Result;
use crate::error::{Context, bail};

/// Number of views that an error names.
const LISTED_VIEWS: usize = 5;

/// Returns the names of all masks in the selections of edits.
pub fn mask_names(edits: &[Edit]) -> Vec<&MaskName> {
    edits.iter().flat_map(|edit| edit.selection.masks()).collect()
}

/// Projects masks onto the splats of a scene: returns the share of each splat's contribution to a
/// view that lies in the white part of a mask, `[N]` per mask, 0 to 1.
///
/// # Errors
/// A view that is not in the data set, a mask that cannot be read or has another size, a device
/// that gave up.
pub fn project_masks(names: &[&MaskName], scene: &luxel_core::Scene, dataset: &Dataset, engine: &mut dyn Engine) -> Result<MaskShares> {
    let mut shares = MaskShares::new();
    if names.is_empty() {
        return Ok(shares);
    }
    let dataset = &*dataset.in_frame(scene.world_from_local);
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    for name in names {
        let view = find_view(dataset, &name.view)?;
        let mask = read_mask(Path::new(&name.file), view)?;
        let contributions = engine.contributions(&view.camera, &options, &mask).context("cannot project a mask")?;
        shares.insert((*name).clone(), contributions.shares());
    }
    Ok(shares)
}

/// Returns a view by its name, or by its name's last part if only one view has it.
///
/// # Errors
/// A name that no view has, or several have.
pub fn find_view<'d>(dataset: &'d Dataset, name: &str) -> Result<&'d View> {
    let views = || dataset.train.iter().chain(&dataset.test);
    if let Some(view) = views().find(|view| view.name == name) {
        return Ok(view);
    }
    let mut named = views().filter(|view| view.stem() == name);
    match (named.next(), named.next()) {
        (Some(view), None) => Ok(view),
        (Some(a), Some(b)) => bail!("view {name}: may be {} or {}; give the whole name", a.name, b.name),
        (None, _) => {
            let some: Vec<&str> = views().take(LISTED_VIEWS).map(|view| view.name.as_str()).collect();
            bail!("view {name}: not in the data set, which has {}, ...", some.join(", "))
        }
    }
}

/// Reads a mask of a view, `[H*W]`, 0 to 1: the brightest channel as it is stored, times opacity
/// unless it is premultiplied. NaN is 0. Larger images by whole factors are averaged.
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

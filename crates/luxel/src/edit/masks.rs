//! Painted masks: images that are white where a view is selected, projected onto the splats.
//!
//! In: names of masks in edits, the cameras that they were painted for (of a data set, or of a file
//! beside the mask), and an engine. Out: for each mask the share of each
//! splat's contribution that lies in it. Degenerate: no masks, no shares. A mask has the size of
//! its view or a whole multiple, which is averaged.

use std::path::Path;

use luxel_core::edit::{MaskName, MaskShares};
use luxel_core::{Camera, Dataset, Edit, Engine, Image, View};

use crate::Result;
use crate::error::{Context, bail};

/// Number of views that an error names.
const LISTED_VIEWS: usize = 5;

/// Returns the names of all masks in the selections of edits.
pub fn mask_names(edits: &[Edit]) -> Vec<&MaskName> {
    edits.iter().flat_map(|edit| edit.selection.masks()).collect()
}

/// Returns whether a mask's view is named by a file with its camera, such as `mask.json`.
pub(crate) fn is_camera_file(view: &str) -> bool {
    Path::new(view).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// Returns whether a mask is painted over a view of a data set, rather than over the picture of a
/// camera file.
pub fn needs_dataset(name: &MaskName) -> bool {
    !is_camera_file(&name.view)
}

/// Projects masks onto the splats of a scene: returns the share of each splat's contribution to a
/// view that lies in the white part of a mask, `[N]` per mask, 0 to 1. `view_camera` returns the
/// camera of a view of the data set, in the local coordinates of the scene.
///
/// # Errors
/// A view that is not in the data set, a camera file or a mask that cannot be read, a mask of
/// another size, a device that gave up.
pub fn project_masks(
    names: &[&MaskName],
    scene: &luxel_core::Scene,
    view_camera: &dyn Fn(&str) -> Result<Camera>,
    engine: &mut dyn Engine,
) -> Result<MaskShares> {
    let mut shares = MaskShares::new();
    if names.is_empty() {
        return Ok(shares);
    }
    engine.load(&scene.splats, None).context("cannot load the scene")?;
    let options = scene.render_options();
    for name in names {
        let camera = if needs_dataset(name) { view_camera(&name.view)? } else { scene.local_camera(&read_camera(Path::new(&name.view))?) };
        let mask = read_mask(Path::new(&name.file), &name.view, &camera)?;
        let contributions = engine.contributions(&camera, &options, &mask).context("cannot project a mask")?;
        shares.insert((*name).clone(), contributions.shares());
    }
    Ok(shares)
}

/// Reads the only camera of a file, world.
fn read_camera(path: &Path) -> Result<Camera> {
    let mut cameras = crate::read_cameras(path)?;
    match (cameras.len(), cameras.pop()) {
        (1, Some(found)) => Ok(found.camera),
        (count, _) => bail!("{}: {count} cameras, expected the one that a mask was painted for", path.display()),
    }
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
fn read_mask(path: &Path, view: &str, camera: &Camera) -> Result<Vec<f32>> {
    let decoded = luxel_io::read_codes(path).context("cannot read a mask")?;
    let alpha = decoded.alpha.filter(|_| !decoded.is_premultiplied);
    let opacity = |i: usize| alpha.as_ref().and_then(|alpha| alpha.get(i)).map_or(1.0, |alpha| alpha.clamp(0.0, 1.0));
    let value = |(i, rgb): (usize, &[f32; 3])| [rgb.iter().copied().fold(0.0, f32::max).min(1.0) * opacity(i); 3];
    let pixels = decoded.image.pixels.iter().enumerate().map(value).collect();
    let mask = Image { width: decoded.image.width, height: decoded.image.height, pixels };
    let [width, height] = camera.size_px.map(|side| side as usize);
    let factor = mask.width / width;
    if factor == 0 || [mask.width / factor, mask.height / factor] != [width, height] {
        bail!(
            "{}: {} x {} pixels, expected {width} x {height} as view {}, or a whole multiple; paint over a render of the view",
            path.display(),
            mask.width,
            mask.height,
            view
        );
    }
    Ok(luxel_io::downscale(&mask, factor).pixels.iter().map(|rgb| rgb[0]).collect())
}

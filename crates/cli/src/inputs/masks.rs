//! Inputs of edits besides the scene: painted masks, projected onto the splats, and the splats to
//! remove.

use anyhow::Result;
use luxel::edit::{Removed, find_view, mask_names, needs_dataset, project_masks};
use luxel_core::edit::{EditStack, MaskShares};
use luxel_core::{Edit, Engine};

use super::scene_source::{DataRequest, SceneSource};
use crate::output::console::Console;

/// Returns the shares of all masks that the edits name, for the scene as it is. Reads the data set
/// only if there are any.
pub(crate) fn mask_shares(
    edits: &[Edit],
    source: &SceneSource,
    request: DataRequest<'_>,
    engine: &mut dyn Engine,
    console: &Console,
) -> Result<MaskShares> {
    let names = mask_names(edits);
    if names.is_empty() {
        return Ok(MaskShares::new());
    }
    let dataset = match names.iter().any(|name| needs_dataset(name)) {
        true => source.dataset(request, console)?,
        false => None,
    };
    let camera = |view: &str| match &dataset {
        Some(dataset) => Ok(find_view(dataset, view)?.camera.clone()),
        None => Err(luxel::Error::new(
            "a mask is painted over a view of a data set; give --data DATASET, or a .json file with its camera as VIEW",
        )),
    };
    Ok(project_masks(&names, &source.scene, &camera, engine)?)
}

/// Returns the splats to remove.
pub(crate) fn removed(
    stack: &EditStack,
    source: &SceneSource,
    masks: &MaskShares,
    request: DataRequest<'_>,
    engine: &mut dyn Engine,
    console: &Console,
) -> Result<Removed> {
    let mut removed = Removed { reasons: vec![None; source.scene.splats.len()] };
    if let Some(selection) = &stack.delete {
        removed = Removed::selected(selection, &source.scene, masks)?;
    }
    if stack.floaters {
        let dataset = source.dataset(request, console)?;
        removed = removed.or(Removed::floaters(&source.scene, dataset.as_ref(), engine, console)?);
    }
    Ok(removed)
}

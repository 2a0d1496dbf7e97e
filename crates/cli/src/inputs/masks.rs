//! Painted masks that edits name, projected onto the splats.

use anyhow::{Result, bail};
use luxel::edit::{mask_names, project_masks};
use luxel_core::edit::MaskShares;
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
    let Some(dataset) = source.dataset(request, console)? else {
        bail!("a mask is painted over a view of a data set; give --data DATASET");
    };
    Ok(project_masks(&names, &source.scene, &dataset, engine)?)
}

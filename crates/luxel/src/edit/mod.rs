//! Edits of light on a scene: painted masks projected onto the splats, edits applied and reported,
//! the selection drawn over a view.
//!
//! In: [`Edit`]s, a scene, and for masks and pictures the views of a data set. Out: the edited
//! scene, and a summary of each edit. Degenerate: a selection without splats is a warning, not an
//! error.

mod clean;
mod masks;
mod overlay;
mod stack;

pub use self::clean::{RemovalReason, Removed, Watching};
pub use self::masks::{find_view, mask_names, needs_dataset, project_masks};
pub(crate) use self::overlay::with_radiance;
pub use self::overlay::{Overlay, draw_overlay, overlay_png, selection_weights};
pub use self::stack::{StackInputs, align, apply_stack, read_stack, stack_file_text};
use luxel_core::edit::{Applied, HardEdge, MaskShares, SelectionSummary, ShMap};
use luxel_core::{Edit, text};

use crate::error::Context;
use crate::{Observer, Result};

/// An edit that was applied.
#[derive(Clone, Debug)]
pub struct AppliedEdit {
    /// The edit as it was resolved, and the weight of each splat.
    pub applied: Applied,
    /// The splats that it selected.
    pub selection: SelectionSummary,
}

/// Applies edits in order, and reports what each selected and whether hues shifted. `masks` come
/// from [`project_masks`]; none are needed for edits without masks.
///
/// ```
/// use luxel::{Silent, edit, synthetic};
/// use luxel_core::Edit;
/// use luxel_core::edit::{MaskShares, ShMap};
///
/// # fn main() -> luxel::Result<()> {
/// let mut scene = synthetic::room(100, 1).into_core();
/// let edits = Edit::parse_all("where L < p50 ~2; gain 4")?;
/// let done = edit::apply(&edits, &mut scene, &MaskShares::new(), ShMap::default(), &Silent)?;
/// assert!(done[0].selection.count >= 50);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// An edit that does not go with the scene. Edits before it are applied then.
pub fn apply(
    edits: &[Edit],
    scene: &mut luxel_core::Scene,
    masks: &MaskShares,
    sh_map: ShMap,
    observer: &dyn Observer,
) -> Result<Vec<AppliedEdit>> {
    let mut done = Vec::with_capacity(edits.len());
    for edit in edits {
        let before = scene.clone();
        let applied = edit.apply(scene, masks, sh_map).with_context(|| format!("cannot apply \"{edit}\""))?;
        let selection = SelectionSummary::new(&before, &applied.weights);
        observer.note(&format!(
            "{}: {} of {}, {} % of the scene's light",
            applied.edit,
            text::count(selection.count),
            text::plural(scene.splats.len(), "splat"),
            text::number(100.0 * selection.light_share)
        ));
        if selection.count == 0 {
            observer.warn(&format!("\"{}\" selects no splats", applied.edit.selection));
        }
        for edge in applied.edit.selection.hard_edges(&before) {
            observer.warn(&hard_edge_warning(&edge));
        }
        if let Some(shift) = applied.hue_shift {
            observer.warn(&format!(
                "hues shift: spherical harmonics do not separate luminance from colour; chromaticity moved by {} on average (0 none, 2 \
                 from one primary to another); scenes trained with method lcd keep theirs",
                text::number(shift)
            ));
        }
        done.push(AppliedEdit { applied, selection });
    }
    Ok(done)
}

/// Returns the warning about a hard edge, with the soft edge to use instead.
fn hard_edge_warning(edge: &HardEdge) -> String {
    format!(
        "\"{}\" is a hard edge where many splats lie, {} % of them within {}: parts of a surface are selected and others are not, which \
         shows as blotches; write \"{}\" for a soft edge",
        edge.test,
        text::number(100.0 * edge.part),
        edge.width,
        edge.soft
    )
}

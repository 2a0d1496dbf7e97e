//! A stack of edits applied to a scene, and as a file.
//!
//! In: an [`EditStack`], a scene, the shares of painted masks, the splats to remove. Out: the scene
//! that `luxel edit` writes. A file holds the stack's text, a statement a line; names of masks in
//! it are relative to its folder. Degenerate: an empty stack changes nothing.

use std::fmt::Write;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use luxel_core::edit::{EditStack, MaskShares, ShMap};
use luxel_core::{SceneBounds, Similarity};

use super::{AppliedEdit, Removed, apply};
use crate::error::{Context, bail};
use crate::{Observer, Result};

/// Size of a file of edits, bytes, at most.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// The direction that the program takes as up in a scene file without a data set.
const UP: DVec3 = DVec3::NEG_Y;

/// Inputs of a stack besides the scene itself.
#[derive(Clone, Debug, Default)]
pub struct StackInputs {
    /// Shares of painted masks.
    pub masks: MaskShares,
    /// Splats to remove.
    pub removed: Removed,
}

/// Applies a stack: edits of light, then removal, then the new axes.
///
/// ```
/// use luxel::edit::{Removed, StackInputs, apply_stack};
/// use luxel::{Silent, synthetic};
/// use luxel_core::edit::{EditStack, MaskShares, ShMap};
///
/// # fn main() -> luxel::Result<()> {
/// let mut scene = synthetic::room(100, 1).into_core();
/// let stack: EditStack = "gain 2; delete L < p50; origin 0,1,0".parse()?;
/// let masks = MaskShares::new();
/// let removed = Removed::selected(&"L < p50".parse()?, &scene, &masks)?;
/// apply_stack(&stack, &mut scene, &StackInputs { masks, removed }, ShMap::default(), &Silent)?;
/// assert!(scene.splats.len() <= 51);
/// assert_eq!(scene.edits.len(), 3);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// An edit that does not go with the scene; a scene of which nothing would be left.
pub fn apply_stack(
    stack: &EditStack,
    scene: &mut luxel_core::Scene,
    inputs: &StackInputs,
    sh_map: ShMap,
    observer: &dyn Observer,
) -> Result<Vec<AppliedEdit>> {
    let done = apply(&stack.edits, scene, &inputs.masks, sh_map, observer)?;
    if inputs.removed.count() > 0 {
        inputs.removed.apply(scene, stack.removal_record())?;
    }
    align(stack, scene)?;
    Ok(done)
}

/// Turns the scene so that [`EditStack::up`] becomes -Y, which the program takes as up in a scene
/// file, and moves it so that [`EditStack::origin`] becomes the origin.
///
/// # Errors
/// Coordinates beyond the range of numbers.
pub fn align(stack: &EditStack, scene: &mut luxel_core::Scene) -> Result<()> {
    if !stack.moves() {
        return Ok(());
    }
    let rotation = stack.up.map_or(DMat3::IDENTITY, |up| rotation_to_up(DVec3::from_array(up)));
    let origin = stack.origin.map_or(DVec3::ZERO, DVec3::from_array);
    let new_from_old = Similarity::new(rotation, 1.0, -(rotation * origin)).context("up or origin is out of range")?;
    let new_from_local = scene.world_from_local.then(&new_from_old);
    let centers: Vec<DVec3> =
        scene.splats.position.iter().map(|point| new_from_local.point(DVec3::from_array(point.map(f64::from)))).collect();
    let frame = SceneBounds::from_points(&centers).map_or(Similarity::IDENTITY, |bounds| bounds.world_from_local());
    scene.world_from_local = new_from_local;
    scene.move_to(frame);
    scene.edits.push(stack.axes_record());
    Ok(())
}

/// Returns the shortest rotation that takes a direction to [`UP`].
fn rotation_to_up(up: DVec3) -> DMat3 {
    let up = up.normalize_or(UP);
    // A half turn has no shortest axis.
    if up.dot(UP) < -1.0 + 1e-12 {
        DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))
    } else {
        DMat3::from_quat(DQuat::from_rotation_arc(up, UP))
    }
}

/// Reads a file of edits; relative names of masks become relative to where the program runs.
///
/// # Errors
/// A file that cannot be read, or whose text is no stack.
pub fn read_stack(path: &Path) -> Result<EditStack> {
    let text = luxel_io::read_text(path, MAX_FILE_BYTES)?;
    let mut stack: EditStack = text.parse().with_context(|| format!("{}: not a file of edits", path.display()))?;
    if stack.is_empty() {
        bail!("{}: has no edits", path.display());
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let joined = |name: &str| folder.join(name).to_string_lossy().into_owned();
    stack.each_mask(&mut |name| {
        name.file = joined(&name.file);
        if super::masks::is_camera_file(&name.view) {
            name.view = joined(&name.view);
        }
    });
    Ok(stack)
}

/// Returns the text of a file of edits in `folder`: a statement a line, masks below that folder
/// relative to it.
pub fn stack_file_text(stack: &EditStack, folder: &Path) -> String {
    let mut stack = stack.clone();
    let relative = |name: &str| Path::new(name).strip_prefix(folder).map_or(name.to_owned(), |name| name.to_string_lossy().into_owned());
    stack.each_mask(&mut |name| (name.file, name.view) = (relative(&name.file), relative(&name.view)));
    let mut text = String::new();
    let removal = stack.removal_record();
    let axes = stack.axes_record();
    for edit in &stack.edits {
        let _ = writeln!(text, "where {};", edit.selection);
        for map in &edit.maps {
            let _ = writeln!(text, "{map};");
        }
    }
    for record in [removal, axes].iter().filter(|record| !record.is_empty()) {
        let _ = writeln!(text, "{record};");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Silent, synthetic};

    #[test]
    fn a_floor_becomes_level_and_a_point_the_origin() {
        let mut scene = synthetic::room(60, 1).into_core();
        let before = scene.clone();
        let stack: EditStack = "up 0,1,1; origin 1,2,3".parse().unwrap();
        apply_stack(&stack, &mut scene, &StackInputs::default(), ShMap::default(), &Silent).unwrap();
        assert_eq!(scene.edits, ["up 0,1,1; origin 1,2,3"]);
        let up = DVec3::new(0.0, 1.0, 1.0).normalize();
        for (old, new) in before.splats.position.iter().zip(&scene.splats.position) {
            let old = DVec3::from_array(old.map(f64::from)) - DVec3::new(1.0, 2.0, 3.0);
            let new = DVec3::from_array(new.map(f64::from));
            assert!((old.dot(up) + new.y).abs() < 1e-5 && (old.length() - new.length()).abs() < 1e-5, "{old} {new}");
        }
        let mut turned = before.clone();
        align(&"up 0,1,0".parse().unwrap(), &mut turned).unwrap();
        assert_eq!(turned.splats.position[7], [0, 1, 2].map(|i| if i == 0 { 1.0 } else { -1.0 } * before.splats.position[7][i]));
        // The direction that is up already.
        let mut same = before.clone();
        align(&"up 0,-2,0".parse().unwrap(), &mut same).unwrap();
        assert_eq!(same.splats, before.splats);
    }

    #[test]
    fn a_file_of_edits_reads_back_with_its_masks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lamp.edits");
        let mask = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        let text = format!("where mask(\"{}\", \"{}\") ~0.2; gain 2; power 0.5; delete L < 1; up 0,1,0", mask("a.png"), mask("a.json"));
        let stack: EditStack = text.parse().unwrap();
        let file = stack_file_text(&stack, folder.path());
        assert!(file.contains("mask(\"a.png\", \"a.json\")"), "{file}");
        std::fs::write(&path, &file).unwrap();
        assert_eq!(read_stack(&path).unwrap(), stack);
        std::fs::write(&path, "shine").unwrap();
        assert!(format!("{:#}", read_stack(&path).unwrap_err()).contains("expected one of"));
    }
}

//! Everything that `luxel edit` does to a scene, as one text: edits of light, splats to delete, and
//! where up and the origin are.
//!
//! ```text
//! stack     = statement (';' statement)*
//! statement = a statement of edits | 'delete' selection | 'floaters' | 'up' X,Y,Z | 'origin' X,Y,Z
//! ```
//! Statements of edits are those of [`super::text`]. Selections of `delete` and floaters are of the
//! scene as it is before the edits; several are deleted together. The place of a `delete` among the
//! edits makes no difference, nor does that of `up` and `origin`, which are coordinates of the
//! world as it is. The output of `Display` reads back as the same stack. Degenerate: empty text
//! changes nothing.

use std::fmt;
use std::str::FromStr;

use super::text::{cursor::Cursor, edits_of};
use super::{Edit, EditTextError, MaskName, Selection};

/// Edits, deletions, and the new axes of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EditStack {
    /// Edits of light, in order.
    pub edits: Vec<Edit>,
    /// Splats to delete, by the scene before the edits.
    pub delete: Option<Selection>,
    /// Whether floaters are deleted.
    pub floaters: bool,
    /// Direction that becomes -Y, which is up in a scene file; any length but 0.
    pub up: Option<[f64; 3]>,
    /// Point that becomes the origin.
    pub origin: Option<[f64; 3]>,
}

impl EditStack {
    /// Returns whether nothing is changed.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns whether the scene is turned or moved.
    pub fn moves(&self) -> bool {
        self.up.is_some() || self.origin.is_some()
    }

    /// Returns the edits, and the selection of splats to delete as one without maps.
    pub fn selecting(&self) -> Vec<Edit> {
        let deleting = self.delete.iter().map(|selection| Edit { selection: selection.clone(), maps: Vec::new() });
        self.edits.iter().cloned().chain(deleting).collect()
    }

    /// Returns the record of the deletion in a scene: `delete L < 1; floaters`.
    pub fn removal_record(&self) -> String {
        let deleted = self.delete.as_ref().map(|selection| format!("delete {selection}"));
        deleted.into_iter().chain(self.floaters.then(|| "floaters".to_owned())).collect::<Vec<_>>().join("; ")
    }

    /// Returns the record of the new axes in a scene: `up 0,0,1; origin 1,2,3`.
    pub fn axes_record(&self) -> String {
        let point = |name: &str, point: &Option<[f64; 3]>| point.map(|[x, y, z]| format!("{name} {x},{y},{z}"));
        point("up", &self.up).into_iter().chain(point("origin", &self.origin)).collect::<Vec<_>>().join("; ")
    }

    /// Calls `change` with the name of each mask.
    pub fn each_mask(&mut self, change: &mut dyn FnMut(&mut MaskName)) {
        self.edits.iter_mut().map(|edit| &mut edit.selection).chain(&mut self.delete).for_each(|selection| selection.each_mask(change));
    }
}

impl Selection {
    /// Calls `change` with the name of each mask.
    pub fn each_mask(&mut self, change: &mut dyn FnMut(&mut MaskName)) {
        match self {
            Self::Mask { name, .. } => change(name),
            Self::Not(inner) => inner.each_mask(change),
            Self::And(parts) | Self::Or(parts) => parts.iter_mut().for_each(|part| part.each_mask(change)),
            _ => {}
        }
    }
}

impl fmt::Display for EditStack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let records = [self.removal_record(), self.axes_record()];
        let edits = self.edits.iter().map(ToString::to_string);
        let parts: Vec<String> = edits.chain(records.into_iter().filter(|record| !record.is_empty())).collect();
        f.write_str(&parts.join("; "))
    }
}

impl FromStr for EditStack {
    type Err = EditTextError;

    fn from_str(text: &str) -> Result<Self, EditTextError> {
        let mut stack = Self::default();
        let mut deleted = Vec::new();
        let edits = edits_of(text, ", delete, floaters, up, origin", &mut |cursor, name| {
            match name {
                "delete" => deleted.push(cursor.selection(0)?),
                "floaters" => stack.floaters = true,
                "up" => {
                    let start = cursor.at;
                    let up = point(cursor)?;
                    if up == [0.0; 3] {
                        return Err(EditTextError { column: cursor.column_of(start), message: "up is 0,0,0, expected a direction".into() });
                    }
                    stack.up = Some(up);
                }
                "origin" => stack.origin = Some(point(cursor)?),
                _ => return Ok(false),
            }
            Ok(true)
        })?;
        stack.edits = edits;
        stack.delete = if deleted.len() > 1 { Some(Selection::Or(deleted)) } else { deleted.pop() };
        Ok(stack)
    }
}

fn point(cursor: &mut Cursor<'_>) -> Result<[f64; 3], EditTextError> {
    cursor.space();
    cursor.numbers(["x", "y", "z"])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stack_reads_back_as_it_is_written() {
        let text = "where L > 1 ~2; gain 0.5; delete L < 0.1; where all; power 0.8; stops -1.5; delete sphere(0,1,2,3) ~0.1; floaters;\nup 0,0,1;origin 1,2.5,-3;";
        let stack: EditStack = text.parse().unwrap();
        assert_eq!((stack.edits.len(), stack.floaters, stack.up, stack.origin), (2, true, Some([0.0, 0.0, 1.0]), Some([1.0, 2.5, -3.0])));
        assert_eq!(stack.removal_record(), "delete L < 0.1 or sphere(0,1,2,3) ~0.1; floaters");
        assert_eq!(stack.to_string().parse::<EditStack>().unwrap(), stack);
        assert!(stack.to_string().contains("power 0.8; stops -1.5"), "{stack}");
        assert!("".parse::<EditStack>().unwrap().is_empty());
    }

    #[test]
    fn what_is_wrong_is_named_with_its_column() {
        for (text, part) in [
            ("gain 2; shine", "column 9: expected one of"),
            ("up 0,0,0", "expected a direction"),
            ("up 1,2", "column 7"),
            ("delete", "expected a test"),
            ("floaters 3", "expected \";\" or the end"),
            ("origin 1,2,1e999", "a number (z)"),
        ] {
            let error = text.parse::<EditStack>().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn the_names_of_masks_can_be_changed() {
        let mut stack: EditStack = "where not (mask(a.png, v) and L > 1); gain 2; delete mask(b.png, b.json)".parse().unwrap();
        stack.each_mask(&mut |name| name.file = format!("folder/{}", name.file));
        assert!(stack.to_string().contains("\"folder/a.png\"") && stack.to_string().contains("\"folder/b.png\""));
    }
}

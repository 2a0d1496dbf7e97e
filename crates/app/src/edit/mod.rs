//! Two scenes under the same edit, and one scene beside the ideal of an edit.

mod against;
pub(crate) mod trial;

pub use self::against::{Against, EditComparison, EditFidelity, FULL_SCALE_ERROR, compare_edits};

//! The files of scenes without splats, whichever kind they are of.

use std::path::Path;

use luxel_io::IoError;

use super::scene::{Content, ImplicitScene};
use super::{anchor_files, field_files};
use crate::Result;

/// Reads the scene of a file, that of a checkpoint too.
pub(super) fn read(path: &Path) -> Result<ImplicitScene> {
    if luxel_io::holds_arrays(path, anchor_files::FORMAT) { anchor_files::read(path) } else { field_files::read(path) }
}

/// Writes a scene alone.
pub(super) fn write(path: &Path, scene: &ImplicitScene) -> Result<(), IoError> {
    match &scene.content {
        Content::Field(field) => field_files::write(path, &scene.place, field),
        Content::Anchors { scene: anchors, response } => anchor_files::write(path, &scene.place, anchors, response.as_deref()),
    }
}

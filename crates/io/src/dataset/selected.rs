//! The images to read of a data set's frames: views to train on, held-out views, and captured
//! images beside radiance.
//!
//! In: frames, their split, the kinds of images that are asked for. Out: images in the order in
//! which they are read: training views by name, held-out ones, then captured images; and the views
//! with their captured images once all are read. Degenerate: poses without what is asked for are
//! errors.

use std::path::Path;

use luxel_core::{PixelValues, View};

use super::source::SourceFrame;
use super::split::Part;
use super::{LoadOptions, Supervision, recordings};
use crate::IoError;

/// The use of an image.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Train,
    Test,
    /// A captured image beside the radiance of a training pose.
    Captured,
    /// A captured image beside the radiance of a held-out pose.
    CapturedTest,
}

/// An image to be read.
pub(super) struct SelectedFrame {
    pub(super) frame: SourceFrame,
    /// Index into the source's frames.
    pub(super) source: usize,
    pub(super) role: Role,
}

/// Frames by name, and their split.
pub(super) struct Split<'a> {
    pub(super) frames: &'a [&'a SourceFrame],
    /// Index of each frame among those of the source.
    pub(super) order: &'a [usize],
    /// Indices of the training frames.
    pub(super) train: &'a [usize],
    /// Indices of the held-out frames.
    pub(super) test: &'a [usize],
}

impl SelectedFrame {
    /// Returns the options that it is read with: beside radiance, captured images alone are read as
    /// such.
    pub(super) fn options<'o>(&self, given: &'o LoadOptions, captured: &'o LoadOptions) -> &'o LoadOptions {
        if matches!(self.role, Role::Captured | Role::CapturedTest) { captured } else { given }
    }
}

impl Split<'_> {
    /// Returns images of frames, by name; with the captured images of a frame in its place where
    /// those are asked for.
    fn images(&self, indices: &[usize], role: Role, of: Expansion) -> Vec<SelectedFrame> {
        let part = if matches!(role, Role::Test | Role::CapturedTest) { Part::Test } else { Part::Train };
        let expand = |i: &usize| {
            let (frame, source) = (self.frames[*i], self.order[*i]);
            let frames = match of {
                Expansion::Frame => vec![frame.clone()],
                Expansion::Captured => recordings::expanded(frame, part == Part::Test),
                Expansion::Beside => recordings::beside(frame),
            };
            frames.into_iter().map(move |frame| SelectedFrame { frame: SourceFrame { part: Some(part), ..frame }, source, role })
        };
        indices.iter().flat_map(expand).collect()
    }
}

/// The images of a frame.
#[derive(Clone, Copy)]
enum Expansion {
    /// Its own.
    Frame,
    /// Its captured ones, if it has any; its own if that is radiance of a held-out pose.
    Captured,
    /// Its captured ones.
    Beside,
}

/// Returns the images to read.
pub(super) fn select(path: &Path, split: &Split<'_>, options: &LoadOptions) -> Result<Vec<SelectedFrame>, IoError> {
    let chosen = |images: Vec<SelectedFrame>| {
        let images = recordings::choose(images, |image| &image.frame, &options.exposures);
        match images.is_empty() {
            true => Err(IoError::invalid(path, format!("no bracket has exposures {}, counted from 0", options.exposures))),
            false => Ok(images),
        }
    };
    let (train, test) = (split.train, split.test);
    let (train, test, captured) = match options.supervision {
        Supervision::Hdr => {
            (split.images(train, Role::Train, Expansion::Captured), split.images(test, Role::Test, Expansion::Captured), Vec::new())
        }
        Supervision::Ldr => {
            let train = chosen(split.images(train, Role::Train, Expansion::Captured))?;
            let both: Vec<usize> = test.iter().copied().filter(|i| split.frames[*i].has_both()).collect();
            let captured = split.images(&both, Role::CapturedTest, Expansion::Beside);
            (train, split.images(test, Role::Test, Expansion::Captured), captured)
        }
        Supervision::Both => {
            recordings::check_pairs(train.iter().map(|i| split.frames[*i]))?;
            let captured = chosen(split.images(train, Role::Captured, Expansion::Captured))?;
            (split.images(train, Role::Train, Expansion::Frame), split.images(test, Role::Test, Expansion::Frame), captured)
        }
    };
    let mut used = Vec::new();
    for mut images in [train, test, captured] {
        images.sort_by(|a, b| a.frame.name.cmp(&b.frame.name));
        used.extend(images);
    }
    Ok(used)
}

/// Returns training and test views of the images that were read, each with the captured images
/// that were read beside its radiance.
pub(super) fn with_captured(
    path: &Path,
    views: impl Iterator<Item = View>,
    used: &[SelectedFrame],
) -> Result<(Vec<View>, Vec<View>), IoError> {
    let (mut train, mut test, mut captured) = (Vec::new(), Vec::new(), Vec::new());
    for (view, image) in views.zip(used) {
        match image.role {
            Role::Train => train.push(view),
            Role::Test => test.push(view),
            Role::Captured | Role::CapturedTest => captured.push((image.source, view)),
        }
    }
    if captured.is_empty() {
        return Ok((train, test));
    }
    // Those whose images are captured ones have none beside them.
    for (view, image) in train.iter_mut().chain(&mut test).zip(used).filter(|(view, _)| view.values == PixelValues::Radiance) {
        let own = captured.iter().filter(|(source, _)| *source == image.source);
        view.recordings = own.map(|(_, view)| view.clone()).collect();
    }
    train.iter().chain(&test).try_for_each(View::validate).map_err(|error| IoError::invalid(path, error))?;
    Ok((train, test))
}

//! Fields and anchors in a program that was built without the feature `methods`: whatever would
//! read or train them is refused.

use std::convert::Infallible;
use std::path::Path;

use luxel::step_methods::{check_is_built, not_built};
use luxel::{Dataset, Error, Observer, Result, SelectedEngine};
use luxel_core::{Dataset as CoreDataset, Knots, Scene};
use luxel_train::{Reconstruction, TrainConfig};
use serde_json::Value;

use super::Processor;
use crate::run::{Launch, RunConfig, RunFolder};

/// A scene that is not stored as splats, of which this program has none.
#[derive(Clone, Debug, PartialEq)]
pub struct NonSplatScene {
    /// Its units and place: a scene without splats.
    pub place: Scene,
    never: Infallible,
}

/// A run that can be continued, of which this program has none.
pub(crate) enum Checkpoint {}

fn refused(path: &Path) -> Error {
    not_built(path.display())
}

impl Checkpoint {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        Err(refused(path))
    }
}

impl NonSplatScene {
    pub(super) fn read(path: &Path) -> Result<Self> {
        Err(refused(path))
    }

    /// Returns the number of trained numbers.
    pub fn parameter_count(&self) -> usize {
        match self.never {}
    }

    /// Returns the camera's response, if it was learned.
    pub fn response(&self) -> Option<Knots> {
        match self.never {}
    }

    /// Returns what the scene is, in a few words.
    pub fn summary(&self) -> String {
        match self.never {}
    }

    /// Returns what the scene is.
    pub fn kind(&self) -> &'static str {
        match self.never {}
    }

    /// Returns the size and the place of the scene, by name.
    pub fn facts(&self) -> Vec<(&'static str, Value)> {
        match self.never {}
    }

    /// Returns a digest of the content.
    pub fn digest(&self) -> String {
        match self.never {}
    }

    /// Puts the scene into an engine that renders it.
    ///
    /// # Errors
    /// None.
    pub fn into_engine(self, _: SelectedEngine) -> Result<SelectedEngine> {
        match self.never {}
    }
}

/// Refuses a run of a field or of anchors.
///
/// # Errors
/// Always.
pub fn newest_scene(folder: &RunFolder, _: &dyn Observer) -> Result<(u32, NonSplatScene)> {
    Err(refused(folder.root()))
}

pub(crate) fn start(_: &CoreDataset, config: &TrainConfig, _: Processor) -> Result<Box<dyn Reconstruction>> {
    check_is_built(config.method)?;
    Err(Error::new("no published method"))
}

pub(crate) fn resume(_: &CoreDataset, checkpoint: Checkpoint, _: Processor) -> Result<Box<dyn Reconstruction>> {
    match checkpoint {}
}

pub(crate) fn seconds_per_step(config: &RunConfig, _: [usize; 2], _: &dyn Observer) -> Result<f64> {
    check_is_built(config.train.method)?;
    Err(Error::new("no published method"))
}

pub(crate) fn open_dataset(path: &Path, config: &RunConfig, _: Launch<'_>) -> Result<Dataset> {
    check_is_built(config.train.method)?;
    Err(refused(path))
}

//! The state of a training run, read piece by piece: what a checkpoint is written from.
//!
//! In: a [`Snapshot`], or a run that is paused while it is saved. Out: arrays of some splats at a
//! time, so that nothing as large as the scene is copied. Degenerate: arrays of other lengths than
//! the number of splats asks for are errors.

use std::borrow::Cow;
use std::ops::Range;

use crate::engine::{DensifyStats, SavedPart, SplatArray};
use crate::{ColorModel, EngineError, Scene, Snapshot, Splats};

/// Arrays of the same shape in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SavedGroup {
    /// Arrays of an engine.
    Engine(SavedPart),
    /// The running mean of the parameters.
    Average,
}

/// The state of a training run at the end of a step; enough to resume bit for bit.
pub trait SavedState {
    /// Returns the number of splats.
    fn splat_count(&self) -> usize;

    /// Returns the scene. Its splats may be none: they are [`Self::values`].
    fn scene(&self) -> &Scene;

    /// Returns the statistics of densification.
    fn stats(&self) -> &DensifyStats;

    /// Returns whether there is a running mean of the parameters.
    fn is_averaged(&self) -> bool;

    /// Returns everything else, as the trainer's JSON.
    fn state_json(&self) -> &str;

    /// Returns the values of an array, of some splats, splat by splat; none for a smoothing filter
    /// that is not there.
    ///
    /// # Errors
    /// [`EngineError::Invalid`] for splats that are not there; [`EngineError::Device`].
    fn values(&mut self, group: SavedGroup, array: SplatArray, splats: Range<usize>) -> Result<Cow<'_, [f32]>, EngineError>;
}

impl<S: SavedState + ?Sized> SavedState for &mut S {
    fn splat_count(&self) -> usize {
        (**self).splat_count()
    }

    fn scene(&self) -> &Scene {
        (**self).scene()
    }

    fn stats(&self) -> &DensifyStats {
        (**self).stats()
    }

    fn is_averaged(&self) -> bool {
        (**self).is_averaged()
    }

    fn state_json(&self) -> &str {
        (**self).state_json()
    }

    fn values(&mut self, group: SavedGroup, array: SplatArray, splats: Range<usize>) -> Result<Cow<'_, [f32]>, EngineError> {
        (**self).values(group, array, splats)
    }
}

impl SavedState for &Snapshot {
    fn splat_count(&self) -> usize {
        self.scene.splats.len()
    }

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn stats(&self) -> &DensifyStats {
        &self.stats
    }

    fn is_averaged(&self) -> bool {
        self.average.is_some()
    }

    fn state_json(&self) -> &str {
        &self.state_json
    }

    fn values(&mut self, group: SavedGroup, array: SplatArray, splats: Range<usize>) -> Result<Cow<'_, [f32]>, EngineError> {
        let of = match group {
            SavedGroup::Engine(SavedPart::Parameters) => Some(&self.scene.splats),
            SavedGroup::Engine(SavedPart::FirstMoments) => Some(&self.moments.first),
            SavedGroup::Engine(SavedPart::SecondMoments) => Some(&self.moments.second),
            SavedGroup::Average => self.average.as_ref(),
        };
        let Some(of) = of else { return Ok(Cow::default()) };
        let (count, color_model) = (self.scene.splats.len(), self.scene.splats.color_model);
        if (of.len(), of.color_model) != (count, color_model) {
            let of_model = |model: ColorModel, count: usize| format!("{count} {} splats", model.name());
            let [found, expected] = [of_model(of.color_model, of.len()), of_model(color_model, count)];
            return Err(EngineError::invalid(format!("{group:?} is of {found}, expected {expected}")));
        }
        Ok(Cow::Borrowed(values_of(of, array, splats)?))
    }
}

/// Returns the values of an array of some splats.
///
/// # Errors
/// [`EngineError::Invalid`] for splats that are not there.
pub fn values_of(of: &Splats, array: SplatArray, splats: Range<usize>) -> Result<&[f32], EngineError> {
    let (values, width) = (of.array(array), array.width(of.color_model));
    if array == SplatArray::Smoothing && values.is_empty() {
        return Ok(values);
    }
    let expected = width * of.len();
    if values.len() != expected {
        return Err(EngineError::invalid(format!("{} has {} values, expected {expected}", array.name(), values.len())));
    }
    let message = || EngineError::invalid(format!("{} of {} splats, not of splat {}", array.name(), of.len(), splats.end));
    values.get(splats.start * width..splats.end * width).ok_or_else(message)
}

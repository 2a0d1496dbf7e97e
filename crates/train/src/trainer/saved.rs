//! The state of a run for a checkpoint, read from the engine piece by piece while the run waits.
//!
//! In: a [`Trainer`]. Out: a [`SavedState`], of which only the statistics of densification are
//! copied: three numbers a splat.

use std::borrow::Cow;
use std::ops::Range;

use luxel_core::engine::{DensifyStats, SplatArray};
use luxel_core::{EngineError, SavedGroup, SavedState, Scene, Splats, values_of};

use super::Trainer;
use crate::TrainError;

/// The state of a run at the end of a step; enough to resume bit for bit.
pub struct RunState<'a> {
    trainer: &'a mut Trainer,
    /// The scene without its splats.
    scene: Scene,
    stats: DensifyStats,
    state_json: String,
}

impl Trainer {
    /// Returns everything needed to resume from here bit for bit, to be read piece by piece. Unlike
    /// [`Self::snapshot`], it copies neither splats nor moments.
    ///
    /// # Errors
    /// Returns [`TrainError::Engine`] if the engine fails.
    pub fn saved_state(&mut self) -> Result<RunState<'_>, TrainError> {
        let stats = self.engine.densify_stats()?;
        let (scene, state_json) = (self.scene_of(Splats::empty(self.state.config.color_model())), self.state_json()?);
        Ok(RunState { trainer: self, scene, stats, state_json })
    }
}

impl SavedState for RunState<'_> {
    fn splat_count(&self) -> usize {
        self.trainer.engine.len()
    }

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn stats(&self) -> &DensifyStats {
        &self.stats
    }

    fn is_averaged(&self) -> bool {
        self.trainer.average.is_some()
    }

    fn state_json(&self) -> &str {
        &self.state_json
    }

    fn values(&mut self, group: SavedGroup, array: SplatArray, splats: Range<usize>) -> Result<Cow<'_, [f32]>, EngineError> {
        match (group, &self.trainer.average) {
            (SavedGroup::Engine(part), _) => Ok(Cow::Owned(self.trainer.engine.save_array(part, array, splats)?)),
            (SavedGroup::Average, Some(average)) => Ok(Cow::Borrowed(values_of(average.mean(), array, splats)?)),
            (SavedGroup::Average, None) => Ok(Cow::default()),
        }
    }
}

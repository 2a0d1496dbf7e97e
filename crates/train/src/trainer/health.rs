//! Signs that training went wrong although the loss is finite.
//!
//! In: parameters and reports. Out: an error with step and view where a parameter is not finite, at
//! the steps where a log line is due; a warning, once, where no view showed a splat for as long.
//! Splats with such parameters are culled, and a black image has a finite loss.

use luxel_core::engine::Geometry;
use luxel_core::{EngineError, ExchangeError};

use super::Trainer;
use crate::TrainError;

/// Steps between two checks of the parameters, and steps without a visible splat that are warned
/// about.
const CHECK_EVERY: u32 = 100;

/// Counts steps without a visible splat.
#[derive(Debug, Default)]
pub(super) struct Visibility {
    /// Steps in a row.
    unseen: u32,
    is_reported: bool,
}

impl Visibility {
    /// Adds a step; returns whether it is to be warned about, which is the case once.
    fn is_lost_after(&mut self, visible: u32) -> bool {
        self.unseen = if visible == 0 { self.unseen.saturating_add(1) } else { 0 };
        let is_lost = self.unseen >= CHECK_EVERY && !self.is_reported;
        self.is_reported |= is_lost;
        is_lost
    }
}

impl Trainer {
    /// Warns if no splat was visible for [`CHECK_EVERY`] steps.
    pub(super) fn watch_visibility(&mut self, step: u32, visible: u32) {
        if self.visibility.is_lost_after(visible) {
            tracing::warn!(
                step,
                splats = self.engine.len(),
                "no camera has seen a splat in the last {CHECK_EVERY} steps: the scene is black; check cameras and points, or lower the \
                 learning rates"
            );
        }
    }

    /// Checks the parameters after `step`, if that is due.
    pub(super) fn check_parameters(&mut self, step: u32) -> Result<(), TrainError> {
        if !step.is_multiple_of(CHECK_EVERY) && step < self.state.config.iterations {
            return Ok(());
        }
        self.compare_ranks(step)?;
        self.engine.check_finite().map_err(|error| match error {
            EngineError::Splats(source) => {
                let view = self.recent.back().map(|(_, view)| view.clone()).unwrap_or_default();
                TrainError::NotFiniteSplat { step, view, source }
            }
            error => error.into(),
        })
    }
}

impl Trainer {
    /// Compares a digest of the geometry after `step` over the ranks of a distributed run: machines
    /// with other instruction sets round otherwise, and would train scenes that drift apart.
    fn compare_ranks(&mut self, step: u32) -> Result<(), TrainError> {
        if self.exchange.ranks() == 1 {
            return Ok(());
        }
        let Geometry { position, log_scale, opacity_logit } = self.engine.geometry()?;
        let numbers = position.as_flattened().iter().chain(log_scale.as_flattened()).chain(&opacity_logit);
        let digest = numbers.fold(DIGEST_START, |digest, value| (digest ^ u64::from(value.to_bits())).wrapping_mul(DIGEST_FACTOR));
        let digests = self.exchange.all_gather(&[digest as u32, (digest >> 32) as u32])?;
        let mut digests = digests.iter();
        let first = digests.next();
        match digests.position(|found| Some(found) != first).map(|others| others + 1) {
            Some(rank) => Err(ExchangeError(format!(
                "after step {step}, rank {rank} holds another scene than rank 0; run all ranks on processors, or GPUs, of the same kind"
            ))
            .into()),
            None => Ok(()),
        }
    }
}

/// Start and factor of FNV-1a in 64 bits, here over words.
const DIGEST_START: u64 = 0xcbf2_9ce4_8422_2325;
const DIGEST_FACTOR: u64 = 0x0000_0100_0000_01b3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_black_scene_is_reported_once_and_not_for_single_views() {
        let mut visibility = Visibility::default();
        let views = (0..250).map(|step| u32::from(step % 90 == 0));
        assert!(!views.into_iter().any(|visible| visibility.is_lost_after(visible)));
        let reported: Vec<bool> = (0..500).map(|_| visibility.is_lost_after(0)).collect();
        assert_eq!(reported.iter().filter(|reported| **reported).count(), 1);
        let mut visibility = Visibility::default();
        assert_eq!((0..300).position(|_| visibility.is_lost_after(0)), Some(99));
    }
}

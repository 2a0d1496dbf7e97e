//! The training views as the start of a run looks at them: as radiance, several at a time, each
//! read as rarely as possible.
//!
//! In: the views of a data set, and the initial curve of the camera where they are captured values.
//! Out: what a function returns for each view, in the order of the views. Views in memory go
//! through all threads. Of those that are read on demand, or become radiance first, at most
//! [`Dataset::readers`] are in memory at a time, and each is dropped after its turn. Results do not
//! depend on the number of readers, because nothing is summed over views here. Degenerate: of
//! several views that cannot be read, the error is of the first.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use luxel_core::{Dataset, Knots, ReadError, View};
use rayon::prelude::*;

use crate::camera_response::exposure_of;
use crate::recorded::radiance_view;

/// The training views of a data set, to be looked at.
#[derive(Clone, Copy)]
pub(crate) struct StartViews<'a> {
    /// The views; captured values where [`Self::knots`] are given.
    pub(crate) train: &'a [View],
    readers: usize,
    knots: Option<Knots>,
}

impl<'a> StartViews<'a> {
    /// Takes the views of a data set, and the curve by which captured values become radiance.
    pub(crate) fn new(dataset: &'a Dataset, knots: Option<Knots>) -> Self {
        Self { train: &dataset.train, readers: dataset.readers.max(1), knots }
    }

    /// Returns what `look` returns for the views of these indices, which ascend; each is read once.
    ///
    /// # Errors
    /// An image or a mask that cannot be read.
    pub(crate) fn look<R: Send>(&self, indices: &[usize], look: impl Fn(usize, &View) -> R + Sync) -> Result<Vec<R>, ReadError> {
        let is_at_hand = |view: &View| view.is_in_memory() && self.knots.is_none();
        if indices.iter().all(|&index| is_at_hand(&self.train[index])) {
            return Ok(indices.par_iter().map(|&index| look(index, &self.train[index])).collect());
        }
        let found: Mutex<Vec<(usize, Result<R, ReadError>)>> = Mutex::new(Vec::with_capacity(indices.len()));
        let (next, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
        let read = || {
            while !is_over.load(Ordering::Relaxed) {
                let at = next.fetch_add(1, Ordering::Relaxed);
                let Some(&index) = indices.get(at) else { break };
                let result = self.radiance(index).map(|view| look(index, &view));
                is_over.fetch_or(result.is_err(), Ordering::Relaxed);
                found.lock().unwrap_or_else(PoisonError::into_inner).push((at, result));
            }
        };
        std::thread::scope(|scope| (0..self.readers.min(indices.len())).for_each(|_| drop(scope.spawn(read))));
        let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
        found.sort_unstable_by_key(|(at, _)| *at);
        found.into_iter().map(|(_, result)| result).collect()
    }

    /// Returns the indices of all views.
    pub(crate) fn all(&self) -> Vec<usize> {
        (0..self.train.len()).collect()
    }

    /// Reads a view, and makes radiance of captured values.
    fn radiance(&self, index: usize) -> Result<View, ReadError> {
        let view = self.train[index].loaded()?;
        Ok(match (&self.knots, exposure_of(&view)) {
            (Some(knots), Some(exposure_s)) => radiance_view(view, exposure_s, knots),
            _ => view,
        })
    }
}

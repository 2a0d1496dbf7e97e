//! The light probe that was made last ([`crate::environment`]), and the lamps that were found last
//! ([`crate::lamps`]).

use std::sync::{Arc, PoisonError};

use luxel::Probe;
use serde::Serialize;
use tokio::sync::Mutex;

/// The request of a probe.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ProbeRequest {
    pub(crate) at: [f64; 3],
    pub(crate) width: usize,
    pub(crate) edit: String,
}

/// A probe and what is doubtful about it.
#[derive(Debug)]
pub(crate) struct Environment {
    pub(crate) probe: Probe,
    pub(crate) warnings: Vec<String>,
}

/// The probe that was made last; while one is made, others wait.
#[derive(Debug, Default)]
pub(crate) struct LastProbe {
    pub(crate) last: Mutex<Option<(ProbeRequest, Arc<Environment>)>>,
    under_way: std::sync::Mutex<Option<(ProbeRequest, Progress)>>,
}

/// The lamps at a point of the scene under edits, as they are answered.
#[derive(Debug)]
pub(crate) struct FoundLamps {
    pub(crate) at: [f64; 3],
    pub(crate) edit: String,
    pub(crate) answer: serde_json::Value,
}

/// The lamps that were found last; while some are searched for, others wait.
#[derive(Debug, Default)]
pub(crate) struct LastLamps {
    pub(crate) last: Mutex<Option<FoundLamps>>,
}

/// How far a probe is: cameras rendered, of all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Progress {
    pub(crate) done: usize,
    pub(crate) total: usize,
}

impl LastProbe {
    fn under_way(&self) -> std::sync::MutexGuard<'_, Option<(ProbeRequest, Progress)>> {
        self.under_way.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns how far this probe is; 0 of 0 for one that is not under way.
    pub(crate) fn progress(&self, request: &ProbeRequest) -> Progress {
        self.under_way().as_ref().filter(|(known, _)| known == request).map(|(_, progress)| *progress).unwrap_or_default()
    }

    /// Notes that a probe is under way, until what is returned is dropped.
    pub(crate) fn begin(&self, request: &ProbeRequest) -> UnderWay<'_> {
        *self.under_way() = Some((request.clone(), Progress::default()));
        UnderWay(self)
    }
}

/// A probe that is under way.
pub(crate) struct UnderWay<'a>(&'a LastProbe);

impl UnderWay<'_> {
    /// Notes how far it is.
    pub(crate) fn set(&self, progress: Progress) {
        if let Some((_, known)) = self.0.under_way().as_mut() {
            *known = progress;
        }
    }
}

impl Drop for UnderWay<'_> {
    fn drop(&mut self) {
        *self.0.under_way() = None;
    }
}

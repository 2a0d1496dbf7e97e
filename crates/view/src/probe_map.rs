//! The light probe that was made last ([`crate::environment`]).

use std::sync::Arc;

use luxel::Probe;
use tokio::sync::Mutex;

/// The request of a probe.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Wish {
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
pub(crate) struct LastProbe(pub(crate) Mutex<Option<(Wish, Arc<Environment>)>>);

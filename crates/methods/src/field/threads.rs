//! The threads that a field computes on.

use crate::field::error::FieldError;

/// Starts threads; 0 are as many as the machine has cores.
pub(crate) fn start_threads(threads: usize) -> Result<rayon::ThreadPool, FieldError> {
    let refused = |e: rayon::ThreadPoolBuildError| FieldError::Threads { threads, message: e.to_string() };
    rayon::ThreadPoolBuilder::new().num_threads(threads).spawn_handler(luxel_lanes::start_thread).build().map_err(refused)
}

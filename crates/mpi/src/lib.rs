//! The exchange between the ranks of a distributed run, through MPI.
//!
//! In: a process that `mpirun` or `srun` started. Out: a [`Connection`], whose exchange carries
//! words between ranks; it computes nothing, so results do not depend on how an implementation of
//! MPI orders its reductions. Degenerate: without the feature `mpi`, [`connect`] is an error that
//! says how to get it; a process that was started by itself is the only rank.
//!
//! A connection must be closed by all ranks, by dropping it, or by one of them with
//! [`Connection::abort`], which ends all. A connection that is dropped in a panic aborts.

#[cfg(not(feature = "mpi"))]
mod absent;
#[cfg(feature = "mpi")]
mod connected;

#[cfg(not(feature = "mpi"))]
pub use absent::{Connection, connect};
#[cfg(feature = "mpi")]
pub use connected::{Connection, connect};

/// Explains why there is no connection.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ConnectError(String);

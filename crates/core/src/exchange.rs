//! The exchange of data between the processes (ranks) that train one scene together.
//!
//! In: messages of 32-bit words to every rank. Out: those that every rank sent to this one, in the
//! order of ranks, whatever arrived first. What is exchanged, and what is computed from it, is the
//! business of training; an implementation only carries words. [`Alone`] is a single process.
//! Degenerate: a rank that is gone is an error of every other, or ends them.

/// Explains why ranks could not exchange data.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ExchangeError(pub String);

/// A connection between ranks. All ranks make the same calls in the same order.
pub trait Exchange: Send {
    /// Returns the number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of ranks, at least 1.
    fn ranks(&self) -> usize;

    /// Sends `messages[r]` to rank `r`, for every rank including this one, and returns the messages
    /// of all ranks to this one, in the order of ranks.
    ///
    /// # Errors
    /// A connection that failed; a message that is too large for it.
    fn all_to_all(&mut self, messages: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>, ExchangeError>;

    /// Sends one message to every rank, and returns the messages of all ranks, in the order of
    /// ranks.
    ///
    /// # Errors
    /// Those of [`Self::all_to_all`].
    fn all_gather(&mut self, message: &[u32]) -> Result<Vec<Vec<u32>>, ExchangeError>;
}

/// The exchange of a process that trains alone.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Exchange for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn ranks(&self) -> usize {
        1
    }

    fn all_to_all(&mut self, messages: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>, ExchangeError> {
        Ok(messages)
    }

    fn all_gather(&mut self, message: &[u32]) -> Result<Vec<Vec<u32>>, ExchangeError> {
        Ok(vec![message.to_vec()])
    }
}

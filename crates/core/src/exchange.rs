//! The exchange of data between the processes (ranks) that train one scene together.
//!
//! In: messages of 32-bit words to every rank. Out: those that every rank sent to this one, in the
//! order of ranks, whichever arrived first. What is exchanged, and what is computed from it, is the
//! business of training; an implementation only carries words. [`SingleProcess`] has nobody to
//! exchange with. Degenerate: a rank that is gone is an error of every other, or ends them.

use std::ops::Range;

/// Explains why ranks could not exchange data.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ExchangeError(pub String);

impl ExchangeError {
    /// Returns the error of a message that is longer than what can be counted.
    pub fn too_large() -> Self {
        Self("a rank sends or receives more than 8 GiB at once, which MPI cannot count; lower the number of splats".to_owned())
    }

    /// Returns the error of ranks that do not expect what the others send.
    pub fn out_of_step() -> Self {
        Self("the ranks are not in step; do all run the same version of the program with the same options?".to_owned())
    }
}

/// Messages of 32-bit words, one from each rank, in the order of ranks, one behind the other in
/// memory.
///
/// ```
/// use luxel_core::Messages;
///
/// let mut messages = Messages::default();
/// messages.push(&[1, 2]);
/// messages.push(&[]);
/// assert_eq!(messages.iter().collect::<Vec<_>>(), [&[1, 2][..], &[]]);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Messages {
    words: Vec<u32>,
    /// The end of each message.
    ends: Vec<usize>,
}

impl Messages {
    /// Appends a message.
    pub fn push(&mut self, message: &[u32]) {
        self.words.extend_from_slice(message);
        self.ends.push(self.words.len());
    }

    /// Returns memory for messages of these lengths, whose words are arbitrary, in place of those
    /// that were here.
    pub fn receive(&mut self, lengths: &[usize]) -> &mut [u32] {
        self.ends.clear();
        let mut end = 0;
        self.ends.extend(lengths.iter().map(|length| {
            end += length;
            end
        }));
        self.words.resize(end, 0);
        &mut self.words
    }

    /// Returns the messages, in the order of ranks.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| &self.words[start..*end])
    }
}

/// A connection between ranks. All ranks make the same calls in the same order.
///
/// Where lengths are known on both sides, messages go from the caller's memory to the caller's
/// memory.
pub trait Exchange: Send {
    /// Returns the number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of ranks, at least 1.
    fn ranks(&self) -> usize;

    /// Sends the words of `sent` in `spans[r]` to rank `r`, for every rank including this one, and
    /// writes what all ranks sent to this one to `received`, in their order: `lengths[r]` words of
    /// rank `r`, which fill it.
    ///
    /// # Errors
    /// A connection that failed; a message of another length, or one that is too large for the
    /// connection.
    fn all_to_all(&mut self, sent: &[u32], spans: &[Range<usize>], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError>;

    /// Sends `sent` to every rank, and writes what all ranks sent to `received`, in their order:
    /// `lengths[r]` words of rank `r`, which fill it.
    ///
    /// # Errors
    /// Those of [`Self::all_to_all`].
    fn all_gather_into(&mut self, sent: &[u32], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError>;

    /// Sends one message of any length to every rank, and returns the messages of all ranks.
    ///
    /// # Errors
    /// Those of [`Self::all_to_all`].
    fn all_gather(&mut self, message: &[u32]) -> Result<Messages, ExchangeError> {
        let length = u32::try_from(message.len()).map_err(|_| ExchangeError::too_large())?;
        let mut lengths = vec![0; self.ranks()];
        self.all_gather_into(&[length], &mut lengths, &vec![1; self.ranks()])?;
        let lengths: Vec<usize> = lengths.into_iter().map(|length| length as usize).collect();
        let mut messages = Messages::default();
        self.all_gather_into(message, messages.receive(&lengths), &lengths)?;
        Ok(messages)
    }
}

/// The exchange of a process that trains alone.
#[derive(Clone, Copy, Debug, Default)]
pub struct SingleProcess;

impl Exchange for SingleProcess {
    fn rank(&self) -> usize {
        0
    }

    fn ranks(&self) -> usize {
        1
    }

    fn all_to_all(&mut self, sent: &[u32], spans: &[Range<usize>], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError> {
        let message = spans.first().and_then(|span| sent.get(span.clone())).ok_or_else(ExchangeError::out_of_step)?;
        self.all_gather_into(message, received, lengths)
    }

    fn all_gather_into(&mut self, sent: &[u32], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError> {
        if lengths != [sent.len()] || received.len() != sent.len() {
            return Err(ExchangeError::out_of_step());
        }
        received.copy_from_slice(sent);
        Ok(())
    }
}

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

/// Messages of 32-bit words, one for each rank, in the order of ranks, one behind the other in
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
    /// Removes all messages, and keeps their memory.
    pub fn clear(&mut self) {
        self.words.clear();
        self.ends.clear();
    }

    /// Appends a message.
    pub fn push(&mut self, message: &[u32]) {
        self.push_by(|words| words.extend_from_slice(message));
    }

    /// Appends the message of the words that `write` appends.
    pub fn push_by(&mut self, write: impl FnOnce(&mut Vec<u32>)) {
        write(&mut self.words);
        self.ends.push(self.words.len());
    }

    /// Returns memory for messages of these lengths, whose words are arbitrary, in place of those
    /// that were here.
    pub fn receive(&mut self, lengths: impl IntoIterator<Item = usize>) -> &mut [u32] {
        self.ends.clear();
        let mut end = 0;
        self.ends.extend(lengths.into_iter().map(|length| {
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

    /// Returns the words of all messages.
    pub fn words(&self) -> &[u32] {
        &self.words
    }
}

/// A connection between ranks. All ranks make the same calls in the same order.
pub trait Exchange: Send {
    /// Returns the number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of ranks, at least 1.
    fn ranks(&self) -> usize;

    /// Sends message `r` to rank `r`, for every rank including this one, and puts the messages of
    /// all ranks to this one in `received`.
    ///
    /// # Errors
    /// A connection that failed; a message that is too large for it.
    fn all_to_all(&mut self, messages: &Messages, received: &mut Messages) -> Result<(), ExchangeError>;

    /// Sends one message to every rank, and puts the messages of all ranks in `received`.
    ///
    /// # Errors
    /// Those of [`Self::all_to_all`].
    fn all_gather_into(&mut self, message: &[u32], received: &mut Messages) -> Result<(), ExchangeError>;

    /// Sends one message to every rank, and returns the messages of all ranks.
    ///
    /// # Errors
    /// Those of [`Self::all_to_all`].
    fn all_gather(&mut self, message: &[u32]) -> Result<Messages, ExchangeError> {
        let mut received = Messages::default();
        self.all_gather_into(message, &mut received)?;
        Ok(received)
    }
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

    fn all_to_all(&mut self, messages: &Messages, received: &mut Messages) -> Result<(), ExchangeError> {
        received.clone_from(messages);
        Ok(())
    }

    fn all_gather_into(&mut self, message: &[u32], received: &mut Messages) -> Result<(), ExchangeError> {
        received.clear();
        received.push(message);
        Ok(())
    }
}

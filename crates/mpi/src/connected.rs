//! The connection through MPI: two collective operations, whose messages may differ in length.
//!
//! In: words for each rank. Out: words of each rank, in the order of ranks. MPI counts words in 32
//! bits, so what a rank sends or receives in one operation is limited to 2^31 words, 8 GiB; more is
//! an error.

use std::ops::Range;

use luxel_core::{Exchange, ExchangeError};
use mpi::datatype::{Partition, PartitionMut};
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};
use mpi::{Count, Threading};

use crate::ConnectError;

/// A connection between ranks.
pub struct Connection {
    /// MPI is finalised when it is dropped, which waits for all ranks.
    _universe: Universe,
}

/// Connects this process with the other ranks. Once in a process, on the thread that will exchange.
///
/// # Errors
/// MPI was initialised before, or does not work in threads.
pub fn connect() -> Result<Connection, ConnectError> {
    let Some((universe, threading)) = mpi::initialize_with_threading(Threading::Funneled) else {
        return Err(ConnectError("MPI was initialised before".to_owned()));
    };
    if threading == Threading::Single {
        return Err(ConnectError("this MPI library does not work in programs with threads; build it with MPI_THREAD_FUNNELED".to_owned()));
    }
    Ok(Connection { _universe: universe })
}

impl Connection {
    /// Returns the exchange between the ranks.
    pub fn exchange(&self) -> Box<dyn Exchange> {
        let world = SimpleCommunicator::world();
        Box::new(MpiExchange { rank: world.rank() as usize, ranks: world.size() as usize })
    }

    /// Ends all ranks with this exit code.
    pub fn abort(&self, code: u8) -> ! {
        SimpleCommunicator::world().abort(code.into())
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        // The other ranks wait for this one, which does not come.
        if std::thread::panicking() {
            self.abort(101);
        }
    }
}

struct MpiExchange {
    rank: usize,
    ranks: usize,
}

/// The words that a rank sends to each rank or receives of each: their numbers and where they
/// start.
struct Parts {
    counts: Vec<Count>,
    starts: Vec<Count>,
}

impl Parts {
    /// Describes these parts of the words.
    fn of(spans: impl IntoIterator<Item = Range<usize>>) -> Result<Self, ExchangeError> {
        let (mut counts, mut starts) = (Vec::new(), Vec::new());
        for span in spans {
            counts.push(count(span.len())?);
            starts.push(count(span.start)?);
        }
        Ok(Self { counts, starts })
    }

    /// Describes messages of these lengths, one behind the other.
    fn in_a_row(lengths: &[usize]) -> Result<Self, ExchangeError> {
        let mut end = 0;
        Self::of(lengths.iter().map(|length| {
            end += length;
            end - length..end
        }))
    }
}

fn count(words: usize) -> Result<Count, ExchangeError> {
    Count::try_from(words).map_err(|_| ExchangeError::too_large())
}

impl Exchange for MpiExchange {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.ranks
    }

    fn all_to_all(&mut self, sent: &[u32], spans: &[Range<usize>], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError> {
        let (to, from) = (Parts::of(spans.iter().cloned())?, Parts::in_a_row(lengths)?);
        let send = Partition::new(sent, to.counts, to.starts);
        let mut receive = PartitionMut::new(received, from.counts, from.starts);
        SimpleCommunicator::world().all_to_all_varcount_into(&send, &mut receive);
        Ok(())
    }

    fn all_gather_into(&mut self, sent: &[u32], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError> {
        count(sent.len())?;
        let from = Parts::in_a_row(lengths)?;
        let mut receive = PartitionMut::new(received, from.counts, from.starts);
        SimpleCommunicator::world().all_gather_varcount_into(sent, &mut receive);
        Ok(())
    }
}

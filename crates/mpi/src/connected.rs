//! The connection through MPI: two collective operations of variable length.
//!
//! In: words for each rank. Out: words of each rank, in the order of ranks. Lengths are exchanged
//! first, as MPI wants to know them. MPI counts words in 32 bits, so what a rank sends or receives
//! in one operation is limited to 2^31 words, 8 GiB; more is an error.

use luxel_core::{Exchange, ExchangeError, Messages};
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

/// Returns the displacements of messages of these lengths, one behind the other.
fn displacements(counts: &[Count]) -> Result<Vec<Count>, ExchangeError> {
    let mut end: Count = 0;
    let mut starts = Vec::with_capacity(counts.len());
    for count in counts {
        starts.push(end);
        end = end.checked_add(*count).ok_or_else(too_large)?;
    }
    Ok(starts)
}

fn too_large() -> ExchangeError {
    ExchangeError("a rank sends or receives more than 8 GiB at once, which MPI cannot count; lower the number of splats".to_owned())
}

fn count_of(message: &[u32]) -> Result<Count, ExchangeError> {
    Count::try_from(message.len()).map_err(|_| too_large())
}

impl Exchange for MpiExchange {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.ranks
    }

    fn all_to_all(&mut self, messages: &Messages, received: &mut Messages) -> Result<(), ExchangeError> {
        let world = SimpleCommunicator::world();
        let counts: Vec<Count> = messages.iter().map(count_of).collect::<Result<_, _>>()?;
        let mut incoming = vec![0 as Count; self.ranks];
        world.all_to_all_into(&counts[..], &mut incoming[..]);
        let (starts, incoming_starts) = (displacements(&counts)?, displacements(&incoming)?);
        let words = received.receive(incoming.iter().map(|count| *count as usize));
        let send = Partition::new(messages.words(), counts, starts);
        let mut receive = PartitionMut::new(words, incoming, incoming_starts);
        world.all_to_all_varcount_into(&send, &mut receive);
        Ok(())
    }

    fn all_gather_into(&mut self, message: &[u32], received: &mut Messages) -> Result<(), ExchangeError> {
        let world = SimpleCommunicator::world();
        let mut counts = vec![0 as Count; self.ranks];
        world.all_gather_into(&count_of(message)?, &mut counts[..]);
        let starts = displacements(&counts)?;
        let words = received.receive(counts.iter().map(|count| *count as usize));
        let mut receive = PartitionMut::new(words, counts, starts);
        world.all_gather_varcount_into(message, &mut receive);
        Ok(())
    }
}

//! The program without MPI: there is never a connection.

use std::convert::Infallible;

use luxel_core::Exchange;

use crate::ConnectError;

/// A connection between ranks, of which there is none without the feature `mpi`.
#[derive(Debug)]
pub struct Connection(Infallible);

/// Connects this process with the other ranks.
///
/// # Errors
/// Always: this program was built without MPI.
pub fn connect() -> Result<Connection, ConnectError> {
    Err(ConnectError(
        "this program was built without MPI; install an MPI library and libclang (on Debian: apt-get install libopenmpi-dev \
         openmpi-bin libclang-dev), and build with: cargo build --release --features mpi"
            .to_owned(),
    ))
}

impl Connection {
    /// Returns the exchange between the ranks.
    pub fn exchange(&self) -> Box<dyn Exchange> {
        match self.0 {}
    }

    /// Ends all ranks with this exit code.
    pub fn abort(&self, _code: u8) -> ! {
        match self.0 {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_says_how_to_get_mpi() {
        let error = connect().unwrap_err().to_string();
        assert!(error.contains("libopenmpi-dev") && error.contains("cargo build --release --features mpi"), "{error}");
    }
}

//! Waits for wgpu's futures.
//!
//! In: a future of a native backend. Out: its result. Source: `std::task`.

use std::pin::pin;
use std::task::{Context, Poll, Waker};

/// Polls a future until it is ready. The futures of wgpu's native backends are ready at once or
/// after a moment.
pub(crate) fn block_on<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        match future.as_mut().poll(&mut context) {
            Poll::Ready(output) => return output,
            Poll::Pending => std::thread::yield_now(),
        }
    }
}

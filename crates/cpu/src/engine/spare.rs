//! Buffers that wait for their next use: handles outlive the call that made them, so their memory
//! comes back when they are dropped.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use bytemuck::Pod;

/// Buffers that nobody uses.
#[derive(Default)]
pub(super) struct Spare<T>(Mutex<Vec<T>>);

/// Most buffers that wait: a program has few handles at a time.
const MOST: usize = 4;

impl<T: Default> Spare<T> {
    /// Returns a buffer, whose contents are arbitrary.
    pub(super) fn take(&self) -> T {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    /// Keeps a buffer for later.
    pub(super) fn give_back(&self, buffer: T) {
        let mut buffers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if buffers.len() < MOST {
            buffers.push(buffer);
        }
    }
}

/// Memory of results that callers handed back. A program that optimises asks for the same sizes
/// again and again.
#[derive(Default)]
pub(super) struct SpareNumbers(Mutex<VecDeque<Vec<f32>>>);

/// Numbers of the smallest memory that waits.
const LEAST_NUMBERS: usize = 4096;
/// Most results that wait, and most numbers in them: what was handed back first is freed.
const MOST_RESULTS: usize = 32;
const MOST_NUMBERS: usize = 64 << 20;

impl SpareNumbers {
    /// Returns `rows` rows of numbers, whose contents are arbitrary. `T` is an array of `f32`.
    pub(super) fn take<T: Pod>(&self, rows: usize) -> Vec<T> {
        let numbers = rows * (size_of::<T>() / size_of::<f32>());
        let found = {
            let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let place = waiting.iter().position(|vector| vector.len() == numbers);
            place.and_then(|place| waiting.remove(place))
        };
        match found.map(bytemuck::allocation::try_cast_vec) {
            Some(Ok(vector)) => vector,
            _ => vec![T::zeroed(); rows],
        }
    }

    /// Keeps memory for later.
    pub(super) fn give_back(&self, vector: Vec<f32>) {
        if vector.len() < LEAST_NUMBERS || vector.capacity() != vector.len() {
            return;
        }
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.push_back(vector);
        while waiting.len() > MOST_RESULTS || waiting.iter().map(Vec::len).sum::<usize>() > MOST_NUMBERS {
            waiting.pop_front();
        }
    }
}

//! Memory for the parameters of all splats: zeroed at first, in huge pages where the system
//! provides them.
//!
//! A step reads all parameters and moments once, front to back, and the processor's prefetching
//! stops at the end of each page: with pages of 4 KiB it would start again at every block of
//! splats. Degenerate: small buffers, and systems that refuse pages, use the allocator.

use std::ops::{Deref, DerefMut};

use memmap2::MmapMut;

use crate::lanes::Lanes;

/// Size of a huge page on x86-64 and most of aarch64. A smaller buffer is allocated as usual.
const HUGE_PAGE: usize = 2 << 20;

/// A buffer `[rows, 16]`, with room for more rows.
pub(crate) struct Buffer {
    memory: Memory,
    rows: usize,
}

enum Memory {
    Heap(Vec<Lanes>),
    /// Anonymous pages. Pages that were never written take no memory.
    Pages(MmapMut),
}

impl Buffer {
    pub(crate) fn zeros(rows: usize) -> Self {
        Self { memory: Memory::zeros(rows), rows }
    }

    /// Changes the length to `rows`. Afterwards the contents are arbitrary: zeros, or old values.
    /// Memory is allocated anew, with room for an eighth more, only if it is too small or more than
    /// twice too large.
    pub(crate) fn resize(&mut self, rows: usize) {
        let room = self.memory.rows().len();
        if rows > room || rows < room / 2 {
            // The old memory is freed before the new is allocated.
            self.memory = Memory::Heap(Vec::new());
            self.memory = Memory::zeros(rows + rows / 8);
        }
        self.rows = rows;
    }
}

impl Memory {
    fn zeros(rows: usize) -> Self {
        let pages = Some(rows * size_of::<Lanes>()).filter(|bytes| *bytes >= HUGE_PAGE).and_then(|bytes| MmapMut::map_anon(bytes).ok());
        match pages {
            Some(pages) => {
                #[cfg(target_os = "linux")]
                // Only a hint: without huge pages everything works, but slower.
                let _ = pages.advise(memmap2::Advice::HugePage);
                Self::Pages(pages)
            }
            // Too small, or refused: the allocator reports a lack of memory.
            None => Self::Heap(vec![Lanes::ZERO; rows]),
        }
    }

    fn rows(&self) -> &[Lanes] {
        match self {
            Self::Heap(rows) => rows,
            Self::Pages(pages) => bytemuck::cast_slice(pages),
        }
    }

    fn rows_mut(&mut self) -> &mut [Lanes] {
        match self {
            Self::Heap(rows) => rows,
            Self::Pages(pages) => bytemuck::cast_slice_mut(pages),
        }
    }
}

impl Deref for Buffer {
    type Target = [Lanes];

    fn deref(&self) -> &[Lanes] {
        &self.memory.rows()[..self.rows]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [Lanes] {
        &mut self.memory.rows_mut()[..self.rows]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_of_any_size_are_zero_and_writable() {
        for rows in [0, 1, HUGE_PAGE / size_of::<Lanes>() - 1, HUGE_PAGE / size_of::<Lanes>(), 100_001] {
            let mut buffer = Buffer::zeros(rows);
            assert_eq!(buffer.len(), rows);
            assert!(buffer.iter().all(|row| *row == Lanes::ZERO));
            if let Some(last) = buffer.last_mut() {
                last.0[15] = 1.0;
                assert_eq!(buffer[rows - 1].0[15], 1.0);
            }
        }
    }

    #[test]
    fn a_resized_buffer_keeps_its_memory_while_it_fits() {
        let mut buffer = Buffer::zeros(0);
        let page = HUGE_PAGE / size_of::<Lanes>();
        buffer.resize(2 * page);
        let at = buffer.as_ptr();
        for rows in [2 * page + page / 8, 2 * page, page + page / 4] {
            buffer.resize(rows);
            assert_eq!((buffer.len(), buffer.as_ptr()), (rows, at));
            buffer.fill(Lanes([1.0; 16]));
        }
        let room = |buffer: &Buffer| buffer.memory.rows().len();
        buffer.resize(3 * page);
        assert_eq!((buffer.len(), room(&buffer)), (3 * page, 3 * page + 3 * page / 8));
        assert!(buffer.iter().all(|row| *row == Lanes::ZERO));
        buffer.resize(0);
        assert_eq!((buffer.len(), room(&buffer)), (0, 0));
    }
}

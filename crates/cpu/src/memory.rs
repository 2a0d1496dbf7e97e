//! Memory for the parameters of all splats: zeroed at first, in huge pages where the system grants them.
//!
//! A step goes through hundreds of megabytes of parameters and moments once, front to back, and the processor's prediction of what comes next ends
//! at each page: in pages of 4 KiB it begins anew at every block of splats.

use std::ops::{Deref, DerefMut};

use memmap2::MmapMut;

use crate::lanes::Lanes;

/// Size of a huge page on x86-64 and most of aarch64; a buffer that would not fill one is an ordinary one.
const HUGE_PAGE: usize = 2 << 20;

/// `[rows, 16]`.
pub(crate) enum Buffer {
    Heap(Vec<Lanes>),
    /// Anonymous pages, of the buffer's size to the byte.
    Pages(MmapMut),
}

impl Buffer {
    pub(crate) fn zeros(rows: usize) -> Self {
        let pages = Some(rows * size_of::<Lanes>()).filter(|bytes| *bytes >= HUGE_PAGE).and_then(|bytes| MmapMut::map_anon(bytes).ok());
        match pages {
            Some(pages) => {
                #[cfg(target_os = "linux")]
                // Only a wish: without huge pages everything is as it should be, but slower.
                let _ = pages.advise(memmap2::Advice::HugePage);
                Self::Pages(pages)
            }
            // Too small, or refused: the allocator knows how to end a program that is out of memory.
            None => Self::Heap(vec![Lanes::ZERO; rows]),
        }
    }
}

impl Deref for Buffer {
    type Target = [Lanes];

    fn deref(&self) -> &[Lanes] {
        match self {
            Self::Heap(rows) => rows,
            Self::Pages(pages) => bytemuck::cast_slice(pages),
        }
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [Lanes] {
        match self {
            Self::Heap(rows) => rows,
            Self::Pages(pages) => bytemuck::cast_slice_mut(pages),
        }
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
}

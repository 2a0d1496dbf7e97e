//! Getting memory ahead of its use, where the processor does not foresee it.
//!
//! Its prediction of what comes next goes line by line and begins anew with each stretch of memory; a block of splats has sixty lines, after which
//! hundreds of cycles of arithmetic follow, in which nothing would be on its way. Two ways help: asking for a few lines and going on, which
//! too many questions hold up, and reading a long stretch at once.

use bytemuck::Pod;

use crate::lanes::Lanes;

/// Sixteens of splats between those that are asked for and those in work.
pub(crate) const AHEAD: usize = 2;

/// Bytes of a cache line; where it has more the reading is of no harm.
const LINE: usize = 64;

/// Reads values in a row, at the pace of memory, so that they are in the core's cache for who needs them here and there.
pub(crate) fn fetch<T: Pod>(values: &[T]) {
    let bytes: &[u8] = bytemuck::cast_slice(values);
    std::hint::black_box(bytes.chunks(LINE).fold(0, |sum, line| sum ^ line[0]));
}

/// Asks for what is at `first` and the `count - 1` numbers behind it, as far as there are so many. Does nothing where the processor has no such
/// instruction that the standard library knows.
#[inline(always)]
pub(crate) fn prefetch_rows(all: &[Lanes], first: usize, count: usize) {
    if let Some(rows) = all.get(first..) {
        rows.iter().take(count).for_each(prefetch);
    }
}

/// Asks for the cache line of a value.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    #[allow(unsafe_code)]
    // SAFETY: the instruction is part of every x86-64 processor, changes nothing but caches, and the address is that of a value that is there.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

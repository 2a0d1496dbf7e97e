//! Reads memory ahead of its use, where the processor does not predict it.
//!
//! The processor predicts accesses line by line, and starts again with each stretch of memory. A
//! block of splats takes tens of lines, followed by hundreds of cycles of arithmetic during which
//! no memory would be read. Two methods help: requesting a few lines without waiting for them
//! ([`prefetch`]), which stalls when there are too many requests, and reading a long stretch at
//! once ([`fetch`]).

use bytemuck::Pod;

use crate::lanes::Lanes;

/// Distance, in blocks of sixteen splats, between the splats that are requested and those being
/// processed.
pub(crate) const AHEAD: usize = 2;

/// Bytes of a cache line. Where lines are longer, the additional reads do no harm.
const LINE: usize = 64;

/// Reads consecutive values at the speed of memory, so that they are in the core's cache for later
/// access in random order.
pub(crate) fn fetch<T: Pod>(values: &[T]) {
    let bytes: &[u8] = bytemuck::cast_slice(values);
    std::hint::black_box(bytes.chunks(LINE).fold(0, |sum, line| sum ^ line[0]));
}

/// Requests `count` rows from `first` on, as far as they exist. Does nothing on processors without
/// a prefetch instruction in the standard library.
#[inline(always)]
pub(crate) fn prefetch_rows(all: &[Lanes], first: usize, count: usize) {
    if let Some(rows) = all.get(first..) {
        rows.iter().take(count).for_each(prefetch);
    }
}

/// Requests the cache line of a value.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    #[expect(unsafe_code, reason = "the standard library has no safe prefetch")]
    // SAFETY: the instruction is part of every x86-64 processor, affects nothing but caches, and
    // the address is that of a live reference.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

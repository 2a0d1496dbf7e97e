//! The ground of Luxel's kernels: the instruction sets that they are compiled for, the choice among
//! them, and the start of threads; sixteen numbers in memory, their sums, and their elementary
//! functions.
//!
//! A kernel is written once over `S: Simd`, sixteen numbers at a time. [`dispatch!`] compiles it
//! for each set of [`Level`] and picks one at run time. Every set costs its share of the build and
//! of the program, so there are three on x86-64 and one elsewhere. Processors with SSE4.2 but not
//! AVX2 run the baseline, which gives the same bits.

pub mod functions;
mod level;
mod memory;
pub mod sums;
mod thread;

pub use fearless_simd::Simd;

pub use crate::level::{Baseline, Level};
pub use crate::memory::{LANES, Lanes};
pub use crate::thread::start_thread;

/// Runs `$body`, compiled for the instruction set `$level`, with its token as `$simd`.
///
/// Closures within `$body` may not be inlined into it; each operation in such a closure is then a
/// call. Use functions marked `#[inline(always)]` instead.
#[macro_export]
macro_rules! dispatch {
    ($level:expr, $simd:pat => $body:expr) => {
        match $level {
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            $crate::Level::Avx512(token) => $crate::dispatch!(@with token, $simd => $body),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            $crate::Level::Avx2(token) => $crate::dispatch!(@with token, $simd => $body),
            $crate::Level::Baseline(token) => $crate::dispatch!(@with token, $simd => $body),
        }
    };
    (@with $token:ident, $simd:pat => $body:expr) => {{
        let $simd = $token;
        $crate::Simd::vectorize(
            $token,
            #[inline(always)]
            || $body,
        )
    }};
}

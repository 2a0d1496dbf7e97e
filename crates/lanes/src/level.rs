//! The instruction set of a processor.

use std::fmt;

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
use fearless_simd::x86::{Avx2, Avx512};

/// The token of the set that every processor of the target has.
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
pub type Baseline = fearless_simd::x86::Sse2;
/// The token of the set that every processor of the target has.
#[cfg(target_arch = "aarch64")]
pub type Baseline = fearless_simd::aarch64::Neon;
/// The token of the set that every processor of the target has.
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub type Baseline = fearless_simd::wasm32::WasmSimd128;
/// The token of the set that every processor of the target has.
#[cfg(not(any(
    target_arch = "x86",
    target_arch = "x86_64",
    target_arch = "aarch64",
    all(target_arch = "wasm32", target_feature = "simd128")
)))]
pub type Baseline = fearless_simd::Fallback;

/// An instruction set that kernels are compiled for, and proof that the processor has it.
#[derive(Clone, Copy)]
pub enum Level {
    /// AVX-512 as since Ice Lake and Zen 4.
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    Avx512(Avx512),
    /// AVX2 with FMA: x86-64-v3.
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    Avx2(Avx2),
    /// The set that every processor of the target has: SSE2 on x86-64, NEON on aarch64.
    Baseline(Baseline),
}

impl Level {
    /// Returns the best set that the processor has.
    pub fn best() -> Self {
        Self::avx512().or_else(Self::avx2).unwrap_or_else(Self::baseline)
    }

    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    fn avx512() -> Option<Self> {
        fearless_simd::Level::new().as_avx512().map(Self::Avx512)
    }

    #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
    fn avx512() -> Option<Self> {
        None
    }

    /// Returns AVX2 with FMA, if the processor has it.
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    pub fn avx2() -> Option<Self> {
        fearless_simd::Level::new().as_avx2().map(Self::Avx2)
    }

    /// Returns AVX2 with FMA, if the processor has it: here never.
    #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
    pub fn avx2() -> Option<Self> {
        None
    }

    /// Returns the set that every processor of the target has.
    pub fn baseline() -> Self {
        Self::Baseline(baseline_token())
    }

    /// Returns the set's name: `avx512`, `avx2`, `sse2`, `neon`, `wasmsimd128` or `fallback`.
    pub fn name(self) -> String {
        let token = match self {
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Avx512(token) => format!("{token:?}"),
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Self::Avx2(token) => format!("{token:?}"),
            Self::Baseline(token) => format!("{token:?}"),
        };
        token.split(['(', ' ', '{']).next().unwrap_or_default().to_lowercase()
    }
}

impl fmt::Debug for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name())
    }
}

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
fn baseline_token() -> Baseline {
    match fearless_simd::Level::new().as_sse2() {
        Some(token) => token,
        None => unreachable!("the target's processors have SSE2"),
    }
}

#[cfg(target_arch = "aarch64")]
fn baseline_token() -> Baseline {
    match fearless_simd::Level::new() {
        fearless_simd::Level::Neon(token) => token,
        #[allow(unreachable_patterns, reason = "NEON is the only set that this target has")]
        _ => unreachable!("the target's processors have NEON"),
    }
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
fn baseline_token() -> Baseline {
    match fearless_simd::Level::new() {
        fearless_simd::Level::WasmSimd128(token) => token,
        #[allow(unreachable_patterns, reason = "SIMD128 is the only set that this target has")]
        _ => unreachable!("the target has SIMD128"),
    }
}

#[cfg(not(any(
    target_arch = "x86",
    target_arch = "x86_64",
    target_arch = "aarch64",
    all(target_arch = "wasm32", target_feature = "simd128")
)))]
fn baseline_token() -> Baseline {
    Baseline::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_runs_the_body_with_its_own_token() {
        let levels = [Some(Level::best()), Level::avx2(), Some(Level::baseline())];
        for level in levels.into_iter().flatten() {
            let sum = crate::dispatch!(level, simd => {
                use fearless_simd::prelude::*;
                let numbers = fearless_simd::f32x16::splat(simd, 1.5);
                (numbers + numbers).to_array()
            });
            assert_eq!(sum, [3.0; 16], "{level:?}");
        }
    }

    #[test]
    fn the_best_level_has_a_short_name() {
        let name = Level::best().name();
        assert!(["avx512", "avx2", "sse2", "neon", "wasmsimd128", "fallback"].contains(&name.as_str()), "{name}");
    }
}

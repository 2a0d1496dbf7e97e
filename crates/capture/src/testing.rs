//! Frames for tests.

use std::sync::Arc;

use crate::{CapturedFrame, CodeTransfer, Codes, SampleLayout, SignalNoise};

/// Returns a frame of twelve linear bits of RGB signals, rounded and clipped.
pub(crate) fn linear_frame(width: usize, height: usize, signals: &[f32], signal_per_radiance: f32) -> CapturedFrame {
    let codes = signals.iter().map(|s| (s * 4095.0).round().clamp(0.0, 4095.0) as u16).collect();
    CapturedFrame {
        width,
        height,
        layout: SampleLayout::Rgb,
        samples: Codes::U16(codes),
        transfers: Arc::from(vec![linear_12_bits(); 3]),
        signal_per_radiance,
        noise: SignalNoise::typical(100.0),
        corrections: None,
    }
}

pub(crate) fn linear_12_bits() -> CodeTransfer {
    CodeTransfer::new((0..4096).map(|code| code as f32 / 4095.0).collect(), 0, 4050, 0.29)
}

//! Frames from decoded photographs: tables from black, white and response curves.
//!
//! In: samples as stored with the facts from their headers. Out: [`CapturedFrame`]. Degenerate: a
//! mosaic that is not a Bayer cell makes no frame.

use std::sync::Arc;

use luxel_core::photo::{Codes, RawInfo, RawPixels};

use crate::{CapturedFrame, Cell, CodeTransfer, Exposure, ResponseCurve, SampleLayout, SignalNoise};

/// Share of the range below white from which on a RAW sample counts as saturated: sensors bend
/// before they stop.
const RAW_CLIP: f32 = 0.985;
/// Uncertainty of a rounded code, in codes.
const ROUNDING: f32 = 0.29;
/// Pixels that [`thinned`] keeps of a frame.
const THINNED_PIXELS: usize = 40_000;

/// Makes a frame of sensor data; `None` where its mosaic cannot be developed.
pub fn raw_frame(pixels: RawPixels, info: &RawInfo, exposure: &Exposure) -> Option<CapturedFrame> {
    let RawPixels { width, height, cell, codes, black, white, corrections } = pixels;
    let layout = match cell {
        Some(colors) => SampleLayout::Mosaic(Cell::bayer(colors)?),
        None => SampleLayout::Rgb,
    };
    let transfers = (0..layout.phases()).map(|phase| raw_transfer(black[phase], white)).collect();
    // A camera that exposes less than its ISO speed implies has that much less signal.
    let signal_per_radiance = exposure.signal_per_radiance() * (-info.baseline_exposure_ev).exp2();
    let noise = match info.noise {
        Some([shot, offset]) => SignalNoise { shot: shot as f32, read: offset.sqrt() as f32 },
        None => SignalNoise::typical(exposure.iso.unwrap_or(100.0)),
    };
    let signal_per_radiance = signal_per_radiance as f32;
    let (samples, corrections) = (Codes::U16(codes), corrections.map(Arc::new));
    Some(CapturedFrame { width, height, layout, samples, transfers, signal_per_radiance, noise, corrections })
}

fn raw_transfer(black: f32, white: f32) -> CodeTransfer {
    let range = (white - black).max(1.0);
    let codes = (white.max(0.0) as usize + 1).min(1 << 16);
    let signal = (0..codes).map(|code| (code as f32 - black) / range).collect();
    let clip = (black + RAW_CLIP * range) as usize;
    // Noise at black is both above and below it: only codes under it mean "at most".
    CodeTransfer::new(signal, (black - 1.0).max(0.0) as usize, clip, ROUNDING)
}

/// Makes a frame of a developed picture, `[H*W*3]` codes, by the tables of its curve.
pub fn developed_frame([width, height]: [usize; 2], codes: Codes, tables: &CurveTables, exposure: &Exposure) -> CapturedFrame {
    CapturedFrame {
        width,
        height,
        layout: SampleLayout::Rgb,
        transfers: Arc::clone(tables.for_codes(&codes)),
        samples: codes,
        signal_per_radiance: exposure.signal_per_radiance() as f32,
        noise: SignalNoise::typical(exposure.iso.unwrap_or(100.0)),
        corrections: None,
    }
}

/// The tables of a response curve for both depths.
#[derive(Clone, Debug)]
pub struct CurveTables {
    of_8_bits: Arc<[CodeTransfer]>,
    of_16_bits: Arc<[CodeTransfer]>,
}

impl CurveTables {
    /// Evaluates a curve at every code.
    pub fn new(response: &ResponseCurve) -> Self {
        Self { of_8_bits: Arc::from(response.transfers(1 << 8)), of_16_bits: Arc::from(response.transfers(1 << 16)) }
    }

    /// Returns the tables for the depth of `codes`.
    pub fn for_codes(&self, codes: &Codes) -> &Arc<[CodeTransfer]> {
        match codes {
            Codes::U8(_) => &self.of_8_bits,
            Codes::U16(_) => &self.of_16_bits,
        }
    }
}

/// Keeps every n-th pixel of every n-th row of an RGB frame, about 40,000 in all: enough to recover
/// a response curve from.
pub fn thinned(frame: &CapturedFrame) -> CapturedFrame {
    let step = ((frame.width * frame.height) as f64 / THINNED_PIXELS as f64).sqrt().max(1.0) as usize;
    thinned_by(frame, step)
}

fn thinned_by(frame: &CapturedFrame, step: usize) -> CapturedFrame {
    let step = step.max(1);
    let (width, height) = (frame.width.div_ceil(step), frame.height.div_ceil(step));
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (y * step, x * step)));
    let indices = places.flat_map(|(y, x)| (0..3).map(move |c| (y * frame.width + x) * 3 + c));
    let samples = match &frame.samples {
        Codes::U8(v) => Codes::U8(indices.filter_map(|i| v.get(i).copied()).collect()),
        Codes::U16(v) => Codes::U16(indices.filter_map(|i| v.get(i).copied()).collect()),
    };
    CapturedFrame { width, height, samples, transfers: Arc::clone(&frame.transfers), corrections: None, ..*frame }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_and_white_levels_are_no_light_and_saturation() {
        let pixels = RawPixels {
            width: 2,
            height: 2,
            cell: Some([0, 1, 1, 2]),
            codes: vec![512, 4095, 2303, 500],
            black: [512.0; 4],
            white: 4095.0,
            corrections: None,
        };
        let info = RawInfo { baseline_exposure_ev: 1.0, ..RawInfo::default() };
        // Without speed and aperture, a second is a signal of this.
        let exposure = Exposure { seconds: 1.0, iso: None, f_number: None };
        let frame = raw_frame(pixels, &info, &exposure).unwrap();
        assert_eq!(f64::from(frame.signal_per_radiance), f64::from((exposure.signal_per_radiance() / 2.0) as f32));
        let transfer = &frame.transfers[0];
        assert_eq!((transfer.signal(512), transfer.signal(4095)), (0.0, 1.0));
        assert!((transfer.signal(2303) - 0.5).abs() < 1e-3 && transfer.signal(500) < 0.0);
        assert!(transfer.is_clipped(4090) && !transfer.is_clipped(4000) && transfer.is_dark(511) && !transfer.is_dark(512));
    }

    #[test]
    fn thinning_keeps_every_step() {
        let tables = CurveTables::new(&ResponseCurve::Srgb);
        let codes = Codes::U8((0..5 * 3 * 3).map(|i| i as u8).collect());
        let exposure = Exposure { seconds: 1.0, iso: None, f_number: None };
        let frame = thinned_by(&developed_frame([5, 3], codes, &tables, &exposure), 2);
        assert_eq!((frame.width, frame.height), (3, 2));
        assert_eq!(frame.samples, Codes::U8(vec![0, 1, 2, 6, 7, 8, 12, 13, 14, 30, 31, 32, 36, 37, 38, 42, 43, 44]));
    }
}

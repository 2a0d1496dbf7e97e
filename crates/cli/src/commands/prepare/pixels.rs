//! From a decoded photograph to a frame: tables from black, white and response curves.

use std::sync::Arc;

use luxel_capture::{Cell, Frame, Layout, Noise, Response, Samples, Transfer};
use luxel_io::{Codes, RawInfo, RawPixels};

/// Share of the range below white from which on a RAW sample counts as saturated: sensors bend before they stop.
const RAW_CLIP: f32 = 0.985;
/// Uncertainty of a rounded code, in codes.
const ROUNDING: f32 = 0.29;

/// A frame of sensor data; `None` where its mosaic is none that can be developed.
pub(super) fn raw_frame(pixels: RawPixels, info: &RawInfo, signal_per_radiance: f64, iso: Option<f64>) -> Option<Frame> {
    let RawPixels { width, height, cell, codes, black, white } = pixels;
    let layout = match cell {
        Some(colors) => Layout::Mosaic(Cell::bayer(colors)?),
        None => Layout::Rgb,
    };
    let transfers = (0..layout.phases()).map(|phase| raw_transfer(black[phase], white)).collect();
    // A camera that exposes less than its ISO speed says has that much less signal.
    let signal_per_radiance = signal_per_radiance * (-info.baseline_exposure_ev).exp2();
    let noise = match info.noise {
        Some([shot, offset]) => Noise { shot: shot as f32, read: offset.sqrt() as f32 },
        None => Noise::typical(iso.unwrap_or(100.0)),
    };
    Some(Frame { width, height, layout, samples: Samples::U16(codes), transfers, signal_per_radiance: signal_per_radiance as f32, noise })
}

fn raw_transfer(black: f32, white: f32) -> Transfer {
    let range = (white - black).max(1.0);
    let codes = (white.max(0.0) as usize + 1).min(1 << 16);
    let signal = (0..codes).map(|code| (code as f32 - black) / range).collect();
    let clip = (black + RAW_CLIP * range) as usize;
    // Black is where noise is both above and below: only what lies a code under it says "at most".
    Transfer::new(signal, (black - 1.0).max(0.0) as usize, clip, ROUNDING)
}

/// A frame of a developed picture.
pub(super) fn developed_frame(
    [width, height]: [usize; 2],
    codes: Codes,
    transfers: &Arc<[Transfer]>,
    signal_per_radiance: f64,
    iso: Option<f64>,
) -> Frame {
    let samples = match codes {
        Codes::U8(v) => Samples::U8(v),
        Codes::U16(v) => Samples::U16(v),
    };
    Frame {
        width,
        height,
        layout: Layout::Rgb,
        samples,
        transfers: Arc::clone(transfers),
        signal_per_radiance: signal_per_radiance as f32,
        noise: Noise::typical(iso.unwrap_or(100.0)),
    }
}

/// Tables of a curve for both depths.
#[derive(Clone, Debug)]
pub(super) struct Tables {
    of_8_bits: Arc<[Transfer]>,
    of_16_bits: Arc<[Transfer]>,
}

impl Tables {
    pub(super) fn new(response: &Response) -> Self {
        Self { of_8_bits: Arc::from(response.transfers(1 << 8)), of_16_bits: Arc::from(response.transfers(1 << 16)) }
    }

    pub(super) fn of(&self, codes: &Codes) -> &Arc<[Transfer]> {
        match codes {
            Codes::U8(_) => &self.of_8_bits,
            Codes::U16(_) => &self.of_16_bits,
        }
    }
}

/// Every `step`-th pixel of every `step`-th row of an RGB frame.
pub(super) fn thinned(frame: &Frame, step: usize) -> Frame {
    let step = step.max(1);
    let (width, height) = (frame.width.div_ceil(step), frame.height.div_ceil(step));
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (y * step, x * step)));
    let indices = places.flat_map(|(y, x)| (0..3).map(move |c| (y * frame.width + x) * 3 + c));
    let samples = match &frame.samples {
        Samples::U8(v) => Samples::U8(indices.filter_map(|i| v.get(i).copied()).collect()),
        Samples::U16(v) => Samples::U16(indices.filter_map(|i| v.get(i).copied()).collect()),
    };
    Frame { width, height, samples, transfers: Arc::clone(&frame.transfers), ..*frame }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_and_white_levels_are_nothing_and_saturation() {
        let pixels = RawPixels {
            width: 2,
            height: 2,
            cell: Some([0, 1, 1, 2]),
            codes: vec![512, 4095, 2303, 500],
            black: [512.0; 4],
            white: 4095.0,
        };
        let info = RawInfo { baseline_exposure_ev: 1.0, ..RawInfo::default() };
        let frame = raw_frame(pixels, &info, 2.0, None).unwrap();
        assert_eq!(frame.signal_per_radiance, 1.0);
        let transfer = &frame.transfers[0];
        assert_eq!((transfer.signal(512), transfer.signal(4095)), (0.0, 1.0));
        assert!((transfer.signal(2303) - 0.5).abs() < 1e-3 && transfer.signal(500) < 0.0);
        assert!(transfer.is_clipped(4090) && !transfer.is_clipped(4000) && transfer.is_dark(511) && !transfer.is_dark(512));
    }

    #[test]
    fn thinning_keeps_every_step() {
        let tables = Tables::new(&Response::Srgb);
        let codes = Codes::U8((0..5 * 3 * 3).map(|i| i as u8).collect());
        let transfers = Arc::clone(tables.of(&codes));
        let frame = thinned(&developed_frame([5, 3], codes, &transfers, 1.0, None), 2);
        assert_eq!((frame.width, frame.height), (3, 2));
        assert_eq!(frame.samples, Samples::U8(vec![0, 1, 2, 6, 7, 8, 12, 13, 14, 30, 31, 32, 36, 37, 38, 42, 43, 44]));
    }
}

//! By how much two exposures of one view are shifted against each other: a hint, nothing is moved.
//!
//! In: two frames of one size. Out: [`FrameOffset`] in pixels of the frames. Median threshold
//! bitmaps (Ward 2003) of the green channel at half resolution: the median is the same place of the
//! scene at every exposure. A pyramid finds the shift coarse to fine. Pixels near the median are
//! left out as noise. Where too few are left (a flat or saturated frame) there is no answer.

use serde::{Deserialize, Serialize};

use crate::CapturedFrame;

/// Shift of a frame against another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameOffset {
    /// Pixels to the right.
    pub x_px: i32,
    /// Pixels down.
    pub y_px: i32,
}

impl FrameOffset {
    /// Returns the length of the shift, pixels.
    pub fn length_px(&self) -> f64 {
        f64::from(self.x_px).hypot(f64::from(self.y_px))
    }
}

/// Longest side of the finest level: beyond, a shift of a pixel has no meaning.
const FINEST_SIDE: usize = 2000;
/// Shortest side of the coarsest level.
const COARSEST_SIDE: usize = 24;
/// Share of pixels that must differ from the median.
const ENOUGH: f64 = 0.2;

/// Returns the shift that best lays `frame` on `reference`; `None` where they cannot be compared.
pub fn frame_offset(reference: &CapturedFrame, frame: &CapturedFrame) -> Option<FrameOffset> {
    if (reference.width, reference.height) != (frame.width, frame.height) {
        return None;
    }
    let (a, b) = (Level::from_frame(reference), Level::from_frame(frame));
    let (mut a, mut b, mut scale) = (a, b, 2);
    while a.width.max(a.height) > FINEST_SIDE {
        (a, b, scale) = (a.halved(), b.halved(), scale * 2);
    }
    let mut pyramid = vec![(a, b)];
    while let Some((a, b)) = pyramid.last().filter(|(a, _)| a.width.min(a.height) / 2 >= COARSEST_SIDE) {
        let next = (a.halved(), b.halved());
        pyramid.push(next);
    }
    let mut best = FrameOffset { x_px: 0, y_px: 0 };
    for (a, b) in pyramid.iter().rev() {
        let (a, b) = (Bitmap::from_level(a)?, Bitmap::from_level(b)?);
        best = FrameOffset { x_px: 2 * best.x_px, y_px: 2 * best.y_px };
        let candidates = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        // The middle goes first among equals.
        let mut found = (a.difference(&b, best)?, best);
        for (dx, dy) in candidates {
            let at = FrameOffset { x_px: best.x_px + dx, y_px: best.y_px + dy };
            if let Some(difference) = a.difference(&b, at).filter(|d| *d < found.0) {
                found = (difference, at);
            }
        }
        best = found.1;
    }
    Some(FrameOffset { x_px: best.x_px * scale, y_px: best.y_px * scale })
}

struct Level {
    width: usize,
    height: usize,
    signal: Vec<f32>,
}

impl Level {
    fn from_frame(frame: &CapturedFrame) -> Self {
        let (width, height, signal) = frame.half_green();
        Self { width, height, signal }
    }

    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let at = |x: usize, y: usize| self.signal.get(y * self.width + x).copied().unwrap_or(0.0);
        let mean = |i: usize| {
            let (x, y) = (i % width * 2, i / width * 2);
            0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
        };
        Self { width, height, signal: (0..width * height).map(mean).collect() }
    }
}

struct Bitmap {
    width: usize,
    height: usize,
    /// Above the median; `None` too near to it.
    bits: Vec<Option<bool>>,
}

impl Bitmap {
    fn from_level(level: &Level) -> Option<Self> {
        let mut sorted = level.signal.clone();
        let middle = sorted.len() / 2;
        if sorted.is_empty() {
            return None;
        }
        let median = *sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
        let band = 0.04 * median.abs() + 2e-3;
        let bit = |s: &f32| if (s - median).abs() <= band { None } else { Some(*s > median) };
        Some(Self { width: level.width, height: level.height, bits: level.signal.iter().map(bit).collect() })
    }

    /// Returns the share of differing pixels with `other` shifted back by `shift`.
    fn difference(&self, other: &Self, shift: FrameOffset) -> Option<f64> {
        let (mut compared, mut differing) = (0usize, 0usize);
        for y in 0..self.height as i32 {
            let from_y = y + shift.y_px;
            if from_y < 0 || from_y >= self.height as i32 {
                continue;
            }
            for x in 0..self.width as i32 {
                let from_x = x + shift.x_px;
                if from_x < 0 || from_x >= self.width as i32 {
                    continue;
                }
                let a = self.bits.get(y as usize * self.width + x as usize).copied().flatten();
                let b = other.bits.get(from_y as usize * self.width + from_x as usize).copied().flatten();
                if let (Some(a), Some(b)) = (a, b) {
                    compared += 1;
                    differing += usize::from(a != b);
                }
            }
        }
        (compared as f64 >= ENOUGH * (self.width * self.height) as f64).then(|| differing as f64 / compared as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::linear_frame;

    /// Returns blobs at 256 x 192, moved and exposed.
    fn frame(shift: [f32; 2], exposure: f32) -> CapturedFrame {
        let signals: Vec<f32> = (0..256 * 192)
            .flat_map(|i| {
                let (x, y) = ((i % 256) as f32 - shift[0], (i / 256) as f32 - shift[1]);
                let v = 0.2 + 0.1 * ((x * 0.11).sin() + (y * 0.07 + 0.02 * x).cos()) + 0.05 * (x * 0.31 + y * 0.23).sin();
                [v * exposure; 3]
            })
            .collect();
        linear_frame(256, 192, &signals, exposure)
    }

    #[test]
    fn shifts_between_exposures_are_found() {
        for shift in [[0.0, 0.0], [6.0, -4.0], [-10.0, 14.0]] {
            let found = frame_offset(&frame([0.0; 2], 1.0), &frame(shift, 0.3)).unwrap();
            assert!((found.x_px as f32 - shift[0]).abs() <= 2.0 && (found.y_px as f32 - shift[1]).abs() <= 2.0, "{shift:?} {found:?}");
        }
    }

    #[test]
    fn flat_frames_have_no_answer() {
        let flat = linear_frame(64, 64, &[0.5; 64 * 64 * 3], 1.0);
        assert_eq!(frame_offset(&flat, &flat), None);
        assert_eq!(frame_offset(&flat, &linear_frame(1, 1, &[0.5; 3], 1.0)), None);
    }
}

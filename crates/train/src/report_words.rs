//! Reports of single views as words of 32 bits, for messages between ranks.
//!
//! In: [`StepReport`]s. Out: words, and the same reports to the bit. Degenerate: words that are no
//! report are `None`.

use glam::DVec3;
use luxel_core::engine::CameraGradient;
use luxel_core::{Knots, RESPONSE_KNOTS, StepReport};

/// Appends a report to a message.
pub(crate) fn write(report: &StepReport, words: &mut Vec<u32>) {
    let StepReport { step, loss, l1, ssim, visible, by_knots, camera, by_vignetting } = report;
    let parts = [by_knots.is_some(), camera.is_some(), by_vignetting.is_some()];
    let present = parts.into_iter().zip(0u32..).map(|(is_there, bit)| u32::from(is_there) << bit).sum::<u32>();
    words.extend([*step, loss.to_bits(), l1.to_bits(), ssim.to_bits(), *visible, present]);
    words.extend(by_knots.iter().flatten().flatten().map(|value| value.to_bits()));
    if let Some(CameraGradient { rotation, translation, focal_px }) = camera {
        let numbers = rotation.to_array().into_iter().chain(translation.to_array()).chain(*focal_px);
        words.extend(numbers.flat_map(|value| [value.to_bits() as u32, (value.to_bits() >> 32) as u32]));
    }
    words.extend(by_vignetting.iter().flatten().map(|value| value.to_bits()));
}

/// Reads a report from the start of a message, and moves on behind it.
pub(crate) fn read(message: &mut &[u32]) -> Option<StepReport> {
    let mut next = || {
        let (word, rest) = message.split_first()?;
        *message = rest;
        Some(*word)
    };
    let step = next()?;
    let [loss, l1, ssim] = [next()?, next()?, next()?].map(f32::from_bits);
    let (visible, present) = (next()?, next()?);
    let mut by_knots = None;
    if present & 1 != 0 {
        let mut knots: Knots = [[0.0; RESPONSE_KNOTS]; 3];
        for value in knots.as_flattened_mut() {
            *value = f32::from_bits(next()?);
        }
        by_knots = Some(knots);
    }
    let mut camera = None;
    if present & 2 != 0 {
        let mut numbers = [0.0; 8];
        for value in &mut numbers {
            *value = f64::from_bits(u64::from(next()?) | u64::from(next()?) << 32);
        }
        let [rx, ry, rz, tx, ty, tz, fx, fy] = numbers;
        camera = Some(CameraGradient { rotation: DVec3::new(rx, ry, rz), translation: DVec3::new(tx, ty, tz), focal_px: [fx, fy] });
    }
    let mut by_vignetting = None;
    if present & 4 != 0 {
        let words = [next()?, next()?, next()?, next()?];
        by_vignetting = Some(words.map(f32::from_bits));
    }
    Some(StepReport { step, loss, l1, ssim, visible, by_knots, camera, by_vignetting })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_pass_to_the_bit() {
        let plain = StepReport { step: 7, loss: 0.1, l1: f32::MIN_POSITIVE, ssim: -0.0, visible: u32::MAX, ..StepReport::default() };
        let camera =
            CameraGradient { rotation: DVec3::new(1e-300, -2.0, 0.1), translation: DVec3::splat(1.0 / 3.0), focal_px: [5.5, -0.0] };
        let knots = std::array::from_fn(|c| std::array::from_fn(|k| 0.1 * (c * RESPONSE_KNOTS + k) as f32));
        let full = StepReport { by_knots: Some(knots), camera: Some(camera), by_vignetting: Some([0.1, 0.2, -0.3, 1e-9]), ..plain };
        let mut words = Vec::new();
        [plain, full, plain].iter().for_each(|report| write(report, &mut words));
        let mut left = &*words;
        for expected in [plain, full, plain] {
            let found = read(&mut left).unwrap();
            assert_eq!(found, expected);
            assert_eq!(found.ssim.to_bits(), expected.ssim.to_bits());
        }
        assert!(left.is_empty() && read(&mut left).is_none() && read(&mut &words[..5]).is_none());
    }
}

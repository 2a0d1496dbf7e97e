//! Corrections of a lens on colours: warps, and gains that follow them.
//!
//! In: camera colours of the samples, linear, with the bits of those that are saturated, and
//! [`RawCorrections`]. Out: the picture that remains. Each plane is taken bilinearly from the place
//! that its warp names. Degenerate: a colour from outside of the samples is unknown, 0 and
//! marked as saturated, a lower bound that says nothing. Samples of another size than the active
//! area stay as they are.

use luxel_core::photo::{Gain, LensStep, RawCorrections, Warp};
use rayon::prelude::*;

/// Colours of the sensor.
pub(crate) struct CameraColors {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// `[H*W]`.
    pub(crate) pixels: Vec<[f32; 3]>,
    /// Bits of the channels that are lower bounds, `[H*W]`.
    pub(crate) saturated: Vec<u8>,
}

/// Applies the steps in their order, and crops.
pub(crate) fn corrected(mut colors: CameraColors, corrections: &RawCorrections) -> CameraColors {
    if corrections.steps.is_empty() || corrections.area_px != [colors.width, colors.height] {
        return colors;
    }
    for step in &corrections.steps {
        match step {
            LensStep::Gain(gain) => multiply(&mut colors, gain),
            LensStep::Warp(warp) => colors = warped(&colors, warp),
        }
    }
    cropped(colors, corrections)
}

fn multiply(colors: &mut CameraColors, gain: &Gain) {
    let area_px = [colors.width, colors.height];
    colors.pixels.par_chunks_mut(colors.width.max(1)).enumerate().for_each(|(y, row)| {
        let mut gains = vec![1.0; row.len() * 3];
        gain.multiply_row(area_px, [0, y], 3, |i| i % 3, &mut gains);
        row.as_flattened_mut().iter_mut().zip(gains).for_each(|(value, gain)| *value *= gain);
    });
}

fn warped(colors: &CameraColors, warp: &Warp) -> CameraColors {
    let (width, height) = (colors.width, colors.height);
    let is_of_all = warp.is_of_all_planes();
    let pixel = |i: usize| {
        let place = [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
        let source = |plane| warp.source([width, height], plane, place);
        let first = source(0);
        let (mut pixel, mut saturated) = ([0.0; 3], 0);
        for (plane, value) in pixel.iter_mut().enumerate() {
            let from = if is_of_all || plane == 0 { first } else { source(plane) };
            let Sample { light, is_bound } = sample(colors, from, plane);
            *value = light;
            saturated |= u8::from(is_bound) << plane;
        }
        (pixel, saturated)
    };
    let (pixels, saturated) = (0..width * height).into_par_iter().map(pixel).unzip();
    CameraColors { width, height, pixels, saturated }
}

/// A colour between pixels.
struct Sample {
    light: f32,
    /// Whether it is a lower bound.
    is_bound: bool,
}

fn sample(colors: &CameraColors, [x, y]: [f64; 2], plane: usize) -> Sample {
    let along = |at: f64, side: usize| {
        let at = at - 0.5;
        let last = side.saturating_sub(1);
        // Within the outermost pixels there is nothing to mix with.
        let is_inside = at >= -0.5 && at <= last as f64 + 0.5;
        let at = at.clamp(0.0, last as f64);
        is_inside.then_some((at as usize, (at as usize + 1).min(last), at.fract() as f32))
    };
    let (Some((x0, x1, fx)), Some((y0, y1, fy))) = (along(x, colors.width), along(y, colors.height)) else {
        return Sample { light: 0.0, is_bound: true };
    };
    let corners = [(x0, y0, (1.0 - fx) * (1.0 - fy)), (x1, y0, fx * (1.0 - fy)), (x0, y1, (1.0 - fx) * fy), (x1, y1, fx * fy)];
    let mut out = Sample { light: 0.0, is_bound: false };
    for (x, y, weight) in corners.into_iter().filter(|(_, _, weight)| *weight > 0.0) {
        let at = y * colors.width + x;
        out.light += weight * colors.pixels.get(at).map_or(0.0, |pixel| pixel[plane]);
        out.is_bound |= colors.saturated.get(at).is_some_and(|bits| bits >> plane & 1 == 1);
    }
    out
}

fn cropped(colors: CameraColors, corrections: &RawCorrections) -> CameraColors {
    let crop = corrections.crop;
    let is_inside = crop.left.saturating_add(crop.width) <= colors.width && crop.top.saturating_add(crop.height) <= colors.height;
    if !is_inside || (crop.width, crop.height) == (colors.width, colors.height) {
        return colors;
    }
    let places = |i: usize| (crop.top + i / crop.width) * colors.width + crop.left + i % crop.width;
    let count = crop.width * crop.height;
    let pixels = (0..count).map(|i| colors.pixels.get(places(i)).copied().unwrap_or_default()).collect();
    let saturated = (0..count).map(|i| colors.saturated.get(places(i)).copied().unwrap_or_default()).collect();
    CameraColors { width: crop.width, height: crop.height, pixels, saturated }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DMat3;
    use luxel_core::photo::{CropRect, GainShape, SampleRegion, WarpKind, WarpPlane};

    use super::*;
    use crate::testing::linear_frame;
    use crate::{CapturedFrame, Cell, SampleLayout, merge};

    fn scaling(factors: &[f64]) -> Warp {
        let plane = |factor: &f64| {
            let mut radial = [0.0; 15];
            radial[0] = *factor;
            WarpPlane { radial, tangential: [0.0; 2], valid: [0.0, 1.0] }
        };
        Warp { planes: factors.iter().map(plane).collect(), center: [0.5; 2], kind: WarpKind::Rectilinear }
    }

    /// Returns colours that are their pixels' columns.
    fn columns(width: usize, height: usize) -> CameraColors {
        let pixels = (0..width * height).map(|i| [(i % width) as f32 + 0.5; 3]).collect();
        CameraColors { width, height, pixels, saturated: vec![0; width * height] }
    }

    fn corrections(area_px: [usize; 2], steps: Vec<LensStep>, crop: CropRect) -> RawCorrections {
        RawCorrections { area_px, steps, crop, ..RawCorrections::default() }
    }

    #[test]
    fn planes_move_by_their_own_numbers_and_the_crop_follows() {
        let warp = scaling(&[1.0, 0.5, 2.0]);
        let crop = CropRect { left: 1, top: 1, width: 6, height: 2 };
        let out = corrected(columns(8, 4), &corrections([8, 4], vec![LensStep::Warp(warp)], crop));
        assert_eq!((out.width, out.height), (6, 2));
        // Pixel 0 of the crop is at 1.5, 2.5 from the centre: half of that at 2.75, twice outside.
        assert_eq!((out.pixels[0], out.saturated[0]), ([1.5, 2.75, 0.0], 0b100));
        assert_eq!((out.pixels[2], out.saturated[2]), ([3.5, 3.75, 3.0], 0));
    }

    #[test]
    fn saturation_moves_with_the_colours() {
        let mut colors = columns(8, 4);
        colors.saturated[8 + 2] = 0b010;
        let crop = CropRect { left: 0, top: 0, width: 8, height: 4 };
        let out = corrected(colors, &corrections([8, 4], vec![LensStep::Warp(scaling(&[0.5]))], crop));
        // Columns 0, 1 and 2 of the result come from 2.25, 2.75 and 3.25, beside column 2 at 2.5.
        let marked: Vec<usize> = (0..8).filter(|x| out.saturated[8 + x] != 0).collect();
        assert_eq!(marked, [0, 1, 2]);
    }

    #[test]
    fn gains_after_a_warp_are_of_the_places_they_end_up_at() {
        let region = SampleRegion { left: 2, right: 3, plane: 1, planes: 1, ..SampleRegion::ALL };
        let gain = Gain { region, shape: GainShape::Columns(vec![4.0]), is_by_color: true };
        let crop = CropRect { left: 0, top: 0, width: 8, height: 4 };
        let steps = vec![LensStep::Warp(scaling(&[0.5])), LensStep::Gain(gain)];
        let out = corrected(columns(8, 4), &corrections([8, 4], steps, crop));
        assert_eq!((out.pixels[2], out.pixels[3]), ([3.25, 13.0, 3.25], [3.75; 3]));
    }

    fn with_gain(frame: CapturedFrame, gain: Gain) -> CapturedFrame {
        let area_px = [frame.width, frame.height];
        CapturedFrame { corrections: Some(Arc::new(RawCorrections { area_px, gains: vec![gain], ..RawCorrections::default() })), ..frame }
    }

    #[test]
    fn gains_multiply_radiance_and_leave_saturation_alone() {
        // A saturated sample and one well below, both behind a lens that lets a quarter through.
        let gain = |factor: f32| Gain { region: SampleRegion::ALL, shape: GainShape::Rows(vec![factor]), is_by_color: true };
        let frame = linear_frame(2, 1, &[1.0, 1.0, 1.0, 0.25, 0.25, 0.25], 0.5);
        let merged = merge(&[with_gain(frame.clone(), gain(4.0))]).unwrap();
        assert_eq!(merged.saturated, [true, true, true, false, false, false]);
        assert!((merged.radiance[0] - 8.0).abs() < 1e-4 && (merged.radiance[3] - 2.0).abs() < 2e-3, "{:?}", merged.radiance);
        // Exposures of one light, each with the gain of its own file, agree.
        let longer = with_gain(linear_frame(2, 1, &[1.0, 1.0, 1.0, 0.5, 0.5, 0.5], 0.5), gain(2.0));
        let merged = merge(&[with_gain(frame, gain(4.0)), longer]).unwrap();
        assert!((merged.radiance[3] - 2.0).abs() < 2e-3 && merged.disagreeing == 0);
    }

    #[test]
    fn maps_of_the_four_places_of_a_mosaic_keep_to_them() {
        let cell = Cell::bayer([0, 1, 1, 2]).unwrap();
        let rgb = linear_frame(4, 4, &[0.1; 48], 1.0);
        let crate::Codes::U16(codes) = &rgb.samples else { unreachable!() };
        let samples = crate::Codes::U16(codes[..16].to_vec());
        let place = |top: usize, left: usize, gain: f32| Gain {
            region: SampleRegion { top, left, bottom: 4, right: 4, row_pitch: 2, column_pitch: 2, plane: 0, planes: 1 },
            shape: GainShape::Columns(vec![gain; 2]),
            is_by_color: false,
        };
        let gains = vec![place(0, 0, 2.0), place(0, 1, 3.0), place(1, 0, 4.0), place(1, 1, 5.0)];
        let corrections = RawCorrections { area_px: [4, 4], gains, ..RawCorrections::default() };
        let transfers = vec![crate::testing::linear_12_bits(); 4].into();
        let frame =
            CapturedFrame { layout: SampleLayout::Mosaic(cell), samples, transfers, corrections: Some(Arc::new(corrections)), ..rgb };
        let merged = merge(&[frame]).unwrap();
        let expected = [0.2, 0.3, 0.2, 0.3, 0.4, 0.5, 0.4, 0.5];
        assert!(merged.radiance[4..12].iter().zip([0.4, 0.5, 0.4, 0.5]).all(|(found, e)| (found - e).abs() < 1e-3));
        assert!(merged.radiance.iter().zip(expected).all(|(found, e)| (found - e).abs() < 1e-3), "{:?}", merged.radiance);
        assert_eq!(merged.develop([1.0; 3], &DMat3::IDENTITY).image.pixels.len(), 16);
    }
}

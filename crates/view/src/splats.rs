//! The splats of a scene for a page that renders by itself.
//!
//! In: a scene and the options that it is rendered with. Out: one body of little-endian numbers:
//! the length of the head (u32), the head (JSON, padded with blanks to a multiple of 4 bytes), and
//! the rows of [`ParameterRows`], one after the other, each with a number for every splat and
//! padded to a multiple of 4 bytes; behind them the 3D filter, where there is one or gains follow,
//! and the gains of edits ([`GAIN_ROW`]), where there are any.
//!
//! Harmonics above degree 0 may be half floats: a relative error of at most 4.9e-4 in coefficients
//! that change a splat's colour with direction. All else is exact. A row with a value beyond the
//! range of half floats stays single.

use bytes::Bytes;
use half::f16;
use half::slice::HalfFloatSliceExt;
use luxel_core::engine::{Antialias, MAX_SAMPLES, ParameterRows, RenderOptions};
use luxel_core::{Scene, Splats};
use serde::Serialize;
use serde_json::{Value, json};

/// How many bits harmonics above degree 0 have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Precision {
    /// Those of the scene.
    Single,
    /// Half floats.
    Half,
}

/// The numbers of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum RowKind {
    F32,
    F16,
}

/// Place of the gains of edits behind the rows of parameters.
pub(crate) const GAIN_ROW: usize = 1;

/// Largest half float.
const LARGEST_HALF: f32 = 65504.0;

/// Returns the bytes of a body for so many splats, without its head.
pub(crate) fn body_bytes(splats: &Splats, precision: Precision) -> u64 {
    let layout = ParameterRows { color_model: splats.color_model };
    let halves = harmonics_above_0(layout).len() as u64;
    let rows = rows_of(splats) as u64;
    let bytes = match precision {
        Precision::Single => 4 * rows,
        Precision::Half => 4 * (rows - halves) + 2 * halves,
    };
    bytes * splats.len() as u64
}

/// Returns the number of rows.
fn rows_of(splats: &Splats) -> usize {
    let behind = if splats.gain.is_empty() { usize::from(!splats.smoothing.is_empty()) } else { GAIN_ROW + 1 };
    ParameterRows { color_model: splats.color_model }.count() + behind
}

/// Returns the rows of harmonics above degree 0.
fn harmonics_above_0(layout: ParameterRows) -> std::ops::Range<usize> {
    ParameterRows::SH + 3..layout.luminance()
}

/// Returns the splats with all that is needed to render them.
pub(crate) fn pack(scene: &Scene, options: &RenderOptions, precision: Precision) -> Bytes {
    let splats = &scene.splats;
    let layout = ParameterRows { color_model: splats.color_model };
    let rows = rows_of(splats);
    let mut planes = Vec::with_capacity(body_bytes(splats, precision) as usize + 4 * rows);
    let mut kinds = Vec::with_capacity(rows);
    let mut values = Vec::with_capacity(splats.len());
    for row in 0..rows {
        values.clear();
        values.extend((0..splats.len()).map(|splat| parameter(splats, layout, row, splat)));
        let is_half = precision == Precision::Half && is_half_row(layout, row, &values);
        kinds.push(if is_half { RowKind::F16 } else { RowKind::F32 });
        push_row(&mut planes, &values, is_half);
    }
    body_with_head(head(scene, options, &kinds).to_string(), planes)
}

/// Returns whether the numbers of a row may be half floats.
pub(crate) fn is_half_row(layout: ParameterRows, row: usize, values: &[f32]) -> bool {
    harmonics_above_0(layout).contains(&row) && values.iter().all(|value| value.abs() <= LARGEST_HALF)
}

/// Adds a row, padded to a multiple of 4 bytes.
pub(crate) fn push_row(planes: &mut Vec<u8>, values: &[f32], is_half: bool) {
    if is_half {
        let mut rounded = vec![f16::ZERO; values.len()];
        rounded.convert_from_f32_slice(values);
        planes.extend(rounded.iter().flat_map(|half| half.to_le_bytes()));
    } else {
        planes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    planes.resize(planes.len().next_multiple_of(4), 0);
}

/// Returns the head, after its length, and what follows it.
pub(crate) fn body_with_head(mut head: String, mut planes: Vec<u8>) -> Bytes {
    while !head.len().is_multiple_of(4) {
        head.push(' ');
    }
    let mut body = Vec::with_capacity(4 + head.len() + planes.len());
    body.extend_from_slice(&(head.len() as u32).to_le_bytes());
    body.extend_from_slice(head.as_bytes());
    body.append(&mut planes);
    body.into()
}

/// Returns a parameter of a splat by the number of its row.
pub(crate) fn parameter(splats: &Splats, layout: ParameterRows, row: usize, splat: usize) -> f32 {
    let value = match row {
        _ if row < ParameterRows::ROTATION => splats.position[splat].get(row),
        _ if row < ParameterRows::LOG_SCALE => splats.rotation[splat].get(row - ParameterRows::ROTATION),
        _ if row < ParameterRows::OPACITY => splats.log_scale[splat].get(row - ParameterRows::LOG_SCALE),
        _ if row < ParameterRows::SH => splats.opacity_logit.get(splat),
        _ if row < layout.luminance() => splats.sh_of(splat).get(row - ParameterRows::SH),
        _ if row < layout.count() => splats.raw_luminance_of(splat).get(row - layout.luminance()),
        _ if row == layout.count() => splats.smoothing.get(splat),
        _ => return splats.gain_of(splat),
    };
    value.copied().unwrap_or(0.0)
}

fn head(scene: &Scene, options: &RenderOptions, kinds: &[RowKind]) -> Value {
    let RenderOptions { raster, background, active_degree } = options;
    let (cutoffs, antialias) = (raster.cutoffs, raster.antialias);
    let layout = ParameterRows { color_model: scene.splats.color_model };
    json!({
        "splats": scene.splats.len(),
        "colorModel": scene.splats.color_model.name(),
        "parameters": layout.count(),
        "rows": kinds,
        "isDisplay": !scene.color_space.is_linear(),
        "radianceScale": scene.radiance_scale.get(),
        "depthUnit": scene.world_from_local.scale() as f32,
        "options": {
            "minAlpha": cutoffs.min_alpha,
            // JSON has no infinity.
            "minContribution": cutoffs.min_contribution.is_finite().then_some(cutoffs.min_contribution),
            "alphaFloor": cutoffs.alpha_floor,
            "minTransmittance": cutoffs.min_transmittance,
            "maxAlpha": cutoffs.max_alpha,
            "near": cutoffs.near,
            "dilationPx2": antialias.dilation_px2(),
            "compensatesOpacity": antialias.compensates_opacity(),
            "smooths": antialias == Antialias::Mip && !scene.splats.smoothing.is_empty(),
            "samples": raster.samples.clamp(1, MAX_SAMPLES),
            "activeDegree": (*active_degree).min(luxel_core::sh::MAX_DEGREE),
            "background": background,
        },
    })
}

#[cfg(test)]
mod tests {
    use luxel::synthetic;

    use super::*;

    fn parts(body: &[u8]) -> (Value, &[u8]) {
        let length = u32::from_le_bytes(body[..4].try_into().unwrap()) as usize;
        (serde_json::from_slice(&body[4..4 + length]).unwrap(), &body[4 + length..])
    }

    #[test]
    fn rows_hold_every_parameter_and_only_harmonics_are_rounded() {
        let scene = synthetic::room(7, 1);
        let layout = ParameterRows { color_model: scene.splats.color_model };
        for precision in [Precision::Single, Precision::Half] {
            let body = pack(&scene, &scene.render_options(), precision);
            let (head, mut planes) = parts(&body);
            assert_eq!((&head["splats"], head["rows"].as_array().unwrap().len()), (&7.into(), layout.count()));
            for row in 0..layout.count() {
                let is_half = head["rows"][row] == "f16";
                assert_eq!(is_half, precision == Precision::Half && harmonics_above_0(layout).contains(&row), "row {row}");
                for splat in 0..7 {
                    let expected = parameter(&scene.splats, layout, row, splat);
                    let found = match is_half {
                        true => f16::from_le_bytes(planes[2 * splat..][..2].try_into().unwrap()).to_f32(),
                        false => f32::from_le_bytes(planes[4 * splat..][..4].try_into().unwrap()),
                    };
                    let tolerance = if is_half { expected.abs() * 4.9e-4 + 6e-8 } else { 0.0 };
                    assert!((found - expected).abs() <= tolerance, "row {row}: {found} for {expected}");
                }
                planes = &planes[if is_half { 16 } else { 28 }..];
            }
            assert!(planes.is_empty());
        }
    }

    #[test]
    fn a_row_beyond_half_floats_stays_single() {
        let mut scene = Scene::clone(&synthetic::room(3, 1));
        scene.splats.sh[4] = 1e6;
        let body = pack(&scene, &scene.render_options(), Precision::Half);
        let kinds = parts(&body).0["rows"].as_array().unwrap().iter().filter(|kind| *kind == "f32").count();
        let whole = pack(&synthetic::room(3, 1), &scene.render_options(), Precision::Half);
        assert_eq!(kinds, 1 + parts(&whole).0["rows"].as_array().unwrap().iter().filter(|kind| *kind == "f32").count());
    }
}

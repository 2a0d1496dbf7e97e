//! The constants in front of every shader, as WGSL.
//!
//! In: core's constants, and those of `layout.rs`. Out: WGSL text. No shader repeats a constant.

use std::fmt::Write;

use luxel_core::engine::ParameterRows;
use luxel_core::engine::{ADAM_EPSILON, MIN_AREA_RATIO};
use luxel_core::{Activation, ColorModel, Component, DEAD_CHROMA_FLOOR, MAX_EXP_ARGUMENT, SH_OFFSET, sh};
use luxel_core::{SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};

use crate::layout::{
    BLOCK_PX, BLOCKS, BUCKET, CULLED_KEY, DENSIFY_CAP, DENSIFY_SMOOTHING, DIGITS, FLAG_ABSOLUTE, FLAG_COMPENSATION, FLAG_EDIT_GAIN,
    FLAG_MIN_CONTRIBUTION, FLAG_SMOOTHING, FLAG_TRAINING, GATHER_ALONE, HALT_NONE, HALT_NOT_FINITE, HALT_OVERFLOW, MARGIN_PX, MAX_GROUPS,
    PLAN_KEEP_MOMENTS, PLAN_NEW_OPACITY, SORT_BLOCK, SORT_COMPACT, SORT_ENTRIES, SORT_IDENTITY, SORT_VISIBLE, TILE_PX,
};

/// Whether the update moves parameters, or only returns their gradients or that by the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Update {
    /// Adam.
    Parameters,
    /// Gradients are stored in place of the first moments.
    OnlyGradients,
    /// Nothing is stored but the gradient by the camera.
    OnlyCamera,
}

/// Returns the constants in front of every shader.
pub(crate) fn constants() -> String {
    let mut text = String::new();
    let integers = [
        ("TILE_PX", TILE_PX),
        ("TILE_PIXELS", TILE_PX * TILE_PX),
        ("BLOCK_WIDTH", BLOCK_PX[0]),
        ("BLOCK_HEIGHT", BLOCK_PX[1]),
        ("BLOCK_PIXELS", BLOCK_PX[0] * BLOCK_PX[1]),
        ("BLOCKS", BLOCKS),
        ("BUCKET", BUCKET),
        ("SORT_BLOCK", SORT_BLOCK),
        ("DIGITS", DIGITS),
        ("CULLED_KEY", CULLED_KEY),
        ("GATHER_ALONE", GATHER_ALONE),
        ("MAX_GROUPS", MAX_GROUPS),
        ("FLAG_COMPENSATION", FLAG_COMPENSATION),
        ("FLAG_SMOOTHING", FLAG_SMOOTHING),
        ("FLAG_EDIT_GAIN", FLAG_EDIT_GAIN),
        ("FLAG_MIN_CONTRIBUTION", FLAG_MIN_CONTRIBUTION),
        ("FLAG_TRAINING", FLAG_TRAINING),
        ("FLAG_ABSOLUTE", FLAG_ABSOLUTE),
        ("SORT_ENTRIES", SORT_ENTRIES),
        ("SORT_IDENTITY", SORT_IDENTITY),
        ("SORT_COMPACT", SORT_COMPACT),
        ("SORT_VISIBLE", SORT_VISIBLE),
        ("HALT_NONE", HALT_NONE),
        ("HALT_OVERFLOW", HALT_OVERFLOW),
        ("HALT_NOT_FINITE", HALT_NOT_FINITE),
        ("PLAN_KEEP_MOMENTS", PLAN_KEEP_MOMENTS),
        ("PLAN_NEW_OPACITY", PLAN_NEW_OPACITY),
        ("DENSIFY_CAP", DENSIFY_CAP),
        ("DENSIFY_SMOOTHING", DENSIFY_SMOOTHING),
        ("SSIM_RADIUS", SSIM_RADIUS as u32),
        ("ROW_POSITION", ParameterRows::POSITION as u32),
        ("ROW_ROTATION", ParameterRows::ROTATION as u32),
        ("ROW_LOG_SCALE", ParameterRows::LOG_SCALE as u32),
        ("ROW_OPACITY", ParameterRows::OPACITY as u32),
        ("ACTIVATION_SOFTPLUS", 0),
        ("ACTIVATION_EXP", 1),
        ("ACTIVATION_RELU", 2),
    ];
    for (name, value) in integers {
        declare(&mut text, name, "u32", &format!("{value}u"));
    }
    let numbers = [
        ("MARGIN_PX", MARGIN_PX),
        ("MIN_AREA_RATIO", MIN_AREA_RATIO),
        ("SQRT_HALF_LOG2_E", std::f32::consts::LOG2_E.sqrt() * std::f32::consts::FRAC_1_SQRT_2),
        ("LOG2_E", std::f32::consts::LOG2_E),
        ("TWO_LN_2", 2.0 * std::f32::consts::LN_2),
        ("TAU", std::f32::consts::TAU),
        ("MAX_EXP_ARGUMENT", MAX_EXP_ARGUMENT),
        ("DEAD_CHROMA_FLOOR", DEAD_CHROMA_FLOOR),
        ("SH_OFFSET", SH_OFFSET),
        ("SSIM_C1", SSIM_C1 as f32),
        ("SSIM_C2", SSIM_C2 as f32),
        ("ADAM_EPSILON", ADAM_EPSILON),
        ("SH_C0", sh::C0),
        ("SH_C1", sh::C1),
    ];
    for (name, value) in numbers {
        declare(&mut text, name, "f32", &number(value));
    }
    let tables: [(&str, &[f32]); 4] = [("SH_C2", &sh::C2), ("SH_C3", &sh::C3), ("SH_C4", &sh::C4), ("SH_C5", &sh::C5)];
    for (name, values) in tables {
        let list: Vec<String> = values.iter().map(|v| number(*v)).collect();
        let kind = format!("array<f32, {}>", values.len());
        declare(&mut text, name, &kind, &format!("{kind}({})", list.join(", ")));
    }
    text
}

/// Returns the functions that apply the window of SSIM in loss.wgsl, tap by tap: sums over places
/// in a row of the halo, or in a column of the rows' sums. Taps of one weight are added first, the
/// small ones before the large.
pub(crate) fn windows() -> String {
    let weights = ssim_window().map(|weight| weight as f32);
    let mut text = String::new();
    for (name, kind, value, stride) in [
        ("moments_of_row", "vec4f", "moments_at", 1),
        ("moments_of_column", "vec4f", "row_at", TILE_PX as usize),
        ("derivatives_of_row", "vec3f", "derivatives_at", 1),
        ("derivatives_of_column", "vec3f", "row_derivatives_at", TILE_PX as usize),
    ] {
        let tap = |k: usize| format!("{value}(first + {}u)", k * stride);
        let pairs = (0..SSIM_RADIUS).map(|k| format!("{} * ({} + {})", number(weights[k]), tap(k), tap(2 * SSIM_RADIUS - k)));
        let middle = format!("{} * {}", number(weights[SSIM_RADIUS]), tap(SSIM_RADIUS));
        let terms: Vec<String> = pairs.chain([middle]).collect();
        // Writing to a string does not fail.
        let _ = writeln!(text, "fn {name}(first: u32) -> {kind} {{\n    return {};\n}}\n", terms.join("\n        + "));
    }
    text
}

/// Returns the constants that follow from the colour model, for its light number `light`.
pub(crate) fn model_constants(model: ColorModel, light: usize, update: Update) -> String {
    let rows = ParameterRows { color_model: model };
    let Component { light, sh: first_sh, luminance: first_luminance, gain } = model.component(light);
    let activation = match light.activation().unwrap_or_default() {
        Activation::Softplus => "ACTIVATION_SOFTPLUS",
        Activation::Exp => "ACTIVATION_EXP",
        Activation::Relu => "ACTIVATION_RELU",
    };
    let mut text = String::new();
    let integers = [
        ("SH_DEGREE", light.sh_degree() as u32),
        ("LUMINANCE_DEGREE", light.luminance_degree() as u32),
        ("MAX_LIGHT_DEGREE", light.max_degree() as u32),
        ("SH_COEFFICIENTS", light.sh_coefficients() as u32),
        ("LUMINANCE_COEFFICIENTS", light.luminance_coefficients() as u32),
        ("ROW_SH", (ParameterRows::SH + 3 * first_sh) as u32),
        ("ROW_LUMINANCE", (rows.luminance() + first_luminance) as u32),
        ("ROW_GAIN", (rows.luminance() + gain.unwrap_or(0)) as u32),
        ("ROW_SMOOTHING", rows.count() as u32),
        ("ROW_EDIT_GAIN", rows.count() as u32 + 1),
        ("ROWS", rows.count() as u32),
    ];
    for (name, value) in integers {
        declare(&mut text, name, "u32", &format!("{value}u"));
    }
    declare(&mut text, "ACTIVATION", "u32", activation);
    declare(&mut text, "IS_LCD", "bool", &light.activation().is_some().to_string());
    declare(&mut text, "IS_LOG", "bool", &light.is_log().to_string());
    declare(&mut text, "HAS_GAIN", "bool", &gain.is_some().to_string());
    declare(&mut text, "ONLY_GRADIENTS", "bool", &(update == Update::OnlyGradients).to_string());
    declare(&mut text, "ONLY_CAMERA", "bool", &(update == Update::OnlyCamera).to_string());
    text
}

fn declare(text: &mut String, name: &str, kind: &str, value: &str) {
    // Writing to a string does not fail.
    let _ = writeln!(text, "const {name}: {kind} = {value};");
}

/// Formats the shortest decimal that reads back as `value`.
fn number(value: f32) -> String {
    format!("{value:?}f")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_read_back_to_the_bit() {
        for value in [ADAM_EPSILON, sh::C0, MARGIN_PX, f32::MIN_POSITIVE, 1e30, -0.1] {
            assert_eq!(number(value).trim_end_matches('f').parse::<f32>().unwrap().to_bits(), value.to_bits());
        }
    }
}

//! Scene to PLY, in blocks of rows: what is held in memory does not grow with the scene.

use std::io::Write;
use std::path::Path;

use luxel_core::{ColorModel, Scene, Splats, sigmoid};
use rayon::prelude::*;

use crate::ply::bake::DisplayBake;
use crate::ply::{COMMENT_TAG, FORMAT_VERSION, is_normalizable, is_usable, record};
use crate::{IoError, write_atomically};

/// Rows made at a time.
const BLOCK_ROWS: usize = 4096;

/// Log scale before the smoothing filter.
pub(super) const EXACT_SCALE: [&str; 3] = ["lcd_log_scale_0", "lcd_log_scale_1", "lcd_log_scale_2"];

/// Prefix of the properties that hold `Splats::sh`.
pub(super) fn sh_prefix(color_model: ColorModel) -> &'static str {
    match color_model {
        ColorModel::Sh { .. } => "lcd_s_",
        ColorModel::Lcd { .. } => "lcd_c_",
    }
}

/// Writes a scene, whole or not at all; folders are made as needed.
///
/// # Errors
/// A scene that could not be read back (wrong lengths, NaN, a rotation of length zero, a radiance scale that is not positive), or
/// the file system's refusal.
pub fn write_scene_ply(path: &Path, scene: &Scene) -> Result<(), IoError> {
    check(path, scene)?;
    write_atomically(path, |file| write(scene, file).map_err(|e| IoError::system(path, "write", &e)))
}

/// The bytes that [`write_scene_ply`] writes; `name` is for errors.
///
/// # Errors
/// As [`write_scene_ply`].
pub fn encode_scene_ply(name: &Path, scene: &Scene) -> Result<Vec<u8>, IoError> {
    check(name, scene)?;
    let mut bytes = Vec::new();
    write(scene, &mut bytes).map_err(|e| IoError::system(name, "write", &e))?;
    Ok(bytes)
}

fn check(path: &Path, scene: &Scene) -> Result<(), IoError> {
    let splats = &scene.splats;
    let invalid = |message: String| Err(IoError::invalid(path, format_args!("scene to write: {message}")));
    if let Err(e) = splats.validate() {
        return invalid(e.to_string());
    }
    if let Some(i) = splats.rotation.iter().position(|q| !is_normalizable(*q)) {
        return invalid(format!("rotation of splat {i} is {:?}, expected a quaternion of length about 1", splats.rotation[i]));
    }
    if let Some(i) = splats.smoothing.iter().position(|s| *s < 0.0) {
        return invalid(format!("smoothing of splat {i} is {}, expected 0 or more", splats.smoothing[i]));
    }
    if !(scene.radiance_scale.is_finite() && scene.radiance_scale > 0.0) {
        return invalid(format!("radiance scale {}, expected a positive number", scene.radiance_scale));
    }
    if !is_usable(&scene.raster) {
        return invalid(format!("raster configuration {:?}, expected cut-offs of 0 to 1", scene.raster));
    }
    record::check(&scene.edits).map_err(|message| IoError::invalid(path, format_args!("scene to write: {message}")))
}

fn write<W: Write + ?Sized>(scene: &Scene, out: &mut W) -> std::io::Result<()> {
    let bake = DisplayBake::new(scene);
    let properties = properties(&scene.splats, &bake);
    write_header(scene, &bake, &properties, out)?;
    let count = scene.splats.len();
    let row_bytes = 4 * properties.len();
    let mut block = vec![0u8; BLOCK_ROWS.min(count) * row_bytes];
    for first in (0..count).step_by(BLOCK_ROWS) {
        let rows = BLOCK_ROWS.min(count - first);
        let part = &mut block[..rows * row_bytes];
        part.par_chunks_exact_mut(row_bytes).enumerate().for_each_init(
            || Vec::with_capacity(properties.len()),
            |values, (row, bytes)| {
                values.clear();
                fill_row(&scene.splats, first + row, &bake, values);
                for (to, value) in bytes.chunks_exact_mut(4).zip(values) {
                    to.copy_from_slice(&value.to_le_bytes());
                }
            },
        );
        out.write_all(part)?;
    }
    Ok(())
}

fn write_header<W: Write + ?Sized>(scene: &Scene, bake: &DisplayBake, properties: &[String], out: &mut W) -> std::io::Result<()> {
    let model = serde_json::to_string(&scene.splats.color_model)?;
    let raster = serde_json::to_string(&scene.raster)?;
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    writeln!(out, "comment {COMMENT_TAG} scene {FORMAT_VERSION}")?;
    writeln!(out, "comment {COMMENT_TAG} color_space {}", scene.color_space.name())?;
    writeln!(out, "comment {COMMENT_TAG} color_model {model}")?;
    writeln!(out, "comment {COMMENT_TAG} radiance_scale {:e}", scene.radiance_scale)?;
    writeln!(out, "comment {COMMENT_TAG} raster {raster}")?;
    for edit in &scene.edits {
        writeln!(out, "comment {COMMENT_TAG} edit {}", record::escaped(edit))?;
    }
    writeln!(out, "comment {COMMENT_TAG} display_bake {}", bake.description())?;
    writeln!(out, "comment lcd_* properties hold the radiance model exactly; f_dc, f_rest, opacity and scale are for display")?;
    writeln!(out, "element vertex {}", scene.splats.len())?;
    for name in properties {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")
}

/// Names in the order of [`fill_row`].
fn properties(splats: &Splats, bake: &DisplayBake) -> Vec<String> {
    let standard = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned);
    let mut names = Vec::from(standard);
    names.extend((0..3 * (bake.coefficients() - 1)).map(|i| format!("f_rest_{i}")));
    names.extend(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(str::to_owned));
    names.extend((0..splats.color_model.luminance_coefficients()).map(|m| format!("lcd_l_{m}")));
    let prefix = sh_prefix(splats.color_model);
    names.extend((0..3 * splats.color_model.sh_coefficients()).map(|i| format!("{prefix}{i}")));
    if !splats.smoothing.is_empty() {
        names.extend(["lcd_filter", "lcd_opacity"].into_iter().chain(EXACT_SCALE).map(str::to_owned));
    }
    names
}

/// Values of splat `i` in the order of [`properties`].
fn fill_row(splats: &Splats, i: usize, bake: &DisplayBake, values: &mut Vec<f32>) {
    let baked = bake.bake(splats, i);
    let (log_scale, opacity_logit) = match splats.smoothing.get(i) {
        Some(deviation) => smoothed(splats.log_scale[i], splats.opacity_logit[i], *deviation),
        None => (splats.log_scale[i], splats.opacity_logit[i]),
    };
    values.extend(splats.position[i]);
    values.extend([0.0; 3]);
    values.extend(baked.map(|channel| channel[0]));
    for channel in &baked {
        values.extend_from_slice(&channel[1..bake.coefficients()]);
    }
    values.push(opacity_logit);
    values.extend(log_scale);
    values.extend(splats.rotation[i]);
    values.extend_from_slice(splats.raw_luminance_of(i));
    values.extend_from_slice(splats.sh_of(i));
    if let Some(deviation) = splats.smoothing.get(i) {
        values.extend([*deviation, splats.opacity_logit[i]]);
        values.extend(splats.log_scale[i]);
    }
}

/// Log scale and opacity logit with the 3D smoothing filter of `deviation` applied: variances add, and the opacity shrinks by the ratio
/// of volumes (Yu et al. 2024, eq. 9).
fn smoothed(log_scale: [f32; 3], opacity_logit: f32, deviation: f32) -> ([f32; 3], f32) {
    // The range within which a variance neither vanishes nor overflows.
    let variance = |log_scale: f32| (2.0 * f64::from(log_scale).clamp(-100.0, 100.0)).exp();
    let added = f64::from(deviation).powi(2);
    let wide = log_scale.map(|s| 0.5 * (variance(s) + added).ln());
    let ratio: f64 = log_scale.iter().zip(wide).map(|(s, w)| f64::from(*s).clamp(-100.0, 100.0) - w).sum::<f64>().exp();
    (wide.map(|s| s as f32), luxel_core::logit((f64::from(sigmoid(opacity_logit)) * ratio) as f32))
}

//! PlayCanvas' compressed PLY, as SuperSplat and splat-transform write it, to a scene of harmonics.
//!
//! In: element `chunk`, one row for each 256 splats, floats `min_x` to `max_scale_z` and perhaps
//! `min_r` to `max_b`; element `vertex` with `packed_position` and `packed_scale` (11, 10 and 11
//! bits between the chunk's bounds), `packed_rotation` (2 bits for the largest component, three of
//! 10 bits between -1/sqrt 2 and 1/sqrt 2), `packed_color` (4 of 8 bits: colour between the bounds
//! or 0..1, opacity 0..1); perhaps element `sh` with 9, 24 or 45 bytes `f_rest_*` of -4..4. Out:
//! [`ColorModel::Sh`] of display colours, cut-offs of 3D Gaussian splatting.
//!
//! Degenerate: opacities of 0 and 1 are kept 1e-6 away from them.

use std::io::BufRead;

use luxel_core::{ColorModel, SH_OFFSET, Splats, logit, sh};

use crate::IoError;
use crate::local_frame::settled;
use crate::ply::header::{Element, Header};
use crate::ply::rows::{Whole, check_count, read_rows, read_whole_rows};
use crate::ply::source::PlySource;
use crate::scene_file::{SceneFile, display_scene};

/// Splats of a chunk.
const CHUNK: usize = 256;
/// Bounds every chunk has.
const BOUNDS: [&str; 12] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
];
/// Bounds newer files have.
const COLOR_BOUNDS: [&str; 6] = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Returns whether a header is that of a compressed PLY.
pub(super) fn is_compressed(header: &Header) -> bool {
    header.elements.iter().any(|e| e.name == "vertex" && e.position("packed_position").is_some())
}

/// Reads the rows behind `header`.
pub(super) fn read<R: BufRead>(source: &mut PlySource<'_, R>, header: &Header) -> Result<SceneFile, IoError> {
    let mut bounds: Option<Vec<Bounds>> = None;
    let mut splats: Option<Splats> = None;
    for element in &header.elements {
        match element.name.as_str() {
            "chunk" => bounds = Some(read_bounds(source, header, element)?),
            "vertex" => {
                let Some(bounds) = &bounds else {
                    return Err(source.invalid("header", "element \"vertex\" comes before \"chunk\", expected the chunks first"));
                };
                splats = Some(read_vertices(source, header, element, bounds)?);
            }
            "sh" => match &mut splats {
                Some(splats) => read_harmonics(source, header, element, splats)?,
                None => return Err(source.invalid("header", "element \"sh\" comes before \"vertex\", expected it after")),
            },
            // Whatever else a program adds behind the splats is its own.
            _ if splats.is_some() => break,
            other => return Err(source.invalid("header", format_args!("element {other:?} comes before the splats, expected \"chunk\""))),
        }
    }
    let mut splats = splats.ok_or_else(|| source.invalid("header", "no element \"vertex\""))?;
    let model = header.splat_model();
    let warnings = Vec::from_iter(model.flatten(&mut splats));
    Ok(SceneFile { scene: settled(display_scene(splats, model.antialias()), None), warnings })
}

/// The bounds of a chunk: lower and upper, for position, log scale and colour.
struct Bounds {
    position: [[f32; 3]; 2],
    log_scale: [[f32; 3]; 2],
    color: [[f32; 3]; 2],
}

fn columns<R: BufRead>(source: &PlySource<'_, R>, element: &Element, names: &[&str]) -> Result<Vec<usize>, IoError> {
    let missing = |name: &str| source.invalid("header", format_args!("element {:?} has no property {name:?}", element.name));
    names.iter().map(|name| element.position(name).ok_or_else(|| missing(name))).collect()
}

fn read_bounds<R: BufRead>(source: &mut PlySource<'_, R>, header: &Header, element: &Element) -> Result<Vec<Bounds>, IoError> {
    let mut columns = columns(source, element, &BOUNDS)?;
    if let Ok(colors) = self::columns(source, element, &COLOR_BOUNDS) {
        columns.extend(colors);
    }
    let mut bounds = Vec::with_capacity(check_count(source, element, header.format)?);
    let left_out = read_rows(source, element, header.format, &columns, |_, values, _| {
        let triple = |at: usize| [0, 1, 2].map(|c| values.get(at + c).copied());
        let at = |at: usize, absent: f32| triple(at).map(|v| v.unwrap_or(absent));
        bounds.push(Bounds { position: [at(0, 0.0), at(3, 0.0)], log_scale: [at(6, 0.0), at(9, 0.0)], color: [at(12, 0.0), at(15, 1.0)] });
        Ok(())
    })?;
    // Every splat of a chunk lies between its bounds.
    left_out.none()?;
    Ok(bounds)
}

/// Returns the lowest `bits` of a word, 0 to 1.
fn unit(word: u32, bits: u32) -> f32 {
    let most = (1u32 << bits) - 1;
    (word & most) as f32 / most as f32
}

fn between([low, high]: [[f32; 3]; 2], t: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|c| low[c] * (1.0 - t[c]) + high[c] * t[c])
}

fn unpack_11_10_11(word: u32) -> [f32; 3] {
    [unit(word >> 21, 11), unit(word >> 11, 10), unit(word, 11)]
}

/// Unpacks a quaternion as w x y z.
fn unpack_rotation(word: u32) -> [f32; 4] {
    let part = |shift: u32| (unit(word >> shift, 10) - 0.5) * std::f32::consts::SQRT_2;
    let small = [part(20), part(10), part(0)];
    let largest = (1.0 - small.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    let [a, b, c] = small;
    match word >> 30 {
        0 => [largest, a, b, c],
        1 => [a, largest, b, c],
        2 => [a, b, largest, c],
        _ => [a, b, c, largest],
    }
}

fn read_vertices<R: BufRead>(
    source: &mut PlySource<'_, R>,
    header: &Header,
    element: &Element,
    bounds: &[Bounds],
) -> Result<Splats, IoError> {
    let columns = columns(source, element, &PACKED)?;
    let count = check_count(source, element, header.format)?;
    if bounds.len() < count.div_ceil(CHUNK) {
        let message = format!("{} chunks for {count} splats, expected {}", bounds.len(), count.div_ceil(CHUNK));
        return Err(source.invalid("header", message));
    }
    let path = source.path;
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    splats.position.reserve_exact(count);
    splats.rotation.reserve_exact(count);
    splats.log_scale.reserve_exact(count);
    splats.opacity_logit.reserve_exact(count);
    splats.sh.reserve_exact(3 * count);
    read_whole_rows(source, element, header.format, &columns, Whole::U32, |row, words| {
        let [position, rotation, scale, color] = *words else { return Ok(()) };
        let Some(bounds) = bounds.get(row as usize / CHUNK) else { return Ok(()) };
        let position = between(bounds.position, unpack_11_10_11(position));
        let log_scale = between(bounds.log_scale, unpack_11_10_11(scale));
        let rgb = between(bounds.color, [unit(color >> 24, 8), unit(color >> 16, 8), unit(color >> 8, 8)]);
        if !position.iter().chain(&log_scale).chain(&rgb).all(|v| v.is_finite()) {
            return Err(IoError::invalid(path, format_args!("vertex {row}: its chunk's bounds are too far apart to lie between")));
        }
        splats.position.push(position);
        splats.rotation.push(unpack_rotation(rotation));
        splats.log_scale.push(log_scale);
        splats.opacity_logit.push(logit(unit(color, 8)));
        splats.sh.extend(rgb.map(|c| (c - SH_OFFSET) / sh::C0));
        Ok(())
    })?;
    Ok(splats)
}

/// Adds the higher harmonics.
fn read_harmonics<R: BufRead>(
    source: &mut PlySource<'_, R>,
    header: &Header,
    element: &Element,
    splats: &mut Splats,
) -> Result<(), IoError> {
    let rest = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    let Some(degree) = (1..=3).find(|&degree| 3 * (sh::coefficients(degree) - 1) == rest) else {
        return Err(source.invalid("header", format_args!("{rest} properties f_rest_* in element \"sh\", expected 9, 24 or 45")));
    };
    let names: Vec<String> = (0..rest).map(|i| format!("f_rest_{i}")).collect();
    let columns = columns(source, element, &names.iter().map(String::as_str).collect::<Vec<_>>())?;
    if check_count(source, element, header.format)? != splats.len() {
        return Err(source.invalid("header", format_args!("{} rows of \"sh\" for {} splats", element.count, splats.len())));
    }
    let higher = rest / 3;
    let mut sh = Vec::with_capacity(3 * (higher + 1) * splats.len());
    let constant = std::mem::take(&mut splats.sh);
    read_whole_rows(source, element, header.format, &columns, Whole::U8, |row, values| {
        let dc = 3 * row as usize;
        sh.extend(constant.get(dc..dc + 3).unwrap_or_default());
        // Channel-major in the file, coefficient-major here. The outermost buckets are their ends,
        // the others their middles.
        for m in 0..higher {
            sh.extend([0, 1, 2].map(|c| match values.get(c * higher + m).copied().unwrap_or(128) {
                0 => -4.0,
                255 => 4.0,
                v => ((v as f32 + 0.5) / 256.0 - 0.5) * 8.0,
            }));
        }
        Ok(())
    })?;
    splats.sh = sh;
    splats.color_model = ColorModel::Sh { degree: degree as u8 };
    Ok(())
}

#[cfg(test)]
mod tests;

//! A display bake to SOG.

use std::path::Path;

use image_webp::{ColorType, WebPEncoder};
use luxel_core::{Antialias, Splats, sigmoid, spatial_order};
use rayon::prelude::*;
use serde_json::json;

use super::archive::{File, archive};
use super::codebook::Codebook;
use super::palette::Palette;
use crate::bake::{Appearance, Baked};
use crate::spz::SpzPositions;
use crate::{IoError, write_atomically};

/// Version of the format.
pub(super) const VERSION: u32 = 2;
/// Steps between the bounds of a coordinate.
pub(super) const STEPS: f32 = 65535.0;
/// Longest side of a WebP picture, pixels.
const MAX_SIDE: usize = 16383;
/// Palette rows side by side in their picture.
pub(super) const PALETTE_ACROSS: usize = 64;
/// Alpha of rotations whose largest number is w.
pub(super) const LARGEST_IS_W: u8 = 252;

/// Writes a display bake, whole or not at all.
///
/// # Errors
/// A linear bake, no splats, more than the pictures hold, or the file system's refusal.
pub fn write_sog(path: &Path, baked: &Baked) -> Result<(), IoError> {
    let bytes = encode_sog(path, baked)?;
    write_atomically(path, |file| file.write_all(&bytes).map_err(|e| IoError::system(path, "write", &e)))
}

/// Returns what [`write_sog`] makes of the positions: their step at a median distance from the
/// origin. None is left out.
pub fn sog_positions(baked: &Baked) -> SpzPositions {
    let splats = &baked.scene.splats;
    let median = |mut values: Vec<f32>| {
        let middle = values.len() / 2;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
    };
    let step = |axis: usize| {
        let (mins, maxs) = bounds(splats.position.iter().map(|p| p.map(logarithm)));
        (maxs[axis] - mins[axis]) / STEPS * (1.0 + median(splats.position.iter().map(|p| p[axis].abs()).collect()))
    };
    let median_size = median(splats.log_scale.iter().map(|[a, b, c]| a.max(*b).max(*c).exp()).collect());
    SpzPositions { step: (0..3).map(step).fold(0.0, f32::max), median_size, left_out: 0 }
}

/// Returns a coordinate as the format divides it into steps.
fn logarithm(v: f32) -> f32 {
    v.signum() * v.abs().ln_1p()
}

/// Returns the least and the largest numbers along each axis.
fn bounds(places: impl Iterator<Item = [f32; 3]>) -> ([f32; 3], [f32; 3]) {
    places.fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(mins, maxs), p| {
        ([0, 1, 2].map(|axis| p[axis].min(mins[axis])), [0, 1, 2].map(|axis| p[axis].max(maxs[axis])))
    })
}

/// Encodes the bytes that [`write_sog`] writes; `name` is for errors.
///
/// # Errors
/// The same as [`write_sog`].
pub fn encode_sog(name: &Path, baked: &Baked) -> Result<Vec<u8>, IoError> {
    if let Appearance::Linear { .. } = baked.appearance {
        return Err(IoError::unsupported(name, "SOG has 256 colours per channel: radiance does not fit, bake for a display"));
    }
    crate::ply::check(name, &baked.scene)?;
    let given = &baked.scene.splats;
    if given.is_empty() {
        return Err(IoError::unsupported(name, "no splats, SOG needs at least one"));
    }
    // Neighbours in pictures are neighbours in space, which compresses well.
    let splats = given.select(spatial_order(&given.position));
    let width = ((splats.len() as f64).sqrt() / 4.0).ceil() as usize * 4;
    let height = splats.len().div_ceil(width).next_multiple_of(4);
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(IoError::unsupported(name, format!("{} splats, of which SOG's pictures hold {}", splats.len(), MAX_SIDE * MAX_SIDE)));
    }
    let (pictures, meta) = pictures(&splats, baked.scene.raster.antialias == Antialias::Mip, [width, height]);
    let encoded = pictures.into_par_iter().map(|picture| picture.encoded().map(|bytes| File { name: picture.name, bytes }));
    let mut files: Vec<File> = encoded
        .collect::<Result<_, image_webp::EncodingError>>()
        .map_err(|e| IoError::invalid(name, format!("cannot encode WebP: {e}")))?;
    files.insert(0, File { name: "meta.json", bytes: meta.to_string().into_bytes() });
    archive(&files).ok_or_else(|| IoError::unsupported(name, "more than 4 GiB, which an archive does not hold"))
}

/// A picture of the format.
struct Picture {
    name: &'static str,
    size_px: [usize; 2],
    /// With alpha.
    rgba: Option<Vec<[u8; 4]>>,
    /// Without.
    rgb: Vec<[u8; 3]>,
}

impl Picture {
    fn rgb(name: &'static str, size_px: [usize; 2], mut rgb: Vec<[u8; 3]>) -> Self {
        rgb.resize(size_px[0] * size_px[1], [0; 3]);
        Self { name, size_px, rgba: None, rgb }
    }

    fn rgba(name: &'static str, size_px: [usize; 2], mut rgba: Vec<[u8; 4]>) -> Self {
        rgba.resize(size_px[0] * size_px[1], [0, 0, 0, 255]);
        Self { name, size_px, rgba: Some(rgba), rgb: Vec::new() }
    }

    fn encoded(&self) -> Result<Vec<u8>, image_webp::EncodingError> {
        let mut out = Vec::new();
        // Sides are at most MAX_SIDE.
        let [width, height] = self.size_px.map(|side| side as u32);
        let (bytes, kind) = match &self.rgba {
            Some(rgba) => (rgba.as_flattened(), ColorType::Rgba8),
            None => (self.rgb.as_flattened(), ColorType::Rgb8),
        };
        WebPEncoder::new(&mut out).encode(bytes, width, height, kind)?;
        Ok(out)
    }
}

/// Returns the pictures, and what describes them.
fn pictures(splats: &Splats, is_antialiased: bool, size_px: [usize; 2]) -> (Vec<Picture>, serde_json::Value) {
    let places: Vec<[f32; 3]> = splats.position.iter().map(|p| p.map(logarithm)).collect();
    let (mins, maxs) = bounds(places.iter().copied());
    let steps = |p: &[f32; 3]| {
        [0, 1, 2].map(|axis| {
            let span = f64::from(maxs[axis]) - f64::from(mins[axis]);
            let unit = if span > 0.0 { (f64::from(p[axis]) - f64::from(mins[axis])) / span } else { 0.0 };
            (unit * f64::from(STEPS)).round() as u16
        })
    };
    let (low, high): (Vec<_>, Vec<_>) =
        places.iter().map(steps).map(|steps| (steps.map(|step| step.to_le_bytes()[0]), steps.map(|step| step.to_le_bytes()[1]))).unzip();

    let stride = 3 * splats.color_model.sh_coefficients();
    let scales = Codebook::new(splats.log_scale.iter().flatten().copied());
    let constants = Codebook::new(splats.sh.chunks_exact(stride).flat_map(|sh| sh[..3].iter().copied()));
    let colors = splats.sh.chunks_exact(stride).zip(&splats.opacity_logit).map(|(sh, opacity)| {
        let [r, g, b] = [0, 1, 2].map(|c| constants.nearest(sh[c]));
        [r, g, b, (sigmoid(*opacity) * 255.0).round() as u8]
    });
    let mut pictures = vec![
        Picture::rgb("means_l.webp", size_px, low),
        Picture::rgb("means_u.webp", size_px, high),
        Picture::rgb("scales.webp", size_px, splats.log_scale.iter().map(|s| s.map(|v| scales.nearest(v))).collect()),
        Picture::rgba("quats.webp", size_px, splats.rotation.iter().map(|q| packed_rotation(*q)).collect()),
        Picture::rgba("sh0.webp", size_px, colors.collect()),
    ];
    let mut meta = json!({
        "version": VERSION,
        "asset": { "generator": concat!("luxel ", env!("CARGO_PKG_VERSION")) },
        "count": splats.len(),
        "means": { "mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scales.0, "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": constants.0, "files": ["sh0.webp"] },
    });
    if is_antialiased {
        meta["antialias"] = true.into();
        // The name of the same from version 3.7 of splat-transform on.
        meta["model"] = "antialiased".into();
    }
    let bands = splats.color_model.sh_degree();
    if bands > 0 {
        let rest: Vec<f32> = splats.sh.chunks_exact(stride).flat_map(|sh| sh[3..].iter().copied()).collect();
        let palette = Palette::new(&rest, stride - 3);
        let codebook = Codebook::new(palette.rows.iter().copied());
        let (coefficients, rows) = (stride / 3 - 1, palette.rows.len() / (stride - 3));
        // A coefficient of a row is a pixel, its channels are red, green and blue.
        let pixels: Vec<[u8; 3]> = palette.rows.as_chunks::<3>().0.iter().map(|rgb| rgb.map(|v| codebook.nearest(v))).collect();
        let labels = palette.labels.iter().map(|label| [label.to_le_bytes()[0], label.to_le_bytes()[1], 0]).collect();
        pictures.push(Picture::rgb("shN_centroids.webp", [PALETTE_ACROSS * coefficients, rows.div_ceil(PALETTE_ACROSS)], pixels));
        pictures.push(Picture::rgb("shN_labels.webp", size_px, labels));
        meta["shN"] = json!({
            "count": rows, "bands": bands, "codebook": codebook.0, "files": ["shN_centroids.webp", "shN_labels.webp"],
        });
    }
    (pictures, meta)
}

/// Returns the three smallest of w x y z and which is the largest, which is positive.
fn packed_rotation(q: [f32; 4]) -> [u8; 4] {
    let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let unit = std::f32::consts::SQRT_2 / (length * q[largest].signum());
    let mut others = (0..4).filter(|i| *i != largest).map(|i| ((q[i] * unit * 0.5 + 0.5) * 255.0).round() as u8);
    let mut next = || others.next().unwrap_or(0);
    // The number of the largest is below four.
    [next(), next(), next(), LARGEST_IS_W + largest as u8]
}

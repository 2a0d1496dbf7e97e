//! SOG to a scene of display colours.

use std::io::Cursor;
use std::path::Path;

use image_webp::WebPDecoder;
use luxel_core::{ColorModel, Scene, Splats, logit, sh};
use serde::Deserialize;

use super::codebook::ENTRIES;
use super::unpacked::{Packed, files};
use super::writer::{LARGEST_IS_W, PALETTE_ACROSS, STEPS, VERSION};
use crate::IoError;
use crate::image::guard::contain;
use crate::input::Input;
use crate::local_frame::settled;
use crate::memory::check_memory;
use crate::read_file::read_file;
use crate::scene_file::{SceneFile, display_scene};
use crate::splat_model::SplatModel;

/// Name of the description in the archive.
const META: &str = "meta.json";

/// The content of `meta.json`. A file of the format's first version has no `version`.
#[derive(Debug, Deserialize)]
struct Meta {
    #[serde(default = "first_version")]
    version: u32,
    #[serde(default)]
    count: Option<usize>,
    #[serde(default)]
    antialias: bool,
    /// The same for versions of splat-transform from 3.7 on, and other models.
    #[serde(default)]
    model: Option<String>,
    means: Option<Means>,
    scales: Option<Coded>,
    quats: Option<Plain>,
    sh0: Option<Coded>,
    #[serde(rename = "shN")]
    sh_n: Option<Harmonics>,
}

fn first_version() -> u32 {
    1
}

#[derive(Debug, Deserialize)]
struct Means {
    mins: [f32; 3],
    maxs: [f32; 3],
    files: [String; 2],
}

#[derive(Debug, Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Debug, Deserialize)]
struct Coded {
    codebook: Vec<f32>,
    files: [String; 1],
}

#[derive(Debug, Deserialize)]
struct Harmonics {
    count: usize,
    bands: usize,
    codebook: Vec<f32>,
    files: [String; 2],
}

/// Returns whether bytes that begin like a ZIP archive are a file of this format.
pub(crate) fn is_sog(bytes: &[u8]) -> bool {
    files(bytes).is_ok_and(|files| files.iter().any(|file| file.name() == META))
}

/// Reads a scene.
///
/// # Errors
/// A missing, truncated or otherwise damaged file, or a version other than 2.
pub fn read_sog(path: &Path) -> Result<Scene, IoError> {
    decode_sog(path, &read_file(path)?)
}

/// Decodes a file's bytes as [`read_sog`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_sog`].
pub fn decode_sog(name: &Path, bytes: &[u8]) -> Result<Scene, IoError> {
    decode(Input::new(name, bytes)).map(|file| file.scene)
}

/// Decodes a scene with its warnings.
pub(crate) fn decode(input: Input<'_>) -> Result<SceneFile, IoError> {
    let invalid = |message: String| input.invalid(format_args!("SOG: {message}"));
    let archive = Archive { input, files: files(input.bytes).map_err(invalid)? };
    let meta = archive.file(META)?.content().map_err(invalid)?;
    let meta: Meta = serde_json::from_slice(&meta).map_err(|e| invalid(format!("{META}: {e}; export the file again")))?;
    if meta.version != VERSION {
        let message = format!("SOG version {}, expected {VERSION}; convert it with splat-transform", meta.version);
        return Err(input.unsupported(message));
    }
    let missing = |what: &str| invalid(format!("{META}: no {what:?}; the file is damaged, export it again"));
    let count = meta.count.ok_or_else(|| missing("count"))?;
    let part = |what: &'static str| move || missing(what);
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    splats.position = archive.positions(&meta.means.ok_or_else(part("means"))?, count)?;
    splats.log_scale = archive.coded(&meta.scales.ok_or_else(part("scales"))?, count)?.into_iter().map(|(rgb, _)| rgb).collect();
    splats.rotation = archive.rotations(&meta.quats.ok_or_else(part("quats"))?, count)?;
    let colors = archive.coded(&meta.sh0.ok_or_else(part("sh0"))?, count)?;
    splats.opacity_logit = colors.iter().map(|(_, opacity)| logit(f32::from(*opacity) / 255.0)).collect();
    match &meta.sh_n {
        None => splats.sh = colors.into_iter().flat_map(|(rgb, _)| rgb).collect(),
        Some(harmonics) => {
            let constants: Vec<[f32; 3]> = colors.into_iter().map(|(rgb, _)| rgb).collect();
            splats.sh = archive.harmonics(harmonics, &constants)?;
            splats.color_model = ColorModel::Sh { degree: harmonics.bands as u8 };
        }
    }
    let model = match &meta.model {
        None if meta.antialias => SplatModel::Antialiased,
        name => name.as_deref().map(SplatModel::from_name).unwrap_or_default(),
    };
    let warnings = Vec::from_iter(model.flatten(&mut splats));
    splats.validate().map_err(|e| invalid(e.to_string()))?;
    Ok(SceneFile { scene: settled(display_scene(splats, model.antialias()), None), warnings })
}

/// The files of a scene.
struct Archive<'a> {
    input: Input<'a>,
    files: Vec<Packed<'a>>,
}

/// Pixels with alpha, of a picture of this width.
struct Pixels {
    width: usize,
    rgba: Vec<[u8; 4]>,
}

impl<'a> Archive<'a> {
    fn invalid(&self, message: impl std::fmt::Display) -> IoError {
        self.input.invalid(format_args!("SOG: {message}; the file is damaged, export it again"))
    }

    fn file(&self, name: &str) -> Result<&Packed<'a>, IoError> {
        self.files.iter().find(|file| file.name() == name).ok_or_else(|| self.invalid(format_args!("no file {name:?} in the archive")))
    }

    /// Returns the pixels of a picture, at least `count` of them.
    fn pixels(&self, name: &str, count: usize) -> Result<Pixels, IoError> {
        let bytes = self.file(name)?.content().map_err(|e| self.invalid(e))?;
        let failed = |e: image_webp::DecodingError| self.invalid(format_args!("{name}: {e}"));
        let pixels = contain(self.input.name, || {
            let mut decoder = WebPDecoder::new(Cursor::new(bytes.as_ref())).map_err(failed)?;
            let (width, height) = decoder.dimensions();
            let pixels = u64::from(width) * u64::from(height);
            if pixels < count as u64 {
                return Err(self.invalid(format_args!("{name}: {width} x {height} pixels for {count} splats")));
            }
            check_memory(self.input.name, pixels.saturating_mul(12))?;
            let channels = if decoder.has_alpha() { 4 } else { 3 };
            let mut out = vec![0; pixels as usize * channels];
            decoder.read_image(&mut out).map_err(failed)?;
            let rgba = out.chunks_exact(channels).map(|p| [p[0], p[1], p[2], p.get(3).copied().unwrap_or(255)]).collect();
            Ok(Pixels { width: width as usize, rgba })
        })?;
        Ok(pixels)
    }

    fn positions(&self, means: &Means, count: usize) -> Result<Vec<[f32; 3]>, IoError> {
        let [low, high] = &means.files;
        let (low, high) = (self.pixels(low, count)?, self.pixels(high, count)?);
        let place = |c: usize, low: u8, high: u8| {
            let unit = f64::from(u16::from_le_bytes([low, high])) / f64::from(STEPS);
            let logarithm = f64::from(means.mins[c]) * (1.0 - unit) + f64::from(means.maxs[c]) * unit;
            (logarithm.signum() * logarithm.abs().exp_m1()) as f32
        };
        Ok(low.rgba.iter().zip(&high.rgba).take(count).map(|(l, h)| [0, 1, 2].map(|c| place(c, l[c], h[c]))).collect())
    }

    /// Returns numbers of a codebook, with the alpha beside them.
    fn coded(&self, coded: &Coded, count: usize) -> Result<Vec<([f32; 3], u8)>, IoError> {
        let [name] = &coded.files;
        let codebook = self.codebook(&coded.codebook, name)?;
        let pixels = self.pixels(name, count)?;
        Ok(pixels.rgba.iter().take(count).map(|[r, g, b, a]| ([*r, *g, *b].map(|code| codebook[usize::from(code)]), *a)).collect())
    }

    fn codebook<'c>(&self, codebook: &'c [f32], name: &str) -> Result<&'c [f32; ENTRIES], IoError> {
        let wrong = || self.invalid(format_args!("codebook of {name} has {} numbers, expected {ENTRIES}", codebook.len()));
        codebook.try_into().map_err(|_| wrong())
    }

    fn rotations(&self, quats: &Plain, count: usize) -> Result<Vec<[f32; 4]>, IoError> {
        let [name] = &quats.files;
        let pixels = self.pixels(name, count)?;
        let rotation = |(i, pixel): (usize, &[u8; 4])| {
            let largest = usize::from(pixel[3].wrapping_sub(LARGEST_IS_W));
            let mut q = [0.0f32; 4];
            let others = (0..4).filter(|n| *n != largest);
            others.zip(pixel).for_each(|(n, code)| q[n] = (f32::from(*code) / 255.0 - 0.5) * std::f32::consts::SQRT_2);
            let rest = 1.0 - q.iter().map(|v| v * v).sum::<f32>();
            let wrong = || self.invalid(format_args!("{name}: alpha of splat {i} is {}, expected {LARGEST_IS_W} to 255", pixel[3]));
            *q.get_mut(largest).ok_or_else(wrong)? = rest.max(0.0).sqrt();
            Ok(q)
        };
        pixels.rgba.iter().take(count).enumerate().map(rotation).collect()
    }

    /// Returns all harmonics of each splat.
    fn harmonics(&self, harmonics: &Harmonics, constants: &[[f32; 3]]) -> Result<Vec<f32>, IoError> {
        let [centroids, labels] = &harmonics.files;
        if !(1..=3).contains(&harmonics.bands) {
            return Err(self.invalid(format_args!("harmonics of {} bands, expected 1 to 3", harmonics.bands)));
        }
        let higher = sh::coefficients(harmonics.bands) - 1;
        let codebook = self.codebook(&harmonics.codebook, centroids)?;
        let labels = self.pixels(labels, constants.len())?;
        let palette = self.pixels(centroids, 0)?;
        check_memory(self.input.name, (constants.len() as u64).saturating_mul(12 * (higher as u64 + 1)))?;
        let mut out = Vec::with_capacity(constants.len() * 3 * (higher + 1));
        for (i, (constant, [low, high, ..])) in constants.iter().zip(&labels.rgba).enumerate() {
            let label = usize::from(u16::from_le_bytes([*low, *high]));
            let first = label / PALETTE_ACROSS * palette.width + label % PALETTE_ACROSS * higher;
            let row = palette.rgba.get(first..first + higher).filter(|_| label < harmonics.count);
            let wrong = || self.invalid(format_args!("harmonics of splat {i} are row {label} of {}", harmonics.count));
            out.extend(constant);
            out.extend(row.ok_or_else(wrong)?.iter().flat_map(|[r, g, b, _]| [*r, *g, *b].map(|code| codebook[usize::from(code)])));
        }
        Ok(out)
    }
}

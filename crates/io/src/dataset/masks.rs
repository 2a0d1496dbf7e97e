//! Masks: images whose brightness is the weight of each pixel, white 1, black 0.
//!
//! In a folder of masks an image's is named like it: `<stem>.png` (or another image format, or with
//! an image's extension before, its own or another: `000.exr.png`), below the same folders, without
//! the first of them, or without any where no two images share a last name. Next to a data set the
//! folder is `masks/`; a merge of exposures leaves another, of the pixels that all of them
//! saturate, to be named.

use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use luxel_core::Mask;
use serde::{Deserialize, Serialize};

use super::files::{Finder, IMAGE_EXTENSIONS, Substitute};
use super::source::SourceFrame;
use crate::IoError;
use crate::image::{DecodedImage, decode_codes};

/// Names that a warning lists.
const MAX_LISTED: usize = 3;

/// The source of masks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum MaskSource {
    /// `mask_path` of a `transforms.json`, or the folder `masks` beside the images, where they are
    /// there.
    #[default]
    Auto,
    /// No masks.
    Off,
    /// The images' alpha channels.
    Alpha,
    /// This folder.
    Folder(PathBuf),
}

impl FromStr for MaskSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "off" => Ok(Self::Off),
            "alpha" => Ok(Self::Alpha),
            "" => Err("names no folder, expected auto, off, alpha or a folder of masks".to_owned()),
            folder => Ok(Self::Folder(folder.into())),
        }
    }
}

impl From<MaskSource> for String {
    fn from(source: MaskSource) -> Self {
        source.to_string()
    }
}

impl TryFrom<String> for MaskSource {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl fmt::Display for MaskSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Off => f.write_str("off"),
            Self::Alpha => f.write_str("alpha"),
            Self::Folder(folder) => write!(f, "{}", folder.display()),
        }
    }
}

/// Gives the frames of the data set in the folder `scene` their masks; warnings for people.
pub(super) fn attach<'a>(
    scene: &Path,
    frames: impl Iterator<Item = &'a mut SourceFrame>,
    source: &MaskSource,
) -> Result<Vec<String>, IoError> {
    let mut frames: Vec<&mut SourceFrame> = frames.collect();
    let folder = match source {
        MaskSource::Off | MaskSource::Alpha => {
            frames.iter_mut().for_each(|frame| frame.mask = None);
            return Ok(Vec::new());
        }
        MaskSource::Auto if frames.iter().any(|frame| frame.mask.is_some()) => return Ok(Vec::new()),
        MaskSource::Auto => {
            let beside = scene.join("masks");
            if !beside.is_dir() {
                return Ok(Vec::new());
            }
            beside
        }
        MaskSource::Folder(folder) if folder.is_dir() => folder.clone(),
        MaskSource::Folder(folder) => {
            return Err(IoError::invalid(folder, "is not a folder, expected one with masks named like the images"));
        }
    };
    let mut last_names: HashMap<String, usize> = HashMap::new();
    for frame in &frames {
        *last_names.entry(last_name(&frame.name).to_owned()).or_default() += 1;
    }
    let finder = Finder::default();
    let mut without = Vec::new();
    for frame in &mut frames {
        frame.mask = mask_of(&finder, &folder, frame, last_names.get(last_name(&frame.name)) == Some(&1));
        if frame.mask.is_none() {
            without.push(frame.name.clone());
        }
    }
    if without.len() == frames.len() && *source != MaskSource::Auto {
        let example = frames.first().map_or("image", |frame| last_name(&frame.name));
        return Err(IoError::invalid(&folder, format!("no mask is named like an image, expected {example}.png and so on")));
    }
    if without.is_empty() {
        return Ok(Vec::new());
    }
    let listed = without.iter().take(MAX_LISTED).cloned().collect::<Vec<_>>().join(", ");
    let more = if without.len() > MAX_LISTED { ", ..." } else { "" };
    Ok(vec![format!(
        "{}: no mask for {} of {} images ({listed}{more}): all of their pixels count",
        folder.display(),
        without.len(),
        frames.len()
    )])
}

fn last_name(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

fn mask_of(finder: &Finder, folder: &Path, frame: &SourceFrame, is_last_name_unique: bool) -> Option<PathBuf> {
    let below_first = frame.name.split_once('/').map(|(_, rest)| rest);
    let last = is_last_name_unique.then(|| last_name(&frame.name));
    let extension = frame.image.extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default();
    [Some(frame.name.as_str()), below_first, last].into_iter().flatten().find_map(|name| {
        let of_file = |extension: &str| finder.find_image(folder, &format!("{name}.{extension}.png"), Substitute::No);
        // COLMAP's masks are named like the copies that it ran on.
        let of_any_copy = || IMAGE_EXTENSIONS.iter().find_map(|extension| of_file(extension));
        of_file(&extension).or_else(|| finder.find_image(folder, &format!("{name}.png"), Substitute::Allowed)).or_else(of_any_copy)
    })
}

/// Decodes the weights of an image of `size_px` from the file's content: the largest channel, 0 to
/// 1.
///
/// # Errors
/// A damaged file, or one of another size.
pub fn decode_mask(path: &Path, bytes: &[u8], size_px: [usize; 2]) -> Result<Mask, IoError> {
    decode_with_remark(path, bytes, size_px).map(|(mask, _)| mask)
}

/// Decodes a mask, with a remark about numbers that are not those of a mask.
pub(super) fn decode_with_remark(path: &Path, bytes: &[u8], size_px: [usize; 2]) -> Result<(Mask, Option<String>), IoError> {
    let DecodedImage { image, alpha, depth, .. } = decode_codes(path, bytes)?;
    if [image.width, image.height] != size_px {
        let [width, height] = size_px;
        let found = format!("a mask of {} x {} pixels, its image has {width} x {height}", image.width, image.height);
        return Err(IoError::invalid(path, format!("{found}; expected masks of the images' size")));
    }
    let is_white = image.pixels.iter().all(|rgb| *rgb == [1.0; 3]);
    if let Some(alpha) = alpha.filter(|alpha| is_white && alpha.iter().any(|a| *a < 1.0)) {
        // The comparison turns NaN into 0.
        let weights = alpha.iter().map(|a| if *a > 0.0 { a.min(1.0) } else { 0.0 }).collect();
        return Ok((Mask { weights }, Some("the mask is white everywhere: its alpha channel is taken".to_owned())));
    }
    let weight = |rgb: &[f32; 3]| rgb.iter().fold(0.0, |most: f32, v| if *v > most { *v } else { most }).min(1.0);
    let mut weights: Vec<f32> = image.pixels.iter().map(weight).collect();
    let Some(bits) = depth.integer_bits() else { return Ok((Mask { weights }, None)) };
    let largest = ((1u32 << bits) - 1) as f32;
    let most = (weights.iter().copied().fold(0.0, f32::max) * largest).round();
    let is_coloured = image.pixels.iter().any(|[r, g, b]| r != g || g != b);
    let remark = if most == 1.0 && largest > 1.0 {
        // Truth values, as arrays of them are saved: no picture ends at the code next to black.
        weights.iter_mut().for_each(|weight| *weight = if *weight > 0.0 { 1.0 } else { 0.0 });
        Some(format!("the mask has numbers 0 and 1 of {largest}: 1 counts as white"))
    } else if is_coloured && most < largest {
        Some(format!("the mask is in colour: its largest channel counts, which is {most} of {largest} at most, and white is {largest}"))
    } else if most > 0.0 && most < 0.5 * largest {
        Some(format!(
            "the largest number of the mask is {most} of {largest}: no pixel weighs more than that share of one, and white is {largest}"
        ))
    } else {
        None
    };
    Ok((Mask { weights }, remark))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode_png;

    /// Returns a mask of four pixels by their colours, and the remark.
    fn decoded(rgb: [[u8; 3]; 4]) -> (Vec<f32>, Option<String>) {
        let bytes = encode_png(2, 2, rgb.as_flattened()).unwrap();
        let (mask, remark) = decode_with_remark(Path::new("mask.png"), &bytes, [2, 2]).unwrap();
        (mask.weights, remark)
    }

    #[test]
    fn truth_values_count_as_black_and_white_and_odd_numbers_are_named() {
        let grey = |codes: [u8; 4]| decoded(codes.map(|code| [code; 3]));
        assert_eq!(grey([0, 255, 255, 0]), (vec![0.0, 1.0, 1.0, 0.0], None));
        let (weights, remark) = grey([0, 1, 1, 0]);
        assert!(weights == [0.0, 1.0, 1.0, 0.0] && remark.is_some_and(|remark| remark.contains("1 counts as white")));
        let (weights, remark) = grey([0, 0, 0, 0]);
        assert!(weights == [0.0; 4] && remark.is_none());
        assert!(grey([0, 5, 5, 0]).1.is_some_and(|remark| remark.contains("5 of 255")));
        // The colour that a palette of classes gives its first one.
        let (weights, remark) = decoded([[0; 3], [128, 0, 0], [128, 0, 0], [0; 3]]);
        assert!((weights[1] - 128.0 / 255.0).abs() < 1e-6 && remark.is_some_and(|remark| remark.contains("in colour")));
    }
}

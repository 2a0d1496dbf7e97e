//! The cameras of a set: which photographs share a lens, and the white balance and colour matrix of
//! RAW files.
//!
//! In: photographs by their headers. Out: [`PlannedCamera`]s and, for each photograph, the index of
//! its camera. Degenerate: RAW files without a colour matrix keep the camera's colours, with a
//! note.

use std::collections::BTreeMap;

use glam::DMat3;
use luxel_core::photo::{PhotoKind, RawInfo};
use luxel_core::text::plural;
use luxel_core::{ColorSpace, Remedy};

use super::options::{PlanOptions, WhiteBalance};
use super::{Photograph, PrepareError, PrepareNote};
use crate::{CalibratedMatrix, CameraColor, CameraColorError, median_neutral};

/// Photographs that share a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedCamera {
    /// Name for people.
    pub name: String,
    /// Number of its photographs.
    pub photos: usize,
    /// Size of its photographs, pixels.
    pub size_px: [u32; 2],
    /// Focal length over the longest side, if EXIF has it.
    pub focal_per_side: Option<f64>,
    /// White balance gains, and the matrix from balanced camera colours to the scene's space, of
    /// RAW files.
    pub color: Option<([f32; 3], DMat3)>,
}

/// Groups photographs by body, lens, focal length and size. Returns the index of each one's camera.
pub(super) fn group_by_camera(photos: &[Photograph]) -> (Vec<usize>, Vec<PlannedCamera>) {
    let mut index: BTreeMap<String, usize> = BTreeMap::new();
    let mut cameras: Vec<PlannedCamera> = Vec::new();
    let camera_of = photos
        .iter()
        .map(|photo| {
            let exif = &photo.info.exif;
            let [width, height] = photo.info.size_px;
            let mut name = exif.camera_name().unwrap_or_else(|| "an unnamed camera".to_owned());
            if let Some(focal) = exif.focal_mm {
                name += &format!(" at {focal:.1} mm");
            }
            if photo.info.raw.as_ref().is_some_and(|raw| raw.is_straightened) {
                name += " without distortion";
            }
            let key = format!("{name}|{:?}|{:?}|{width}x{height}", exif.serial, exif.lens);
            let camera = *index.entry(key).or_insert_with(|| {
                // 36 mm is the longer side of the format that the equivalent focal length is given
                // for.
                let focal_per_side = exif.focal_35mm.map(|f| f / 36.0).filter(|f| (0.1..20.0).contains(f));
                cameras.push(PlannedCamera { name, photos: 0, size_px: [width, height], focal_per_side, color: None });
                cameras.len() - 1
            });
            if let Some(found) = cameras.get_mut(camera) {
                found.photos += 1;
            }
            camera
        })
        .collect();
    (camera_of, cameras)
}

pub(super) fn note_cameras(photos: &[Photograph], cameras: &[PlannedCamera], notes: &mut Vec<PrepareNote>) {
    let mut note = |text: String| notes.push(PrepareNote::new(text));
    if cameras.len() > 1 {
        let list: Vec<String> = cameras
            .iter()
            .map(|c| format!("{} of {} x {} from {}", plural(c.photos, "photograph"), c.size_px[0], c.size_px[1], c.name))
            .collect();
        note(format!("mixed cameras, lenses or sizes, each with a lens of its own: {}", list.join("; ")));
    }
    let is_portrait = |c: &&PlannedCamera| c.size_px[1] > c.size_px[0];
    let portraits: usize = cameras.iter().filter(is_portrait).map(|c| c.photos).sum();
    if portraits > 0 && portraits < photos.len() {
        note(format!(
            "{portraits} of {} are portraits and the others landscapes: pixels are kept as they are stored; a camera that was turned without \
             turning pixels would be one lens instead of two",
            plural(photos.len(), "photograph")
        ));
    }
    let mut orientations: BTreeMap<u16, usize> = BTreeMap::new();
    for photo in photos {
        *orientations.entry(photo.info.exif.orientation.unwrap_or(1)).or_default() += 1;
    }
    if orientations.keys().any(|o| *o != 1) {
        let list: Vec<String> = orientations.iter().map(|(o, n)| format!("{n} with {o}")).collect();
        note(format!(
            "orientation tags ({}) are not applied: pixels stay as the lens saw them, and reconstruction turns them by itself",
            list.join(", ")
        ));
    }
    let automatic =
        photos.iter().filter(|p| p.info.kind == PhotoKind::Developed && p.info.exif.is_white_balance_automatic == Some(true)).count();
    if automatic > 0 {
        note(format!(
            "{} developed with automatic white balance: colours may change from view to view; set the camera's to a fixed one, or shoot RAW",
            plural(automatic, "picture")
        ));
    }
}

/// Gives the cameras of a RAW set one white balance, each with its own matrix, because each body
/// has colours of its own.
pub(super) fn balance(
    photos: &[Photograph],
    camera_of: &[usize],
    cameras: &mut [PlannedCamera],
    options: &PlanOptions,
    notes: &mut Vec<PrepareNote>,
) -> Result<(), PrepareError> {
    let chosen = chosen_neutral(photos, &options.white_balance)?;
    let space = options.color_space;
    // Bodies of one model share a balance whatever lens or size.
    let model = |i: usize| photos.get(i).and_then(|p| p.info.exif.camera_name());
    for (index, camera) in cameras.iter_mut().enumerate() {
        let Some(first) = (0..photos.len()).find(|i| camera_of.get(*i) == Some(&index)) else { continue };
        let raws: Vec<&RawInfo> =
            (0..photos.len()).filter(|i| model(*i) == model(first)).filter_map(|i| photos[i].info.raw.as_ref()).collect();
        let as_shot: Vec<[f64; 3]> = raws.iter().filter_map(|raw| raw.as_shot_neutral).collect();
        let neutral = match chosen.or_else(|| median_neutral(&as_shot)) {
            Some(neutral) => neutral,
            None => {
                let text = format!("{}: no white balance in the files; assumed as shot in the light its matrix is for", camera.name);
                notes.push(PrepareNote::new(text));
                [1.0; 3]
            }
        };
        let color = matrix_from_raw(raws.first().copied(), neutral, space).map_err(|error| {
            let remedy = Remedy::give("white_balance").or(Remedy::advice("convert the file with a DNG converter"));
            PrepareError::new(format!("{}: {error}", photos[first].file_name())).with_remedy(remedy)
        })?;
        if color.is_none() {
            let text = format!("{}: no colour matrix in the files: camera colours are treated as {}", camera.name, space.name());
            notes.push(PrepareNote::new(text));
        }
        let gains = CameraColor::balance(neutral).map_err(PrepareError::new)?;
        camera.color = Some((gains, color.unwrap_or(DMat3::IDENTITY)));
    }
    Ok(())
}

/// Returns the camera colours of white that the user chose; `None` as shot.
fn chosen_neutral(photos: &[Photograph], choice: &WhiteBalance) -> Result<Option<[f64; 3]>, PrepareError> {
    let name = match choice {
        WhiteBalance::AsShot => return Ok(None),
        WhiteBalance::Neutral(neutral) => return Ok(Some(*neutral)),
        WhiteBalance::Photo(name) => name,
    };
    let Some(photo) = photos.iter().find(|p| p.file_name() == *name || p.stem == *name) else {
        let example = photos.first().map(Photograph::file_name).unwrap_or_default();
        let message = format!("white balance: no photograph named \"{name}\", expected a name such as {example}");
        return Err(PrepareError::new(message).with_remedy(Remedy::set("white_balance", example)));
    };
    match photo.info.raw.as_ref().and_then(|raw| raw.as_shot_neutral) {
        Some(neutral) => Ok(Some(neutral)),
        None => {
            let message = format!("white balance: {name} does not state its white balance");
            Err(PrepareError::new(message).with_remedy(Remedy::set("white_balance", "three numbers such as 0.5,1,0.6")))
        }
    }
}

/// Returns the matrix from balanced camera colours to `space`, or `None` without matrices in the
/// file.
fn matrix_from_raw(raw: Option<&RawInfo>, neutral: [f64; 3], space: ColorSpace) -> Result<Option<DMat3>, CameraColorError> {
    let Some(raw) = raw.filter(|raw| !raw.camera_from_xyz.is_empty()) else { return Ok(None) };
    let rows = |m: &[f64; 9]| DMat3::from_cols_array(m).transpose();
    let color = CameraColor {
        camera_from_xyz: raw.camera_from_xyz.iter().map(|(kelvin, m)| CalibratedMatrix { kelvin: *kelvin, matrix: rows(m) }).collect(),
        d50_from_balanced: raw.d50_from_balanced.iter().map(rows).collect(),
    };
    color.scene_from_balanced(neutral, space).map(Some)
}

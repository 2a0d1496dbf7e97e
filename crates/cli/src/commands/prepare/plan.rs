//! What will be done with the photographs, decided from their headers: cameras, exposures, brackets, white balance.
//!
//! In: a [`Scan`] and the options. Out: [`Plan`], views with the indices of their frames, and notes about what is odd. Nothing is decoded yet but
//! what a response curve is recovered from ([`super::response`]).

use std::collections::BTreeMap;

use anyhow::{Result, bail};
use glam::DMat3;
use luxel::text::plural;
use luxel_capture::{BracketNote, BracketRule, Brackets, CameraColor, Exposure, Shot, find_brackets, median_neutral};
use luxel_core::{Chromaticities, ColorSpace};
use luxel_io::{PhotoKind, RawInfo};

use super::scan::{PhotoFile, Scan};
use crate::args::{PrepareArgs, ResponseArg, WhiteBalanceArg};

/// A view to be made.
#[derive(Clone, Debug)]
pub(super) struct PlannedView {
    /// Of its files.
    pub(super) name: String,
    /// Indices of photographs, shortest exposure first.
    pub(super) frames: Vec<usize>,
    /// Index of its camera.
    pub(super) camera: usize,
}

/// Photographs that share a lens.
#[derive(Clone, Debug)]
pub(super) struct PlannedCamera {
    /// For people.
    pub(super) name: String,
    pub(super) photos: usize,
    pub(super) size_px: [u32; 2],
    /// Focal length over the longest side, if EXIF has it.
    pub(super) focal_per_side: Option<f64>,
    /// Gains and matrix of RAW files.
    pub(super) color: Option<([f32; 3], DMat3)>,
}

/// Everything decided.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub(super) kind: PhotoKind,
    pub(super) views: Vec<PlannedView>,
    pub(super) cameras: Vec<PlannedCamera>,
    /// How brackets were found.
    pub(super) brackets: &'static str,
    /// Whether radiance is in cd/m2 as far as EXIF tells it.
    pub(super) is_absolute: bool,
    pub(super) notes: Vec<String>,
}

/// Refuses options that files of this kind have no use for.
pub(super) fn check_options(args: &PrepareArgs, photos: &[PhotoFile]) -> Result<()> {
    let kind = photos.first().map_or(PhotoKind::Radiance, |p| p.info.kind);
    if kind == PhotoKind::Radiance && args.exposures.is_some() {
        bail!("--exposures is for photographs; OpenEXR, HDR and float TIFF files hold radiance, however they were exposed: leave it out");
    }
    if kind != PhotoKind::Developed && args.response != ResponseArg::Auto {
        bail!("--response is for JPEG, PNG and integer TIFF files; RAW files and those of radiance are linear: leave it out");
    }
    if kind != PhotoKind::Raw && args.white_balance != WhiteBalanceArg::AsShot {
        bail!("--white-balance is for RAW files; developed pictures and radiance have theirs already: leave it out");
    }
    Ok(())
}

/// Decides. Photographs without an exposure get one where that is sound.
pub(super) fn plan(scan: &mut Scan, args: &PrepareArgs) -> Result<Plan> {
    let mut notes = Vec::new();
    let kind = scan.photos.first().map_or(PhotoKind::Radiance, |p| p.info.kind);
    let is_absolute = settle_exposures(kind, &mut scan.photos, args.brackets.0, &mut notes)?;
    let photos = &scan.photos;
    let (camera_of, mut cameras) = cameras(photos);
    note_cameras(photos, &cameras, &mut notes);
    if kind == PhotoKind::Developed {
        note_primaries(photos, args, &mut notes);
    }
    if kind == PhotoKind::Raw {
        balance(photos, &camera_of, &mut cameras, args, &mut notes)?;
    }
    let shots: Vec<Shot> = photos
        .iter()
        .zip(&camera_of)
        .map(|(photo, camera)| Shot {
            name: photo.stem.clone(),
            camera: *camera,
            time_s: photo.info.exif.time_s,
            stops: photo.exposure.filter(|_| kind != PhotoKind::Radiance).map(|e| e.stops()),
            seconds: photo.exposure.map(|e| e.seconds),
        })
        .collect();
    let found = find_brackets(&shots, args.brackets.0)?;
    note_brackets(photos, &found, &mut notes);
    let views = found
        .views
        .iter()
        .map(|frames| PlannedView {
            name: view_name(photos, frames),
            frames: frames.clone(),
            camera: frames.first().and_then(|i| camera_of.get(*i)).copied().unwrap_or(0),
        })
        .collect();
    note_what_is_not_applied(photos, &mut notes);
    Ok(Plan { kind, views, cameras, brackets: found.found_by, is_absolute, notes })
}

/// The name of the first file by name; unique, because each file belongs to one view.
fn view_name(photos: &[PhotoFile], frames: &[usize]) -> String {
    frames.iter().filter_map(|i| photos.get(*i)).map(|p| p.stem.as_str()).min().unwrap_or_default().to_owned()
}

/// Makes exposures comparable, or says why they are not. Returns whether the scale is absolute.
fn settle_exposures(kind: PhotoKind, photos: &mut [PhotoFile], rule: BracketRule, notes: &mut Vec<String>) -> Result<bool> {
    if kind == PhotoKind::Radiance {
        return Ok(false);
    }
    let lacking: Vec<String> = photos.iter().filter(|p| p.exposure.is_none()).map(PhotoFile::file_name).collect();
    if lacking.len() == photos.len() {
        if matches!(rule, BracketRule::Names | BracketRule::Count(_)) {
            bail!("no photograph has its exposure in EXIF, and brackets need it: give them with --exposures");
        }
        notes.push("no photograph has its exposure in EXIF: all are taken as exposed alike; if they are not, give --exposures".to_owned());
        for photo in photos.iter_mut() {
            photo.exposure = Some(Exposure { seconds: 1.0, iso: None, f_number: None });
        }
        return Ok(false);
    }
    if !lacking.is_empty() {
        let (n, named) = (lacking.len(), lacking.iter().take(3).cloned().collect::<Vec<_>>().join(", "));
        bail!(
            "{} of {} have no exposure time in EXIF ({named}{}): give it with --exposures, or leave them out",
            n,
            plural(photos.len(), "photograph"),
            if n > 3 { ", ..." } else { "" }
        );
    }
    let mut absolute = true;
    for (what, has) in [
        ("ISO speed", photos.iter().map(|p| p.exposure.is_some_and(|e| e.iso.is_some())).collect::<Vec<_>>()),
        ("aperture", photos.iter().map(|p| p.exposure.is_some_and(|e| e.f_number.is_some())).collect()),
    ] {
        let without = has.iter().filter(|h| !**h).count();
        if without == has.len() {
            absolute = false;
            notes.push(format!("no photograph has its {what} in EXIF: all are taken to have the same, and radiance is not in cd/m2"));
        } else if without > 0 {
            let name = photos.iter().zip(&has).find(|(_, h)| !**h).map(|(p, _)| p.file_name()).unwrap_or_default();
            bail!("{without} of {} have no {what} in EXIF ({name}): give it with --exposures, or leave them out", has.len());
        }
    }
    Ok(absolute)
}

/// Cameras by body, lens, focal length and size; which one each photograph is of.
fn cameras(photos: &[PhotoFile]) -> (Vec<usize>, Vec<PlannedCamera>) {
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
            let key = format!("{name}|{:?}|{:?}|{width}x{height}", exif.serial, exif.lens);
            let camera = *index.entry(key).or_insert_with(|| {
                // 36 mm is the longer side of the format that the equivalent focal length is given for.
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

fn note_cameras(photos: &[PhotoFile], cameras: &[PlannedCamera], notes: &mut Vec<String>) {
    if cameras.len() > 1 {
        let list: Vec<String> = cameras
            .iter()
            .map(|c| format!("{} of {} x {} from {}", plural(c.photos, "photograph"), c.size_px[0], c.size_px[1], c.name))
            .collect();
        notes.push(format!("mixed cameras, lenses or sizes, each with a lens of its own: {}", list.join("; ")));
    }
    let is_portrait = |c: &&PlannedCamera| c.size_px[1] > c.size_px[0];
    let portraits: usize = cameras.iter().filter(is_portrait).map(|c| c.photos).sum();
    if portraits > 0 && portraits < photos.len() {
        notes.push(format!(
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
        notes.push(format!(
            "orientation tags ({}) are not applied: pixels stay as the lens saw them, and reconstruction turns them by itself",
            list.join(", ")
        ));
    }
    let automatic =
        photos.iter().filter(|p| p.info.kind == PhotoKind::Developed && p.info.exif.is_white_balance_automatic == Some(true)).count();
    if automatic > 0 {
        notes.push(format!(
            "{} developed with automatic white balance: colours may change from view to view; set the camera's to a fixed one, or shoot RAW",
            plural(automatic, "picture")
        ));
    }
}

/// Pictures that state primaries, by chunks or by a profile: taken, if they are known.
fn note_primaries(photos: &[PhotoFile], args: &PrepareArgs, notes: &mut Vec<String>) {
    let described = |found: &Chromaticities| match ColorSpace::of_chromaticities(found) {
        Some(space) => space.name().to_owned(),
        None => format!("red, green, blue and white at {found:?}"),
    };
    let mut counts: BTreeMap<(Option<&str>, Option<String>), usize> = BTreeMap::new();
    for info in photos.iter().map(|p| &p.info) {
        let profile = info.profile.as_ref().map(|profile| profile.name.as_str());
        *counts.entry((profile, info.primaries.as_ref().map(described))).or_default() += 1;
    }
    for ((profile, primaries), n) in counts {
        let pictures = plural(n, "picture");
        match (profile, primaries) {
            // What is taken without a word, too, is no news.
            (None, None) => {}
            (_, Some(primaries)) if primaries == ColorSpace::LinearRec709.name() => {}
            (Some(name), Some(primaries)) => notes.push(format!("{pictures} with the ICC profile \"{name}\": colours are those of {primaries}")),
            (None, Some(primaries)) => notes.push(format!("{pictures} with primaries of their own: colours are those of {primaries}")),
            (Some(name), None) => notes.push(format!(
                "not applied, but carried by {pictures}: the ICC profile \"{name}\", whose primaries are none of {}; colours are taken for {} \
                 (--input-space)",
                ColorSpace::NAMES,
                ColorSpace::from(args.input_space).name()
            )),
        }
    }
}

/// One white balance for the set; of several bodies one each, for each has colours of its own.
fn balance(
    photos: &[PhotoFile],
    camera_of: &[usize],
    cameras: &mut [PlannedCamera],
    args: &PrepareArgs,
    notes: &mut Vec<String>,
) -> Result<()> {
    let given = match &args.white_balance {
        WhiteBalanceArg::AsShot => None,
        WhiteBalanceArg::Neutral(neutral) => Some(*neutral),
        WhiteBalanceArg::Photo(name) => {
            let Some(photo) = photos.iter().find(|p| p.file_name() == *name || p.stem == *name) else {
                let example = photos.first().map(PhotoFile::file_name).unwrap_or_default();
                bail!("--white-balance: no photograph named \"{name}\", expected a name such as {example}");
            };
            match photo.info.raw.as_ref().and_then(|raw| raw.as_shot_neutral) {
                Some(neutral) => Some(neutral),
                None => bail!("--white-balance: {name} does not say its white balance; give three numbers"),
            }
        }
    };
    let space = ColorSpace::from(args.color_space);
    // Bodies of one model share a balance whatever lens or size.
    let model = |i: usize| photos.get(i).and_then(|p| p.info.exif.camera_name());
    for (index, camera) in cameras.iter_mut().enumerate() {
        let own: Vec<usize> = (0..photos.len()).filter(|i| camera_of.get(*i) == Some(&index)).collect();
        let Some(&first) = own.first() else { continue };
        let raws: Vec<&RawInfo> =
            (0..photos.len()).filter(|i| model(*i) == model(first)).filter_map(|i| photos[i].info.raw.as_ref()).collect();
        let as_shot: Vec<[f64; 3]> = raws.iter().filter_map(|raw| raw.as_shot_neutral).collect();
        let neutral = match given.or_else(|| median_neutral(&as_shot)) {
            Some(neutral) => neutral,
            None => {
                notes.push(format!("{}: no white balance in the files; taken as shot in the light its matrix is for", camera.name));
                [1.0; 3]
            }
        };
        let color = color_of(raws.first().copied(), neutral, space).map_err(|e| {
            anyhow::anyhow!("{}: {e}; give --white-balance, or convert the file with a DNG converter", photos[first].file_name())
        })?;
        if color.is_none() {
            notes.push(format!("{}: no colour matrix in the files: camera colours are taken for {}", camera.name, space.name()));
        }
        let gains = CameraColor::balance(neutral)?;
        camera.color = Some((gains, color.unwrap_or(DMat3::IDENTITY)));
    }
    Ok(())
}

fn color_of(raw: Option<&RawInfo>, neutral: [f64; 3], space: ColorSpace) -> Result<Option<DMat3>, luxel_capture::CameraColorError> {
    let Some(raw) = raw.filter(|raw| !raw.camera_from_xyz.is_empty()) else { return Ok(None) };
    let rows = |m: &[f64; 9]| DMat3::from_cols_array(m).transpose();
    let color = CameraColor {
        camera_from_xyz: raw.camera_from_xyz.iter().map(|(kelvin, m)| (*kelvin, rows(m))).collect(),
        d50_from_balanced: raw.d50_from_balanced.iter().map(rows).collect(),
    };
    color.scene_from_balanced(neutral, space).map(Some)
}

fn note_brackets(photos: &[PhotoFile], found: &Brackets, notes: &mut Vec<String>) {
    for note in &found.notes {
        match note {
            BracketNote::Missing { view, stops, found: n, expected } => {
                let name = found.views.get(*view).map(|frames| view_name(photos, frames)).unwrap_or_default();
                let missing: Vec<String> = stops.iter().map(|s| format!("{:+.1} EV", s - reference_stops(photos, found))).collect();
                notes.push(format!(
                    "view {name}: its bracket has {n} of {expected} exposures, missing {}: what only they show is noisy or saturated",
                    if missing.is_empty() { "an unknown one".to_owned() } else { missing.join(", ") }
                ));
            }
            BracketNote::Extra { view, found: n, expected } => {
                let name = found.views.get(*view).map(|frames| view_name(photos, frames)).unwrap_or_default();
                notes.push(format!("view {name}: its bracket has {n} exposures, the others {expected}"));
            }
        }
    }
}

/// Exposure of the middle frame of the middle view: what EV are counted from.
fn reference_stops(photos: &[PhotoFile], found: &Brackets) -> f64 {
    let longest = found.views.iter().max_by_key(|frames| frames.len());
    let middle = longest.and_then(|frames| frames.get(frames.len() / 2)).and_then(|i| photos.get(*i));
    middle.and_then(|p| p.exposure).map_or(0.0, |e| e.stops())
}

fn note_what_is_not_applied(photos: &[PhotoFile], notes: &mut Vec<String>) {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for what in photos.iter().filter_map(|p| p.info.raw.as_ref()).flat_map(|raw| &raw.not_applied) {
        *counts.entry(what).or_default() += 1;
    }
    for (what, n) in counts {
        notes.push(format!("not applied, but asked for by {}: {what}", plural(n, "file")));
    }
}

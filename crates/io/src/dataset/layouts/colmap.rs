//! COLMAP folders, and the HDR-GS and GaussHDR repacks of HDR-NeRF's scenes, which are COLMAP
//! folders with HDR images apart.
//!
//! HDR-GS: COLMAP names `<i>_<k>.png`, the HDR image is `exr/<i>.exr`; sorted as text by `<i>_`,
//! every other one is held out. GaussHDR: COLMAP names `<train|test>_ldr_<i>_<k>.png`, the HDR
//! image is `images_hdr/<train|test>_hdr_<i>.exr`; the name states the split. Where several
//! exposures of a pose are registered, the first by name gives pose and features.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use crate::IoError;
use crate::dataset::colmap::{ColmapFiles, ColmapImage, ColmapModel, ColmapPoint, find_model, read_model};
use crate::dataset::files::{Finder, Substitute, composed, list_images, view_name, without_extension};
use crate::dataset::source::{DatasetSource, Origin, Recording, Sighting, SourceFrame, SourcePoint, split_beside};
use crate::dataset::split::{Part, SplitRule};
use crate::dataset::{Supervision, recordings};

/// Names that a warning lists.
const MAX_LISTED: usize = 3;

/// How the images of a COLMAP folder are found from the registered names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::dataset) enum ColmapLayout {
    /// In `images/`, of the same stem: COLMAP reads 8-bit copies, radiance beside them goes first.
    Plain,
    /// See the module.
    HdrGs,
    /// See the module.
    GaussHdr,
}

/// An HDR image with the registered image that gives its pose.
struct Chosen<'a> {
    /// Index into the model's images.
    index: usize,
    image: &'a ColmapImage,
    /// Path of the HDR image below the scene's folder; its view name.
    file_path: String,
    path: PathBuf,
    part: Option<Part>,
    recordings: Vec<Recording>,
}

/// Reads the model and finds the images.
pub(in crate::dataset) fn colmap_source(folder: &Path, layout: ColmapLayout, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let Some(found) = find_model(folder) else {
        return Err(IoError::invalid(
            folder,
            "no COLMAP model: expected cameras.bin or cameras.txt in sparse/0, in sparse or in the folder itself",
        ));
    };
    let (model, files) = read_model(&found.folder)?;
    if model.images.is_empty() {
        return Err(IoError::invalid(&files.images, "no registered images, expected at least one"));
    }
    let scene = scene_folder(folder);
    let finder = Finder::default();
    let model_scene = ModelScene { files: &files, folder: &scene, supervision, finder: &finder };
    let mut warnings = Vec::from_iter(found.warning);
    warnings.extend(model.warnings.iter().cloned());
    let chosen = match layout {
        ColmapLayout::Plain => plain_images(&model, &model_scene, &mut warnings)?,
        ColmapLayout::HdrGs => hdr_gs_images(&model, &model_scene)?,
        ColmapLayout::GaussHdr => gauss_hdr_images(&model, &model_scene)?,
    };
    warnings.extend(finder.warnings());
    if layout == ColmapLayout::Plain {
        warnings.extend(unregistered(&scene, &chosen));
    }
    let beside = split_beside(&scene)?;
    let own_split = chosen.iter().any(|c| c.part.is_some());
    let split = match (layout, &beside) {
        // HDR-GS's split is a habit of its code, and a file beside it is a choice; GaussHDR's is
        // written in the names.
        (ColmapLayout::HdrGs, SplitRule::Lists(_)) | (ColmapLayout::Plain, _) => beside,
        _ if own_split => SplitRule::Frames,
        _ => beside,
    };
    let mut frame_of_image = vec![None; model.images.len()];
    let mut frames = Vec::with_capacity(chosen.len());
    for c in chosen {
        frame_of_image[c.index] = Some(frames.len());
        frames.push(SourceFrame {
            name: view_name(&c.file_path),
            image: c.path,
            camera_from_world: c.image.camera_from_world,
            intrinsics: c.image.intrinsics,
            origin: origin(&files, c.image),
            part: c.part,
            recordings: c.recordings,
            exposure_s: None,
            noise: None,
            mask: None,
        });
    }
    let points = points_with_sightings(&model, &frame_of_image, |p| p.position.to_array(), &mut warnings);
    let format = match layout {
        ColmapLayout::Plain => "COLMAP",
        ColmapLayout::HdrGs => "HDR-GS (COLMAP with exr/)",
        ColmapLayout::GaussHdr => "GaussHDR (COLMAP with images_hdr/)",
    };
    let points_from = format!("the COLMAP model in {}", found.folder.display());
    let notes = model.rigs.clone().into_iter().collect();
    Ok(DatasetSource { format: format.to_owned(), folder: scene, frames, split, points, points_from, notes, warnings })
}

/// Returns the points of the model whose position, mapped by `position`, is finite; sightings in
/// images without a frame are dropped.
pub(in crate::dataset) fn points_with_sightings(
    model: &ColmapModel,
    frame_of_image: &[Option<usize>],
    position: impl Fn(&ColmapPoint) -> [f64; 3],
    warnings: &mut Vec<String>,
) -> Vec<SourcePoint> {
    let sighting = |[image, feature]: [u32; 2]| {
        let frame = (*frame_of_image.get(image as usize)?)?;
        let image = model.images.get(image as usize)?;
        let [x, y] = *image.features_px.get(feature as usize)?;
        let [w, h] = image.intrinsics.size_px?;
        Some(Sighting { frame, at: [x / w as f32, y / h as f32] })
    };
    let points: Vec<SourcePoint> = model
        .points
        .iter()
        .map(|p| SourcePoint {
            position: position(p),
            rgb8: Some(p.rgb8),
            sightings: p.track.iter().filter_map(|t| sighting(*t)).collect(),
        })
        .filter(|p| p.position.iter().all(|v| (*v as f32).is_finite()))
        .collect();
    if points.len() < model.points.len() {
        warnings.push(format!("{} COLMAP points without a finite position are left out", model.points.len() - points.len()));
    }
    points
}

fn origin(files: &ColmapFiles<PathBuf>, image: &ColmapImage) -> Origin {
    Origin { path: files.images.clone(), place: format!("image {} ({:?})", image.id, image.name) }
}

/// Returns the scene's folder, where the folder of the model itself was named: the nearest with
/// images.
pub(in crate::dataset) fn scene_folder(folder: &Path) -> PathBuf {
    let up = [folder.to_path_buf(), folder.join(".."), folder.join("../..")];
    up.into_iter().find(|f| ["images", "exr", "images_hdr"].iter().any(|i| f.join(i).is_dir())).unwrap_or_else(|| folder.into())
}

/// The scene of a model: its files, its folder, and the kind of images to read.
struct ModelScene<'a> {
    files: &'a ColmapFiles<PathBuf>,
    folder: &'a Path,
    supervision: Supervision,
    finder: &'a Finder,
}

/// Says which images in `images/` have no pose, by their stems.
fn unregistered(scene: &Path, chosen: &[Chosen<'_>]) -> Option<String> {
    let folder = scene.join("images");
    let registered: HashSet<String> = chosen.iter().map(|c| composed(&view_name(&c.file_path))).collect();
    let mut others = BTreeSet::new();
    list_images(&folder, "images", &mut others);
    let total = others.len();
    others.retain(|name| !registered.contains(&composed(name)));
    let listed: Vec<&str> = others.iter().take(MAX_LISTED).map(String::as_str).collect();
    let more = if others.len() > MAX_LISTED { ", ..." } else { "" };
    (!others.is_empty()).then(|| {
        format!("{} of {total} images have no pose in the COLMAP model and are left out ({}{more})", others.len(), listed.join(", "))
    })
}

fn plain_images<'a>(model: &'a ColmapModel, scene: &ModelScene<'_>, warnings: &mut Vec<String>) -> Result<Vec<Chosen<'a>>, IoError> {
    let mut chosen = Vec::with_capacity(model.images.len());
    let mut substituted = Vec::new();
    let substitute = match scene.supervision {
        Supervision::Hdr | Supervision::Both => Substitute::Radiance,
        Supervision::Ldr => Substitute::Allowed,
    };
    for (index, image) in model.images.iter().enumerate() {
        let found = ["images", ""].iter().find_map(|sub| {
            let path = scene.finder.find_image(&scene.folder.join(sub), &image.name, substitute)?;
            Some((path, format!("{sub}/{}", image.name)))
        });
        let Some((path, file_path)) = found else {
            let tried = scene.folder.join("images").join(&image.name);
            return Err(origin(scene.files, image).error(format!("image {} does not exist", tried.display())));
        };
        if path.extension() != Path::new(&image.name).extension() {
            substituted.push((&image.name, path.clone()));
        }
        chosen.push(Chosen { index, image, file_path, path, part: None, recordings: Vec::new() });
    }
    if let [(name, path), ..] = substituted.as_slice() {
        let (n, path) = (substituted.len(), path.display());
        warnings.push(format!("{n} images are read in another format than COLMAP's copies, such as {path} for {name}"));
    }
    Ok(chosen)
}

/// Returns for each HDR image the first registered image by name. `hdr_of`: key to group and sort
/// by, path below the scene, side of the split. Where captured images are read, the HDR images may
/// be missing.
fn grouped_images<'a>(
    model: &'a ColmapModel,
    scene: &ModelScene<'_>,
    hdr_of: impl Fn(&str) -> Result<(String, String, Option<Part>), String>,
) -> Result<Vec<Chosen<'a>>, IoError> {
    let mut groups: BTreeMap<String, Chosen<'a>> = BTreeMap::new();
    for (index, image) in model.images.iter().enumerate() {
        let base = image.name.rsplit(['/', '\\']).next().unwrap_or(&image.name);
        let (key, file_path, part) = hdr_of(without_extension(base)).map_err(|e| origin(scene.files, image).error(e))?;
        let path = scene.finder.find(scene.folder, &file_path).unwrap_or_else(|| scene.folder.join(&file_path));
        if scene.supervision.reads_radiance() && !path.is_file() {
            return Err(origin(scene.files, image).error(format!("its HDR image {} does not exist", path.display())));
        }
        let candidate = Chosen { index, image, file_path, path, part, recordings: Vec::new() };
        match groups.get_mut(&key) {
            Some(first) if first.image.name <= image.name => {}
            Some(first) => *first = candidate,
            None => drop(groups.insert(key, candidate)),
        }
    }
    Ok(groups.into_values().collect())
}

fn hdr_gs_images<'a>(model: &'a ColmapModel, scene: &ModelScene<'_>) -> Result<Vec<Chosen<'a>>, IoError> {
    let mut chosen = grouped_images(model, scene, |stem| {
        let view = stem.split('_').next().unwrap_or(stem);
        // The order of the names with their `_`: 0_, 10_, 11_, ..., 1_, 20_, ...
        Ok((format!("{view}_"), format!("exr/{view}.exr"), None))
    })?;
    let stated = match scene.supervision.reads_recordings() {
        true => recordings::hdr_gs_exposures(scene.folder)?,
        false => BTreeMap::new(),
    };
    for (i, c) in chosen.iter_mut().enumerate() {
        c.part = Some(if i % 2 == 0 { Part::Train } else { Part::Test });
        if scene.supervision.reads_recordings() {
            let view = view_name(&c.file_path);
            c.recordings = recordings::hdr_gs(scene.finder, scene.folder, view.rsplit('/').next().unwrap_or(&view), &stated)?;
        }
    }
    Ok(chosen)
}

fn gauss_hdr_images<'a>(model: &'a ColmapModel, scene: &ModelScene<'_>) -> Result<Vec<Chosen<'a>>, IoError> {
    let mut chosen = grouped_images(model, scene, |stem| {
        let parts: Vec<&str> = stem.split('_').collect();
        let number = match parts.as_slice() {
            [_, .., number, _exposure] => number.parse::<u32>().ok(),
            _ => None,
        };
        let (Some(prefix), Some(number)) = (parts.first(), number) else {
            return Err("the name is not of the form train_ldr_<number>_<exposure>".to_owned());
        };
        let file = format!("{prefix}_hdr_{number:03}");
        let part = match (stem.contains("train"), stem.contains("test")) {
            (true, _) => Some(Part::Train),
            (false, true) => Some(Part::Test),
            (false, false) => None,
        };
        Ok((file.clone(), format!("images_hdr/{file}.exr"), part))
    })?;
    if scene.supervision.reads_recordings() {
        let exposures = recordings::read_exposures(&scene.folder.join("exposure.json"))?;
        for c in &mut chosen {
            let stem = view_name(&c.file_path);
            let stem = stem.rsplit('/').next().unwrap_or(&stem).replacen("_hdr_", "_ldr_", 1);
            c.recordings = recordings::listed(scene.finder, &scene.folder.join("images"), "images", &stem, &exposures);
        }
    }
    Ok(chosen)
}

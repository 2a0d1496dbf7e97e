//! Folders with `transforms.json`, or `transforms_train.json` and `transforms_test.json` (else
//! `transforms_val.json`); and
//! HDR-NeRF's synthetic scenes, which have the latter and their HDR images in `train_hdr/` and
//! `test_hdr/`.
//!
//! HDR-NeRF: a frame names a pose, `<folder>/<anything>_<i>`, or an exposure of it, `..._<i>_<k>`;
//! its HDR image is `{train,test}_hdr/hdr_<i>.exr`. Frames of one pose are one view.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};

use super::colmap::points_with_sightings;
use crate::dataset::colmap::{ColmapModel, ColmapPoint, FoundModel, find_model, read_model};
use crate::dataset::files::{Finder, Substitute, view_name, without_extension};
use crate::dataset::source::{DatasetSource, Origin, SourceFrame, SourcePoint, split_beside};
use crate::dataset::split::{NameIndex, Part, SplitLists, SplitRule};
use crate::dataset::transforms::{Transforms, TransformsFrame, parse_transforms};
use crate::dataset::{Supervision, recordings};
use crate::image::holds_radiance;
use crate::read_file::read_file;
use crate::{IoError, read_points_ply};

/// Largest disagreement of the camera positions of `transforms.json` and of the COLMAP model beside
/// it, as a fraction of the distance between cameras, at which both are taken to share a frame.
const SAME_FRAME_TOLERANCE: f64 = 0.01;
/// Missing images that a warning lists.
const MAX_LISTED: usize = 3;

/// The descriptions in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::dataset) enum TransformsFiles {
    /// One for all.
    Single(PathBuf),
    /// One for each side of the split.
    Pair {
        /// `transforms_train.json`.
        train: PathBuf,
        /// `transforms_test.json`, else `transforms_val.json`, if there is one.
        test: Option<PathBuf>,
    },
}

impl TransformsFiles {
    /// Finds the files of the layout at `path`, a folder or a JSON file; the pair takes precedence
    /// over the single file.
    pub(in crate::dataset) fn find(path: &Path) -> Option<Self> {
        let pair = |folder: &Path| {
            let [train, test, val] = ["train", "test", "val"].map(|part| folder.join(format!("transforms_{part}.json")));
            train.is_file().then(|| Self::Pair { train, test: [test, val].into_iter().find(|path| path.is_file()) })
        };
        if path.is_dir() {
            let single = path.join("transforms.json");
            return pair(path).or_else(|| single.is_file().then_some(Self::Single(single)));
        }
        let halves = ["transforms_train.json", "transforms_test.json", "transforms_val.json"];
        let is_half = path.file_name().is_some_and(|name| halves.iter().any(|half| name == *half));
        let whole = is_half.then(|| path.parent()).flatten().and_then(pair);
        Some(whole.unwrap_or_else(|| Self::Single(path.into())))
    }

    fn folder(&self) -> PathBuf {
        let (Self::Single(path) | Self::Pair { train: path, .. }) = self;
        path.parent().map(Path::to_path_buf).unwrap_or_default()
    }

    fn read(&self) -> Result<Vec<Described>, IoError> {
        let one = |path: &Path, part| Ok(Described { transforms: parse_transforms(path, &read_file(path)?)?, path: path.into(), part });
        match self {
            Self::Single(path) => Ok(vec![one(path, None)?]),
            Self::Pair { train, test } => {
                let mut all = vec![one(train, Some(Part::Train))?];
                if let Some(test) = test {
                    all.push(one(test, Some(Part::Test))?);
                }
                Ok(all)
            }
        }
    }
}

/// A parsed file with its side of the split.
struct Described {
    transforms: Transforms,
    path: PathBuf,
    part: Option<Part>,
}

impl Described {
    fn origin(&self, index: usize, frame: &TransformsFrame) -> Origin {
        Origin { path: self.path.clone(), place: format!("frame {index} ({:?})", frame.file_path) }
    }
}

/// Reads the files, finds the images and the points.
pub(in crate::dataset) fn transforms_source(files: &TransformsFiles) -> Result<DatasetSource, IoError> {
    let folder = files.folder();
    let described = files.read()?;
    let finder = Finder::default();
    let mut frames = Vec::new();
    let mut with_radiance = Vec::new();
    let mut missing = Missing::default();
    for file in &described {
        for (i, frame) in file.transforms.frames.iter().enumerate() {
            let origin = file.origin(i, frame);
            let Some(image) = finder.find_image(&folder, &frame.file_path, Substitute::No) else {
                missing.frames.push((origin, frame.file_path.as_str()));
                continue;
            };
            let mask = frame.mask_path.as_ref().map(|mask| {
                let missing = || origin.error(format!("its mask {} does not exist", folder.join(mask.replace('\\', "/")).display()));
                finder.find(&folder, mask).ok_or_else(missing)
            });
            let mask = mask.transpose()?;
            if !holds_radiance(&image) {
                with_radiance.extend(finder.radiance_beside(&folder, &frame.file_path).map(|radiance| (image.clone(), radiance)));
            }
            frames.push(SourceFrame { mask, ..new_frame(view_name(&frame.file_path), image, frame, origin, file.part) });
        }
    }
    let split = match files {
        TransformsFiles::Pair { .. } => SplitRule::Frames,
        TransformsFiles::Single(path) => match described.first().and_then(|d| d.transforms.split.clone()) {
            Some([train, val, test]) => {
                let test = if test.is_empty() { val } else { test };
                let [train, test] = [train, test].map(|list| missing.without(list));
                SplitRule::Lists(SplitLists { path: path.clone(), train, test })
            }
            None => split_beside(&folder)?,
        },
    };
    let format = match files {
        TransformsFiles::Single(_) => "nerfstudio transforms.json",
        TransformsFiles::Pair { test: Some(test), .. } if is_val(test) => "transforms_train.json and transforms_val.json",
        TransformsFiles::Pair { .. } => "transforms_train.json and transforms_test.json",
    };
    let left_out = missing.warning(frames.len(), &folder)?;
    let mut source = finish(files, &described, frames, split, format)?;
    source.warnings.extend(left_out);
    source.warnings.extend(finder.warnings());
    if let [(image, radiance), ..] = with_radiance.as_slice() {
        source.warnings.push(format!(
            "{} images are not radiance and have radiance beside them that no frame names, such as {} beside {}; name it as \"file_path\"",
            with_radiance.len(),
            radiance.display(),
            image.display()
        ));
    }
    Ok(source)
}

/// The frames whose images do not exist.
#[derive(Default)]
struct Missing<'a> {
    frames: Vec<(Origin, &'a str)>,
}

impl Missing<'_> {
    /// Returns a list of the split without the frames that are left out.
    fn without(&self, mut list: Vec<String>) -> Vec<String> {
        let clean = |name: &str| name.trim_start_matches("./").to_owned();
        list.retain(|name| !self.frames.iter().any(|(_, path)| clean(path) == clean(name)));
        list
    }

    /// Returns a line about the frames that are left out. Where no more than half of the images are
    /// there, the folder is wrong or a copy was cut short: an error.
    fn warning(&self, present: usize, folder: &Path) -> Result<Option<String>, IoError> {
        let Some((origin, path)) = self.frames.first() else { return Ok(None) };
        if present <= self.frames.len() {
            return Err(origin.error(format!("image {} does not exist", folder.join(path).display())));
        }
        let (count, total) = (self.frames.len(), self.frames.len() + present);
        let listed: Vec<&str> = self.frames.iter().take(MAX_LISTED).map(|(_, path)| *path).collect();
        let more = if count > MAX_LISTED { ", ..." } else { "" };
        Ok(Some(format!("{count} of {total} frames name images that do not exist, and are left out ({}{more})", listed.join(", "))))
    }
}

/// Returns whether a file describes views for validation.
fn is_val(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == "transforms_val.json")
}

/// Reads HDR-NeRF's synthetic scenes.
pub(in crate::dataset) fn hdr_nerf_source(files: &TransformsFiles, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let folder = files.folder();
    if !matches!(files, TransformsFiles::Pair { .. }) {
        return Err(IoError::invalid(folder, "no transforms_train.json, expected one with HDR-NeRF's layout"));
    }
    let described = files.read()?;
    let finder = Finder::default();
    let mut frames: Vec<SourceFrame> = Vec::new();
    let mut by_name: HashMap<String, usize> = HashMap::new();
    for file in &described {
        let (part, side) = if file.part == Some(Part::Test) { ("test", "test_hdr") } else { ("train", "train_hdr") };
        let exposures = match supervision {
            Supervision::Hdr => BTreeMap::new(),
            // Captured images of held-out poses are not read beside radiance.
            Supervision::Both if part == "test" => BTreeMap::new(),
            Supervision::Ldr | Supervision::Both => recordings::read_exposures(&folder.join(format!("exposure_{part}.json")))?,
        };
        for (i, frame) in file.transforms.frames.iter().enumerate() {
            let origin = file.origin(i, frame);
            let Some(number) = pose_number(&frame.file_path) else {
                return Err(origin.error("the name does not end in _<number>, expected the number of its HDR image"));
            };
            let name = format!("{side}/hdr_{number:03}");
            let file_path = format!("{name}.exr");
            let image = finder.find(&folder, &file_path).unwrap_or_else(|| folder.join(&file_path));
            if let Some(first) = by_name.get(&name).and_then(|first| frames.get(*first)) {
                if !first.camera_from_world.abs_diff_eq(frame.camera_from_world, 1e-6) {
                    let other = &first.origin.place;
                    return Err(origin.error(format!("another pose than {other}, expected one for all exposures of {}", image.display())));
                }
                continue;
            }
            if supervision.reads_radiance() && !image.is_file() {
                return Err(origin.error(format!("its HDR image {} does not exist", image.display())));
            }
            by_name.insert(name.clone(), frames.len());
            let recordings = recordings::hdr_nerf(&finder, &folder, &frame.file_path, number, &exposures);
            frames.push(SourceFrame { recordings, ..new_frame(name, image, frame, origin, file.part) });
        }
    }
    finish(files, &described, frames, SplitRule::Frames, "HDR-NeRF synthetic")
}

/// Returns `7` for `train/r_7`, `train/007` and `train/007_2.png`: of two numbers at the end the
/// second is the exposure's.
fn pose_number(file_path: &str) -> Option<u32> {
    let stem = without_extension(file_path.rsplit(['/', '\\']).next()?);
    let mut parts = stem.rsplit('_').map(|part| part.parse::<u32>().ok());
    let last = parts.next()??;
    Some(parts.next().flatten().unwrap_or(last))
}

fn new_frame(name: String, image: PathBuf, frame: &TransformsFrame, origin: Origin, part: Option<Part>) -> SourceFrame {
    let TransformsFrame { camera_from_world, intrinsics, exposure_s, noise, .. } = *frame;
    SourceFrame { name, image, recordings: Vec::new(), exposure_s, noise, mask: None, camera_from_world, intrinsics, origin, part }
}

/// Adds points and warnings.
fn finish(
    files: &TransformsFiles,
    described: &[Described],
    frames: Vec<SourceFrame>,
    split: SplitRule,
    format: &str,
) -> Result<DatasetSource, IoError> {
    let (folder, mut warnings) = (files.folder(), Vec::new());
    match files {
        TransformsFiles::Pair { test: Some(test), .. } if is_val(test) => {
            warnings.push("no transforms_test.json: the views of transforms_val.json are the test views".to_owned());
        }
        _ if matches!(split, SplitRule::Frames) && folder.join("transforms_val.json").is_file() => {
            warnings.push("transforms_val.json is not used: its views are neither trained on nor tested".to_owned());
        }
        _ => {}
    }
    let (points, points_from) = points(&folder, described, &frames, &mut warnings)?;
    let format = format.to_owned();
    Ok(DatasetSource { format, folder, frames, split, points, points_from, notes: Vec::new(), warnings })
}

/// Returns the points of `ply_file_path`, or of the COLMAP model beside the file. A PLY of as many
/// points as the model is the same cloud, taken from the model for its tracks. Beside them is where
/// they are from, for people.
fn points(
    folder: &Path,
    described: &[Described],
    frames: &[SourceFrame],
    warnings: &mut Vec<String>,
) -> Result<(Vec<SourcePoint>, String), IoError> {
    let (file, ply) = described.iter().find_map(|d| Some((&d.path, d.transforms.ply_file_path.as_ref()?))).unzip();
    let path = ply.map(|ply| Finder::default().find(folder, ply).unwrap_or_else(|| folder.join(ply.replace('\\', "/"))));
    let cloud = path.as_ref().map(|path| read_points_ply(path)).transpose()?;
    warnings.extend(cloud.as_ref().zip(path.as_ref()).and_then(|(cloud, path)| cloud.warning(path)));
    let cloud = cloud.map(|cloud| cloud.points);
    let found = [folder.to_path_buf(), folder.join("colmap")].iter().find_map(|f| find_model(f));
    if let Some(FoundModel { folder: model_folder, warning }) = found {
        let (model, _) = read_model(&model_folder)?;
        let is_other = cloud.as_ref().is_some_and(|cloud| cloud.len() != model.points.len());
        if !is_other && !model.points.is_empty() {
            let world_from_model = described.first().map_or(DAffine3::IDENTITY, |d| d.transforms.world_from_reconstruction);
            match frames_of_images(&model, world_from_model, frames) {
                Ok(frame_of_image) => {
                    warnings.extend(warning);
                    warnings.extend(model.warnings.iter().cloned());
                    let position = |p: &ColmapPoint| world_from_model.transform_point3(p.position).to_array();
                    let from = format!("the COLMAP model in {}", model_folder.display());
                    return Ok((points_with_sightings(&model, &frame_of_image, position, warnings), from));
                }
                Err(why) if cloud.is_none() => warnings.push(format!("the points of {} are left out: {why}", model_folder.display())),
                Err(_) => {}
            }
        }
    }
    let point = |(position, rgb8)| SourcePoint { position, rgb8, sightings: Vec::new() };
    let from = file.zip(ply).map(|(file, ply)| format!("\"ply_file_path\" ({ply}) of {}", file.display())).unwrap_or_default();
    Ok((cloud.unwrap_or_default().into_iter().map(point).collect(), from))
}

/// Returns the frame of each image of the model; an error, in words, where model and frames do not
/// share a world.
fn frames_of_images(model: &ColmapModel, world_from_model: DAffine3, frames: &[SourceFrame]) -> Result<Vec<Option<usize>>, String> {
    let index = NameIndex::new(frames.iter().map(|f| f.name.as_str()));
    let found: Vec<Option<usize>> = model.images.iter().map(|image| index.find(&image.name).flatten()).collect();
    let eye = |pose: &DAffine3| -(pose.matrix3.transpose() * pose.translation);
    let pairs: Vec<(DVec3, DVec3)> = model
        .images
        .iter()
        .zip(&found)
        .filter_map(|(image, frame)| {
            let frame = frames.get((*frame)?)?;
            Some((world_from_model.transform_point3(eye(&image.camera_from_world)), eye(&frame.camera_from_world)))
        })
        .collect();
    let Some((_, origin)) = pairs.first() else {
        return Err("none of the COLMAP images is a frame, so that it is unknown whether they share a coordinate frame".to_owned());
    };
    let extent = pairs.iter().map(|(_, eye)| eye.distance(*origin)).fold(0.1 * origin.length(), f64::max);
    let worst = pairs.iter().map(|(model, eye)| model.distance(*eye)).fold(0.0, f64::max);
    if worst <= SAME_FRAME_TOLERANCE * extent {
        Ok(found)
    } else {
        Err(format!("their cameras are up to {worst:.3} from the frames', so that they do not share a coordinate frame"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pose_numbers_are_told_from_exposures() {
        assert_eq!(pose_number("./train/r_7"), Some(7));
        assert_eq!(pose_number("train/007_2.png"), Some(7));
        assert_eq!(pose_number("train/007"), Some(7));
        assert_eq!(pose_number("test/r_0_4"), Some(0));
        assert_eq!(pose_number("test/r"), None);
    }
}

//! Captured LDR images: display-referred images with their exposures, as data sets for HDR from LDR
//! have them beside or in place of radiance.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::path::Path;
use std::str::FromStr;

use luxel_core::Remedy;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::files::{Finder, Substitute, view_name, without_extension};
use super::json_fields::{kind_of, parse_json};
use super::source::{Recording, SourceFrame};
use super::split::SplitRule;
use crate::IoError;
use crate::read_file::read_file;

/// Exposures of HDR-GS's images `<i>_0.png` to `<i>_4.png`, seconds: its repack leaves HDR-NeRF's
/// list out.
const HDR_GS_EXPOSURES: [f32; 5] = [0.125, 0.5, 2.0, 8.0, 32.0];

/// Which images are trained on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Supervision {
    /// Radiance.
    #[default]
    Hdr,
    /// Captured LDR images with their exposures.
    Ldr,
    /// Radiance, and beside it the captured LDR images of each training pose.
    Both,
}

impl Supervision {
    /// Returns whether training poses must have radiance.
    pub fn reads_radiance(self) -> bool {
        matches!(self, Self::Hdr | Self::Both)
    }

    /// Returns whether captured LDR images are read.
    pub fn reads_recordings(self) -> bool {
        matches!(self, Self::Ldr | Self::Both)
    }
}

/// The choice of captured images of each pose that are trained on, counted from the shortest
/// exposure.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Exposures {
    /// All.
    #[default]
    All,
    /// One of each pose, the next pose's the next in turn.
    Single,
    /// The middle one of each pose; of an even number the shorter of the two in the middle.
    Middle,
    /// These, counted from 0.
    Of(Vec<usize>),
}

impl FromStr for Exposures {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let list: Result<Vec<usize>, _> = text.split(',').map(|part| part.trim().parse()).collect();
        match (text, list) {
            ("all", _) => Ok(Self::All),
            ("single", _) => Ok(Self::Single),
            ("middle", _) => Ok(Self::Middle),
            (_, Ok(list)) => Ok(Self::Of(list)),
            _ => Err(format!("\"{text}\" names no exposures, expected all, single, middle, or numbers from 0 such as 0,2,4")),
        }
    }
}

impl fmt::Display for Exposures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Single => f.write_str("single"),
            Self::Middle => f.write_str("middle"),
            Self::Of(list) => f.write_str(&list.iter().map(usize::to_string).collect::<Vec<_>>().join(",")),
        }
    }
}

impl From<Exposures> for String {
    fn from(exposures: Exposures) -> Self {
        exposures.to_string()
    }
}

impl TryFrom<String> for Exposures {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Reads an `exposure.json`.
pub(super) fn read_exposures(path: &Path) -> Result<BTreeMap<String, f32>, IoError> {
    parse_exposures(path, &read_file(path)?)
}

/// Parses an `exposure.json`, image names and seconds: seconds by the last part of the name,
/// without the image's extension.
///
/// # Errors
/// Text that is not JSON or not an object, or a value that is not a number above 0.
pub fn parse_exposures(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, f32>, IoError> {
    let root = parse_json(path, bytes)?;
    let Value::Object(root) = root else {
        return Err(IoError::invalid(path, format!("the file holds {}, expected an object of image names and seconds", kind_of(&root))));
    };
    let mut exposures = BTreeMap::new();
    for (name, value) in root {
        let seconds = value.as_f64().map(|v| v as f32).filter(|v| v.is_normal() && *v > 0.0);
        let Some(seconds) = seconds else {
            return Err(IoError::invalid(path, format!("{name:?} is {value}, expected seconds, a number above 0")));
        };
        let name = view_name(&name);
        exposures.insert(name.rsplit('/').next().unwrap_or(&name).to_owned(), seconds);
    }
    Ok(exposures)
}

/// Returns images `<stem>_<k>` in `folder` that have an exposure; views of them are named with
/// `prefix`.
pub(super) fn listed(finder: &Finder, folder: &Path, prefix: &str, stem: &str, exposures: &BTreeMap<String, f32>) -> Vec<Recording> {
    let of_stem = exposures.range(format!("{stem}_")..).take_while(|(name, _)| name.starts_with(&format!("{stem}_")));
    of_stem
        .filter(|(name, _)| name[stem.len() + 1..].bytes().all(|b| b.is_ascii_digit()))
        .filter_map(|(name, exposure_s)| {
            let image = finder.find_image(folder, name, Substitute::No)?;
            Some(Recording { name: view_name(&format!("{prefix}/{name}")), image, exposure_s: *exposure_s })
        })
        .collect()
}

/// Returns the captured images of the pose of an HDR-NeRF frame: of `train/r_7` or `train/r_7_2`
/// the images `train/r_7_<k>`.
pub(super) fn hdr_nerf(finder: &Finder, folder: &Path, file_path: &str, number: u32, exposures: &BTreeMap<String, f32>) -> Vec<Recording> {
    let slashed = file_path.replace('\\', "/");
    let (parent, base) = slashed.rsplit_once('/').unwrap_or((".", &slashed));
    let base = without_extension(base);
    // The stem ends in the pose's number, or in that and the exposure's.
    let is_pose = |stem: &str| stem.rsplit('_').next().is_some_and(|end| end.parse() == Ok(number));
    let stem = base.rsplit_once('_').map(|(stem, _)| stem).filter(|stem| is_pose(stem) && !exposures.contains_key(&format!("{base}_0")));
    listed(finder, &folder.join(parent), parent, stem.unwrap_or(base), exposures)
}

/// Returns the exposures that lists beside HDR-GS's repack state, seconds by image; none without
/// lists. HDR-NeRF's scenes differ in their exposures.
pub(super) fn hdr_gs_exposures(scene: &Path) -> Result<BTreeMap<String, f32>, IoError> {
    let mut stated = BTreeMap::new();
    for list in ["exposure_train.json", "exposure_test.json"].map(|name| scene.join(name)) {
        if list.is_file() {
            stated.extend(read_exposures(&list)?);
        }
    }
    Ok(stated)
}

/// Returns the captured images `images/<view>_<k>` of HDR-GS's repack, with the exposures that are
/// stated, or HDR-GS's own where none is.
///
/// # Errors
/// An image without an exposure where others have one.
pub(super) fn hdr_gs(finder: &Finder, scene: &Path, view: &str, stated: &BTreeMap<String, f32>) -> Result<Vec<Recording>, IoError> {
    let mut recordings = Vec::new();
    for (k, assumed) in HDR_GS_EXPOSURES.iter().enumerate() {
        let name = format!("{view}_{k}");
        let Some(image) = finder.find_image(&scene.join("images"), &name, Substitute::No) else { continue };
        let exposure_s = match stated.get(&name) {
            Some(seconds) => *seconds,
            None if stated.is_empty() => *assumed,
            None => {
                let message = format!("exposure_train.json and exposure_test.json state no exposure of {name:?}, but of other images");
                return Err(IoError::invalid(&image, message).with_remedy(Remedy::advice("add it, in seconds")));
            }
        };
        recordings.push(Recording { name: format!("images/{name}"), image, exposure_s });
    }
    Ok(recordings)
}

/// Returns the frames that `frame` represents: where captured images are read, those of a training
/// pose, or of a held-out one without radiance.
pub(super) fn expanded(frame: &SourceFrame, is_held_out: bool) -> Vec<SourceFrame> {
    if frame.recordings.is_empty() || (is_held_out && frame.has_both()) {
        return vec![frame.clone()];
    }
    beside(frame)
}

/// Returns the captured images of a frame as frames.
pub(super) fn beside(frame: &SourceFrame) -> Vec<SourceFrame> {
    let recording = |recording: &Recording| SourceFrame {
        name: recording.name.clone(),
        image: recording.image.clone(),
        exposure_s: Some(recording.exposure_s),
        recordings: Vec::new(),
        ..frame.clone()
    };
    frame.recordings.iter().map(recording).collect()
}

/// Moves frames that are captured LDR images to the frames of radiance that have their poses, and
/// checks that each of the training poses has equally many captured images.
pub(super) fn pair(path: &Path, frames: Vec<SourceFrame>) -> Result<Vec<SourceFrame>, IoError> {
    let pose = |frame: &SourceFrame| frame.camera_from_world.to_cols_array().map(f64::to_bits);
    let (captured, mut frames): (Vec<_>, Vec<_>) = frames.into_iter().partition(|frame| frame.exposure_s.is_some());
    for frame in captured {
        let Some(exposure_s) = frame.exposure_s else { continue };
        let Some(radiance) = frames.iter_mut().find(|other| pose(other) == pose(&frame)) else {
            let message = format!("no radiance image has the pose of the captured image {}, expected one beside it", frame.image.display());
            return Err(frame.origin.error(message).with_remedy(Remedy::set("supervision", "ldr")));
        };
        radiance.recordings.push(Recording { name: frame.name, image: frame.image, exposure_s });
    }
    if frames.iter().all(|frame| frame.recordings.is_empty()) {
        let message = "no captured LDR images with exposures beside the radiance, expected some of each training pose, \
                       as the layouts of HDR-NeRF, HDR-GS and GaussHDR have them";
        let remedy = Remedy::set("supervision", "hdr").or(Remedy::advice("train a method that needs radiance alone"));
        return Err(IoError::invalid(path, message).with_remedy(remedy));
    }
    Ok(frames)
}

/// Moves frames that are captured LDR images to frames of radiance that have their poses, as
/// [`pair`] does, where the split leaves their side to the frame of radiance. Others stay frames.
pub(super) fn pair_unlisted(mut frames: Vec<SourceFrame>, split: &SplitRule) -> Vec<SourceFrame> {
    let partners = partners(&frames, split);
    for (i, radiance) in partners.iter().enumerate() {
        let (Some(radiance), Some(exposure_s)) = (*radiance, frames[i].exposure_s) else { continue };
        let recording = Recording { name: frames[i].name.clone(), image: frames[i].image.clone(), exposure_s };
        frames[radiance].recordings.push(recording);
    }
    without_partner(frames, &partners)
}

/// Leaves out frames that are captured LDR images where radiance has their pose, and the split
/// leaves their side to it.
pub(super) fn radiance_alone(frames: Vec<SourceFrame>, split: &SplitRule) -> Vec<SourceFrame> {
    let partners = partners(&frames, split);
    without_partner(frames, &partners)
}

/// Returns for each frame that is a captured LDR image the place of the frame of radiance that has
/// its pose, if the split leaves its side to that.
fn partners(frames: &[SourceFrame], split: &SplitRule) -> Vec<Option<usize>> {
    let pose = |frame: &SourceFrame| frame.camera_from_world.to_cols_array().map(f64::to_bits);
    let listed = match split {
        SplitRule::Lists(lists) => lists.named(frames.iter().map(|frame| frame.name.as_str())),
        SplitRule::Frames | SplitRule::EveryEighth => HashSet::new(),
    };
    let goes_with = |captured: &SourceFrame, radiance: &SourceFrame| match split {
        SplitRule::Lists(_) | SplitRule::EveryEighth => true,
        SplitRule::Frames => captured.part.is_none() || captured.part == radiance.part,
    };
    let partner = |(i, frame): (usize, &SourceFrame)| {
        let is_partner = |other: &SourceFrame| other.exposure_s.is_none() && pose(other) == pose(frame) && goes_with(frame, other);
        if frame.exposure_s.is_none() || listed.contains(&i) { None } else { frames.iter().position(is_partner) }
    };
    frames.iter().enumerate().map(partner).collect()
}

fn without_partner(frames: Vec<SourceFrame>, partners: &[Option<usize>]) -> Vec<SourceFrame> {
    frames.into_iter().zip(partners).filter(|(_, partner)| partner.is_none()).map(|(frame, _)| frame).collect()
}

/// Checks that training poses have equally many captured images: a file or an exposure that is
/// missing would otherwise go unnoticed.
pub(super) fn check_pairs<'a>(frames: impl Iterator<Item = &'a SourceFrame> + Clone) -> Result<(), IoError> {
    let most = frames.clone().map(|frame| frame.recordings.len()).max().unwrap_or(0);
    for frame in frames {
        let found = frame.recordings.len();
        if found < most {
            let message =
                format!("{found} captured images of known exposure of view {}, other views have {most}: expected as many", frame.name);
            return Err(frame.origin.error(message).with_remedy(Remedy::advice("add the missing images or their exposures")));
        }
    }
    Ok(())
}

/// Keeps the captured images of each pose that `exposures` names, in the order given; frames of
/// equal pose form one bracket.
pub(super) fn choose<T>(frames: Vec<T>, of: impl Fn(&T) -> &SourceFrame, exposures: &Exposures) -> Vec<T> {
    if *exposures == Exposures::All {
        return frames;
    }
    let pose = |frame: &SourceFrame| frame.camera_from_world.to_cols_array().map(f64::to_bits);
    let mut brackets: Vec<([u64; 12], Vec<usize>)> = Vec::new();
    for (i, frame) in frames.iter().enumerate() {
        let pose = pose(of(frame));
        match brackets.iter_mut().find(|(other, _)| *other == pose) {
            Some((_, bracket)) => bracket.push(i),
            None => brackets.push((pose, vec![i])),
        }
    }
    let mut is_chosen = vec![false; frames.len()];
    for (turn, (_, mut bracket)) in brackets.into_iter().enumerate() {
        let seconds = |i: usize| of(&frames[i]).exposure_s.unwrap_or(0.0);
        bracket.sort_by(|a, b| seconds(*a).total_cmp(&seconds(*b)));
        let count = bracket.len();
        for (place, i) in bracket.into_iter().enumerate() {
            is_chosen[i] = match exposures {
                Exposures::All => true,
                Exposures::Single => place == turn % count,
                Exposures::Middle => place == (count - 1) / 2,
                Exposures::Of(places) => places.contains(&place),
            };
        }
    }
    frames.into_iter().zip(is_chosen).filter_map(|(frame, is_chosen)| is_chosen.then_some(frame)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_are_read_from_text() {
        for (text, choice) in
            [("all", Exposures::All), ("single", Exposures::Single), ("middle", Exposures::Middle), ("0,2,4", Exposures::Of(vec![0, 2, 4]))]
        {
            assert_eq!((text.parse(), choice.to_string().as_str()), (Ok(choice), text));
        }
        assert!("one".parse::<Exposures>().unwrap_err().contains("expected all, single"));
    }
}

//! Rigs and frames of COLMAP 3.12 and later: poses of cameras within a rig, and of the rig at each
//! moment. An image's pose is the product of both; what its own file states is a copy.
//!
//! In: `rigs` and `frames`, text or binary, beside the model. Out: the model with the frames'
//! poses, and a line about them for people. Degenerate cases: a camera without a place in its rig,
//! and an image in no frame, keep the pose of `images`; where both disagree a warning says so.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DAffine3;
use luxel_core::text::plural;

use super::binary::Cursor;
use super::text::{Fields, Lines};
use super::{ColmapModel, pose};
use crate::IoError;

/// Disagreement of a pose with that of its frame that is rounding: of entries of the rotation, and
/// of the translation as a share of its length.
const ROUNDING: f64 = 1e-5;

/// COLMAP's number and name of cameras among sensors; others are inertial units.
const CAMERA: (i32, &str) = (0, "CAMERA");

/// The two files, for messages and reading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RigFiles<T> {
    /// Sensors of each rig.
    pub rigs: T,
    /// Poses of rigs.
    pub frames: T,
}

/// Rigs with their frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rigs {
    rigs: HashMap<u32, Rig>,
    frames: Vec<Frame>,
}

/// The cameras of a rig, each with its pose relative to the rig, if it is known.
type Rig = HashMap<u32, Option<DAffine3>>;

/// A rig at a moment.
#[derive(Clone, Debug, PartialEq)]
struct Frame {
    rig: u32,
    rig_from_world: DAffine3,
    images: Vec<RigImage>,
}

/// An image of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct RigImage {
    camera: u32,
    image: u64,
}

/// Parses `rigs.bin` and `frames.bin`; `paths` are for error messages.
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`], naming file and entry.
pub fn parse_rigs_binary(paths: &RigFiles<PathBuf>, bytes: &RigFiles<Vec<u8>>) -> Result<Rigs, IoError> {
    let mut out = Rigs::default();
    let cursor = &mut Cursor::new(&paths.rigs, &bytes.rigs);
    let count = cursor.count("rigs", 4 + 4)?;
    for i in 0..count {
        cursor.place = format!("rig {} of {count}", i + 1);
        let (id, sensors) = (cursor.u32()?, cursor.u32()?);
        let mut rig = Rig::new();
        for sensor in 0..sensors {
            let (kind, camera) = (cursor.i32()?, cursor.u32()?);
            let is_placed = sensor == 0 || cursor.take::<1>()? != [0];
            let placed = match (sensor, is_placed) {
                (0, _) => Some(DAffine3::IDENTITY),
                (_, true) => Some(binary_pose(cursor)?),
                (_, false) => None,
            };
            if kind == CAMERA.0 {
                rig.insert(camera, placed);
            }
        }
        insert(&mut out, &paths.rigs, id, rig)?;
    }
    cursor.end("rig")?;
    let cursor = &mut Cursor::new(&paths.frames, &bytes.frames);
    let count = cursor.count("frames", 4 + 4 + 7 * 8 + 4)?;
    for i in 0..count {
        cursor.place = format!("frame {} of {count}", i + 1);
        let (_id, rig) = (cursor.u32()?, cursor.u32()?);
        let rig_from_world = binary_pose(cursor)?;
        let mut images = Vec::new();
        for _ in 0..cursor.u32()? {
            let (kind, camera, image) = (cursor.i32()?, cursor.u32()?, cursor.u64()?);
            if kind == CAMERA.0 {
                images.push(RigImage { camera, image });
            }
        }
        out.frames.push(Frame { rig, rig_from_world, images });
    }
    cursor.end("frame")?;
    Ok(out)
}

fn binary_pose(cursor: &mut Cursor<'_>) -> Result<DAffine3, IoError> {
    let (quaternion, translation) = (cursor.f64s()?, cursor.f64s()?);
    pose(quaternion, translation).map_err(|e| cursor.error(e))
}

/// Parses `rigs.txt` and `frames.txt`; `paths` are for error messages.
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`], naming file and line.
pub fn parse_rigs_text(paths: &RigFiles<PathBuf>, bytes: &RigFiles<Vec<u8>>) -> Result<Rigs, IoError> {
    let mut out = Rigs::default();
    let mut lines = Lines::new(&paths.rigs, &bytes.rigs)?;
    while let Some(mut fields) = lines.next_entry() {
        let id = fields.value("a rig number")?;
        let sensors: u32 = fields.value("a number of sensors")?;
        let mut rig = Rig::new();
        for sensor in 0..sensors {
            let (kind, camera): (String, u32) = (fields.value("CAMERA or IMU")?, fields.value("a sensor's number")?);
            let placed = if sensor == 0 {
                Some(DAffine3::IDENTITY)
            } else if fields.value::<u8>("1 where a pose follows, else 0")? == 1 {
                Some(text_pose(&mut fields)?)
            } else {
                None
            };
            if kind == CAMERA.1 {
                rig.insert(camera, placed);
            }
        }
        insert(&mut out, &paths.rigs, id, rig)?;
    }
    let mut lines = Lines::new(&paths.frames, &bytes.frames)?;
    while let Some(mut fields) = lines.next_entry() {
        let _id: u32 = fields.value("a frame number")?;
        let rig = fields.value("a rig number")?;
        let rig_from_world = text_pose(&mut fields)?;
        let count: u32 = fields.value("a number of images")?;
        let mut images = Vec::new();
        for _ in 0..count {
            let kind: String = fields.value("CAMERA or IMU")?;
            let found = RigImage { camera: fields.value("a camera number")?, image: fields.value("an image number")? };
            if kind == CAMERA.1 {
                images.push(found);
            }
        }
        out.frames.push(Frame { rig, rig_from_world, images });
    }
    Ok(out)
}

fn text_pose(fields: &mut Fields<'_>) -> Result<DAffine3, IoError> {
    let (quaternion, translation) = (fields.values("a quaternion")?, fields.values("a translation")?);
    pose(quaternion, translation).map_err(|e| fields.error(e))
}

fn insert(out: &mut Rigs, path: &Path, id: u32, rig: Rig) -> Result<(), IoError> {
    match out.rigs.insert(id, rig) {
        None => Ok(()),
        Some(_) => Err(IoError::invalid(path, format!("rig {id} occurs twice"))),
    }
}

impl Rigs {
    /// Gives the images of the model the poses of their frames.
    pub(super) fn apply(&self, paths: &RigFiles<PathBuf>, model: &mut ColmapModel) -> Result<(), IoError> {
        let mut poses: HashMap<u32, DAffine3> = HashMap::new();
        for frame in &self.frames {
            let Some(rig) = self.rigs.get(&frame.rig) else {
                let rigs = paths.rigs.display();
                return Err(IoError::invalid(&paths.frames, format!("a frame is of rig {}, which is not in {rigs}", frame.rig)));
            };
            for RigImage { camera, image } in &frame.images {
                // A camera without a place leaves its images theirs.
                if let (Some(Some(camera_from_rig)), Ok(image)) = (rig.get(camera), u32::try_from(*image)) {
                    poses.insert(image, *camera_from_rig * frame.rig_from_world);
                }
            }
        }
        let mut moved = Vec::new();
        let mut without = 0usize;
        for image in &mut model.images {
            let Some(found) = poses.get(&image.id) else {
                without += 1;
                continue;
            };
            let scale = found.translation.length().max(1.0);
            let turned = (found.matrix3 - image.camera_from_world.matrix3).to_cols_array().iter().fold(0.0f64, |a, v| a.max(v.abs()));
            let shifted = found.translation.distance(image.camera_from_world.translation) / scale;
            if turned > ROUNDING || shifted > ROUNDING {
                moved.push(image.name.clone());
                image.camera_from_world = *found;
            }
        }
        if let [first, ..] = moved.as_slice() {
            let (n, frames) = (moved.len(), paths.frames.display());
            model.warnings.push(format!(
                "{n} images have another pose than {frames} says, such as {first}: that of the rig's frame is taken, as COLMAP does"
            ));
        }
        if without > 0 && !poses.is_empty() {
            model.warnings.push(format!("{}: {without} images are in no frame and keep their own poses", paths.frames.display()));
        }
        model.rigs = self.summary();
        Ok(())
    }

    /// Returns a line about rigs of several cameras, for people; `None` where there is none.
    fn summary(&self) -> Option<String> {
        let several: Vec<usize> = self.rigs.values().map(Rig::len).filter(|cameras| *cameras > 1).collect();
        let (least, most) = (several.iter().min()?, several.iter().max()?);
        let cameras = if least == most { format!("{least} cameras") } else { format!("{least} to {most} cameras") };
        let is_of_several = |frame: &&Frame| self.rigs.get(&frame.rig).is_some_and(|rig| rig.len() > 1);
        let (rigs, frames) = (several.len(), self.frames.iter().filter(is_of_several).count());
        Some(format!("{} of {cameras}, {}", plural(rigs, "rig"), plural(frames, "frame")))
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::super::parse_text;
    use super::super::tests_support::{paths as model_paths, text_model};
    use super::*;

    fn paths(extension: &str) -> RigFiles<PathBuf> {
        RigFiles { rigs: format!("rigs.{extension}").into(), frames: format!("frames.{extension}").into() }
    }

    /// A rig of two cameras, the second turned half a turn about x and moved; one frame.
    fn text() -> RigFiles<Vec<u8>> {
        let rigs = b"# rigs\n1 3 CAMERA 7 CAMERA 8 1 0 1 0 0 0.5 0 0 IMU 3 0\n".to_vec();
        RigFiles { rigs, frames: b"# frames\n4 1 1 0 0 0 0 0 2 3 CAMERA 7 1 CAMERA 8 2 IMU 3 9\n".to_vec() }
    }

    fn binary() -> RigFiles<Vec<u8>> {
        let numbers = |values: [f64; 7]| values.map(f64::to_le_bytes).concat();
        let ints = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let mut rigs = [1u64.to_le_bytes().to_vec(), ints(&[1, 3, 0, 7, 0, 8])].concat();
        rigs.push(1);
        rigs.extend(numbers([0.0, 1.0, 0.0, 0.0, 0.5, 0.0, 0.0]));
        rigs.extend(ints(&[1, 3]));
        rigs.push(0);
        let mut frames = [1u64.to_le_bytes().to_vec(), ints(&[4, 1])].concat();
        frames.extend(numbers([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]));
        frames.extend(ints(&[3]));
        for (kind, sensor, image) in [(0, 7, 1u64), (0, 8, 2), (1, 3, 9)] {
            frames.extend(ints(&[kind, sensor]));
            frames.extend(image.to_le_bytes());
        }
        RigFiles { rigs, frames }
    }

    #[test]
    fn text_and_binary_say_the_same_and_every_truncation_is_an_error() {
        let whole = parse_rigs_binary(&paths("bin"), &binary()).unwrap();
        assert_eq!(parse_rigs_text(&paths("txt"), &text()).unwrap(), whole);
        for n in 0..binary().rigs.len() {
            assert!(parse_rigs_binary(&paths("bin"), &RigFiles { rigs: binary().rigs[..n].to_vec(), ..binary() }).is_err(), "{n}");
        }
        for n in 0..binary().frames.len() {
            assert!(parse_rigs_binary(&paths("bin"), &RigFiles { frames: binary().frames[..n].to_vec(), ..binary() }).is_err(), "{n}");
        }
    }

    #[test]
    fn images_take_the_poses_of_their_frames() {
        let mut model = parse_text(&model_paths("txt"), &text_model()).unwrap();
        parse_rigs_text(&paths("txt"), &text()).unwrap().apply(&paths("txt"), &mut model).unwrap();
        // Image 1 is of the rig's first camera, image 2 of the turned and moved one.
        let [first, second] = [0, 1].map(|i| model.images[i].camera_from_world);
        assert!(first.transform_point3(DVec3::ZERO).distance(DVec3::new(0.0, 0.0, 2.0)) < 1e-12);
        assert!(second.transform_point3(DVec3::new(0.0, 1.0, 0.0)).distance(DVec3::new(0.5, -1.0, -2.0)) < 1e-12);
        assert!(model.warnings[0].contains("2 images have another pose than frames.txt says, such as a.exr"), "{:?}", model.warnings);
        assert_eq!(model.rigs.as_deref(), Some("1 rig of 2 cameras, 1 frame"));
    }

    #[test]
    fn frames_of_no_rig_are_an_error() {
        let mut model = parse_text(&model_paths("txt"), &text_model()).unwrap();
        let rigs = parse_rigs_text(&paths("txt"), &RigFiles { rigs: Vec::new(), ..text() }).unwrap();
        assert!(rigs.apply(&paths("txt"), &mut model).unwrap_err().message.contains("rig 1, which is not in rigs.txt"));
        let twice = RigFiles { rigs: b"1 1 CAMERA 7\n1 1 CAMERA 8\n".to_vec(), ..text() };
        assert!(parse_rigs_text(&paths("txt"), &twice).unwrap_err().message.contains("rig 1 occurs twice"));
    }

    proptest! {
        #[test]
        fn random_bytes_do_not_panic(rigs: Vec<u8>, frames: Vec<u8>) {
            let _ = parse_rigs_binary(&paths("bin"), &RigFiles { rigs: rigs.clone(), frames: frames.clone() });
            let _ = parse_rigs_text(&paths("txt"), &RigFiles { rigs, frames });
        }
    }
}

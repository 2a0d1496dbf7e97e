//! COLMAP's binary model: little-endian, every list preceded by its length. Lengths are believed
//! only as far as the file reaches.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::models::{CAMERA_MODELS, MAX_PARAMETERS, lens_image, unknown_model};
use super::{Collected, ColmapFiles, ColmapModel, ColmapPoint, RawImage, pose};
use crate::IoError;

/// Parses `cameras.bin`, `images.bin` and `points3D.bin`; `paths` are for error messages.
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`] and [`crate::IoErrorKind::Unsupported`], naming file and entry.
pub fn parse_binary(paths: &ColmapFiles<PathBuf>, bytes: &ColmapFiles<Vec<u8>>) -> Result<ColmapModel, IoError> {
    let mut collected = Collected::default();
    cameras(&mut collected, &mut Cursor::new(&paths.cameras, &bytes.cameras))?;
    images(&mut collected, &mut Cursor::new(&paths.images, &bytes.images))?;
    points(&mut collected, &mut Cursor::new(&paths.points, &bytes.points))?;
    collected.resolve(paths)
}

/// Bytes yet to be read.
pub(super) struct Cursor<'a> {
    path: &'a Path,
    rest: &'a [u8],
    /// Place that is being read, for messages: `image 3 of 35`.
    pub(super) place: String,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8]) -> Self {
        Self { path, rest: bytes, place: "header".to_owned() }
    }

    pub(super) fn error(&self, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.path, format!("{}: {message}", self.place))
    }

    pub(super) fn take<const N: usize>(&mut self) -> Result<[u8; N], IoError> {
        let Some((head, rest)) = self.rest.split_first_chunk::<N>() else {
            return Err(self.error(format!("the file ends, expected {N} more bytes, found {}: it is truncated", self.rest.len())));
        };
        self.rest = rest;
        Ok(*head)
    }

    pub(super) fn i32(&mut self) -> Result<i32, IoError> {
        self.take().map(i32::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, IoError> {
        self.take().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, IoError> {
        self.take().map(u64::from_le_bytes)
    }

    pub(super) fn f64s<const N: usize>(&mut self) -> Result<[f64; N], IoError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.take()?);
        }
        Ok(values)
    }

    /// Returns a list's length, whose entries take at least `entry_bytes` each.
    pub(super) fn count(&mut self, what: &str, entry_bytes: usize) -> Result<usize, IoError> {
        let count = self.u64()?;
        let room = self.rest.len() / entry_bytes;
        usize::try_from(count).ok().filter(|count| *count <= room).ok_or_else(|| {
            self.error(format!(
                "claims {count} {what}, but the {} bytes that follow hold at most {room}: it is truncated or damaged",
                self.rest.len()
            ))
        })
    }

    /// Returns the text up to a zero byte.
    fn name(&mut self) -> Result<String, IoError> {
        let Some(end) = self.rest.iter().position(|b| *b == 0) else {
            return Err(self.error("the name is not ended by a zero byte: the file is truncated or damaged"));
        };
        let name = std::str::from_utf8(&self.rest[..end]).map_err(|_| self.error("the name is not UTF-8"))?.to_owned();
        self.rest = &self.rest[end + 1..];
        if name.is_empty() { Err(self.error("the name is empty")) } else { Ok(name) }
    }

    pub(super) fn end(&mut self, what: &str) -> Result<(), IoError> {
        self.place = format!("after the last {what}");
        match self.rest.len() {
            0 => Ok(()),
            more => Err(self.error(format!("{more} bytes more than expected: the file is damaged or of a newer format"))),
        }
    }
}

fn cameras(out: &mut Collected, cursor: &mut Cursor<'_>) -> Result<(), IoError> {
    // id, model, width, height and at least 2 parameters.
    let count = cursor.count("cameras", 4 + 4 + 8 + 8 + 2 * 8)?;
    for i in 0..count {
        cursor.place = format!("camera {} of {count}", i + 1);
        let id = cursor.u32()?;
        let model = cursor.u32()?;
        let size = [cursor.u64()?, cursor.u64()?];
        let Some(known) = CAMERA_MODELS.get(model as usize) else {
            return Err(unknown_model(cursor.path, id, &format!("number {model}")));
        };
        let parameters = known.parameters;
        let mut params = [0.0; MAX_PARAMETERS];
        for value in params.iter_mut().take(parameters) {
            [*value] = cursor.f64s()?;
        }
        out.cameras.push((id, lens_image(cursor.path, id, known, size, &params[..parameters])?.intrinsics()));
    }
    cursor.end("camera")
}

fn images(out: &mut Collected, cursor: &mut Cursor<'_>) -> Result<(), IoError> {
    // id, quaternion, translation, camera, a name of one letter, number of features.
    let count = cursor.count("images", 4 + 7 * 8 + 4 + 2 + 8)?;
    for i in 0..count {
        cursor.place = format!("image {} of {count}", i + 1);
        let id = cursor.u32()?;
        let (quaternion, translation) = (cursor.f64s()?, cursor.f64s()?);
        let camera = cursor.u32()?;
        let name = cursor.name()?;
        cursor.place = format!("image {} of {count} ({name:?})", i + 1);
        let camera_from_world = pose(quaternion, translation).map_err(|e| cursor.error(e))?;
        let features = cursor.count("features", 3 * 8)?;
        let mut features_px = Vec::with_capacity(features);
        for _ in 0..features {
            let [x, y] = cursor.f64s()?;
            // The point that the feature belongs to is in the points' tracks, too.
            cursor.u64()?;
            features_px.push([x as f32, y as f32]);
        }
        out.images.push(RawImage { id, name, camera_from_world, camera, features_px });
    }
    cursor.end("image")
}

fn points(out: &mut Collected, cursor: &mut Cursor<'_>) -> Result<(), IoError> {
    // id, position, colour, error, length of the track.
    let count = cursor.count("points", 8 + 3 * 8 + 3 + 8 + 8)?;
    out.points.reserve(count);
    for i in 0..count {
        cursor.place = format!("point {} of {count}", i + 1);
        let id = cursor.u64()?;
        let position = DVec3::from(cursor.f64s::<3>()?);
        let rgb8 = cursor.take()?;
        let [_error] = cursor.f64s()?;
        let length = cursor.count("observations", 2 * 4)?;
        let mut track = Vec::with_capacity(length);
        for _ in 0..length {
            track.push([cursor.u32()?, cursor.u32()?]);
        }
        out.points.push((id, ColmapPoint { position, rgb8, track }));
    }
    cursor.end("point")
}

#[cfg(test)]
mod tests {
    use super::super::tests_support::{binary_model, paths};
    use super::*;
    use luxel_core::{CameraProjection, Fisheye};
    use proptest::prelude::*;

    #[test]
    fn every_truncation_is_an_error() {
        let whole = binary_model();
        let model = parse_binary(&paths("bin"), &whole).unwrap();
        assert_eq!((model.images.len(), model.points.len()), (2, 1));
        assert_eq!(model.points[0].track, [[0, 1], [1, 0]]);
        for n in 0..whole.images.len() {
            let cut = ColmapFiles { images: whole.images[..n].to_vec(), ..whole.clone() };
            assert!(parse_binary(&paths("bin"), &cut).is_err(), "images.bin cut at {n}");
        }
        for n in 0..whole.points.len() {
            let cut = ColmapFiles { points: whole.points[..n].to_vec(), ..whole.clone() };
            assert!(parse_binary(&paths("bin"), &cut).is_err(), "points3D.bin cut at {n}");
        }
        for n in 0..whole.cameras.len() {
            let cut = ColmapFiles { cameras: whole.cameras[..n].to_vec(), ..whole.clone() };
            assert!(parse_binary(&paths("bin"), &cut).is_err(), "cameras.bin cut at {n}");
        }
    }

    #[test]
    fn claims_of_absurd_counts_allocate_nothing() {
        let bytes = ColmapFiles { points: 1_000_000u64.to_le_bytes().to_vec(), ..binary_model() };
        let error = parse_binary(&paths("bin"), &bytes).unwrap_err().to_string();
        assert!(error.contains("claims 1000000 points"), "{error}");
    }

    #[test]
    fn unknown_camera_models_are_named() {
        for (number, name) in [(18u32, "number 18"), (77, "number 77")] {
            let mut bytes = binary_model();
            bytes.cameras[12..16].copy_from_slice(&number.to_le_bytes());
            let error = parse_binary(&paths("bin"), &bytes).unwrap_err();
            assert_eq!(error.kind, crate::IoErrorKind::Unsupported);
            assert!(error.message.contains(name) && error.message.contains("image_undistorter"), "{error}");
        }
    }

    #[test]
    fn a_fisheye_is_read_by_its_number() {
        let mut bytes = binary_model();
        bytes.cameras[12..16].copy_from_slice(&5u32.to_le_bytes());
        let model = parse_binary(&paths("bin"), &bytes).unwrap();
        let projection = CameraProjection::Fisheye(Fisheye::new([0.1, -0.02, 0.001, 0.002]));
        assert_eq!((model.images[0].intrinsics.projection, model.images[0].intrinsics.foreign_lens), (projection, None));
    }

    proptest! {
        #[test]
        fn random_bytes_do_not_panic(cameras: Vec<u8>, images: Vec<u8>, points: Vec<u8>) {
            let _ = parse_binary(&paths("bin"), &ColmapFiles { cameras, images, points });
        }

        #[test]
        fn damaged_models_do_not_panic(at in 0usize..1000, byte: u8, file in 0usize..3) {
            let mut bytes = binary_model();
            let target = [&mut bytes.cameras, &mut bytes.images, &mut bytes.points].into_iter().nth(file).unwrap();
            let at = at % target.len();
            target[at] = byte;
            let _ = parse_binary(&paths("bin"), &bytes);
        }
    }
}

//! COLMAP's text model: one camera or point a line, two lines an image (pose, features); `#` starts
//! a comment line.

use std::iter::{Enumerate, Peekable};
use std::path::{Path, PathBuf};
use std::str::{FromStr, SplitAsciiWhitespace};

use glam::DVec3;

use super::models::{CameraModel, MAX_PARAMETERS, lens_image, unknown_model};
use super::{Collected, ColmapFiles, ColmapModel, ColmapPoint, RawImage, pose};
use crate::IoError;
use crate::byte_order_mark::without_mark;

/// Parses `cameras.txt`, `images.txt` and `points3D.txt`; `paths` are for error messages.
///
/// # Errors
/// [`crate::IoErrorKind::Invalid`] and [`crate::IoErrorKind::Unsupported`], naming file and line.
pub fn parse_text(paths: &ColmapFiles<PathBuf>, bytes: &ColmapFiles<Vec<u8>>) -> Result<ColmapModel, IoError> {
    let mut collected = Collected::default();
    cameras(&mut collected, Lines::new(&paths.cameras, &bytes.cameras)?)?;
    images(&mut collected, Lines::new(&paths.images, &bytes.images)?)?;
    points(&mut collected, Lines::new(&paths.points, &bytes.points)?)?;
    collected.resolve(paths)
}

/// The lines of a file, counted from 1.
pub(super) struct Lines<'a> {
    path: &'a Path,
    lines: Peekable<Enumerate<std::str::Lines<'a>>>,
}

impl<'a> Lines<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self, IoError> {
        let text = std::str::from_utf8(bytes)
            .map_err(|e| IoError::invalid(path, format!("byte {}: not UTF-8 text, expected COLMAP's text format", e.valid_up_to())))?;
        Ok(Self { path, lines: without_mark(text).lines().enumerate().peekable() })
    }

    fn fields(&self, index: usize, line: &'a str) -> Fields<'a> {
        Fields { path: self.path, line: index + 1, words: line.split_ascii_whitespace(), text: line }
    }

    /// Returns the next line, whatever it holds, unless it is an image's: some programs leave out
    /// the empty line of an image without features.
    fn features(&mut self) -> Option<Fields<'a>> {
        let (index, line) = self.lines.next_if(|(_, line)| !is_image(line))?;
        Some(self.fields(index, line))
    }

    /// Returns the next line that is neither empty nor a comment.
    pub(super) fn next_entry(&mut self) -> Option<Fields<'a>> {
        loop {
            let (index, line) = self.lines.next()?;
            let trimmed = line.trim_ascii();
            if !trimmed.is_empty() && !trimmed.starts_with('#') {
                return Some(self.fields(index, line));
            }
        }
    }
}

/// The words of a line yet to be read.
pub(super) struct Fields<'a> {
    path: &'a Path,
    line: usize,
    words: SplitAsciiWhitespace<'a>,
    text: &'a str,
}

impl Fields<'_> {
    pub(super) fn error(&self, message: impl std::fmt::Display) -> IoError {
        IoError::invalid(self.path, format!("line {}: {message}", self.line))
    }

    pub(super) fn value<T: FromStr>(&mut self, what: &str) -> Result<T, IoError> {
        let word =
            self.words.next().ok_or_else(|| self.error(format!("the line ends, expected {what}: the file is truncated or damaged")))?;
        word.parse().map_err(|_| self.error(format!("{word:?}, expected {what}")))
    }

    pub(super) fn values<const N: usize>(&mut self, what: &str) -> Result<[f64; N], IoError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.value(what)?;
        }
        Ok(values)
    }

    fn is_at_end(&self) -> bool {
        self.words.clone().next().is_none()
    }
}

fn cameras(out: &mut Collected, mut lines: Lines<'_>) -> Result<(), IoError> {
    while let Some(mut fields) = lines.next_entry() {
        let id = fields.value("a camera number")?;
        let model: String = fields.value("a camera model")?;
        let size = [fields.value("a width in pixels")?, fields.value("a height in pixels")?];
        let Some(known) = CameraModel::named(&model) else {
            return Err(unknown_model(fields.path, id, &model));
        };
        let parameters = known.parameters;
        let mut params = [0.0; MAX_PARAMETERS];
        for value in params.iter_mut().take(parameters) {
            *value = fields.value("a lens parameter")?;
        }
        if !fields.is_at_end() {
            return Err(fields.error(format!("more than the {parameters} parameters of {model}")));
        }
        out.cameras.push((id, lens_image(fields.path, id, known, size, &params[..parameters])?.intrinsics()));
    }
    Ok(())
}

fn images(out: &mut Collected, mut lines: Lines<'_>) -> Result<(), IoError> {
    while let Some(mut fields) = lines.next_entry() {
        let id = fields.value("an image number")?;
        let (quaternion, translation) = (fields.values("a quaternion")?, fields.values("a translation")?);
        let camera = fields.value("a camera number")?;
        let name = nth_word_to_end(fields.text, 9).ok_or_else(|| fields.error("the line ends, expected the image's name"))?.to_owned();
        let camera_from_world = pose(quaternion, translation).map_err(|e| fields.error(e))?;
        // The last image's features may be missing where there are none and the file's last newline
        // was trimmed.
        let mut features_px = Vec::new();
        if let Some(mut fields) = lines.features() {
            while !fields.is_at_end() {
                let [x, y]: [f64; 2] = fields.values("feature coordinates")?;
                let _point: i64 = fields.value("a point's number or -1")?;
                features_px.push([x as f32, y as f32]);
            }
        }
        out.images.push(RawImage { id, name, camera_from_world, camera, features_px });
    }
    Ok(())
}

/// Returns whether a line is an image's: nine numbers, then a name.
fn is_image(line: &str) -> bool {
    let words: Vec<&str> = line.split_ascii_whitespace().take(10).collect();
    let is_number = |word: &&str| word.parse::<f64>().is_ok();
    words.len() == 10 && words[..9].iter().all(is_number) && !is_number(&words[9])
}

/// Returns the text from word `n` (from 0) on, without surrounding white space: names may hold
/// spaces.
fn nth_word_to_end(text: &str, n: usize) -> Option<&str> {
    let mut rest = text.trim_ascii();
    for _ in 0..n {
        rest = rest[rest.find(|c: char| c.is_ascii_whitespace())?..].trim_ascii_start();
    }
    (!rest.is_empty()).then_some(rest)
}

fn points(out: &mut Collected, mut lines: Lines<'_>) -> Result<(), IoError> {
    while let Some(mut fields) = lines.next_entry() {
        let id = fields.value("a point number")?;
        let position = DVec3::from(fields.values::<3>("a position")?);
        let rgb8 = [fields.value("red 0 to 255")?, fields.value("green 0 to 255")?, fields.value("blue 0 to 255")?];
        let _error: f64 = fields.value("a reprojection error")?;
        let mut track = Vec::new();
        while !fields.is_at_end() {
            track.push([fields.value("an image number")?, fields.value("a feature number")?]);
        }
        out.points.push((id, ColmapPoint { position, rgb8, track }));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::parse_binary;
    use super::super::tests_support::{binary_model, paths, text_model};
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn text_and_binary_say_the_same() {
        assert_eq!(parse_text(&paths("txt"), &text_model()).unwrap(), parse_binary(&paths("bin"), &binary_model()).unwrap());
    }

    #[test]
    fn errors_name_the_line() {
        let with_points = |text: &str| parse_text(&paths("txt"), &ColmapFiles { points: text.into(), ..text_model() });
        let message = |text: &str| with_points(text).unwrap_err().to_string();
        assert_eq!(message("# c\n1 0 0"), "points3D.txt: line 2: the line ends, expected a position: the file is truncated or damaged");
        assert!(message("1 0 0 0 300 0 0 0").contains("\"300\", expected red 0 to 255"));
        assert!(message("1 0 0 0 0 0 0 0\n1 0 0 0 0 0 0 0").contains("point 1 occurs twice"));
        let singular = ColmapFiles { images: b"1 0 0 0 0 0 0 0 1 a.exr\n\n".to_vec(), ..text_model() };
        assert!(parse_text(&paths("txt"), &singular).unwrap_err().message.contains("quaternion has length 0"));
    }

    #[test]
    fn tracks_that_name_nothing_are_left_out_with_a_count() {
        let model =
            parse_text(&paths("txt"), &ColmapFiles { points: b"1 0 0 0 0 0 0 0 5 0 1 9 1 1 6 2\n".to_vec(), ..text_model() }).unwrap();
        assert_eq!(model.points[0].track, [[0, 1]]);
        let left_out = |n: usize, what: &str| format!("points3D.txt: {n} entries of tracks name {what} and are left out; the points stay");
        assert_eq!(model.warnings, [left_out(2, "images that the model lacks"), left_out(1, "features that their images lack")]);
    }

    #[test]
    fn a_byte_order_mark_is_left_out() {
        let marked = |bytes: Vec<u8>| [b"\xef\xbb\xbf".to_vec(), bytes].concat();
        let ColmapFiles { cameras, images, points } = text_model();
        let files = ColmapFiles { cameras: marked(cameras), images: marked(images), points: marked(points) };
        assert_eq!(parse_text(&paths("txt"), &files).unwrap(), parse_text(&paths("txt"), &text_model()).unwrap());
    }

    #[test]
    fn an_image_without_features_may_lack_their_line() {
        let images = b"1 1 0 0 0 0 0 0 7 a.exr\n2 0 1 0 0 1 2 3 7 b.exr\n4.5 5.5 9\n3 0 1 0 0 1 2 3 7 c.exr\n\n".to_vec();
        let model = parse_text(&paths("txt"), &ColmapFiles { images, points: Vec::new(), ..text_model() }).unwrap();
        let found: Vec<_> = model.images.iter().map(|image| (image.name.as_str(), image.features_px.len())).collect();
        assert_eq!(found, [("a.exr", 0), ("b.exr", 1), ("c.exr", 0)]);
    }

    #[test]
    fn names_may_hold_spaces() {
        let images = ColmapFiles { images: b"1 1 0 0 0 0 0 0 7  my image.exr \n".to_vec(), points: Vec::new(), ..text_model() };
        assert_eq!(parse_text(&paths("txt"), &images).unwrap().images[0].name, "my image.exr");
    }

    proptest! {
        #[test]
        fn random_text_does_not_panic(cameras in "[0-9 .\n#A-Z_-]{0,200}", images in "[0-9 .\n#a-z-]{0,200}", points in "[0-9 .\n#-]{0,200}") {
            let _ = parse_text(&paths("txt"), &ColmapFiles { cameras: cameras.into(), images: images.into(), points: points.into() });
        }

        #[test]
        fn damaged_models_do_not_panic(at in 0usize..1000, byte: u8, file in 0usize..3) {
            let mut bytes = text_model();
            let target = [&mut bytes.cameras, &mut bytes.images, &mut bytes.points].into_iter().nth(file).unwrap();
            let at = at % target.len();
            target[at] = byte;
            let _ = parse_text(&paths("txt"), &bytes);
        }
    }
}

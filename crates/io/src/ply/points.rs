//! Point clouds: positions and, where there are any, display colours.

use std::io::BufRead;
use std::path::Path;

use luxel_core::text::plural;

use crate::IoError;
use crate::ply::header::{Element, Header, Kind, Scalar};
use crate::ply::rows::{check_count, read_rows, seek_element};
use crate::ply::source::PlySource;

/// Names under which colours are found.
const COLOR_NAMES: [[&str; 3]; 3] = [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];

/// World position, and display colour 0..=255 where the file has one.
pub type PlyPoint = ([f64; 3], Option<[u8; 3]>);

/// The points of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlyCloud {
    /// In the order of the file.
    pub points: Vec<PlyPoint>,
    /// Number of points that were left out, since they have no finite position.
    pub left_out: u64,
}

impl PlyCloud {
    /// Returns what a user should know about the points of the file at `path`.
    pub fn warning(&self, path: &Path) -> Option<String> {
        let left_out = plural(self.left_out as usize, "point");
        (self.left_out > 0).then(|| format!("{}: left out without a finite position: {left_out}", path.display()))
    }
}

/// Returns the world position and display colour 0..=255 of every vertex; colours of other types
/// (16 bits, or floats of 0 to 1) are brought to 8 bits. Vertices without a finite position are
/// left out and counted.
///
/// # Errors
/// A missing or damaged file, or no vertex with a finite position.
pub fn read_points_ply(path: &Path) -> Result<PlyCloud, IoError> {
    decode(PlySource::open(path)?)
}

/// Decodes a file's bytes as [`read_points_ply`] does; `name` is for errors.
///
/// # Errors
/// The same as [`read_points_ply`].
pub fn decode_points_ply(name: &Path, bytes: &[u8]) -> Result<PlyCloud, IoError> {
    decode(PlySource::from_bytes(name, bytes))
}

fn decode<R: BufRead>(mut source: PlySource<'_, R>) -> Result<PlyCloud, IoError> {
    let header = Header::read(&mut source)?;
    let element = seek_element(&mut source, &header, "vertex")?;
    let mut columns = Vec::new();
    for name in ["x", "y", "z"] {
        let missing = || source.invalid("header", format_args!("element \"vertex\" has no property {name:?}"));
        columns.push(element.position(name).ok_or_else(missing)?);
    }
    let factor = color_columns(element).map(|(at, factor)| {
        columns.extend(at);
        factor
    });
    let mut points = Vec::with_capacity(check_count(&source, element, header.format)?);
    let left_out = read_rows(&mut source, element, header.format, &columns, |_, row, position| {
        if let [_, _, _, ref color @ ..] = *row {
            let rgb8 = factor.and_then(|f| <[f32; 3]>::try_from(color).ok().map(|c| c.map(|v| (v * f).round().clamp(0.0, 255.0) as u8)));
            points.push((position, rgb8));
        }
        Ok(())
    })?;
    Ok(PlyCloud { points, left_out: left_out.of_rows(element.count)?.total() })
}

/// Returns the columns of red, green and blue, and the factor that brings their type to 0..=255.
fn color_columns(element: &Element) -> Option<([usize; 3], f32)> {
    COLOR_NAMES.iter().find_map(|names| {
        let [r, g, b] = names.map(|name| element.position(name));
        let at = [r?, g?, b?];
        let factor = match element.properties[at[0]].kind {
            Kind::Scalar(Scalar::F32 | Scalar::F64) => 255.0,
            Kind::Scalar(Scalar::U16) => 1.0 / 257.0,
            _ => 1.0,
        };
        Some((at, factor))
    })
}

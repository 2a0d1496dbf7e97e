//! The cameras of a data set in words: sizes, projections, focal lengths, fields of view, and what
//! is done about the lens.
//!
//! In: the frames of a data set, of whose images only headers are read. Out: a line for each kind
//! of camera, the most frequent first.

use std::path::Path;

use glam::{DAffine3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, text::plural};

use super::block::Block;
use super::source::SourceFrame;
use super::{LoadOptions, read_source};
use crate::IoError;
use crate::image::image_size;
use crate::lens::{PreparedLens, Warp};

/// Words about a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatasetDescription {
    /// Layout and program.
    pub format: String,
    /// A line for each kind of camera.
    pub cameras: Vec<String>,
    /// Lines about what else the files hold, such as rigs.
    pub notes: Vec<String>,
}

/// Describes the data set at `path` without decoding its images.
///
/// # Errors
/// The same as [`super::load_dataset`], but for what is within images.
pub fn describe_dataset(path: &Path, options: &LoadOptions) -> Result<DatasetDescription, IoError> {
    let block = Block::read(path)?;
    let mut source = read_source(&block.as_ref().map_or(Ok(path.to_owned()), |block| block.whole(path))?, options)?;
    if let Some(block) = block {
        source.frames.retain(|frame| block.views.contains(&frame.name));
        source.notes.push(format!("a block of {}", block.dataset_path(path).display()));
    }
    let mut groups: Vec<Group> = Vec::new();
    for frame in &source.frames {
        let Some(seen) = DescribedCamera::of_frame(frame)? else { continue };
        let found = groups.iter_mut().find(|group| group.size_px == seen.size_px && group.lens == seen.lens);
        match found {
            Some(group) => group.add(&seen),
            None => groups.push(Group::new(seen)),
        }
    }
    groups.sort_by_key(|group| std::cmp::Reverse(group.count));
    Ok(DatasetDescription { format: source.format, cameras: groups.iter().map(Group::line).collect(), notes: source.notes })
}

/// A frame's camera in words and numbers.
struct DescribedCamera {
    size_px: [u32; 2],
    lens: String,
    focal_px: f64,
    /// Field of view across and down, degrees.
    field: [f64; 2],
}

impl DescribedCamera {
    /// Returns the camera of the first image of a frame; `None` if it has none.
    fn of_frame(frame: &SourceFrame) -> Result<Option<Self>, IoError> {
        let captured = frame.recordings.first().map(|recording| &recording.image);
        let Some(image) = [Some(&frame.image), captured].into_iter().flatten().find(|path| path.is_file()) else { return Ok(None) };
        let stored = image_size(image)?;
        let turned = [stored[1], stored[0]];
        let size_px = if !frame.intrinsics.fits(stored) && frame.intrinsics.fits(turned) { turned } else { stored };
        let camera = frame.intrinsics.camera(DAffine3::IDENTITY, size_px).map_err(|e| frame.origin.error(e))?;
        let foreign = frame.intrinsics.foreign_lens;
        let prepared = foreign.map(|lens| lens.prepared());
        let lens = match foreign {
            Some(lens) => {
                let terms = terms(&lens.warp);
                format!("{} lens{terms}, resampled as {} when it is read", lens.base.name(), camera.projection.name())
            }
            None => native(&camera).to_owned(),
        };
        Ok(Some(Self { size_px, lens, focal_px: camera.focal_px.x, field: field(&camera, prepared.as_ref()) }))
    }
}

/// Describes a lens that a camera can have.
fn native(camera: &Camera) -> &'static str {
    match camera.projection {
        CameraProjection::Pinhole if camera.distortion.is_none() => "pinhole without distortion",
        CameraProjection::Pinhole if camera.distortion.p1 == 0.0 && camera.distortion.p2 == 0.0 => {
            "pinhole with radial distortion, which is removed when it is read"
        }
        CameraProjection::Pinhole => "pinhole with radial and tangential distortion, which is removed when it is read",
        CameraProjection::Fisheye(lens) if lens.coefficients == [0.0; 4] => "equidistant fisheye",
        CameraProjection::Fisheye(_) => "fisheye with radial coefficients",
        CameraProjection::Equirectangular => "equirectangular panorama",
    }
}

/// Returns the kinds of terms of a warp.
fn terms(warp: &Warp) -> String {
    let is_there = |values: &[f64]| values.iter().any(|v| *v != 0.0);
    let kinds = [
        (is_there(&warp.radial) || is_there(&warp.denominator), "radial"),
        (is_there(&warp.tangential), "tangential"),
        (is_there(&warp.prism), "prism"),
        (warp.shear != 0.0, "skew"),
    ];
    let names: Vec<&str> = kinds.iter().filter(|(is_there, _)| *is_there).map(|(_, name)| *name).collect();
    if names.is_empty() { String::new() } else { format!(" with {} distortion", names.join(", ")) }
}

/// Returns the field of view between the middles of the edges, degrees.
fn field(camera: &Camera, foreign: Option<&PreparedLens>) -> [f64; 2] {
    let [width, height] = camera.size_px.map(f64::from);
    let (x, y) = (camera.center_px.x, camera.center_px.y);
    if camera.projection == CameraProjection::Equirectangular && foreign.is_none() {
        return [width / camera.focal_px.x, height / camera.focal_px.y].map(f64::to_degrees);
    }
    let angle = |px: DVec2| {
        let place = (px - camera.center_px) / camera.focal_px;
        let direction = match foreign {
            Some(lens) => lens.direction(place * (lens.reach() / place.length()).min(1.0)),
            None => camera.unproject(px),
        };
        let widest = if let CameraProjection::Fisheye(lens) = camera.projection { lens.max_angle_rad } else { 0.0 };
        direction.map_or(widest, |direction: DVec3| direction.normalize().z.clamp(-1.0, 1.0).acos())
    };
    let across = angle(DVec2::new(0.0, y)) + angle(DVec2::new(width, y));
    let down = angle(DVec2::new(x, 0.0)) + angle(DVec2::new(x, height));
    [across.to_degrees(), down.to_degrees()]
}

/// Frames with equal words about their cameras.
struct Group {
    size_px: [u32; 2],
    lens: String,
    count: usize,
    focal_px: [f64; 2],
    field: [f64; 2],
}

impl Group {
    fn new(DescribedCamera { size_px, lens, focal_px, field }: DescribedCamera) -> Self {
        Self { size_px, lens, count: 1, focal_px: [focal_px; 2], field }
    }

    fn add(&mut self, seen: &DescribedCamera) {
        self.count += 1;
        self.focal_px = [self.focal_px[0].min(seen.focal_px), self.focal_px[1].max(seen.focal_px)];
    }

    fn line(&self) -> String {
        let ([w, h], [across, down], [short, long]) = (self.size_px, self.field, self.focal_px);
        let focal = if long - short < 0.05 { format!("{short:.1} px") } else { format!("{short:.1} to {long:.1} px") };
        let (images, lens) = (plural(self.count, "image"), &self.lens);
        format!("{images} of {w} x {h} pixels: {lens}; focal length {focal}, field of view {across:.0} x {down:.0} degrees")
    }
}

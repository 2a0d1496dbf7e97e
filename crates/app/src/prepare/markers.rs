//! Markers in the pictures that structure from motion saw: AprilTags, which give the scale.
//!
//! In: the pictures with COLMAP's cameras and poses. Out: [`MarkerFit`]. The library finds the
//! corners; lens distortion is taken out of them, and [`fit_markers`] measures. Degenerate:
//! pictures that cannot be read are errors; a set without markers is one that names what was looked
//! for.

use luxel::{Error, Result};
use luxel_capture::world::MarkerFit;
use luxel_core::Remedy;
use luxel_io::colmap::ColmapModel;

use super::folders::Folders;
use super::{Markers, PrepareOptions};

/// Refuses markers where they cannot be found.
pub(super) fn check(options: &PrepareOptions, is_panorama: bool) -> Result<()> {
    let refused = |message: &str| Err(Error::new(message).with_remedy(Remedy::leave_out("marker_size")));
    match options.markers {
        Some(_) if !cfg!(feature = "markers") => refused("this program was built without the feature markers, which finds them"),
        Some(_) if is_panorama => refused("markers are found in photographs, not in panoramas"),
        _ => Ok(()),
    }
}

#[cfg(not(feature = "markers"))]
pub(super) fn markers_of(_: &Folders, _: &ColmapModel, _: Markers) -> Result<MarkerFit> {
    Err(Error::new("this program was built without the feature markers"))
}

#[cfg(feature = "markers")]
pub(super) use found::markers_of;

#[cfg(feature = "markers")]
mod found {
    use apriltag::{DetectorBuilder, Family, Image};
    use glam::DVec2;
    use luxel_capture::world::{MarkerSighting, fit_markers};
    use luxel_io::colmap::ColmapImage;
    use luxel_io::{ReadOptions, Transfer, read_image};
    use rayon::prelude::*;

    use super::super::MarkerFamily;
    use super::super::dataset::undistorted;
    use super::*;
    use crate::text::plural;
    use luxel::error::Context;

    /// Number of wrong bits that are corrected.
    const CORRECTED_BITS: usize = 1;

    /// Finds and measures the markers in the pictures of a model.
    pub(in super::super) fn markers_of(folders: &Folders, model: &ColmapModel, markers: Markers) -> Result<MarkerFit> {
        let found: Vec<Vec<MarkerSighting>> =
            model.images.par_iter().map(|image| sightings(folders, image, markers.family)).collect::<Result<_>>()?;
        let views = found.iter().filter(|seen| !seen.is_empty()).count();
        fit_markers(&found.concat(), markers.edge_m).map_err(|reason| {
            let (seen, family) = (plural(views, "view"), name(markers.family));
            Error::new(format!("AprilTags of family {family}, seen in {seen} of {}: {reason}", model.images.len()))
                .with_remedy(Remedy::leave_out("marker_size"))
        })
    }

    fn name(family: MarkerFamily) -> &'static str {
        match family {
            MarkerFamily::Tag36h11 => "36h11",
            MarkerFamily::Tag25h9 => "25h9",
            MarkerFamily::Tag16h5 => "16h5",
        }
    }

    /// Returns the markers in a picture.
    fn sightings(folders: &Folders, image: &ColmapImage, family: MarkerFamily) -> Result<Vec<MarkerSighting>> {
        let camera = image.camera().map_err(|e| Error::new(format!("COLMAP's camera of {}: {e}", image.name)))?;
        let (eye, world_from_camera) = (camera.eye(), camera.camera_from_world.matrix3.transpose());
        let direction = |corner: [f64; 2]| {
            let on_plane = (DVec2::from_array(corner) - camera.center_px) / camera.focal_px;
            world_from_camera * undistorted(on_plane, &camera.distortion).extend(1.0).normalize()
        };
        let found = corners_in(&folders.output.join("proxies").join(&image.name), family)?;
        Ok(found.into_iter().map(|(id, corners)| MarkerSighting { id, eye, corners: corners.map(direction) }).collect())
    }

    /// Returns number and corners, pixels, of each marker in the picture of this file.
    fn corners_in(path: &std::path::Path, family: MarkerFamily) -> Result<Vec<(usize, [[f64; 2]; 4])>> {
        // The codes of the file, as they are.
        let options = ReadOptions { transfer: Some(Transfer::Linear), layer: None };
        let picture = read_image(path, &options)?.image;
        let failed = || format!("{}: markers cannot be looked for in it", path.display());
        let mut grey = Image::zeros_with_alignment(picture.width, picture.height, 1).with_context(failed)?;
        for (at, [r, g, b]) in picture.pixels.iter().enumerate() {
            grey[(at % picture.width, at / picture.width)] = (255.0 * (r + g + b) / 3.0).round() as u8;
        }
        let family = match family {
            MarkerFamily::Tag36h11 => Family::tag_36h11(),
            MarkerFamily::Tag25h9 => Family::tag_25h9(),
            MarkerFamily::Tag16h5 => Family::tag_16h5(),
        };
        let mut detector = DetectorBuilder::new().add_family_bits(family, CORRECTED_BITS).build().with_context(failed)?;
        Ok(detector.detect(&grey).iter().map(|found| (found.id(), found.corners())).collect())
    }
}

//! From COLMAP's model of cut-outs to one of panoramas.
//!
//! In: a model whose images are cut-outs. Out: the model of the panoramas they belong to, with a
//! whole panorama for each camera, and features in its pixels. Cut-outs that COLMAP posed one by
//! one are averaged ([`panorama_pose`]). Points that one panorama alone sees are left out: its
//! cut-outs have one place. Degenerate: a panorama of which no cut-out was found has no pose.

use std::collections::{BTreeMap, HashMap};

use glam::{DAffine3, DVec2};
use luxel::{Error, Result};
use luxel_capture::panorama::{CutoutPose, Face, panorama_pose};
use luxel_capture::prepare::ViewRecord;
use luxel_core::Camera;
use luxel_io::colmap::{ColmapImage, ColmapModel, ColmapPoint};

use super::dataset::{check_size, undistorted};
use super::folders::{Folders, proxy_name};
use super::pictures::cutout_name;
use crate::text::plural;

/// Angle between a panorama and one of its cut-outs from which the latter counts as wrong, degrees.
const WRONG_DEG: f64 = 2.0;

/// A model of panoramas.
pub(super) struct PanoramaModel {
    pub(super) model: ColmapModel,
    /// A line about cut-outs that do not fit, for people.
    pub(super) note: Option<String>,
}

/// A cut-out of the model.
struct Cutout<'a> {
    image: &'a ColmapImage,
    face: Face,
    /// Index of its panorama.
    view: usize,
    camera: Camera,
}

/// Returns the model of the panoramas.
pub(super) fn panorama_model(folders: &Folders, records: &[ViewRecord], model: &ColmapModel) -> Result<PanoramaModel> {
    let cutouts = cutouts(folders, records, model)?;
    let mut points_of = vec![0usize; cutouts.len()];
    for [image, _] in model.points.iter().flat_map(|point| &point.track) {
        points_of.get_mut(*image as usize).into_iter().for_each(|count| *count += 1);
    }
    let mut poses: BTreeMap<usize, Vec<CutoutPose>> = BTreeMap::new();
    for (cutout, points) in cutouts.iter().zip(&points_of).filter_map(|(cutout, points)| Some((cutout.as_ref()?, *points))) {
        let camera_from_world = cutout.image.camera_from_world;
        poses.entry(cutout.view).or_default().push(CutoutPose { face: cutout.face, camera_from_world, points });
    }
    let mut images = Vec::new();
    let mut place_of = HashMap::new();
    let mut wrong = Vec::new();
    for (view, poses) in &poses {
        let (Some(found), Some(record)) = (panorama_pose(poses), records.get(*view)) else { continue };
        if found.turn_deg > WRONG_DEG {
            wrong.push(record.name.as_str());
        }
        place_of.insert(*view, images.len());
        let size_px = record.size_px.map(|side| side as u32);
        images.push(ColmapImage::panorama(images.len() as u32 + 1, proxy_name(&record.name), found.camera_from_world, size_px));
    }
    let points = model.points.iter().filter_map(|point| moved_point(point, model, &cutouts, &place_of, &mut images)).collect();
    let note = wrong.first().map(|first| {
        format!(
            "{} ({first}{}) have cut-outs that were found more than {WRONG_DEG:.0} degrees beside the others, and count little",
            plural(wrong.len(), "panorama"),
            if wrong.len() > 1 { ", ..." } else { "" }
        )
    });
    Ok(PanoramaModel { model: ColmapModel { images, points, ..ColmapModel::default() }, note })
}

/// Returns the cut-out that each image of the model is, if it is one.
fn cutouts<'a>(folders: &Folders, records: &[ViewRecord], model: &'a ColmapModel) -> Result<Vec<Option<Cutout<'a>>>> {
    let mut by_name: HashMap<String, (usize, Face)> = HashMap::new();
    for (view, record) in records.iter().enumerate() {
        by_name.extend(Face::ALL.map(|face| (cutout_name(face, record.proxy_px[0], &record.name), (view, face))));
    }
    let cutout = |image: &'a ColmapImage| {
        let Some(&(view, face)) = by_name.get(&image.name) else { return Ok(None) };
        let camera = image.camera().map_err(|e| Error::new(format!("COLMAP's camera of {}: {e}", image.name)))?;
        if let Some(record) = records.get(view) {
            check_size(folders, &image.name, camera.size_px, record.proxy_px)?;
        }
        Ok(Some(Cutout { image, face, view, camera }))
    };
    model.images.iter().map(cutout).collect()
}

/// Returns a point with its track in panoramas, whose features are added to them; `None` if fewer
/// than two see it.
fn moved_point(
    point: &ColmapPoint,
    model: &ColmapModel,
    cutouts: &[Option<Cutout<'_>>],
    place_of: &HashMap<usize, usize>,
    images: &mut [ColmapImage],
) -> Option<ColmapPoint> {
    let mut seen: BTreeMap<usize, [f32; 2]> = BTreeMap::new();
    for [image, feature] in &point.track {
        let found = cutouts.get(*image as usize).and_then(Option::as_ref);
        let feature = model.images.get(*image as usize).and_then(|image| image.features_px.get(*feature as usize));
        let (Some(cutout), Some(feature)) = (found, feature) else { continue };
        let Some(&place) = place_of.get(&cutout.view) else { continue };
        // Neighbouring cut-outs overlap: the first one counts.
        if let Some(image) = images.get(place)
            && let Some(at) = panorama_px(cutout, *feature, image)
        {
            seen.entry(place).or_insert(at);
        }
    }
    if seen.len() < 2 {
        return None;
    }
    let mut track = Vec::with_capacity(seen.len());
    for (place, at) in seen {
        let image = images.get_mut(place)?;
        track.push([place as u32, image.features_px.len() as u32]);
        image.features_px.push(at);
    }
    Some(ColmapPoint { track, ..point.clone() })
}

/// Returns the place in a panorama of a feature of its cut-out.
fn panorama_px(cutout: &Cutout<'_>, [x, y]: [f32; 2], panorama: &ColmapImage) -> Option<[f32; 2]> {
    let lens = &cutout.camera;
    let straight = undistorted((DVec2::new(x.into(), y.into()) - lens.center_px) / lens.focal_px, &lens.distortion);
    let direction = cutout.face.panorama_from_cutout() * straight.extend(1.0);
    let camera = Camera { camera_from_world: DAffine3::IDENTITY, ..panorama.camera().ok()? };
    camera.project(direction).map(|(at, _)| at.as_vec2().to_array())
}

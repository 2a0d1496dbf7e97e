//! Observations follow their image through undistortion and reduction.

use std::collections::BTreeMap;

use glam::{DVec2, Vec2};
use luxel_core::{Camera, Distortion, Observation, OnDemand, Point, ReadError, Similarity, View, mask};

use super::source::{Sighting, SourcePoint};
use crate::lens::{PreparedLens, newton};

/// Residual on normalised coordinates: a thousandth of a pixel at a focal length of 10,000.
const TOLERANCE: f64 = 1e-7;

/// The view that receives a frame's observations.
pub(super) struct ObservedView<'a> {
    /// Index into the data set's training views.
    pub(super) index: u32,
    /// The camera of the image as it was read.
    pub(super) photographed: &'a Camera,
    /// Its lens, if no camera can have it.
    pub(super) foreign_lens: Option<PreparedLens>,
    /// The view.
    pub(super) view: &'a View,
}

/// Returns the points of the data set. `targets`: of each frame of the source; none for those that
/// are not trained on. Observations outside of their view or on a masked pixel are dropped: there
/// is no radiance to be read there.
/// Masks are looked at one after the other, so that those read on demand need not be in memory
/// together.
///
/// # Errors
/// A mask that cannot be read.
pub(super) fn map_points(
    points: Vec<SourcePoint>,
    targets: &[Vec<ObservedView<'_>>],
    local_from_world: &Similarity,
) -> Result<Vec<Point>, ReadError> {
    let map = |point: SourcePoint| {
        let observation = |target: &ObservedView<'_>, sighting: &Sighting| {
            let [w, h] = target.photographed.size_px.map(f64::from);
            let photographed_px = DVec2::new(f64::from(sighting.at[0]) * w, f64::from(sighting.at[1]) * h);
            let px = match target.foreign_lens {
                Some(lens) => map_lens_pixel(photographed_px, target.photographed, &lens, &target.view.camera)?,
                None => map_pixel(photographed_px, target.photographed, &target.view.camera)?,
            };
            let px = px.as_vec2();
            is_inside(&target.view.camera, px).then(|| Observation { view: target.index, pixel_px: px.to_array() })
        };
        let seen = |sighting: &Sighting| {
            let targets = targets.get(sighting.frame).map_or(&[][..], Vec::as_slice);
            targets.iter().filter_map(|target| observation(target, sighting)).collect::<Vec<_>>()
        };
        let observations = point.sightings.iter().flat_map(seen).collect();
        Point { position: local_from_world.point(point.position.into()).as_vec3().to_array(), rgb8: point.rgb8, observations }
    };
    let mut points: Vec<Point> = points.into_iter().map(map).collect();
    drop_masked(&mut points, targets)?;
    Ok(points)
}

fn is_inside(camera: &Camera, px: Vec2) -> bool {
    px.x >= 0.0 && px.y >= 0.0 && (px.x as u32) < camera.size_px[0] && (px.y as u32) < camera.size_px[1]
}

/// Drops observations on masked pixels.
fn drop_masked(points: &mut [Point], targets: &[Vec<ObservedView<'_>>]) -> Result<(), ReadError> {
    /// An observation: its point, and its place among the point's.
    type Place = [usize; 2];
    let masked = targets.iter().flatten().filter(|target| target.view.mask.is_some());
    let mut places: BTreeMap<u32, (&View, Vec<Place>)> = masked.map(|target| (target.index, (target.view, Vec::new()))).collect();
    for (i, point) in points.iter().enumerate() {
        for (k, observation) in point.observations.iter().enumerate() {
            if let Some((_, places)) = places.get_mut(&observation.view) {
                places.push([i, k]);
            }
        }
    }
    for (view, places) in places.into_values().filter(|(_, places)| !places.is_empty()) {
        let mask = view.mask.as_ref().map(OnDemand::loaded).transpose()?;
        for [i, k] in places {
            let [x, y] = points[i].observations[k].pixel_px.map(|at| at as usize);
            if !mask::is_valid(mask.as_deref(), y * view.camera.size_px[0] as usize + x) {
                points[i].observations[k].view = DROPPED;
            }
        }
    }
    points.iter_mut().for_each(|point| point.observations.retain(|observation| observation.view != DROPPED));
    Ok(())
}

/// Marks an observation that is to be dropped; no data set has that many views.
const DROPPED: u32 = u32::MAX;

/// Returns the pixel coordinates in the view of a pixel of the image as it was read.
fn map_pixel(px: DVec2, from: &Camera, to: &Camera) -> Option<DVec2> {
    let normalised = undistort((px - from.center_px) / from.focal_px, &from.distortion)?;
    Some(normalised * to.focal_px + to.center_px)
}

/// Returns the pixel coordinates in the view of a pixel of the image as it was read, through a lens
/// that no camera can have.
fn map_lens_pixel(px: DVec2, from: &Camera, lens: &PreparedLens, to: &Camera) -> Option<DVec2> {
    let direction = lens.direction((px - from.center_px) / from.focal_px)?;
    to.projection.plane_from_point(direction).map(|placed| placed.plane * to.focal_px + to.center_px)
}

/// Returns the undistorted normalised coordinates of distorted ones, by Newton's method; `None`
/// where it does not converge.
fn undistort(distorted: DVec2, lens: &Distortion) -> Option<DVec2> {
    if lens.is_none() {
        return distorted.is_finite().then_some(distorted);
    }
    newton::inverse(|p| lens.distort(p), distorted, distorted, TOLERANCE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn undistortion_inverts_distortion(
            x in -0.8f64..0.8, y in -0.6f64..0.6, k1 in -0.2f64..0.2, k2 in -0.05f64..0.05, p1 in -0.01f64..0.01, p2 in -0.01f64..0.01,
        ) {
            let (p, lens) = (DVec2::new(x, y), Distortion { k1, k2, p1, p2 });
            let found = undistort(lens.distort(p), &lens).unwrap();
            prop_assert!(found.distance(p) < 1e-5, "{found} {p}");
        }
    }

    #[test]
    fn lenses_that_fold_do_not_hang() {
        let lens = Distortion { k1: -5.0, k2: 0.0, p1: 0.0, p2: 0.0 };
        assert_eq!(undistort(DVec2::new(0.9, 0.0), &lens).filter(|p| !p.is_finite()), None);
        assert_eq!(undistort(DVec2::new(f64::NAN, 0.0), &lens), None);
    }
}

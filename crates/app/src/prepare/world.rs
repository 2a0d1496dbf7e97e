//! World coordinates of the data set: up is up, the origin where the cameras look, lengths in
//! metres where something says so.
//!
//! In: COLMAP's model and what the photographs' headers say about their place. Out: the model in
//! the new coordinates, and [`WorldReport`]. Degenerate: coordinates that are to be kept have no
//! report.

use std::collections::HashMap;

use glam::DVec3;
use luxel::{Error, Result};
use luxel_capture::prepare::{Photograph, Plan, PrepareNote, SetProjection, ViewRecord};
use luxel_capture::world::{GpsFit, KnownScale, MarkerFit, OriginSource, ScaleSource, UpSource, World, WorldView, find_world};
use luxel_core::Remedy;
use luxel_core::photo::Exif;
use luxel_io::colmap::ColmapModel;
use serde::Serialize;

use super::PrepareOptions;
use super::folders::{Folders, proxy_name};
use super::markers::markers_of;
use crate::text::plural;

/// Version of the way in which coordinates are found.
const WORLD_VERSION: &str = "2";
/// Views that see a point whose place is trusted.
const TRUSTED_TRACK: usize = 3;

/// The facts that photographs state about their place.
pub(super) struct FileFacts<'a> {
    by_view: HashMap<&'a str, Exif>,
    is_panorama: bool,
}

impl<'a> FileFacts<'a> {
    pub(super) fn new(plan: &'a Plan, photos: &[Photograph]) -> Self {
        let of_view = |frames: &[usize]| {
            let exifs = || frames.iter().filter_map(|i| photos.get(*i)).map(|photo| &photo.info.exif);
            Exif {
                orientation: exifs().find_map(|exif| exif.orientation),
                gps: exifs().find_map(|exif| exif.gps),
                pitch_deg: exifs().find_map(|exif| exif.pitch_deg),
                ..Exif::default()
            }
        };
        let by_view = plan.views.iter().map(|view| (view.name.as_str(), of_view(&view.frames))).collect();
        Self { by_view, is_panorama: plan.projection == SetProjection::Equirectangular }
    }

    /// Returns the facts about a view.
    pub(super) fn view(&self, view: &str) -> Exif {
        self.by_view.get(view).cloned().unwrap_or_default()
    }
}

/// The coordinates of a data set, and their sources.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorldReport {
    /// Rotation from COLMAP's coordinates, row by row: p' = scale rotation p + translation.
    pub rotation: [[f64; 3]; 3],
    /// Factor of COLMAP's lengths.
    pub scale: f64,
    /// Translation, in the new unit.
    pub translation: [f64; 3],
    /// Axis that is up.
    pub up_axis: &'static str,
    /// Source of the up direction.
    pub up_from: UpSource,
    /// Source of the origin.
    pub origin_from: OriginSource,
    /// Source of the scale.
    pub scale_from: String,
    /// Length of a unit, metres, if it is known.
    pub metres_per_unit: Option<f64>,
    /// Axis that is north, if it is known.
    pub north_axis: Option<&'static str>,
    /// Fit to GPS positions.
    pub gps: Option<GpsFit>,
    /// Why GPS positions are not used, where there are some.
    pub gps_unused: Option<String>,
    /// Fit to markers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub markers: Option<MarkerFit>,
}

impl WorldReport {
    fn new(world: &World) -> Self {
        let rotation = world.transform.rotation();
        Self {
            rotation: [0, 1, 2].map(|row| rotation.row(row).to_array()),
            scale: world.transform.scale(),
            translation: world.transform.translation().to_array(),
            up_axis: "-y",
            up_from: world.up,
            origin_from: world.origin,
            scale_from: match &world.scale {
                ScaleSource::Known(KnownScale::Distance(known)) => {
                    let [a, b] = &known.ends;
                    format!("the distance of {} m from {a} to {b}", known.metres)
                }
                ScaleSource::Known(KnownScale::Markers(fit)) => {
                    format!("{} with edges of {} m", plural(fit.markers, "marker"), fit.edge_m)
                }
                ScaleSource::Gps => "GPS positions".to_owned(),
                ScaleSource::Unknown => "unknown".to_owned(),
            },
            metres_per_unit: world.metres_per_unit(),
            north_axis: world.gps.map(|_| "+z"),
            gps: world.gps,
            gps_unused: world.gps_unused.clone(),
            markers: match world.scale {
                ScaleSource::Known(KnownScale::Markers(fit)) => Some(fit),
                _ => None,
            },
        }
    }

    /// Returns up, origin and scale in words for people.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![
            format!("up is -y, from {}", self.up_from.words()),
            format!("the origin is {}", self.origin_from.words()),
            match self.metres_per_unit {
                Some(_) => format!("lengths are in metres, from {}", self.scale_from),
                None => "the scale is unknown: lengths are in a unit of COLMAP's".to_owned(),
            },
        ];
        lines.extend(self.gps.map(|fit| {
            format!(
                "z is north; {} of {} GPS positions fit, {:.1} m off (median) over {:.1} m (root mean square from their middle), which gives \
                 {:.4} m in a unit of COLMAP's, standard error {:.1} %",
                fit.used,
                fit.views,
                fit.residual_m,
                fit.spread_m,
                fit.metres_per_unit,
                100.0 * fit.relative_error
            )
        }));
        lines.extend(self.markers.map(|fit| {
            let (metres, percent) = (fit.metres_per_unit, 100.0 * fit.deviation);
            format!("markers give {metres:.4} m in a unit of COLMAP's, their edges {percent:.1} % off (median)")
        }));
        lines.extend(self.gps_unused.as_ref().map(|reason| format!("GPS is not used: {reason}")));
        lines
    }
}

/// Returns the settings that coordinates depend on, for keys.
pub(super) fn settings(options: &PrepareOptions) -> String {
    let markers = options.markers.map(|markers| format!(" {markers:?}")).unwrap_or_default();
    format!("{WORLD_VERSION} {} {:?}{markers}", options.keep_coordinates, options.known_distance)
}

/// Moves a model to world coordinates. Returns `None` if its own are to be kept.
pub(super) fn place(
    model: &mut ColmapModel,
    records: &[ViewRecord],
    facts: &FileFacts<'_>,
    folders: &Folders,
    options: &PrepareOptions,
) -> Result<Option<WorldReport>> {
    if options.keep_coordinates {
        return Ok(None);
    }
    let by_name: HashMap<String, &ViewRecord> = records.iter().map(|record| (proxy_name(&record.name), record)).collect();
    let views: Vec<WorldView> = model
        .images
        .iter()
        .filter_map(|image| {
            let record = by_name.get(&image.name)?;
            let Exif { orientation, gps, pitch_deg, .. } = facts.view(&record.name);
            let (name, files) = (record.name.clone(), record.files.clone());
            let camera_from_world = image.camera_from_world;
            Some(WorldView { name, files, camera_from_world, orientation, pitch_deg, gps, is_panorama: facts.is_panorama })
        })
        .collect();
    let trusted: Vec<DVec3> = model.points.iter().filter(|p| p.track.len() >= TRUSTED_TRACK).map(|p| p.position).collect();
    let all = || model.points.iter().map(|p| p.position).collect();
    let points = if trusted.is_empty() { all() } else { trusted };
    let known = match options.markers {
        Some(markers) => Some(KnownScale::Markers(markers_of(folders, model, markers)?)),
        None => options.known_distance.clone().map(KnownScale::Distance),
    };
    let world = find_world(&views, &points, known.as_ref()).map_err(|error| {
        let remedy = Remedy::give("known_distance");
        Error::new(error.message).with_remedy(error.remedy.unwrap_or(remedy))
    })?;
    model.images.iter_mut().for_each(|image| world.transform.apply_to_pose(&mut image.camera_from_world));
    model.points.iter_mut().for_each(|point| point.position = world.transform.point(point.position));
    Ok(Some(WorldReport::new(&world)))
}

/// Returns the note on a scale that nothing gives.
pub(super) fn scale_note(world: &WorldReport) -> Option<PrepareNote> {
    let text = "the scale of the data set is unknown: no GPS positions fit, and no distance or size of markers is given";
    let remedy = || Remedy::give("known_distance").or(Remedy::give("marker_size"));
    world.metres_per_unit.is_none().then(|| PrepareNote::new(text).with_remedy(remedy()))
}

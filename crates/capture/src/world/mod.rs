//! World coordinates that make sense: up is up, the origin is where the cameras look, lengths are
//! in metres where something says so.
//!
//! In: cameras and points of a reconstruction, whose place, rotation and scale are arbitrary. Out:
//! [`World`]: a [`Similarity`] to x right, y down, z forward, as COLMAP's cameras and splat files
//! have their axes, with the source of each part. Up comes from the cameras, a floor, or GPS
//! ([`UpSource`]); the origin from the viewing rays ([`OriginSource`]); the scale from GPS or from
//! what the user knows ([`KnownScale`]), else it stays, and is stated to be unknown. With positions
//! by GPS z is north, else the heading stays.
//!
//! Degenerate: no camera changes nothing; one camera, cameras in a line and cameras that look one
//! way have the sources that are left.

mod choice;
mod directions;
mod distance;
mod downwards;
mod eigen;
mod floor;
mod gps;
mod markers;
mod origin;
#[cfg(test)]
mod tests;
mod up;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use luxel_core::Similarity;
use luxel_core::photo::GpsPosition;

pub use self::distance::{KnownDistance, Landmark};
pub(crate) use self::eigen::median;
pub use self::gps::{GpsFit, metres_of};
pub use self::markers::{MarkerFit, MarkerSighting, fit_markers};
pub use self::origin::OriginSource;
pub use self::up::UpSource;

use self::gps::Pair;
use self::up::{UpEstimate, up_of_cameras};
use crate::prepare::PrepareError;

/// A camera of a reconstruction with what its file says about its place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldView {
    /// Name of the view.
    pub name: String,
    /// Names of its files.
    pub files: Vec<String>,
    /// Pose, of the pixels as they are stored.
    pub camera_from_world: DAffine3,
    /// Orientation that Exif states, 1 to 8; 1 if none.
    pub orientation: Option<u16>,
    /// Angle of the viewing direction above the horizon, degrees, if the file states it.
    pub pitch_deg: Option<f64>,
    /// Position by GPS.
    pub gps: Option<GpsPosition>,
    /// Whether it is a panorama, which looks everywhere.
    pub is_panorama: bool,
}

/// Directions of a picture as it is looked at, in the world.
#[derive(Clone, Copy, Debug)]
struct ImageAxes {
    up: DVec3,
    right: DVec3,
}

impl WorldView {
    fn eye(&self) -> DVec3 {
        -(self.camera_from_world.matrix3.transpose() * self.camera_from_world.translation)
    }

    fn forward(&self) -> DVec3 {
        self.camera_from_world.matrix3.row(2)
    }

    /// Returns up in the camera's coordinates, of a picture as it is looked at.
    fn up_in_camera(&self) -> DVec3 {
        match self.orientation {
            Some(3 | 4) => DVec3::Y,
            Some(5 | 6) => DVec3::NEG_X,
            Some(7 | 8) => DVec3::X,
            _ => DVec3::NEG_Y,
        }
    }

    fn axes(&self) -> ImageAxes {
        let up = self.up_in_camera();
        let world_from_camera = self.camera_from_world.matrix3.transpose();
        ImageAxes { up: world_from_camera * up, right: world_from_camera * DVec3::Z.cross(up) }
    }

    /// Returns the vertical in the world that the stated pitch implies, for a camera without roll.
    fn stated_up(&self) -> Option<DVec3> {
        let (sin, cos) = self.pitch_deg.filter(|p| p.abs() <= 90.0)?.to_radians().sin_cos();
        Some(self.camera_from_world.matrix3.transpose() * (self.up_in_camera() * cos + DVec3::Z * sin))
    }
}

/// A length that the user knows.
#[derive(Clone, Debug, PartialEq)]
pub enum KnownScale {
    /// A distance.
    Distance(KnownDistance),
    /// The size of markers, measured in the reconstruction.
    Markers(MarkerFit),
}

/// The source of the scale.
#[derive(Clone, Debug, PartialEq)]
pub enum ScaleSource {
    /// A length that the user knows.
    Known(KnownScale),
    /// Positions by GPS.
    Gps,
    /// Nothing: lengths are those of the reconstruction.
    Unknown,
}

/// Coordinates of a world.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// From the reconstruction's coordinates to these.
    pub transform: Similarity,
    /// Source of the up direction, which is -y.
    pub up: UpSource,
    /// Source of the origin.
    pub origin: OriginSource,
    /// Source of the scale.
    pub scale: ScaleSource,
    /// Fit to positions by GPS.
    pub gps: Option<GpsFit>,
    /// Why positions by GPS are not used, if views have some.
    pub gps_unused: Option<String>,
}

impl World {
    /// Returns the length of a unit of the coordinates, metres; `None` if it is unknown.
    pub fn metres_per_unit(&self) -> Option<f64> {
        (self.scale != ScaleSource::Unknown).then_some(1.0)
    }
}

/// Largest angle between the up direction by cameras and that by GPS, as a cosine: 20 degrees.
const GPS_AGREEMENT: f64 = 0.94;

/// Finds world coordinates for a reconstruction.
///
/// ```
/// use luxel_capture::world::{ScaleSource, UpSource, WorldView, find_world};
///
/// let world = find_world(&[WorldView::default()], &[], None)?;
/// assert_eq!((world.up, world.scale), (UpSource::ImageUp, ScaleSource::Unknown));
/// # Ok::<(), luxel_capture::prepare::PrepareError>(())
/// ```
///
/// # Errors
/// A known distance whose ends have no place or the same.
pub fn find_world(views: &[WorldView], points: &[DVec3], known: Option<&KnownScale>) -> Result<World, PrepareError> {
    let eyes: Vec<DVec3> = views.iter().map(WorldView::eye).collect();
    let pairs = gps_pairs(views);
    let estimate = with_floor(with_gps(up_of_cameras(views, points), &pairs), points, &eyes);
    let focus = origin::focus(views, points);
    let rotation = DMat3::from_quat(DQuat::from_rotation_arc(estimate.up, DVec3::NEG_Y));
    let level = Similarity::new(rotation, 1.0, -(rotation * focus.point)).unwrap_or_default();
    let (mut transform, mut scale, mut gps, mut gps_unused) = (level, ScaleSource::Unknown, None, None);
    if !pairs.is_empty() {
        let level_pairs: Vec<Pair> = pairs.iter().map(|pair| Pair { world: level.point(pair.world), ..*pair }).collect();
        match gps::level_fit(&level_pairs) {
            Ok((fit, by_gps)) => {
                // The origin stays where the cameras look.
                let about_origin = Similarity::new(by_gps.rotation(), by_gps.scale(), DVec3::ZERO);
                transform = level.then(&about_origin.unwrap_or_default());
                (scale, gps) = (ScaleSource::Gps, Some(fit));
            }
            Err(reason) => gps_unused = Some(reason),
        }
    }
    if let Some(known) = known {
        let factor = match known {
            KnownScale::Distance(known) => known.metres_per_unit(views, |p| transform.point(p))?,
            KnownScale::Markers(fit) => fit.metres_per_unit / transform.scale(),
        };
        transform = transform.then(&Similarity::scaling(factor));
        scale = ScaleSource::Known(known.clone());
    }
    Ok(World { transform, up: estimate.source, origin: focus.source, scale, gps, gps_unused })
}

/// Returns places with positions, of the views that have one.
fn gps_pairs(views: &[WorldView]) -> Vec<Pair> {
    let with: Vec<(DVec3, GpsPosition)> = views.iter().filter_map(|view| Some((view.eye(), view.gps?))).collect();
    let metres = metres_of(&with.iter().map(|(_, gps)| *gps).collect::<Vec<_>>());
    with.iter().zip(metres).map(|((world, _), metres)| Pair { world: *world, metres }).collect()
}

/// Takes the up direction by GPS where cameras that look one way say little, or disagree with it.
fn with_gps(estimate: UpEstimate, pairs: &[Pair]) -> UpEstimate {
    if estimate.source == UpSource::StatedPitch {
        return estimate;
    }
    match gps::up_by_positions(pairs) {
        Some(up) if !matches!(estimate.source, UpSource::Rights | UpSource::Panoramas) || up.dot(estimate.up) < GPS_AGREEMENT => {
            UpEstimate { up, source: UpSource::Gps }
        }
        _ => estimate,
    }
}

/// Takes the floor's normal where there is a floor near level.
fn with_floor(estimate: UpEstimate, points: &[DVec3], eyes: &[DVec3]) -> UpEstimate {
    let max_tilt_deg: f64 = match estimate.source {
        UpSource::StatedPitch | UpSource::Unknown | UpSource::Floor => return estimate,
        UpSource::Rights | UpSource::Panoramas | UpSource::LookingDown | UpSource::Gps => 8.0,
        // Cameras that look one way may all look down.
        UpSource::ImageUp => 40.0,
    };
    match floor::floor_normal(points, eyes, estimate.up, max_tilt_deg.to_radians()) {
        Some(up) => UpEstimate { up, source: UpSource::Floor },
        None => estimate,
    }
}

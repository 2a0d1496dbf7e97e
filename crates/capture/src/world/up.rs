//! The direction that is up, from what cameras say about it.
//!
//! In: [`WorldView`]s. Out: a unit vector in the world's present coordinates with its source. A
//! photograph's right side is level however the camera is pitched, so up is the normal of the plane
//! of the rights, if cameras look in several directions. A pitch that files state (a drone's
//! gimbal) comes first. Panoramas are upright by themselves. All are robust: a view that disagrees
//! with the others loses its weight.
//!
//! Degenerate: cameras that all look the same way, or one camera: up is that of the images, unless
//! they look straight down, which their headings or places tell ([`super::downwards`]).

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::directions::{ROUNDS, USUAL_ROLL_RAD, robust_mean};
use super::downwards::down_of_cameras;
use super::eigen::{eigen3, median, outer};
use super::{ImageAxes, WorldView};

/// The origin of the up direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpSource {
    /// The camera's pitch that files state.
    StatedPitch,
    /// The mean of the panoramas' up directions.
    Panoramas,
    /// The normal of the plane of the images' right sides.
    Rights,
    /// The opposite of the viewing direction: all cameras look straight down.
    LookingDown,
    /// The mean of the images' up directions: cameras look one way.
    ImageUp,
    /// Positions by GPS in three dimensions.
    Gps,
    /// The floor that points show, near one of the former.
    Floor,
    /// There is no camera.
    Unknown,
}

impl UpSource {
    /// Returns the source in words for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::StatedPitch => "the pitch of the camera that files state",
            Self::Panoramas => "what is up in the panoramas",
            Self::LookingDown => "the cameras: all look straight down",
            Self::Rights => "the cameras: what is left and right in images is level",
            Self::ImageUp => "what is up in images, because cameras look one way",
            Self::Gps => "GPS positions in three dimensions",
            Self::Floor => "the floor that points show",
            Self::Unknown => "nothing: there is no camera",
        }
    }
}

/// An up direction with its source.
#[derive(Clone, Copy, Debug)]
pub(super) struct UpEstimate {
    /// Unit vector.
    pub(super) up: DVec3,
    pub(super) source: UpSource,
}

/// Share of the rights' spread in the second direction from which they span a plane: headings
/// within ten degrees.
const LEAST_SPREAD: f64 = 0.03;
/// Spread in the second direction over that in the third.
const LEAST_FLATNESS: f64 = 4.0;
/// Largest angle between the directions that files state, as a cosine: 10 degrees.
const STATED_AGREEMENT: f64 = 0.985;

/// Returns the up direction by the cameras alone.
pub(super) fn up_of_cameras(views: &[WorldView], points: &[DVec3]) -> UpEstimate {
    let axes: Vec<ImageAxes> = views.iter().map(WorldView::axes).collect();
    let ups: Vec<DVec3> = axes.iter().map(|axes| axes.up).collect();
    if let Some(up) = stated_up(views) {
        return UpEstimate { up, source: UpSource::StatedPitch };
    }
    let mean_up = robust_mean(&ups);
    if let Some(up) = mean_up.filter(|_| views.iter().all(|view| view.is_panorama)) {
        return UpEstimate { up, source: UpSource::Panoramas };
    }
    if let Some(normal) = normal_of_rights(&axes) {
        let sum: DVec3 = ups.iter().sum();
        let looking: DVec3 = views.iter().map(WorldView::forward).sum();
        // Cameras above a scene, with all headings, have no common up direction, but look down.
        let has_common_up = normal.dot(sum).abs() > 0.1 * ups.len() as f64;
        let is_up = if has_common_up { normal.dot(sum) > 0.0 } else { normal.dot(looking) < 0.0 };
        return UpEstimate { up: if is_up { normal } else { -normal }, source: UpSource::Rights };
    }
    if let Some(down) = down_of_cameras(views, &axes, points) {
        return UpEstimate { up: -down, source: UpSource::LookingDown };
    }
    match mean_up {
        Some(up) => UpEstimate { up, source: UpSource::ImageUp },
        None => UpEstimate { up: DVec3::NEG_Y, source: UpSource::Unknown },
    }
}

/// Returns the mean of the up directions that follow from stated pitches; `None` unless most views
/// state one and they agree.
fn stated_up(views: &[WorldView]) -> Option<DVec3> {
    let stated: Vec<DVec3> = views.iter().filter_map(WorldView::stated_up).collect();
    let mean = robust_mean(&stated).filter(|_| 2 * stated.len() > views.len())?;
    let agreeing = stated.iter().filter(|up| up.dot(mean) > STATED_AGREEMENT).count();
    (5 * agreeing >= 4 * stated.len()).then_some(mean)
}

/// Returns the normal of the plane that the rights lie in, of either sign; `None` if they do not
/// span one.
fn normal_of_rights(axes: &[ImageAxes]) -> Option<DVec3> {
    let mut normal: Option<DVec3> = None;
    for _ in 0..ROUNDS {
        let tilt = |axes: &ImageAxes| normal.map_or(0.0, |n| axes.right.dot(n).abs().min(1.0).asin());
        let usual = median(axes.iter().map(tilt)).max(USUAL_ROLL_RAD);
        let weight = |axes: &ImageAxes| 1.0 / (1.0 + (tilt(axes) / usual).powi(2));
        let total: f64 = axes.iter().map(weight).sum();
        let spread: DMat3 = axes.iter().map(|axes| outer(axes.right) * (weight(axes) / total)).fold(DMat3::ZERO, |a, b| a + b);
        let [_, (second, _), (third, vector)] = eigen3(&spread);
        if !(second >= LEAST_SPREAD && second >= LEAST_FLATNESS * third) {
            return None;
        }
        normal = Some(vector);
    }
    normal
}

//! The plan for a set of photographs, decided from their headers: cameras, exposures, brackets,
//! white balance.
//!
//! In: [`Photograph`]s and [`PlanOptions`]. Out: [`Plan`]: views with the indices of their frames,
//! and notes about what is odd. Degenerate: photographs of which none states its exposure are
//! treated as exposed alike; if only some do, that is an error.

use luxel_core::Remedy;
use luxel_core::photo::PhotoKind;
use luxel_core::text::plural;

use super::cameras::{PlannedCamera, balance, group_by_camera, note_cameras};
use super::notes::{note_brackets, note_corrections, note_gain_maps, note_primaries};
use super::options::{PlanOptions, WhiteBalance};
use super::photograph::view_name;
use super::projection::{SetProjection, choose_projection};
use super::{Photograph, PrepareError, PrepareNote, ResponseChoice};
use crate::{BracketRule, Exposure, Shot, find_brackets};

/// A view to be made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedView {
    /// Name of its files.
    pub name: String,
    /// Indices of photographs, shortest exposure first.
    pub frames: Vec<usize>,
    /// Index of its camera.
    pub camera: usize,
}

/// Every decision about a set of photographs.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Kind of all photographs.
    pub kind: PhotoKind,
    /// Projection of all photographs.
    pub projection: SetProjection,
    /// Views to be made.
    pub views: Vec<PlannedView>,
    /// Cameras, each with a lens of its own.
    pub cameras: Vec<PlannedCamera>,
    /// How brackets were found, in words for people.
    pub brackets: &'static str,
    /// Whether radiance is in cd/m2, as far as EXIF allows.
    pub is_absolute: bool,
    /// Remarks for the user.
    pub notes: Vec<PrepareNote>,
}

/// Refuses options that photographs of this kind have no use for.
///
/// # Errors
/// A list of exposures for radiance, a response curve for linear files, a white balance for files
/// that have theirs already.
pub fn check_options(options: &PlanOptions, photos: &[Photograph]) -> Result<(), PrepareError> {
    let kind = kind_of(photos);
    let refuse = |option, message: &str| Err(PrepareError::new(message).with_remedy(Remedy::leave_out(option)));
    if kind == PhotoKind::Radiance && options.has_exposure_list {
        return refuse(
            "exposures",
            "exposures are for photographs; OpenEXR, HDR and float TIFF files hold radiance, however they were exposed",
        );
    }
    if kind != PhotoKind::Developed && options.response != ResponseChoice::Auto {
        return refuse("response", "a response curve is for JPEG, PNG and integer TIFF files; RAW files and those of radiance are linear");
    }
    if kind != PhotoKind::Raw && options.white_balance != WhiteBalance::AsShot {
        return refuse("white_balance", "a white balance is for RAW files; developed pictures and radiance have theirs already");
    }
    Ok(())
}

/// Decides what is done with the photographs. Those without an exposure get one where that is
/// sound.
///
/// ```
/// use luxel_capture::prepare::{Photograph, PlanOptions, plan};
/// use luxel_capture::{BracketRule, Exposure};
/// use luxel_core::photo::{Exif, PhotoInfo, PhotoKind};
///
/// let mut photos: Vec<Photograph> = [0.01, 0.08]
///     .into_iter()
///     .zip(["desk_1", "desk_2"])
///     .map(|(seconds, stem)| Photograph {
///         path: format!("{stem}.jpg").into(),
///         stem: stem.into(),
///         digest: stem.into(),
///         info: PhotoInfo {
///             kind: PhotoKind::Developed,
///             size_px: [600, 400],
///             exif: Exif::default(),
///             raw: None,
///             profile: None,
///             primaries: None,
///             curve: None,
///             has_gain_map: false,
///         },
///         exposure: Some(Exposure { seconds, iso: Some(100.0), f_number: Some(8.0) }),
///     })
///     .collect();
/// let options = PlanOptions { brackets: BracketRule::Count(2), ..PlanOptions::default() };
/// let plan = plan(&mut photos, &options)?;
/// assert_eq!(plan.views.len(), 1);
/// assert_eq!(plan.views[0].frames, [0, 1]);
/// assert!(plan.is_absolute);
/// # Ok::<(), luxel_capture::prepare::PrepareError>(())
/// ```
///
/// # Errors
/// Exposures that only some photographs have, brackets that do not fit the rule, a white balance
/// that cannot be found, and panoramas that are not whole or among other photographs.
pub fn plan(photos: &mut [Photograph], options: &PlanOptions) -> Result<Plan, PrepareError> {
    let mut notes = Vec::new();
    let kind = kind_of(photos);
    let projection = choose_projection(photos, options.projection, &mut notes)?;
    let is_absolute = complete_exposures(kind, photos, options.brackets, &mut notes)?;
    let photos = &*photos;
    let (camera_of, mut cameras) = group_by_camera(photos);
    note_cameras(photos, &cameras, &mut notes);
    if kind == PhotoKind::Developed {
        note_primaries(photos, options.input_space, &mut notes);
        note_gain_maps(photos, &mut notes);
    }
    if kind == PhotoKind::Raw {
        balance(photos, &camera_of, &mut cameras, options, &mut notes)?;
    }
    let shots: Vec<Shot> = photos
        .iter()
        .zip(&camera_of)
        .map(|(photo, camera)| Shot {
            name: photo.stem.clone(),
            camera: *camera,
            time_s: photo.info.exif.time_s,
            stops: photo.exposure.filter(|_| kind != PhotoKind::Radiance).map(|e| e.stops()),
            seconds: photo.exposure.map(|e| e.seconds),
        })
        .collect();
    let found = find_brackets(&shots, options.brackets).map_err(|error| {
        let remedy = Remedy::set("brackets", "auto").or(Remedy::advice("leave the odd photographs out"));
        PrepareError::new(error).with_remedy(remedy)
    })?;
    note_brackets(photos, &found, &mut notes);
    let views = found
        .views
        .iter()
        .map(|frames| PlannedView {
            name: view_name(photos, frames),
            frames: frames.clone(),
            camera: frames.first().and_then(|i| camera_of.get(*i)).copied().unwrap_or(0),
        })
        .collect();
    note_corrections(photos, &mut notes);
    Ok(Plan { kind, projection, views, cameras, brackets: found.found_by, is_absolute, notes })
}

fn kind_of(photos: &[Photograph]) -> PhotoKind {
    photos.first().map_or(PhotoKind::Radiance, |p| p.info.kind)
}

/// Makes exposures comparable, or explains why they are not. Returns whether the scale is absolute.
fn complete_exposures(
    kind: PhotoKind,
    photos: &mut [Photograph],
    rule: BracketRule,
    notes: &mut Vec<PrepareNote>,
) -> Result<bool, PrepareError> {
    if kind == PhotoKind::Radiance {
        return Ok(false);
    }
    let without: Vec<String> = photos.iter().filter(|p| p.exposure.is_none()).map(Photograph::file_name).collect();
    if without.len() == photos.len() {
        if matches!(rule, BracketRule::Names | BracketRule::Count(_)) {
            let message = "no photograph has its exposure in EXIF, and brackets need it";
            return Err(PrepareError::new(message).with_remedy(Remedy::give("exposures")));
        }
        let text = "no photograph has its exposure in EXIF: all are treated as exposed alike, which may be wrong";
        notes.push(PrepareNote::new(text).with_remedy(Remedy::give("exposures")));
        for photo in photos.iter_mut() {
            photo.exposure = Some(Exposure { seconds: 1.0, iso: None, f_number: None });
        }
        return Ok(false);
    }
    let give_or_leave_out = || Remedy::give("exposures").or(Remedy::advice("leave these photographs out"));
    if !without.is_empty() {
        let (n, named) = (without.len(), without.iter().take(3).cloned().collect::<Vec<_>>().join(", "));
        let message = format!(
            "{} of {} have no exposure time in EXIF ({named}{})",
            n,
            plural(photos.len(), "photograph"),
            if n > 3 { ", ..." } else { "" }
        );
        return Err(PrepareError::new(message).with_remedy(give_or_leave_out()));
    }
    let mut is_absolute = true;
    for (what, has) in [
        ("ISO speed", photos.iter().map(|p| p.exposure.is_some_and(|e| e.iso.is_some())).collect::<Vec<_>>()),
        ("aperture", photos.iter().map(|p| p.exposure.is_some_and(|e| e.f_number.is_some())).collect()),
    ] {
        let without = has.iter().filter(|h| !**h).count();
        if without == has.len() {
            is_absolute = false;
            let text = format!("no photograph has its {what} in EXIF: all are assumed to have the same, and radiance is not in cd/m2");
            notes.push(PrepareNote::new(text));
        } else if without > 0 {
            let name = photos.iter().zip(&has).find(|(_, h)| !**h).map(|(p, _)| p.file_name()).unwrap_or_default();
            let message = format!("{without} of {} have no {what} in EXIF ({name})", plural(has.len(), "photograph"));
            return Err(PrepareError::new(message).with_remedy(give_or_leave_out()));
        }
    }
    Ok(is_absolute)
}

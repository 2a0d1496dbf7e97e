//! Warnings about a data set that can be read but looks wrong: one line for each kind, with the
//! first view that has it.
//!
//! In: the views with their files. Out: warnings for people. Nothing is changed.

use std::path::Path;

use glam::{DVec2, DVec3};
use luxel_core::photo::EQUAL_EXPOSURES_STOPS;
use luxel_core::{Camera, PixelValues, Point};

use super::LoadOptions;
use super::intrinsics::Focal;
use super::load::LoadedView;
use super::source::SourceFrame;
use crate::image::holds_radiance;

/// Horizontal fields of view of lenses, degrees: from a telescope's to beyond the widest lens
/// without distortion.
const FIELDS_OF_VIEW: std::ops::RangeInclusive<f64> = 0.2..=170.0;
/// Largest distance of a principal point from the middle, as a fraction of the side: more than
/// lenses shift.
const MAX_SHIFT: f64 = 0.4;
/// Distance of cameras, as a fraction of their distance from the origin, below which they are in
/// one place.
const ONE_PLACE: f64 = 1e-9;
/// Steps from the middle to the corner at which distortion is looked at.
const RADIAL_STEPS: u32 = 256;
/// Views that a warning lists.
const MAX_LISTED: usize = 3;

/// A view with the place that describes it.
#[derive(Clone, Copy)]
pub(super) struct CheckedView<'a> {
    pub(super) frame: &'a SourceFrame,
    pub(super) loaded: &'a LoadedView,
}

/// Returns a line for every kind of thing that looks wrong. `folder` is the scene's.
pub(super) fn warnings(folder: &Path, views: &[CheckedView<'_>], points: &[Point]) -> Vec<String> {
    let mut out = Vec::new();
    out.extend(absurd_focal_length(views));
    out.extend(absurd_center(views));
    out.extend(folding_distortion(views));
    out.extend(one_place(views));
    out.extend(listed(folder, views, |v| v.loaded.is_black, "black: a lens cap, or a render that failed; remove it, or mask it"));
    out.extend(listed(
        folder,
        views,
        |v| v.loaded.has_no_pixels,
        "without a single usable pixel: all of them are negative, NaN or infinite",
    ));
    out.extend(masks(views));
    out.extend(unequal_exposures(views));
    if points.len() == 1 {
        out.push("a single point: it says little about where the scene is; training starts from the cameras".to_owned());
    }
    out
}

/// Says that a curve was given that no image has a use for.
pub(super) fn idle_transfer(views: &[CheckedView<'_>], options: &LoadOptions) -> Option<String> {
    let transfer = options.transfer.filter(|transfer| transfer.plate_primaries().is_none())?;
    let is_idle = views.iter().all(|view| holds_radiance(&view.frame.image));
    is_idle.then(|| format!("the transfer curve {transfer} has no effect: all images hold floats, which are light already"))
}

/// Says what the masks of files hide.
fn masks(views: &[CheckedView<'_>]) -> Option<String> {
    let hidden: Vec<f64> = views.iter().filter_map(|v| v.loaded.hidden_by_mask).collect();
    let first = views.iter().find(|v| v.loaded.hidden_by_mask.is_some())?;
    let place = match &first.frame.mask {
        Some(path) => path.parent().unwrap_or(path).display().to_string(),
        None => "their alpha channels".to_owned(),
    };
    let share = 100.0 * hidden.iter().sum::<f64>() / hidden.len() as f64;
    let whole = hidden.iter().filter(|share| **share > 0.999).count();
    let oddity = match whole {
        0 if share == 0.0 => "; masks that hide nothing are of no use: is black what should be left out?".to_owned(),
        0 => String::new(),
        whole => format!(
            "; {} all of theirs: is white what should be kept?",
            if whole == 1 { "1 of them hides".to_owned() } else { format!("{whole} of them hide") }
        ),
    };
    Some(format!("{} of {} views have masks, from {place}, which hide {share:.1} % of their pixels{oddity}", hidden.len(), views.len()))
}

/// Says that photographs were exposed differently, which nothing undoes.
fn unequal_exposures(views: &[CheckedView<'_>]) -> Option<String> {
    let mut exposures: Vec<f64> = views.iter().filter_map(|v| v.loaded.photo_exposure).collect();
    exposures.sort_by(f64::total_cmp);
    let (least, most) = (exposures.first()?, exposures.last()?);
    let stops = (most / least).log2();
    (stops > EQUAL_EXPOSURES_STOPS).then(|| {
        let count = exposures.len();
        format!(
            "the exposures of {count} photographs, by their EXIF, differ by up to {stops:.1} stops, and all are read as if exposed alike: \
             train with exposure compensation, or prepare the photographs, which divides by their exposures"
        )
    })
}

/// Lists the files of views that are `what`.
fn listed(folder: &Path, views: &[CheckedView<'_>], is_one: impl Fn(&CheckedView<'_>) -> bool, what: &str) -> Option<String> {
    let found: Vec<&CheckedView<'_>> = views.iter().filter(|v| is_one(v)).collect();
    let file = |v: &&CheckedView<'_>| v.frame.image.strip_prefix(folder).unwrap_or(&v.frame.image).display().to_string();
    let names: Vec<String> = found.iter().take(MAX_LISTED).map(file).collect();
    let more = if found.len() > MAX_LISTED { ", ..." } else { "" };
    let (names, kind) = (names.join(", "), if found.len() == 1 { "view is" } else { "views are" });
    (!found.is_empty()).then(|| format!("{} {kind} {what} ({names}{more})", found.len()))
}

/// Returns a line about the first of the views for which `fault` finds something.
fn first_of(views: &[CheckedView<'_>], fault: impl Fn(&CheckedView<'_>) -> Option<String>) -> Option<String> {
    let mut found = views.iter().filter_map(|v| Some((v, fault(v)?)));
    let (view, text) = found.next()?;
    let others = found.count();
    let origin = &view.frame.origin;
    let more =
        if others > 0 { format!("; {others} more {} like this", if others == 1 { "view is" } else { "views are" }) } else { String::new() };
    Some(format!("{}: {}: {text}{more}", origin.path.display(), origin.place))
}

fn absurd_focal_length(views: &[CheckedView<'_>]) -> Option<String> {
    first_of(views, |v| {
        let camera = &v.loaded.photographed;
        if !camera.projection.is_pinhole() {
            return None;
        }
        let [width, height] = camera.size_px;
        let field = (2.0 * (0.5 * f64::from(width) / camera.focal_px.x).atan()).to_degrees();
        let is_json = v.frame.origin.path.extension().is_some_and(|e| e == "json");
        let stated = match v.frame.intrinsics.focal {
            Focal::Angle { x: Some(x), .. } => format!("\"camera_angle_x\" is {x} radians"),
            Focal::Angle { x: None, y } => format!("\"camera_angle_y\" is {} radians", y.unwrap_or(f64::NAN)),
            Focal::Pixels(focal) if is_json => format!("\"fl_x\" is {} px", focal.x),
            Focal::Pixels(focal) => format!("the focal length is {} px", focal.x),
        };
        (!FIELDS_OF_VIEW.contains(&field)).then(|| {
            let (low, high) = (FIELDS_OF_VIEW.start(), FIELDS_OF_VIEW.end());
            let field = if field < 0.1 { format!("{field:.1e}") } else { format!("{field:.1}") };
            format!("{stated}: a field of view of {field} degrees for {width} x {height} pixels, expected {low} to {high}; check its unit")
        })
    })
}

fn absurd_center(views: &[CheckedView<'_>]) -> Option<String> {
    first_of(views, |v| {
        let Camera { center_px, size_px: [width, height], .. } = v.loaded.photographed;
        let size = DVec2::new(width.into(), height.into());
        let shift = ((center_px - 0.5 * size) / size).abs().max_element();
        (shift > MAX_SHIFT).then(|| {
            let (x, y) = (center_px.x, center_px.y);
            format!("the principal point is {x}, {y} px in an image of {width} x {height}, expected it near the middle; check its unit and the image")
        })
    })
}

/// A radius of the image at which points further out are imaged further in.
fn folding_distortion(views: &[CheckedView<'_>]) -> Option<String> {
    first_of(views, |v| {
        let camera = &v.loaded.photographed;
        let d = camera.distortion;
        let size = DVec2::new(camera.size_px[0].into(), camera.size_px[1].into());
        let corners = [DVec2::ZERO, DVec2::new(size.x, 0.0), DVec2::new(0.0, size.y), size];
        let reach = corners.map(|corner| ((corner - camera.center_px) / camera.focal_px).length()).into_iter().fold(0.0, f64::max);
        let distorted = |r: f64| r * (1.0 + r * r * (d.k1 + r * r * d.k2));
        let mut last = 0.0;
        for step in 1..=4 * RADIAL_STEPS {
            let r = reach * f64::from(step) / f64::from(RADIAL_STEPS);
            let now = distorted(r);
            if now <= last && last < reach {
                let (k1, k2, share) = (d.k1, d.k2, 100.0 * last / reach);
                return Some(format!(
                    "the lens distortion (k1 {k1}, k2 {k2}) folds back at {share:.0} % of the way to the corner: what lies further out is lost; check the model"
                ));
            }
            if now >= reach {
                return None;
            }
            last = now;
        }
        None
    })
}

/// Cameras that are all in one place see no distances.
fn one_place(views: &[CheckedView<'_>]) -> Option<String> {
    let eyes: Vec<DVec3> = views.iter().map(|v| v.loaded.photographed.eye()).collect();
    let (first, rest) = eyes.split_first()?;
    let is_here = |eye: &DVec3| eye.distance(*first) <= ONE_PLACE * first.length().max(eye.length());
    let is_radiance = views.iter().all(|v| v.loaded.view.values == PixelValues::Radiance);
    (is_radiance && !rest.is_empty() && rest.iter().all(is_here)).then(|| {
        format!("all {} cameras are in one place: images from there tell no distances, and other viewpoints will look wrong", eyes.len())
    })
}

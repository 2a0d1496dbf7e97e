//! The data set in COLMAP's layout: undistorted radiance in `images/`, cameras and points in
//! `sparse/0`.
//!
//! In: the model of the proxies, or of the panoramas that they are cut out of, and the radiance of
//! the views. Out: images without empty pixels (the focal length is raised until there are none),
//! the model as text with features moved accordingly, and [`Registration`]. Features that belong to
//! no point are left out. Radiance is resampled once, in linear light and full float; masks of
//! saturated pixels likewise, black wherever a saturated pixel has a part. Panoramas stay as they
//! are.
//!
//! A view's radiance is removed from `work` once its image is written; what remains there are views
//! without a pose.

use std::collections::HashMap;

use glam::DVec2;
use luxel::error::{Context, bail};
use luxel::{Error, Event, ItemKind, Observer, Result};
use luxel_capture::prepare::{RegisteredView, Registration, ViewRecord};
use luxel_core::{Camera, ColorSpace, Distortion, Remedy};
use luxel_io::colmap::{ColmapModel, ColmapPoint, MeasuredPoint, PosedImage, read_colmap_model, write_text};
use luxel_io::{ExrOptions, ExrSample, ReadOptions, Transfer, encode_png, pinhole_within, read_image, undistort_into, write_exr};

use super::colmap::LargestModel;
use super::folders::{Folders, proxy_name};
use crate::files::{remove_if_there, write_bytes};

/// Least share of valid pixels in a valid pixel of a resampled mask: all, but for rounding.
const MIN_VALID_SHARE: f32 = 0.999;

/// Colour space and unit of pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixels {
    pub(super) space: ColorSpace,
    /// Whether radiance is in cd/m2.
    pub(super) is_absolute: bool,
}

impl Pixels {
    /// Returns options of OpenEXR files: float, with space and unit.
    pub(super) fn exr_options(self) -> ExrOptions {
        let units = if self.is_absolute { "cd/m2 by EXIF and ISO 12232" } else { "of the capture" };
        let attributes = vec![("luxel:color_space".to_owned(), self.space.name().to_owned()), ("luxel:units".to_owned(), units.to_owned())];
        ExrOptions { sample: ExrSample::Float, color_space: self.space, attributes, ..ExrOptions::default() }
    }
}

/// A view with a pose.
struct Posed<'a> {
    record: &'a ViewRecord,
    /// Index in the model.
    index: usize,
    /// Camera of the proxy.
    seen: Camera,
    /// Camera of the full image, with its distortion.
    lens: Camera,
    /// Camera of the undistorted image; a panorama's own.
    pinhole: Camera,
}

/// Returns whether the data set's model is there, with every image that it names.
pub(super) fn is_complete(folders: &Folders) -> bool {
    let images = folders.output.join("images");
    let has_all = |model: ColmapModel| model.images.iter().all(|image| images.join(&image.name).is_file());
    read_colmap_model(&folders.output.join("sparse/0")).is_ok_and(has_all)
}

/// Writes images and model.
pub(super) fn write(
    folders: &Folders,
    records: &[ViewRecord],
    LargestModel { model, models }: &LargestModel,
    pixels: Pixels,
    observer: &dyn Observer,
) -> Result<Registration> {
    let posed = posed_views(folders, records, model)?;
    if posed.is_empty() {
        bail!("COLMAP's model has none of the views; remove {} and start again", folders.work.display());
    }
    let total = posed.len() as u32;
    observer.event(Event::StepsBegin { done: 0, total });
    for (done, view) in (1u32..).zip(&posed) {
        write_image(folders, view, pixels)?;
        write_mask(folders, view)?;
        observer.event(Event::Step { done });
        let name = view.record.name.clone();
        observer.event(Event::Item { kind: ItemKind::UndistortedImage, name, done, total });
    }
    observer.event(Event::StepsEnd);
    let errors = point_errors(&posed, model);
    let registration = registration(&posed, model, &errors, *models);
    write_model(folders, &posed, model, &errors)?;
    for view in &posed {
        // A file that is left over does no harm.
        let _ = std::fs::remove_file(folders.radiance(&view.record.name));
        let _ = std::fs::remove_file(folders.saturation(&view.record.name));
    }
    Ok(registration)
}

fn posed_views<'a>(folders: &Folders, records: &'a [ViewRecord], model: &ColmapModel) -> Result<Vec<Posed<'a>>> {
    let by_name: HashMap<String, &ViewRecord> = records.iter().map(|r| (proxy_name(&r.name), r)).collect();
    let mut pinholes: Vec<(Camera, Camera)> = Vec::new();
    let mut posed = Vec::new();
    for (index, image) in model.images.iter().enumerate() {
        let Some(record) = by_name.get(&image.name) else { continue };
        let seen = image.camera().map_err(|e| Error::new(format!("COLMAP's camera of {}: {e}", image.name)))?;
        let is_panorama = !seen.projection.is_pinhole();
        check_size(folders, &image.name, seen.size_px, if is_panorama { record.size_px } else { record.proxy_px })?;
        let factor = if is_panorama { 1.0 } else { record.proxy_reduction as f64 };
        let lens = Camera {
            focal_px: seen.focal_px * factor,
            center_px: seen.center_px * factor,
            size_px: record.size_px.map(|s| s as u32),
            ..seen.clone()
        };
        let is_same = |other: &Camera| {
            (other.focal_px, other.center_px, other.size_px, other.distortion)
                == (lens.focal_px, lens.center_px, lens.size_px, lens.distortion)
        };
        let within = match pinholes.iter().find(|(of, _)| is_same(of)) {
            _ if is_panorama => lens.clone(),
            Some((_, pinhole)) => pinhole.clone(),
            None => {
                let pinhole = pinhole_within(&lens).ok_or_else(|| no_pinhole(&image.name, &lens.distortion))?;
                pinholes.push((lens.clone(), pinhole.clone()));
                pinhole
            }
        };
        let pinhole = Camera { camera_from_world: lens.camera_from_world, ..within };
        posed.push(Posed { record, index, seen, lens, pinhole });
    }
    posed.sort_by(|a, b| a.record.name.cmp(&b.record.name));
    Ok(posed)
}

/// Refuses a model of pictures that differ in size from the proxies.
pub(super) fn check_size(folders: &Folders, name: &str, size_px: [u32; 2], expected: [usize; 2]) -> Result<()> {
    let ([width, height], expected) = (size_px, expected.map(|side| side as u32));
    if size_px != expected {
        bail!(
            "{}: {name} has {width} x {height} pixels in the model, expected {} x {} as in proxies/: the model is of other pictures; make \
             it from these, or remove it",
            folders.work.join("sparse").display(),
            expected[0],
            expected[1]
        );
    }
    Ok(())
}

/// Returns the error of a lens that no pinhole camera replaces.
fn no_pinhole(name: &str, lens: &Distortion) -> Error {
    let (k1, k2) = (lens.k1, lens.k2);
    let text = format!("the lens of {name} that COLMAP found (k1 {k1:.3}, k2 {k2:.3}) leaves no pinhole image: it needs a simpler model");
    Error::new(text).with_remedy(Remedy::set("camera_model", "simple-radial"))
}

fn write_image(folders: &Folders, view: &Posed<'_>, pixels: Pixels) -> Result<()> {
    let from = folders.radiance(&view.record.name);
    let decoded = read_image(&from, &ReadOptions::default())?;
    let size = [decoded.image.width, decoded.image.height];
    if size != view.record.size_px {
        bail!("{}: {} x {} pixels, expected {:?}; remove it and start again", from.display(), size[0], size[1], view.record.size_px);
    }
    // A lens without distortion changes nothing, to the bit.
    let is_straight = view.lens.distortion.is_none() && view.lens.focal_px == view.pinhole.focal_px;
    let image = if is_straight { decoded.image } else { undistort_into(&decoded.image, &view.lens, &view.pinhole).0 };
    let options = ExrOptions { camera: Some(view.pinhole.clone()), ..pixels.exr_options() };
    write_exr(&folders.image(&view.record.name), &image, &options)?;
    Ok(())
}

/// Writes `saturation/NAME.png` of a view that has saturated pixels.
fn write_mask(folders: &Folders, view: &Posed<'_>) -> Result<()> {
    let (from, to) = (folders.saturation(&view.record.name), folders.mask(&view.record.name));
    if !from.exists() {
        return remove_if_there(&to);
    }
    if !view.lens.projection.is_pinhole() {
        let mask = std::fs::read(&from).with_context(|| format!("{}: cannot read", from.display()))?;
        return write_bytes(&to, &mask);
    }
    let options = ReadOptions { transfer: Some(Transfer::Linear), layer: None };
    let (mask, _) = undistort_into(&read_image(&from, &options)?.image, &view.lens, &view.pinhole);
    let rgb8: Vec<u8> = mask.pixels.iter().flat_map(|[valid, ..]| [if *valid < MIN_VALID_SHARE { 0 } else { u8::MAX }; 3]).collect();
    write_bytes(&to, &encode_png(mask.width, mask.height, &rgb8)?)
}

/// Returns the reprojection error of each point in each view of its track, pixels of the proxies.
fn point_errors(posed: &[Posed<'_>], model: &ColmapModel) -> Vec<Vec<Option<f64>>> {
    let by_index: HashMap<usize, &Posed<'_>> = posed.iter().map(|view| (view.index, view)).collect();
    let error = |point: &ColmapPoint, [image, feature]: [u32; 2]| {
        let view = by_index.get(&(image as usize))?;
        let [x, y] = *model.images.get(image as usize)?.features_px.get(feature as usize)?;
        let p = view.seen.camera_from_world.transform_point3(point.position);
        if !view.seen.projection.is_pinhole() {
            // Pixels of the panorama's middle: towards the poles its own are smaller.
            let seen = view.seen.unproject(DVec2::new(x.into(), y.into()))?;
            return Some(seen.angle_between(p) * view.seen.focal_px.x);
        }
        let straight = (p.z > 0.0).then(|| DVec2::new(p.x / p.z, p.y / p.z))?;
        let at = view.seen.distortion.distort(straight) * view.seen.focal_px + view.seen.center_px;
        Some(at.distance(DVec2::new(f64::from(x), f64::from(y))))
    };
    model.points.iter().map(|point| point.track.iter().map(|seen| error(point, *seen)).collect()).collect()
}

fn registration(posed: &[Posed<'_>], model: &ColmapModel, errors: &[Vec<Option<f64>>], models: usize) -> Registration {
    let mut sums: HashMap<usize, (usize, f64)> = HashMap::new();
    for (point, errors) in model.points.iter().zip(errors) {
        for ([image, _], error) in point.track.iter().zip(errors).filter_map(|(seen, error)| Some((seen, (*error)?))) {
            let sum = sums.entry(*image as usize).or_default();
            *sum = (sum.0 + 1, sum.1 + error);
        }
    }
    let views = posed.iter().map(|view| {
        let (points, sum) = sums.get(&view.index).copied().unwrap_or_default();
        let registered = RegisteredView {
            points,
            error_px: sum / points.max(1) as f64,
            focal_px: view.pinhole.focal_px.x,
            kept: view.lens.focal_px.x / view.pinhole.focal_px.x,
        };
        (view.record.name.clone(), registered)
    });
    let (sightings, total) = sums.values().fold((0, 0.0), |(n, sum), (m, error)| (n + m, sum + error));
    Registration {
        views: views.collect(),
        points: model.points.len(),
        mean_error_px: total / sightings.max(1) as f64,
        mean_track: sightings as f64 / model.points.len().max(1) as f64,
        models,
    }
}

fn write_model(folders: &Folders, posed: &[Posed<'_>], model: &ColmapModel, errors: &[Vec<Option<f64>>]) -> Result<()> {
    let to_image = |view: &Posed<'_>| {
        let name = format!("{}.exr", view.record.name);
        PosedImage { name, camera: view.pinhole.clone(), features_px: Vec::new() }
    };
    let mut images: Vec<PosedImage> = posed.iter().map(to_image).collect();
    let place: HashMap<usize, usize> = posed.iter().enumerate().map(|(at, view)| (view.index, at)).collect();
    let mut points = Vec::new();
    for (point, errors) in model.points.iter().zip(errors) {
        let mut track = Vec::new();
        for [image, feature] in &point.track {
            let (Some(&at), Some(from)) = (place.get(&(*image as usize)), model.images.get(*image as usize)) else { continue };
            let (Some(view), Some(&[x, y])) = (posed.get(at), from.features_px.get(*feature as usize)) else { continue };
            let straight = undistorted((DVec2::new(x.into(), y.into()) - view.seen.center_px) / view.seen.focal_px, &view.lens.distortion);
            let moved = straight * view.pinhole.focal_px + view.pinhole.center_px;
            let [width, height] = view.pinhole.size_px.map(f64::from);
            // Features in the part that undistortion cut off are lost.
            if let Some(image) = images.get_mut(at).filter(|_| moved.x >= 0.0 && moved.y >= 0.0 && moved.x < width && moved.y < height) {
                track.push([at as u32, image.features_px.len() as u32]);
                image.features_px.push(moved.as_vec2().to_array());
            }
        }
        let known: Vec<f64> = errors.iter().flatten().copied().collect();
        if track.len() > 1 {
            let error = known.iter().sum::<f64>() / known.len().max(1) as f64;
            points.push(MeasuredPoint { point: ColmapPoint { track, ..point.clone() }, error_px: error });
        }
    }
    write_text(&folders.output.join("sparse/0"), &images, &points)?;
    Ok(())
}

/// Returns coordinates without distortion, by fixed-point iteration. It converges within the part
/// of the lens that does not fold.
pub(super) fn undistorted(distorted: DVec2, lens: &Distortion) -> DVec2 {
    let mut p = distorted;
    for _ in 0..40 {
        let step = lens.distort(p) - distorted;
        p -= step;
        if step.length_squared() < 1e-24 {
            break;
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distortion_is_undone() {
        let lens = Distortion { k1: -0.15, k2: 0.03, p1: 0.002, p2: -0.001 };
        for p in [DVec2::new(0.4, -0.3), DVec2::ZERO, DVec2::new(-0.6, 0.45)] {
            assert!(undistorted(lens.distort(p), &lens).distance(p) < 1e-10, "{p}");
        }
    }
}

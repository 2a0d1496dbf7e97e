//! Cameras of an OpenUSD layer, text or binary, beside a folder of images.
//!
//! An image belongs to a camera by its name: a camera without samples over time has the image of
//! its name (`images/left.exr` of `/Rig/left`; characters that prims cannot have count as `_`), a
//! camera over time has the images whose number is a time code within its samples
//! (`images/shot.1001.exr`), in a folder of the camera's name or under a name that begins with it
//! where there are several. Where no name fits and there are as many images as cameras, or as
//! samples, they are taken in order, with a warning. Lengths stay in the stage's units, axes are
//! the stage's. Pixels are square: the horizontal aperture counts.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::IoError;
use crate::dataset::Supervision;
use crate::dataset::files::{list_images, without_extension};
use crate::dataset::posed::{CameraFile, PosedCamera, PosedLens, WidthLens, from_opengl, rigid};
use crate::dataset::source::DatasetSource;
use crate::image::image_size;
use crate::read_file::open_regular;
use crate::usd::{BINARY_MAGIC, PACKAGE_MAGIC, UsdCamera, UsdCameras, read_cameras};

/// Extensions of layers.
pub(in crate::dataset) const EXTENSIONS: [&str; 4] = ["usda", "usd", "usdc", "usdz"];
/// Folders of images, in the order they are looked in.
const IMAGE_FOLDERS: [&str; 3] = ["images", "input", "plates"];
/// Difference of two shapes, of the aperture and of the image, that is rounding.
const ROUNDING: f64 = 0.01;
/// Names that a message lists.
const MAX_LISTED: usize = 3;

/// Returns whether a file of OpenUSD has a camera: of text, by a search for its definition.
pub(in crate::dataset) fn has_camera(path: &Path) -> bool {
    let Ok((file, _)) = open_regular(path) else { return false };
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let Ok(head) = reader.fill_buf() else { return false };
    if head.starts_with(BINARY_MAGIC) || head.starts_with(PACKAGE_MAGIC) {
        return read_cameras(path).is_ok_and(|cameras| !cameras.is_empty());
    }
    let mut first = [0u8; 5];
    if reader.read_exact(&mut first).is_err() || &first != b"#usda" {
        return false;
    }
    let wanted = b"def Camera ";
    // What is kept of a block so that a definition across two is found.
    let mut end: Vec<u8> = Vec::new();
    loop {
        let Ok(block) = reader.fill_buf() else { return false };
        if block.is_empty() {
            return false;
        }
        end.extend_from_slice(block);
        let read = block.len();
        if end.windows(wanted.len()).any(|window| window == wanted) {
            return true;
        }
        end.drain(..end.len().saturating_sub(wanted.len()));
        reader.consume(read);
    }
}

/// Returns the layers of a folder that have cameras.
pub(in crate::dataset) fn layers(folder: &Path) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_layer = |path: &PathBuf| path.extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)));
    let mut found: Vec<PathBuf> = paths.filter(|path| is_layer(path) && has_camera(path)).collect();
    found.sort();
    found
}

/// Reads the layer and finds the images.
pub(in crate::dataset) fn usd_source(path: &Path, supervision: Supervision) -> Result<DatasetSource, IoError> {
    let found = if path.is_file() { vec![path.to_path_buf()] } else { layers(path) };
    let file = match found.as_slice() {
        [one] => one,
        [] => return Err(IoError::invalid(path, "no OpenUSD layer (.usda, .usdc, .usdz, .usd) with a camera, expected one")),
        several => return Err(crate::dataset::candidates::several(path, "OpenUSD layers with cameras", several)),
    };
    let folder = file.parent().unwrap_or(file);
    let layer = read_cameras(file)?;
    if layer.is_empty() {
        let remedy = "flatten the stage with `usdcat --flatten -o cameras.usda` if they are in other layers";
        return Err(IoError::invalid(file, format!("no prim of type Camera, expected one; {remedy}")));
    }
    let images = images(folder)?;
    let mut warnings = Vec::new();
    let placed = assigned(file, &layer, &images, &mut warnings)?;
    let mut cameras = Vec::with_capacity(placed.len());
    let mut aspects: Option<String> = None;
    for ImageCamera { image, camera, time } in placed {
        let at = time.map_or_else(String::new, |time| format!(" at time {time}"));
        let place = format!("camera {}{at}", camera.path);
        let wrong = |message: String| IoError::invalid(file, format!("{place}: {message}"));
        let found = camera.at(time).map_err(wrong)?;
        let pose = rigid(from_opengl(found.axes), found.eye).map_err(wrong)?;
        let lens = PosedLens::Width(WidthLens { focal: found.focal, shift: found.shift });
        if aspects.is_none()
            && let Some(aspect) = found.aspect
        {
            let [w, h] = image_size(&image_path(folder, image))?.map(f64::from);
            aspects = ((aspect / (w / h) - 1.0).abs() > ROUNDING).then(|| {
                format!("{place}: its apertures have the shape {aspect:.3}, its image {:.3}: the horizontal aperture counts", w / h)
            });
        }
        cameras.push(PosedCamera { name: image.to_owned(), camera_from_world: pose, lens, place });
    }
    warnings.extend(aspects);
    let format = format!("USD cameras ({} up, {} m a unit)", layer.up_axis, layer.meters_per_unit);
    CameraFile { format, folder, path: file, supervision }.source(cameras, warnings)
}

/// Returns the file of a view's name.
fn image_path(folder: &Path, name: &str) -> PathBuf {
    crate::dataset::files::Finder::default()
        .find_image(folder, name, crate::dataset::files::Substitute::Allowed)
        .unwrap_or_else(|| folder.join(name))
}

/// Returns the names of the images below the folder, sorted, without extensions.
fn images(folder: &Path) -> Result<Vec<String>, IoError> {
    for sub in IMAGE_FOLDERS {
        let mut found = BTreeSet::new();
        list_images(&folder.join(sub), sub, &mut found);
        if !found.is_empty() {
            return Ok(found.into_iter().collect());
        }
    }
    let expected = IMAGE_FOLDERS.map(|sub| format!("{sub}/")).join(" or ");
    Err(IoError::invalid(folder, format!("no images beside the cameras, expected them in {expected}")))
}

/// An image with its camera.
struct ImageCamera<'a> {
    /// Path below the scene's folder, without extension.
    image: &'a str,
    camera: &'a UsdCamera,
    time: Option<f64>,
}

/// Finds the camera of each image.
fn assigned<'a>(
    file: &Path,
    layer: &'a UsdCameras,
    images: &'a [String],
    warnings: &mut Vec<String>,
) -> Result<Vec<ImageCamera<'a>>, IoError> {
    let by_name: Vec<ImageCamera<'a>> = images.iter().filter_map(|image| placed(layer, image)).collect();
    if !by_name.is_empty() {
        return Ok(by_name);
    }
    let still = layer.cameras.iter().filter(|camera| camera.times().is_empty()).count();
    if still == layer.len() && layer.len() == images.len() {
        let mut sorted: Vec<&UsdCamera> = layer.cameras.iter().collect();
        sorted.sort_by(|a, b| a.path.cmp(&b.path));
        let all = images.iter().zip(sorted).map(|(image, camera)| ImageCamera { image, camera, time: None });
        warnings.push(in_order(images, &layer.cameras[0].path));
        return Ok(all.collect());
    }
    if let [camera] = layer.cameras.as_slice() {
        let times = camera.times();
        if times.len() == images.len() {
            warnings.push(in_order(images, &format!("{} at time {}", camera.path, times[0])));
            return Ok(images.iter().zip(times).map(|(image, time)| ImageCamera { image, camera, time: Some(time) }).collect());
        }
    }
    let listed = |names: Vec<&str>| {
        let more = if names.len() > MAX_LISTED { ", ..." } else { "" };
        format!("{}{more}", names.iter().take(MAX_LISTED).copied().collect::<Vec<_>>().join(", "))
    };
    let names = listed(images.iter().map(String::as_str).collect());
    let cameras = listed(layer.cameras.iter().map(|camera| camera.path.as_str()).collect());
    let samples: usize = layer.cameras.iter().map(|camera| camera.times().len()).sum();
    Err(IoError::invalid(
        file,
        format!(
            "{} images ({names}), none named like a camera ({cameras}) or numbered like one of {samples} time samples; name them so, such as images/{}.0001.exr",
            images.len(),
            layer.cameras.first().map_or("camera", UsdCamera::name)
        ),
    ))
}

fn in_order(images: &[String], first: &str) -> String {
    let image = images.first().map(String::as_str).unwrap_or_default();
    format!("no image is named or numbered like a camera: {} images are taken in order, {image} for {first} first", images.len())
}

/// Returns the camera that an image's name means.
fn placed<'a>(layer: &'a UsdCameras, image: &'a str) -> Option<ImageCamera<'a>> {
    let stem = image.rsplit('/').next().unwrap_or(image);
    let named = layer.cameras.iter().find(|camera| camera.times().is_empty() && is_name_of(camera, stem));
    if let Some(camera) = named {
        return Some(ImageCamera { image, camera, time: None });
    }
    let time = number(stem)?;
    let is_within = |camera: &&UsdCamera| {
        let times = camera.times();
        times.first().is_some_and(|first| *first <= time) && times.last().is_some_and(|last| time <= *last)
    };
    let moving: Vec<&UsdCamera> = layer.cameras.iter().filter(|camera| !camera.times().is_empty()).collect();
    let of_name = moving.iter().copied().find(|camera| {
        let folder = image.rsplit('/').nth(1);
        folder.is_some_and(|folder| is_name_of(camera, folder)) || stem.starts_with(camera.name())
    });
    let camera = of_name.or(if let [one] = moving.as_slice() { Some(*one) } else { None }).filter(is_within)?;
    Some(ImageCamera { image, camera, time: Some(time) })
}

/// Returns whether a prim may have been named after this: other characters become `_`, and a digit
/// at the beginning has one before it.
fn is_name_of(camera: &UsdCamera, name: &str) -> bool {
    let prim: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    camera.name() == prim || camera.name() == format!("_{prim}") || camera.name() == without_extension(name)
}

/// Returns the number at the end of a name.
fn number(stem: &str) -> Option<f64> {
    let digits = stem.len() - stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    stem.get(stem.len() - digits..)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_the_digits_at_the_end() {
        assert_eq!([number("shot.1001"), number("r_0012"), number("7"), number("left")], [Some(1001.0), Some(12.0), Some(7.0), None]);
    }
}

//! Data sets from memory: images, cameras and points of a program, without files.
//!
//! In: [`MemoryDataset`], world coordinates. Out: the data set that files of the same content make:
//! pixels that are not radiance are masked, lens distortion is removed, coordinates are local.
//! Degenerate: without a test view, none is held out.

use glam::DVec3;
use luxel_core::{
    BadPixels, Camera, ColorSpace, Dataset, Distortion, Image, Mask, PixelValues, Point, SceneBounds, Similarity, Target, View,
};

use super::fingerprint::Fingerprint;
use super::image_memory::readers_in_memory;
use super::load::{both, field_mask, mask_bad_pixels};
use super::{LoadOptions, split::Part};
use crate::IoError;
use crate::image::undistort;

/// Name of the data set in errors, in place of a path.
const NAME: &str = "data set in memory";

/// A posed image of radiance.
#[derive(Clone, Debug)]
pub struct MemoryView {
    /// Name, unique within the data set.
    pub name: String,
    /// Camera, world coordinates; may have lens distortion.
    pub camera: Camera,
    /// Radiance, of the camera's size.
    pub image: Image,
    /// Weights of the pixels, 0 to 1.
    pub mask: Option<Mask>,
    /// Whether the view is held out to measure with.
    pub is_test: bool,
}

/// A 3D point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MemoryPoint {
    /// Position, world coordinates.
    pub position: [f64; 3],
    /// Display colour, 0 to 255.
    pub rgb8: Option<[u8; 3]>,
}

/// The parts of a data set.
#[derive(Clone, Debug, Default)]
pub struct MemoryDataset {
    /// Posed images, in any order.
    pub views: Vec<MemoryView>,
    /// Points from structure from motion; may be empty.
    pub points: Vec<MemoryPoint>,
    /// Colour space of all images.
    pub color_space: ColorSpace,
}

/// Makes a data set of images in memory.
///
/// ```
/// use luxel_core::Image;
/// use luxel_core::synthetic::room_camera;
/// use luxel_io::{MemoryDataset, MemoryView, dataset_in_memory};
///
/// let view = |name: &str| MemoryView {
///     name: name.into(),
///     camera: room_camera([4, 3]),
///     image: Image::filled(4, 3, [0.5; 3]),
///     mask: None,
///     is_test: name == "b",
/// };
/// let parts = MemoryDataset { views: vec![view("a"), view("b")], ..MemoryDataset::default() };
/// let dataset = dataset_in_memory(parts)?;
/// assert_eq!((dataset.train.len(), dataset.test.len()), (1, 1));
/// # Ok::<(), luxel_io::IoError>(())
/// ```
///
/// # Errors
/// No view to train on; names that are empty or not unique; a camera that cannot be used; an image
/// or a mask of another size than the camera's.
pub fn dataset_in_memory(parts: MemoryDataset) -> Result<Dataset, IoError> {
    let MemoryDataset { mut views, points, color_space } = parts;
    views.sort_by(|a, b| (a.is_test, &a.name).cmp(&(b.is_test, &b.name)));
    check(&views)?;
    if let Some(i) = points.iter().position(|point| !point.position.iter().all(|v| v.is_finite())) {
        return Err(IoError::invalid(NAME, format!("point {i} is not finite")));
    }
    let world_from_local = local_coordinates(&views, &points);
    let local_from_world = world_from_local.inverse();
    let mut fingerprint = Fingerprint::new(NAME, &LoadOptions::default());
    let (mut bad_pixels, mut test) = (Vec::new(), Vec::new());
    let mut train: Vec<View> = Vec::with_capacity(views.len());
    for given in views {
        let part = if given.is_test { Part::Test } else { Part::Train };
        fingerprint.text(if part == Part::Test { "test" } else { "train" });
        let digest = digest(&given);
        let (view, bad) = view_of(given, &local_from_world);
        fingerprint.view(&view, &digest);
        bad_pixels.extend(bad);
        if part == Part::Test { test.push(view) } else { train.push(view) }
    }
    let local = |point: &MemoryPoint| Point {
        position: local_from_world.point(point.position.into()).as_vec3().to_array(),
        rgb8: point.rgb8,
        observations: Vec::new(),
    };
    let points: Vec<Point> = points.iter().map(local).collect();
    fingerprint.points(&points);
    fingerprint.local_coordinates(&world_from_local);
    bad_pixels.sort_by(|a, b| a.name.cmp(&b.name));
    let no_test = "no test views: no image is held out to measure quality with".to_owned();
    let warnings = if test.is_empty() { vec![no_test] } else { Vec::new() };
    let (format, fingerprint) = (NAME.to_owned(), fingerprint.finish());
    let (metres_per_unit, is_developed, readers) = (None, false, readers_in_memory());
    Ok(Dataset {
        format,
        train,
        test,
        points,
        color_space,
        bad_pixels,
        fingerprint,
        warnings,
        world_from_local,
        metres_per_unit,
        is_developed,
        readers,
    })
}

/// Checks names, cameras and sizes.
fn check(views: &[MemoryView]) -> Result<(), IoError> {
    if !views.iter().any(|view| !view.is_test) {
        return Err(IoError::invalid(NAME, format!("no view to train on among {}, expected at least one", views.len())));
    }
    let mut names: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
    names.sort_unstable();
    if names.first().is_some_and(|name| name.is_empty()) {
        return Err(IoError::invalid(NAME, "a view has no name"));
    }
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(IoError::invalid(NAME, format!("two views are named {:?}, expected each name once", pair[0])));
    }
    for view in views {
        let invalid = |message: String| IoError::invalid(NAME, format!("view {}: {message}", view.name));
        view.camera.validate().map_err(|error| invalid(format!("camera: {error}")))?;
        let [width, height] = view.camera.size_px.map(|side| side as usize);
        let Image { width: w, height: h, pixels } = &view.image;
        if (*w, *h) != (width, height) || pixels.len() != width * height {
            return Err(invalid(format!("the image is {w} x {h}, the camera expects {width} x {height}")));
        }
        let Some(mask) = &view.mask else { continue };
        if mask.weights.len() != width * height {
            return Err(invalid(format!("the mask has {} pixels, the image {}", mask.weights.len(), width * height)));
        }
        mask.total().ok_or_else(|| invalid("the mask has a weight that is not a number from 0 to 1".to_owned()))?;
    }
    Ok(())
}

fn local_coordinates(views: &[MemoryView], points: &[MemoryPoint]) -> Similarity {
    let eyes: Vec<DVec3> = views.iter().map(|view| view.camera.eye()).collect();
    let points: Vec<DVec3> = points.iter().map(|point| point.position.into()).collect();
    SceneBounds::from_views(&eyes, &points).map_or(Similarity::IDENTITY, |bounds| bounds.world_from_local())
}

/// Returns the digest of a view's pixels and weights.
fn digest(view: &MemoryView) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(bytemuck::cast_slice(view.image.pixels.as_flattened()));
    if let Some(mask) = &view.mask {
        hasher.update(b"mask");
        hasher.update(bytemuck::cast_slice(&mask.weights));
    }
    hasher.finalize()
}

/// Returns the view in local coordinates, without lens distortion, and the pixels that were masked.
fn view_of(given: MemoryView, local_from_world: &Similarity) -> (View, Option<BadPixels>) {
    let MemoryView { name, mut camera, mut image, mask: weights, is_test: _ } = given;
    local_from_world.apply_to_camera(&mut camera);
    let (mut mask, bad) = mask_bad_pixels(&mut image, &name);
    for other in [weights, field_mask(&camera)].into_iter().flatten() {
        mask = Some(both(mask, other));
    }
    if !camera.distortion.is_none() {
        let (straight, seen, _) = undistort(&image, mask.as_ref(), &camera);
        (image, mask) = (straight, Some(seen));
        camera.distortion = Distortion::default();
    }
    let (values, target) = (PixelValues::Radiance, Target::default());
    let (mask, recordings) = (mask.map(Into::into), Vec::new());
    (View { name, camera, image: image.into(), values, noise: None, mask, recordings, target }, bad)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;
    use luxel_core::synthetic::room_camera;

    use super::*;

    fn view(name: &str, x: f64) -> MemoryView {
        let mut camera = room_camera([3, 2]);
        camera.camera_from_world = DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0));
        MemoryView { name: name.into(), camera, image: Image::filled(3, 2, [1.0; 3]), mask: None, is_test: false }
    }

    #[test]
    fn views_are_sorted_split_and_masked_as_those_of_files_are() {
        let mut views = vec![view("b", 1.0), view("a", 0.0), MemoryView { is_test: true, ..view("c", 2.0) }];
        views[0].image.pixels[4] = [f32::NAN, 0.0, 0.0];
        let points = vec![MemoryPoint { position: [0.0, 1.0, 5.0], rgb8: Some([1, 2, 3]) }];
        let dataset = dataset_in_memory(MemoryDataset { views: views.clone(), points, ..MemoryDataset::default() }).unwrap();
        assert_eq!(dataset.train.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!((dataset.test.len(), dataset.points.len(), dataset.bad_pixels[0].nan), (1, 1, 1));
        assert!(!dataset.train[1].is_valid(4) && dataset.train[1].is_valid(3));
        for view in dataset.train.iter().chain(&dataset.test) {
            assert_eq!(view.validate(), Ok(()));
        }
        let again = |views| dataset_in_memory(MemoryDataset { views, ..MemoryDataset::default() }).unwrap().fingerprint;
        let mut brighter = views.clone();
        brighter[1].image.pixels[0][2] = 1.5;
        assert_ne!(again(views.clone()), again(brighter));
        views.reverse();
        assert_eq!(again(views.clone()), again(views));
    }

    #[test]
    fn a_scene_far_from_the_origin_gets_coordinates_of_its_own() {
        let views = vec![view("a", 4e6), view("b", 4e6 + 2.0)];
        let dataset = dataset_in_memory(MemoryDataset { views, ..MemoryDataset::default() }).unwrap();
        let mut camera = dataset.train[1].camera.clone();
        assert!(camera.eye().length() < 10.0);
        dataset.world_from_local.apply_to_camera(&mut camera);
        assert!((camera.eye().x - (4e6 + 2.0)).abs() < 1e-6);
    }

    #[test]
    fn what_does_not_go_together_is_refused_by_name() {
        type Breakage = (fn(&mut [MemoryView]), &'static str);
        let broken: [Breakage; 6] = [
            (|v| v.iter_mut().for_each(|v| v.is_test = true), "no view to train on among 2"),
            (|v| v[1].name = "a".into(), "two views are named \"a\""),
            (|v| v[0].name.clear(), "a view has no name"),
            (|v| v[1].camera.focal_px.x = 0.0, "view b: camera: focal length 0"),
            (|v| v[0].image = Image::filled(2, 3, [0.0; 3]), "view a: the image is 2 x 3, the camera expects 3 x 2"),
            (|v| v[0].mask = Some(Mask { weights: vec![1.0; 5] }), "view a: the mask has 5 pixels, the image 6"),
        ];
        for (break_it, message) in broken {
            let mut views = vec![view("a", 0.0), view("b", 1.0)];
            break_it(&mut views);
            let error = dataset_in_memory(MemoryDataset { views, ..MemoryDataset::default() }).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}

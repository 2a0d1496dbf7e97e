//! A data set: posed images, their split, and the points found by structure from motion.

use std::borrow::Cow;
use std::sync::Arc;

use glam::DVec3;

use crate::{Camera, ColorSpace, Image, Mask, NoiseModel, OnDemand, PixelValues, ReadError, Similarity, Target, ViewError, mask};

/// A posed image.
#[derive(Clone, Debug)]
pub struct View {
    /// Name, unique within the data set: the image's path without its extension (`images/000`). The
    /// last part names outputs.
    pub name: String,
    /// Undistorted camera; its size is that of the image.
    pub camera: Camera,
    /// Radiance in the data set's units, or captured LDR values, as [`Self::values`] tells; invalid
    /// pixels are 0.
    pub image: OnDemand<Image>,
    /// The meaning of the pixel values.
    pub values: PixelValues,
    /// Noise of the radiance, if the data set states it.
    pub noise: Option<NoiseModel>,
    /// Mask; `None` if all pixels count fully.
    pub mask: Option<OnDemand<Mask>>,
    /// Captured LDR images of the same pose and size, beside radiance; empty unless they are read
    /// with it.
    pub recordings: Vec<Self>,
    /// The comparison of renders with the image in training; readers leave the default.
    pub target: Target,
}

impl View {
    /// Returns a view of radiance all of whose pixels count fully.
    pub fn of_radiance(name: impl Into<String>, camera: Camera, image: Image) -> Self {
        Self {
            name: name.into(),
            camera,
            image: image.into(),
            values: PixelValues::Radiance,
            noise: None,
            mask: None,
            recordings: Vec::new(),
            target: Target::default(),
        }
    }

    /// Returns the last part of the name: `000` for `images/000`.
    pub fn stem(&self) -> &str {
        self.name.rsplit('/').next().unwrap_or(&self.name)
    }

    /// Returns whether pixel `i` (row-major) takes part in loss and metrics.
    pub fn is_valid(&self, i: usize) -> bool {
        mask::is_valid(self.mask.as_deref(), i)
    }

    /// Returns whether image and mask are in memory.
    pub fn is_in_memory(&self) -> bool {
        self.image.is_in_memory() && self.mask.as_ref().is_none_or(OnDemand::is_in_memory)
    }

    /// Returns the number of pixels.
    pub fn pixel_count(&self) -> u64 {
        self.camera.size_px.iter().map(|side| u64::from(*side)).product()
    }

    /// Returns the view with image and mask in memory. Those that are read on demand are dropped
    /// with the result. Captured images beside it stay as they are.
    ///
    /// # Errors
    /// An image or a mask that cannot be read.
    pub fn loaded(&self) -> Result<Self, ReadError> {
        let mask = self.mask.as_ref().map(OnDemand::loaded).transpose()?;
        Ok(Self { image: self.image.loaded()?, mask, ..self.clone() })
    }

    /// Returns the view without what was read on demand, so that keeping it takes no memory.
    #[must_use]
    pub fn released(&self) -> Self {
        Self { image: self.image.released(), mask: self.mask.as_ref().map(OnDemand::released), ..self.clone() }
    }

    /// Checks that the camera can be used and is undistorted, and that image and mask are of its
    /// size.
    ///
    /// # Errors
    /// The first violation found.
    pub fn validate(&self) -> Result<(), ViewError> {
        let view = || self.name.clone();
        if !self.camera.distortion.is_none() {
            return Err(ViewError::Distorted { view: view() });
        }
        self.camera.validate().map_err(|source| ViewError::Camera { view: view(), source })?;
        self.validate_recordings()?;
        // Those that are read on demand were checked when they were first read.
        let Some(image_now) = self.image.get() else { return Ok(()) };
        let (image, camera) = ([image_now.width, image_now.height], self.camera.size_px.map(|side| side as usize));
        if image != camera {
            return Err(ViewError::ImageSize { view: view(), image, camera });
        }
        let expected = camera[0] * camera[1];
        if image_now.pixels.len() != expected {
            return Err(ViewError::PixelCount { view: view(), found: image_now.pixels.len(), expected });
        }
        let Some(mask) = self.mask.as_ref().and_then(OnDemand::get) else { return Ok(()) };
        if mask.weights.len() != expected {
            return Err(ViewError::MaskSize { view: view(), found: mask.weights.len(), expected });
        }
        mask.total().map(|_| ()).ok_or_else(|| ViewError::MaskWeight { view: view() })
    }

    /// Checks that the images beside the view's radiance are captured values of its size.
    fn validate_recordings(&self) -> Result<(), ViewError> {
        for recording in &self.recordings {
            recording.validate()?;
            let sizes = [recording.camera.size_px, self.camera.size_px];
            if sizes[0] != sizes[1] {
                let [recording_px, view_px] = sizes;
                return Err(ViewError::RecordingSize { view: self.name.clone(), recording: recording.name.clone(), recording_px, view_px });
            }
            if !matches!(recording.values, PixelValues::Recorded { exposure_s } if exposure_s.is_normal() && exposure_s > 0.0) {
                return Err(ViewError::RecordingExposure { view: self.name.clone(), recording: recording.name.clone() });
            }
        }
        Ok(())
    }

    /// Returns the view, without the captured images beside it, with its image reduced `factor`
    /// times a side by area average over valid pixels, in linear light.
    ///
    /// A reduced pixel is valid if at least one of its pixels and at least the part `min_valid` (0
    /// to 1) of its area are valid. In each channel, captured LDR values must be all saturated, all
    /// black or all in between. The weight of a reduced pixel is the mean weight of its valid
    /// pixels. Incomplete blocks at the right and bottom border are left out, so that the camera is
    /// scaled exactly. The factor is lowered where it would leave less than one pixel a side.
    pub fn downscaled(&self, factor: u32, min_valid: f64) -> Self {
        let [width, height] = self.camera.size_px;
        let factor = factor.min(width).min(height).max(1);
        let camera = self.camera.downscaled(factor);
        let ([width, height], factor) = (camera.size_px.map(|side| side as usize), factor as usize);
        let enough = (min_valid * (factor * factor) as f64).max(1.0);
        let bounds = self.values.bounds(&self.image);
        let mut light = self.image.shared();
        if self.values != PixelValues::Radiance {
            self.values.to_light(Arc::make_mut(&mut light));
        }
        let mut weights = Vec::with_capacity(width * height);
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let corner = [x * factor, y * factor];
                let mask = self.mask.as_deref();
                let block = light.reduce_block(mask, corner, factor);
                let is_mixture = |bounds: &Image| PixelValues::is_mixture(bounds.reduce_block(mask, corner, factor).mean);
                let is_valid = block.valid as f64 >= enough && !bounds.as_ref().is_some_and(is_mixture);
                pixels.push(if is_valid { block.mean } else { [0.0; 3] });
                weights.push(if is_valid { block.weight } else { 0.0 });
            }
        }
        let mut image = Image { width, height, pixels };
        self.values.from_light(&mut image);
        let mask = weights.iter().any(|weight| *weight < 1.0).then(|| Mask { weights }.into());
        let noise = self.noise.map(|model| model.averaged(factor * factor));
        let (name, recordings) = (self.name.clone(), Vec::new());
        Self { name, camera, image: image.into(), values: self.values, noise, mask, recordings, target: self.target }
    }
}

/// An observation of a 3D point in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index into [`Dataset::train`]; observations in test views are dropped by the reader.
    pub view: u32,
    /// Pixel coordinates in the (undistorted, downscaled) image.
    pub pixel_px: [f32; 2],
}

/// A 3D point from structure from motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Local coordinates, see [`Dataset::world_from_local`].
    pub position: [f32; 3],
    /// Display colour 0..=255, if the file gives one.
    pub rgb8: Option<[u8; 3]>,
    /// Observations in training views; may be empty.
    pub observations: Vec<Observation>,
}

/// Pixels that were masked out of one image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BadPixels {
    /// Name of the view.
    pub name: String,
    /// Pixels with a NaN channel.
    pub nan: usize,
    /// Pixels with an infinite channel and no NaN.
    pub infinite: usize,
    /// Pixels with a negative channel and otherwise finite.
    pub negative: usize,
}

/// A complete data set for training.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Detected format in words, such as `nerfstudio transforms.json`.
    pub format: String,
    /// Training views, sorted by name.
    pub train: Vec<View>,
    /// Held-out test views, sorted by name; may be empty.
    pub test: Vec<View>,
    /// Points from structure from motion; may be empty.
    pub points: Vec<Point>,
    /// Colour space of all images.
    pub color_space: ColorSpace,
    /// Images with masked pixels.
    pub bad_pixels: Vec<BadPixels>,
    /// Digest of names, split, cameras and file contents: equal exactly for equal inputs.
    pub fingerprint: String,
    /// Warnings for the user, such as about 8-bit input.
    pub warnings: Vec<String>,
    /// The transform from the coordinates of cameras and points (local) to those of the files
    /// (world); the identity for scenes of usual size near the origin, see [`crate::SceneBounds`].
    pub world_from_local: Similarity,
    /// Length of a unit of the world, metres; `None` if nothing states it.
    pub metres_per_unit: Option<f64>,
    /// Whether the images are single photographs that were developed for display, such as JPEG
    /// files, and not radiance that was measured: their brightness may differ from view to view by
    /// what the camera or a program did to them.
    pub is_developed: bool,
    /// Views that memory has room for reading side by side, at least 1, while nothing else holds
    /// any. Results do not depend on it.
    pub readers: usize,
}

impl Dataset {
    /// Returns the data set in other local coordinates, such as those of a scene to be compared
    /// with it; the world stays.
    pub fn in_frame(&self, world_from_local: Similarity) -> Cow<'_, Self> {
        if self.world_from_local == world_from_local {
            return Cow::Borrowed(self);
        }
        let moved = self.world_from_local.then(&world_from_local.inverse());
        let mut dataset = self.clone();
        for view in dataset.train.iter_mut().chain(&mut dataset.test) {
            moved.apply_to_camera(&mut view.camera);
        }
        for point in &mut dataset.points {
            point.position = moved.point(DVec3::from_array(point.position.map(f64::from))).as_vec3().to_array();
        }
        dataset.world_from_local = world_from_local;
        Cow::Owned(dataset)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec2, DVec3};

    use super::*;
    use crate::{CameraProjection, Distortion};

    fn view(width: u32, height: u32, mask: Option<Vec<bool>>) -> View {
        let pixels = (0..width * height).map(|i| [i as f32, 1e4 * (i % 2) as f32, 0.5]).collect();
        View {
            name: "ramp".to_owned(),
            camera: Camera {
                camera_from_world: DAffine3::from_translation(DVec3::new(0.1, -0.2, 0.3)),
                focal_px: DVec2::new(50.0, 60.0),
                center_px: DVec2::new(0.5 * f64::from(width) + 1.0, 0.5 * f64::from(height)),
                size_px: [width, height],
                distortion: Distortion::default(),
                projection: CameraProjection::Pinhole,
            },
            image: Image::from_pixels(width as usize, height as usize, pixels).unwrap().into(),
            values: PixelValues::Radiance,
            noise: None,
            mask: mask.map(|valid| Mask::from_valid(valid).into()),
            recordings: Vec::new(),
            target: Target::default(),
        }
    }

    #[test]
    fn recordings_are_reduced_without_blocks_that_are_saturated_in_part() {
        let mut full = view(6, 2, None);
        full.values = PixelValues::Recorded { exposure_s: 1.0 };
        // One block in range, one saturated, one partly saturated.
        let row = [[0.5; 3], [0.4; 3], [1.0; 3], [1.0; 3], [1.0; 3], [0.9; 3]];
        full.image = Image::from_pixels(6, 2, [row, row].concat()).unwrap().into();
        let reduced = full.downscaled(2, 0.5);
        assert_eq!([0, 1, 2].map(|i| reduced.is_valid(i)), [true, true, false]);
        assert_eq!(reduced.image.pixels[1], [1.0; 3]);
    }

    #[test]
    fn a_view_is_refused_where_camera_image_and_mask_disagree() {
        let good = view(4, 3, Some(vec![true; 12]));
        assert_eq!(good.validate(), Ok(()));
        type Breakage = (fn(&mut View), &'static str);
        let broken: [Breakage; 6] = [
            (|v| v.camera.focal_px.x = -1.0, "view ramp: camera: focal length -1 x 60 px, expected positive numbers"),
            (|v| v.camera.distortion.k1 = 0.1, "view ramp: camera: has lens distortion; undistort its image first"),
            (|v| v.camera.size_px = [5, 3], "view ramp: image is 4 x 3, the camera expects 5 x 3"),
            (
                |v| v.image = Image { pixels: v.image.pixels[..7].to_vec(), ..*v.image }.into(),
                "view ramp: image holds 7 pixels, its size says 12",
            ),
            (|v| v.mask = Some(Mask { weights: vec![1.0; 11] }.into()), "view ramp: mask holds 11 pixels, the image 12"),
            (|v| v.mask = Some(Mask { weights: vec![f32::NAN; 12] }.into()), "view ramp: mask: a weight is not a number from 0 to 1"),
        ];
        for (break_it, message) in broken {
            let mut view = good.clone();
            break_it(&mut view);
            assert_eq!(view.validate().unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn recordings_are_captured_values_of_the_view_s_size() {
        let recorded =
            |width, exposure_s| View { values: PixelValues::Recorded { exposure_s }, name: "ramp_0".into(), ..view(width, 3, None) };
        let pair = |recording| View { recordings: vec![recording], ..view(4, 3, None) }.validate();
        assert_eq!(pair(recorded(4, 0.5)), Ok(()));
        for (recording, message) in [
            (recorded(5, 0.5), "view ramp: its captured image ramp_0 is 5 x 3, expected 4 x 3"),
            (recorded(4, 0.0), "view ramp: its captured image ramp_0 has no exposure, expected seconds above 0"),
            (
                View { name: "ramp_0".into(), ..view(4, 3, None) },
                "view ramp: its captured image ramp_0 has no exposure, expected seconds above 0",
            ),
        ] {
            assert_eq!(pair(recording).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn a_reduced_camera_sees_a_point_at_the_same_place() {
        for (size, factor) in [([64, 48], 4), ([65, 50], 4), ([640, 425], 3), ([9, 7], 7)] {
            let full = view(size[0], size[1], None);
            let reduced = full.downscaled(factor, 0.5);
            for point in [DVec3::new(0.0, 0.0, 2.0), DVec3::new(-0.3, 0.4, 1.0), DVec3::new(0.7, 0.2, 5.0)] {
                let (at, depth) = full.camera.project(point).unwrap();
                let (reduced_at, reduced_depth) = reduced.camera.project(point).unwrap();
                assert!((reduced_at * f64::from(factor) - at).length() < 1e-9, "{at} {reduced_at}");
                assert_eq!(depth, reduced_depth);
            }
            assert_eq!(reduced.camera.size_px, size.map(|side| side / factor));
            let [width, height] = reduced.camera.size_px.map(|side| side as usize);
            assert_eq!([reduced.image.width, reduced.image.height, reduced.image.pixels.len()], [width, height, width * height]);
            assert_eq!(reduced.mask, None);
        }
    }

    #[test]
    fn a_reduced_image_keeps_the_light_of_its_blocks() {
        let reduced = view(4, 4, None).downscaled(2, 0.5);
        assert_eq!(reduced.image.pixels, [[2.5, 5e3, 0.5], [4.5, 5e3, 0.5], [10.5, 5e3, 0.5], [12.5, 5e3, 0.5]]);
        // Reducing twice by 2 equals reducing once by 4.
        let (twice, once) = (view(8, 8, None).downscaled(2, 0.5).downscaled(2, 0.5), view(8, 8, None).downscaled(4, 0.5));
        assert_eq!((twice.image, twice.camera), (once.image, once.camera));
        let same = view(3, 2, None);
        assert_eq!(same.downscaled(1, 0.5).image, same.image);
        assert_eq!(same.downscaled(9, 0.5).camera.size_px, [1, 1]);
    }

    #[test]
    fn a_pixel_is_valid_if_enough_of_its_area_is() {
        // Blocks with 4, 2, 1 and 0 valid pixels.
        let valid = [[1, 1, 1, 0], [1, 1, 0, 1], [1, 0, 0, 0], [0, 0, 0, 0]].concat().iter().map(|v| *v == 1).collect();
        let half = view(4, 4, Some(valid));
        let reduced = half.downscaled(2, 0.5);
        assert_eq!(reduced.mask.unwrap().weights, [1.0, 1.0, 0.0, 0.0]);
        // The mean of pixels 2 and 7 alone; a block with too few valid pixels is black.
        assert_eq!(reduced.image.pixels[1..], [[4.5, 5e3, 0.5], [0.0; 3], [0.0; 3]]);
        assert_eq!(half.downscaled(2, 0.0).mask.unwrap().weights, [1.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn a_pixel_weighs_what_its_area_does() {
        let mut full = view(4, 2, None);
        full.mask = Some(Mask { weights: vec![0.5, 0.25, 1.0, 1.0, 0.75, 0.0, 1.0, 1.0] }.into());
        assert_eq!(full.downscaled(2, 0.5).mask.unwrap().weights, [0.5, 1.0]);
        assert_eq!(Mask { weights: vec![0.5, 1.0] }.total(), Some(1.5));
        assert_eq!(Mask { weights: vec![0.5, f32::NAN] }.total(), None);
        assert_eq!(Mask { weights: vec![1.5] }.total(), None);
    }
}

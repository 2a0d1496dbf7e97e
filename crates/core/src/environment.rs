//! Environment maps: radiance by direction around a point, as light probes store it.
//!
//! In: renders of the cameras of [`Rig`] at a point. Out: an [`Image`] in one of OpenEXR's two
//! projections ([`Projection`]), averaged over each pixel in linear light, and [`Summary`], the
//! irradiance it gives to surfaces.
//!
//! The environment's axes are those of OpenEXR: y is up; the middle of a latitude-longitude map
//! looks along +z, and +x is to the left of it.
//!
//! The rig is a cube with 2x2 cameras per face, each aimed along its own axis. Both the ellipse
//! that approximates a splat and its colour, evaluated towards the splat's centre, are most
//! accurate near the camera's axis, so narrow cameras reduce both errors. Faces are halved by
//! angle. No camera looks further than 36 degrees from its axis, and all overlap by a pixel, so
//! that interpolation needs no neighbours.
//!
//! Degenerate: a focal length far from that of the training views, without anti-aliasing
//! ([`crate::Antialias::Off`]). Dilation then widens splats smaller than a pixel, so renders at a
//! lower resolution than in training are too bright, and at a higher one too dark. [`Rig::new`]
//! therefore takes the training views' focal length, whatever the map's size.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use crate::{Camera, Distortion, Image};

/// The projection of directions to an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// Equirectangular, twice as wide as high.
    ///
    /// Latitude runs from 90 degrees at the top to -90, longitude from 180 degrees at the left to
    /// -180. Longitude 0 is +z and 90 is +x.
    #[default]
    LatitudeLongitude,
    /// The six faces of a cube: +x, -x, +y, -y, +z, -z from top to bottom.
    Cube,
}

impl Projection {
    /// Returns the height of an image of this width.
    pub fn height(self, width: usize) -> usize {
        match self {
            Self::LatitudeLongitude => (width / 2).max(1),
            Self::Cube => 6 * width,
        }
    }

    /// Returns the direction (of any length) of a point of the image, pixels.
    pub fn direction(self, [x, y]: [f64; 2], width: usize) -> DVec3 {
        use std::f64::consts::PI;
        let w = width as f64;
        match self {
            Self::LatitudeLongitude => {
                let latitude = PI * (0.5 - y / self.height(width) as f64);
                let longitude = 2.0 * PI * (0.5 - x / w);
                DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos())
            }
            Self::Cube => {
                let face = ((y / w) as usize).min(5);
                let (column, row) = (2.0 * x / w - 1.0, 2.0 * (y / w - face as f64) - 1.0);
                let [forward, right, down] = FACES[face];
                forward + column * right + row * down
            }
        }
    }

    /// Returns the solid angle of a pixel, steradians.
    fn solid_angle(self, [x, y]: [usize; 2], width: usize) -> f64 {
        use std::f64::consts::PI;
        let w = width as f64;
        match self {
            Self::LatitudeLongitude => {
                let height = self.height(width) as f64;
                let latitude = |y: usize| PI * (0.5 - y as f64 / height);
                2.0 * PI / w * (latitude(y).sin() - latitude(y + 1).sin())
            }
            Self::Cube => {
                let d = self.direction([x as f64 + 0.5, y as f64 + 0.5], width);
                4.0 / (w * w) / d.length().powi(3)
            }
        }
    }
}

/// Forward, right and down axes of each face of a cube, seen from inside.
const FACES: [[DVec3; 3]; 6] = [
    [DVec3::X, DVec3::Z, DVec3::NEG_Y],
    [DVec3::NEG_X, DVec3::NEG_Z, DVec3::NEG_Y],
    [DVec3::Y, DVec3::X, DVec3::NEG_Z],
    [DVec3::NEG_Y, DVec3::X, DVec3::Z],
    [DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y],
    [DVec3::NEG_Z, DVec3::X, DVec3::NEG_Y],
];

/// Number of cameras across a face.
const ACROSS: usize = 2;
/// Smallest and largest number of samples across a pixel of the map.
const SAMPLES: [f64; 2] = [3.0, 32.0];
/// Longest focal length of a rig, pixels; its images have about 0.9 times as many pixels a side.
const MAX_FOCAL_PX: f64 = 8192.0;
/// Margin beyond a camera's part that interpolation may read, pixels.
const MARGIN_PX: f64 = 1.5;
/// Render pixels per pixel of the map if no focal length is known.
const OVERSAMPLING: f64 = 1.5;

/// A rig of cameras that together see all directions around a point.
#[derive(Clone, Debug)]
pub struct Rig {
    /// Cameras in the scene's world, in the order in which [`Rig::assemble`] expects their renders.
    pub cameras: Vec<Camera>,
    environment_from_world: DMat3,
    projection: Projection,
    width: usize,
    /// Number of samples across a pixel of the map.
    samples: usize,
}

/// The projection and size of a map.
#[derive(Clone, Copy, Debug)]
pub struct MapSize {
    /// Projection of the map.
    pub projection: Projection,
    /// Width, pixels; for a cube, that of a face.
    pub width: usize,
}

impl Rig {
    /// Returns the rig for a map at the point `at` of the world.
    ///
    /// `environment_from_world` is a rotation. `focal_px` is the focal length of the training
    /// views, if known.
    pub fn new(at: DVec3, environment_from_world: DMat3, map: MapSize, focal_px: Option<f64>) -> Self {
        let MapSize { projection, width } = map;
        // Pixels per radian in the middle of the map or of a face.
        let density = match projection {
            Projection::LatitudeLongitude => width as f64 / std::f64::consts::TAU,
            Projection::Cube => width as f64 / 2.0,
        };
        let focal = focal_px.unwrap_or(OVERSAMPLING * density).clamp(2.0, MAX_FOCAL_PX);
        let mut cameras = Vec::with_capacity(6 * ACROSS * ACROSS);
        for face in FACES {
            for row in 0..ACROSS {
                for column in 0..ACROSS {
                    cameras.push(part_camera(at, environment_from_world, face, [column, row], focal));
                }
            }
        }
        let samples = (focal / density + 1.0).ceil().clamp(SAMPLES[0], SAMPLES[1]) as usize;
        Self { cameras, environment_from_world, projection, width, samples }
    }

    /// Assembles the map from the renders of [`Rig::cameras`]; directions that no render covers are
    /// black.
    pub fn assemble(&self, renders: &[Image]) -> Image {
        let Self { projection, width, samples, .. } = *self;
        let height = projection.height(width);
        let mut image = Image::filled(width, height, [0.0; 3]);
        let step = 1.0 / samples as f64;
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0f64; 3];
                for j in 0..samples {
                    for i in 0..samples {
                        let at = [x as f64 + (i as f64 + 0.5) * step, y as f64 + (j as f64 + 0.5) * step];
                        let radiance = self.radiance(renders, projection.direction(at, width));
                        sum.iter_mut().zip(radiance).for_each(|(sum, c)| *sum += c);
                    }
                }
                image.pixels[y * width + x] = sum.map(|c| (c * step * step) as f32);
            }
        }
        image
    }

    /// Returns the interpolated radiance from a direction of the environment.
    fn radiance(&self, renders: &[Image], direction: DVec3) -> [f64; 3] {
        let camera = part_of(direction);
        let (Some(camera), Some(render)) = (self.cameras.get(camera), renders.get(camera)) else { return [0.0; 3] };
        let in_camera = camera.camera_from_world.matrix3 * (self.environment_from_world.transpose() * direction);
        let at = DVec2::new(in_camera.x, in_camera.y) / in_camera.z * camera.focal_px + camera.center_px - DVec2::splat(0.5);
        let (x, y) = (at.x.floor(), at.y.floor());
        let (fx, fy) = (at.x - x, at.y - y);
        let pixel = |dx: f64, dy: f64| {
            let (px, py) = ((x + dx).clamp(0.0, render.width as f64 - 1.0), (y + dy).clamp(0.0, render.height as f64 - 1.0));
            render.at(px as usize, py as usize).map(f64::from)
        };
        let (a, b, c, d) = (pixel(0.0, 0.0), pixel(1.0, 0.0), pixel(0.0, 1.0), pixel(1.0, 1.0));
        [0, 1, 2].map(|i| (a[i] * (1.0 - fx) + b[i] * fx) * (1.0 - fy) + (c[i] * (1.0 - fx) + d[i] * fx) * fy)
    }
}

/// Returns the tangent at border `part` of the parts, from one end of a face to the other: halves
/// by angle.
fn border(part: usize) -> f64 {
    let angle = std::f64::consts::FRAC_PI_4 * (2.0 * part as f64 / ACROSS as f64 - 1.0);
    angle.tan()
}

/// Returns the camera of one part of a face.
fn part_camera(at: DVec3, environment_from_world: DMat3, face: [DVec3; 3], [column, row]: [usize; 2], focal: f64) -> Camera {
    let [front, right, down] = face;
    let middle = |part: usize| (0.5 * (border(part).atan() + border(part + 1).atan())).tan();
    let forward = (front + middle(column) * right + middle(row) * down).normalize();
    let x_axis = (right - right.dot(forward) * forward).normalize();
    let y_axis = forward.cross(x_axis);
    // Extent of the part's corners and edges on the image plane.
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for i in 0..=1 {
        for j in 0..=1 {
            let corner = front + border(column + i) * right + border(row + j) * down;
            let p = DVec2::new(corner.dot(x_axis), corner.dot(y_axis)) / corner.dot(forward);
            (low, high) = (low.min(p), high.max(p));
        }
    }
    let (low, high) = (low * focal - MARGIN_PX, high * focal + MARGIN_PX);
    let size = (high - low).ceil();
    let environment_rows = DMat3::from_cols(x_axis, y_axis, forward).transpose();
    let matrix3 = environment_rows * environment_from_world;
    Camera {
        camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * at) },
        focal_px: DVec2::splat(focal),
        center_px: -low,
        size_px: [size.x as u32, size.y as u32],
        distortion: Distortion::default(),
    }
}

/// Returns the index of the camera that covers a direction.
fn part_of(direction: DVec3) -> usize {
    let axis = direction.abs().max_position();
    let face = 2 * axis + usize::from(direction[axis] < 0.0);
    let [front, right, down] = FACES[face];
    let depth = direction.dot(front);
    let part = |side: DVec3| (1..ACROSS).filter(|p| direction.dot(side) > border(*p) * depth).count();
    (face * ACROSS + part(down)) * ACROSS + part(right)
}

/// A summary of the light of an environment.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Mean radiance over all directions.
    pub mean_radiance: [f64; 3],
    /// Largest channel of any pixel.
    pub peak_radiance: f32,
    /// Direction of that pixel, a unit vector in the environment's axes.
    pub peak_direction: [f64; 3],
    /// Irradiance of surfaces that face +x, -x, +y, -y, +z, -z: the integral of radiance times
    /// cosine over solid angle.
    pub irradiance: [[f64; 3]; 6],
}

impl Summary {
    /// Returns the summary of a map in `projection`.
    pub fn new(image: &Image, projection: Projection) -> Self {
        let width = image.width;
        let mut sum = [0f64; 3];
        let mut irradiance = [[0f64; 3]; 6];
        let (mut peak_radiance, mut peak_direction) = (f32::NEG_INFINITY, [0.0; 3]);
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = (i % width, i / width);
            let direction = projection.direction([x as f64 + 0.5, y as f64 + 0.5], width).normalize();
            let solid_angle = projection.solid_angle([x, y], width);
            let light = pixel.map(|c| f64::from(c) * solid_angle);
            sum.iter_mut().zip(light).for_each(|(sum, c)| *sum += c);
            for (irradiance, [normal, ..]) in irradiance.iter_mut().zip(FACES) {
                let cosine = direction.dot(normal).max(0.0);
                irradiance.iter_mut().zip(light).for_each(|(sum, c)| *sum += c * cosine);
            }
            let brightest = pixel.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            if brightest > peak_radiance {
                (peak_radiance, peak_direction) = (brightest, direction.to_array());
            }
        }
        let all = 4.0 * std::f64::consts::PI;
        Self { mean_radiance: sum.map(|c| c / all), peak_radiance, peak_direction, irradiance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns renders of a world whose radiance is a function of direction.
    fn renders(rig: &Rig, radiance: impl Fn(DVec3) -> [f32; 3]) -> Vec<Image> {
        let render = |camera: &Camera| {
            let [width, height] = camera.size_px.map(|side| side as usize);
            let pixel = |i: usize| {
                let px = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
                let slope = (px - camera.center_px) / camera.focal_px;
                let world = camera.camera_from_world.matrix3.transpose() * DVec3::new(slope.x, slope.y, 1.0);
                radiance(world.normalize())
            };
            Image { width, height, pixels: (0..width * height).map(pixel).collect() }
        };
        rig.cameras.iter().map(render).collect()
    }

    fn map(projection: Projection, width: usize) -> MapSize {
        MapSize { projection, width }
    }

    const TURN: DMat3 = DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);

    #[test]
    fn cameras_are_valid_and_narrow() {
        let rig = Rig::new(DVec3::new(1.0, 2.0, 3.0), TURN, map(Projection::LatitudeLongitude, 256), Some(90.0));
        assert_eq!(rig.cameras.len(), 24);
        for camera in &rig.cameras {
            camera.validate().unwrap();
            assert!((camera.eye() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-9);
            for corner in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
                let size = DVec2::new(camera.size_px[0].into(), camera.size_px[1].into());
                let slope = (size * DVec2::from_array(corner) - camera.center_px) / camera.focal_px;
                assert!(slope.length().atan().to_degrees() < 38.0, "{}", slope.length().atan().to_degrees());
            }
        }
    }

    #[test]
    fn directions_come_out_where_they_belong() {
        // Radiance equals the direction, in world axes.
        let smooth = |d: DVec3| [0, 1, 2].map(|c| (2.0 + d[c]) as f32);
        for projection in [Projection::LatitudeLongitude, Projection::Cube] {
            let rig = Rig::new(DVec3::ZERO, TURN, map(projection, 64), None);
            let image = rig.assemble(&renders(&rig, smooth));
            assert_eq!(image.height, projection.height(64));
            for (i, pixel) in image.pixels.iter().enumerate() {
                let d = projection.direction([(i % 64) as f64 + 0.5, (i / 64) as f64 + 0.5], 64).normalize();
                let world = TURN.transpose() * d;
                let error = (0..3).map(|c| (f64::from(pixel[c]) - 2.0 - world[c]).abs()).fold(0.0, f64::max);
                assert!(error < 6e-3, "{projection:?} pixel {i}: {pixel:?} {world}");
            }
        }
    }

    #[test]
    fn maps_lie_as_openexr_has_them() {
        let near = |a: DVec3, b: DVec3| (a.normalize() - b).length() < 1e-9;
        let at = |x, y| Projection::LatitudeLongitude.direction([x, y], 8);
        assert!(near(at(4.0, 2.0), DVec3::Z) && near(at(2.0, 2.0), DVec3::X) && near(at(0.0, 0.0), DVec3::Y));
        let face = |n: f64| Projection::Cube.direction([4.0, 4.0 + 8.0 * n], 8);
        for (n, axis) in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z].into_iter().enumerate() {
            assert!(near(face(n as f64), axis));
            let [forward, right, down] = FACES[n];
            assert_eq!(right.cross(down), forward);
        }
    }

    #[test]
    fn irradiance_is_that_of_known_environments() {
        use std::f64::consts::PI;
        for projection in [Projection::LatitudeLongitude, Projection::Cube] {
            let rig = Rig::new(DVec3::ZERO, DMat3::IDENTITY, map(projection, 128), None);
            // Everywhere 1: pi. Above the horizon 1: pi, 0 and pi / 2.
            let sky = |d: DVec3| [1.0, if d.y > 0.0 { 1.0 } else { 0.0 }, (1.0 + d.y) as f32];
            let summary = Summary::new(&rig.assemble(&renders(&rig, sky)), projection);
            let expected = [PI, PI, PI, PI, PI, PI];
            for (found, expected) in summary.irradiance.iter().zip(expected) {
                assert!((found[0] - expected).abs() < 2e-3, "{projection:?} {found:?}");
            }
            for (face, expected) in [(0, PI / 2.0), (2, PI), (3, 0.0)] {
                assert!((summary.irradiance[face][1] - expected).abs() < 0.03, "{projection:?} {:?}", summary.irradiance[face]);
            }
            // L = 1 + y: pi + 2 pi / 3 upwards.
            assert!((summary.irradiance[2][2] - (PI + 2.0 * PI / 3.0)).abs() < 3e-3);
            assert!((summary.mean_radiance[0] - 1.0).abs() < 1e-3 && (summary.mean_radiance[1] - 0.5).abs() < 6e-3);
            assert!((summary.peak_radiance - 2.0).abs() < 1e-2 && summary.peak_direction[1] > 0.98);
        }
    }
}

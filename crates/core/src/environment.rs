//! Environment maps: radiance by direction around a point, as light probes store it.
//!
//! In: renders of the cameras of [`PanoramaRig`], or of [`Rig`] for engines that render pinholes
//! only, at a point. Out: an [`Image`] in one of OpenEXR's two
//! projections ([`Projection`]), averaged over each pixel in linear light, and [`Summary`], the
//! irradiance it gives to surfaces.
//!
//! The environment's axes are those of OpenEXR: y is up; the middle of a latitude-longitude map
//! looks along +z, and +x is to the left of it.
//!
//! The rig is a cube with 3x3 cameras per face, each aimed along its own axis. Both the ellipse
//! that approximates a splat and its colour, evaluated towards the splat's centre, are most
//! accurate near the camera's axis, so narrow cameras reduce both errors. Faces are divided by
//! angle. No camera looks further than 36 degrees from its axis.
//!
//! A near splat differs between two cameras, so each reaches 9 degrees into its neighbours' parts,
//! and the map fades from one to the next: the weight of a camera falls smoothly to zero at its
//! border, and all weights of a direction add up to one ([`Rig::assemble`]).
//!
//! Degenerate: a focal length far from that of the training views, without anti-aliasing
//! ([`crate::Antialias::Off`]). Dilation then widens splats smaller than a pixel, so renders at a
//! lower resolution than in training are too bright, and at a higher one too dark. [`Rig::new`]
//! therefore takes the training views' focal length, whatever the map's size.

mod fade;
mod lights;
mod panorama;
mod summary;

use fade::{FacePoint, Fades};
use glam::{DAffine3, DMat3, DVec2, DVec3};
pub use lights::{Light, lights};
pub use panorama::{PanoramaRig, PartialPanorama};
pub use summary::Summary;

use crate::{Camera, CameraProjection, Distortion, Image};

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
const ACROSS: usize = 3;
/// Number of cameras of a face.
const OF_FACE: usize = ACROSS * ACROSS;
/// Angle by which a camera reaches into the parts of its neighbours, radians: at most half a part,
/// so that no more than two columns or rows of cameras see a direction.
const REACH: f64 = 9.0 / 180.0 * std::f64::consts::PI;
/// Smallest and largest number of samples across a pixel of the map.
const SAMPLES: [f64; 2] = [3.0, 32.0];
/// Longest focal length of a rig, pixels; its images have about as many pixels a side.
const MAX_FOCAL_PX: f64 = 8192.0;
/// Margin beyond the directions of a camera that interpolation may read, pixels.
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
    fades: Fades,
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
        let density = density(map);
        let focal = focal_px.unwrap_or(OVERSAMPLING * density).clamp(2.0, MAX_FOCAL_PX);
        let mut cameras = Vec::with_capacity(6 * OF_FACE);
        for face in FACES {
            for row in 0..ACROSS {
                for column in 0..ACROSS {
                    cameras.push(part_camera(at, environment_from_world, face, [column, row], focal));
                }
            }
        }
        let samples = (focal / density + 1.0).ceil().clamp(SAMPLES[0], SAMPLES[1]) as usize;
        Self { cameras, environment_from_world, projection, width, samples, fades: Fades::new() }
    }

    /// Returns the cameras of each face, in the order of [`Self::cameras`].
    pub fn faces(&self) -> impl Iterator<Item = &[Camera]> {
        self.cameras.chunks(OF_FACE)
    }

    /// Assembles the map from the renders of [`Rig::cameras`].
    pub fn assemble(&self, renders: &[Image]) -> Image {
        let mut map = self.empty_map();
        for (face, renders) in renders.chunks(OF_FACE).enumerate() {
            map.add_face(self, face, renders);
        }
        map.into_image(self)
    }

    /// Returns a map to which faces are added one by one, so that the renders of one face are in
    /// memory at a time.
    pub fn empty_map(&self) -> PartialMap {
        PartialMap { sums: vec![[0.0; 3]; self.width * self.projection.height(self.width)] }
    }

    /// Returns the radiance from a direction of the environment as the cameras of a face see it,
    /// times their weights.
    fn weighted_radiance(&self, face: usize, renders: &[Image], direction: DVec3) -> [f64; 3] {
        let mut sum = [0.0; 3];
        let Some(FacePoint { weight, at }) = self.fades.face_point(face, direction) else { return sum };
        let (columns, rows) = (self.fades.part_weights(at.x), self.fades.part_weights(at.y));
        for (part, render) in renders.iter().enumerate() {
            let weight = weight * rows[part / ACROSS] * columns[part % ACROSS];
            if weight > 0.0
                && let Some(camera) = self.cameras.get(face * OF_FACE + part)
            {
                let in_camera = camera.camera_from_world.matrix3 * (self.environment_from_world.transpose() * direction);
                let radiance = interpolated(camera, render, in_camera);
                sum.iter_mut().zip(radiance).for_each(|(sum, c)| *sum += weight * c);
            }
        }
        sum
    }
}

/// A map of which some faces of the rig are still missing; they are black in it.
#[derive(Clone, Debug)]
pub struct PartialMap {
    /// Radiance times weight, summed over the samples of each pixel.
    sums: Vec<[f64; 3]>,
}

impl PartialMap {
    /// Adds what the cameras of a face see, given their renders.
    pub fn add_face(&mut self, rig: &Rig, face: usize, renders: &[Image]) {
        let Rig { projection, width, samples, .. } = *rig;
        let Some([forward, ..]) = FACES.get(face) else { return };
        let step = 1.0 / samples as f64;
        // No sample of a pixel is further than this from its middle, radians, in either projection.
        let radius = 5.0 / width as f64;
        let least_cosine = (corner_angle() + radius).min(std::f64::consts::PI).cos();
        for (i, sum) in self.sums.iter_mut().enumerate() {
            let (x, y) = ((i % width) as f64, (i / width) as f64);
            if projection.direction([x + 0.5, y + 0.5], width).normalize().dot(*forward) < least_cosine {
                continue;
            }
            for sample in 0..samples * samples {
                let [column, row] = [sample % samples, sample / samples].map(|part| (part as f64 + 0.5) * step);
                let radiance = rig.weighted_radiance(face, renders, projection.direction([x + column, y + row], width));
                sum.iter_mut().zip(radiance).for_each(|(sum, c)| *sum += c);
            }
        }
    }

    /// Returns the map of the faces that were added.
    pub fn into_image(self, rig: &Rig) -> Image {
        let share = 1.0 / (rig.samples * rig.samples) as f64;
        let pixels = self.sums.iter().map(|sum| sum.map(|c| (c * share) as f32)).collect();
        Image { width: rig.width, height: rig.projection.height(rig.width), pixels }
    }
}

/// Returns the bilinear interpolation of a render at a direction in the axes of its camera.
fn interpolated(camera: &Camera, render: &Image, direction: DVec3) -> [f64; 3] {
    let at = direction.truncate() / direction.z * camera.focal_px + camera.center_px - DVec2::splat(0.5);
    let (x, y) = (at.x.floor(), at.y.floor());
    let (fx, fy) = (at.x - x, at.y - y);
    let pixel = |dx: f64, dy: f64| {
        let (px, py) = ((x + dx).clamp(0.0, render.width as f64 - 1.0), (y + dy).clamp(0.0, render.height as f64 - 1.0));
        render.at(px as usize, py as usize).map(f64::from)
    };
    let (a, b, c, d) = (pixel(0.0, 0.0), pixel(1.0, 0.0), pixel(0.0, 1.0), pixel(1.0, 1.0));
    [0, 1, 2].map(|i| (a[i] * (1.0 - fx) + b[i] * fx) * (1.0 - fy) + (c[i] * (1.0 - fx) + d[i] * fx) * fy)
}

/// Returns the pixels per radian in the middle of a map or of a face.
fn density(MapSize { projection, width }: MapSize) -> f64 {
    match projection {
        Projection::LatitudeLongitude => width as f64 / std::f64::consts::TAU,
        Projection::Cube => width as f64 / 2.0,
    }
}

/// Returns the angle at border `part` of the parts, from one end of a face to the other.
fn border_angle(part: usize) -> f64 {
    std::f64::consts::FRAC_PI_4 * (2.0 * part as f64 / ACROSS as f64 - 1.0)
}

/// Returns the angle between the axis of a face and the furthest direction in which it has a share.
fn corner_angle() -> f64 {
    (std::f64::consts::SQRT_2 * (std::f64::consts::FRAC_PI_4 + REACH).tan()).atan()
}

/// Returns the camera of one part of a face.
fn part_camera(at: DVec3, environment_from_world: DMat3, face: [DVec3; 3], [column, row]: [usize; 2], focal: f64) -> Camera {
    let [front, right, down] = face;
    let middle = |part: usize| (0.5 * (border_angle(part) + border_angle(part + 1))).tan();
    let ends = |part: usize| [(border_angle(part) - REACH).tan(), (border_angle(part + 1) + REACH).tan()];
    let forward = (front + middle(column) * right + middle(row) * down).normalize();
    let x_axis = (right - right.dot(forward) * forward).normalize();
    let y_axis = forward.cross(x_axis);
    // Extent of the part's corners and edges, with the reach, on the image plane.
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for across in ends(column) {
        for along in ends(row) {
            let corner = front + across * right + along * down;
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
        projection: CameraProjection::Pinhole,
    }
}

#[cfg(test)]
mod tests;

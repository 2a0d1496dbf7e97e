//! Environment maps: radiance by direction around a point, as light probes store it.
//!
//! In: renders of the cameras of [`PanoramaRig`] at a point. Out: an [`Image`](crate::Image) in one
//! of OpenEXR's two projections ([`Projection`]), averaged over each pixel in linear light; with
//! [`Summary`], the irradiance it gives to surfaces, and its [`lights`].
//!
//! The environment's axes are those of OpenEXR: y is up; the middle of a latitude-longitude map
//! looks along +z, and +x is to the left of it.
//!
//! Degenerate: a focal length far from that of the training views, without anti-aliasing
//! ([`crate::Antialias::Off`]). Dilation then widens splats smaller than a pixel, so renders at a
//! lower resolution than in training are too bright, and at a higher one too dark.
//! [`PanoramaRig::new`] therefore takes the training views' focal length, whatever the map's size.

mod lights;
mod panorama;
mod summary;

use glam::DVec3;
pub use lights::{Light, lights};
pub use panorama::{PanoramaRig, PartialPanorama};
pub use summary::Summary;

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
    pub fn solid_angle(self, [x, y]: [usize; 2], width: usize) -> f64 {
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

/// The projection and size of a map.
#[derive(Clone, Copy, Debug)]
pub struct MapSize {
    /// Projection of the map.
    pub projection: Projection,
    /// Width, pixels; for a cube, that of a face.
    pub width: usize,
}

impl MapSize {
    /// Returns the pixels per radian in the middle of a map or of a face.
    fn density(self) -> f64 {
        match self.projection {
            Projection::LatitudeLongitude => self.width as f64 / std::f64::consts::TAU,
            Projection::Cube => self.width as f64 / 2.0,
        }
    }

    /// Returns whether the map's columns go round.
    fn is_round(self) -> bool {
        self.projection == Projection::LatitudeLongitude
    }
}

#[cfg(test)]
mod tests;

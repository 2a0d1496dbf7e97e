//! Lamps of any shape: closed surfaces that shine alike everywhere.

use glam::{DMat3, DVec3};

/// A closed surface that shines alike everywhere, outwards.
#[derive(Clone, Debug, PartialEq)]
pub struct LightMesh {
    /// Corners, seen from the lamp's middle.
    pub points: Vec<DVec3>,
    /// Numbers of corners, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Area that is seen of it from afar, the mean of all directions.
    pub mean_area: f64,
}

impl LightMesh {
    /// Returns the mesh after a rotation.
    #[must_use]
    pub fn turned(mut self, rotation: DMat3) -> Self {
        self.points.iter_mut().for_each(|point| *point = rotation * *point);
        self
    }

    /// Returns the mesh with its lengths times a factor.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        self.points.iter_mut().for_each(|point| *point *= factor);
        self.mean_area *= factor * factor;
        self
    }

    /// Returns the lower and upper corner of the box along the axes that holds it, seen from the
    /// lamp's middle; zeros without points.
    pub fn bounds(&self) -> [DVec3; 2] {
        let join = |[low, high]: [DVec3; 2], point: &DVec3| [low.min(*point), high.max(*point)];
        self.points.first().map_or([DVec3::ZERO; 2], |first| self.points.iter().fold([*first; 2], join))
    }
}

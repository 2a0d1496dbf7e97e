//! The closed surface around the low values of a grid, by the same surface nets.
//!
//! In: values at the corners of a grid of cubes, which are above the level at its border. Out: a
//! [`TriangleMesh`] around those below the level, without radiance. Degenerate: no value below the
//! level gives an empty mesh.

use fast_surface_nets::ndshape::{RuntimeShape, Shape};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::Vec3;

use crate::{TriangleMesh, simplify};

/// A value at each corner of a grid of cubes.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Number of corners along x, y and z.
    pub size: [usize; 3],
    /// Place of the first one.
    pub origin: [f32; 3],
    /// Side of a cube.
    pub voxel: f32,
    /// Values, x first.
    pub values: Vec<f32>,
}

impl Grid {
    /// Returns the surface around the values below `level`. More than `triangles` triangles are
    /// simplified to that many, or to a few more where the topology forbids less.
    pub fn surface(&self, level: f32, triangles: usize) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        let shape = RuntimeShape::<u32, 3>::new(self.size.map(|side| side as u32));
        if self.values.len() != self.size.iter().product::<usize>() || self.size.iter().any(|side| *side < 2) {
            return mesh;
        }
        let distances: Vec<f32> = self.values.iter().map(|value| value - level).collect();
        let mut net = SurfaceNetsBuffer::default();
        surface_nets(&distances, &shape, [0; 3], shape.as_array().map(|side| side - 1), &mut net);
        mesh.positions = net.positions.iter().map(|p| [0, 1, 2].map(|c| self.voxel.mul_add(p[c], self.origin[c]))).collect();
        mesh.normals = net.normals.iter().map(|normal| Vec3::from(*normal).normalize_or(Vec3::Y).to_array()).collect();
        mesh.radiance = vec![[0.0; 3]; mesh.positions.len()];
        mesh.triangles = net.indices.as_chunks::<3>().0.to_vec();
        simplify::simplify(&mut mesh, triangles);
        mesh
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distances from the middle of a grid of 21 corners a side, 0.1 apart.
    fn distances() -> Grid {
        let place = |i: usize| Vec3::new((i % 21) as f32, (i / 21 % 21) as f32, (i / 441) as f32) * 0.1 - Vec3::ONE;
        Grid { size: [21; 3], origin: [-1.0; 3], voxel: 0.1, values: (0..21 * 21 * 21).map(|i| place(i).length()).collect() }
    }

    #[test]
    fn a_level_of_distances_is_a_ball_seen_from_outside() {
        let mesh = distances().surface(0.7, usize::MAX);
        assert!(mesh.positions.iter().all(|p| (Vec3::from(*p).length() - 0.7).abs() < 0.02));
        let volume: f32 = mesh.triangles.iter().map(|t| triple(&mesh, t)).sum::<f32>() / 6.0;
        // Positive where corners go round counter-clockwise from outside. Triangles cut a ball's
        // volume.
        assert!((volume / (4.0 / 3.0 * std::f32::consts::PI * 0.343) - 1.0).abs() < 0.04, "{volume}");
        let few = distances().surface(0.7, 100);
        assert!(few.triangles.len() <= 100 && few.triangles.len() > 50, "{}", few.triangles.len());
    }

    fn triple(mesh: &TriangleMesh, corners: &[u32; 3]) -> f32 {
        let [a, b, c] = corners.map(|corner| Vec3::from(mesh.positions[corner as usize]));
        a.dot(b.cross(c))
    }

    #[test]
    fn nothing_below_the_level_is_no_surface() {
        assert!(distances().surface(-1.0, 100).triangles.is_empty());
        assert!(Grid { values: Vec::new(), ..distances() }.surface(0.7, 100).triangles.is_empty());
    }
}

//! Holes: closed loops of edges that have a triangle on one side only.
//!
//! In: a mesh, a length. Out: the mesh with flat holes filled whose bounding box has a shorter
//! diagonal. Splats of a gloss or a mirror lie behind its surface, so that the surface has a hole
//! there. No vertex is added, so the filling has the radiance of the hole's rim. A loop around a
//! part of the surface, in place of a hole in it, is left open: the filling would show its back
//! where the part shows its front. Degenerate: a length of 0 fills nothing.

use std::collections::HashSet;

use earcut::Earcut;
use glam::{DVec3, Vec3};

use crate::TriangleMesh;

/// Distance of the rim from its plane, root mean square, over the diagonal: flatter holes are
/// filled.
const FLATNESS: f64 = 0.05;
/// Least cosine between the filling's normal and the mean normal of the rim.
const LEAST_AGREEMENT: f64 = 0.5;

/// Fills flat holes; returns how many.
pub(crate) fn fill_holes(mesh: &mut TriangleMesh, max_diagonal: f64) -> usize {
    let mut earcut = Earcut::new();
    let mut filled = 0;
    for rim in rims(mesh) {
        let points: Vec<DVec3> = rim.iter().map(|vertex| Vec3::from(mesh.positions[*vertex as usize]).as_dvec3()).collect();
        let Some(normal) = plane(&points, max_diagonal) else { continue };
        let facing = rim.iter().map(|vertex| Vec3::from(mesh.normals[*vertex as usize]).as_dvec3()).sum::<DVec3>();
        if facing.normalize_or_zero().dot(normal) < LEAST_AGREEMENT {
            continue;
        }
        let (side, up) = normal.any_orthonormal_pair();
        let mut corners: Vec<u32> = Vec::new();
        earcut.earcut(points.iter().map(|p| [p.dot(side), p.dot(up)]), &[], &mut corners);
        for [a, b, c] in corners.as_chunks::<3>().0 {
            let [p, q, r] = [a, b, c].map(|corner| points[*corner as usize]);
            let is_turned = (q - p).cross(r - p).dot(normal) < 0.0;
            let [a, b, c] = if is_turned { [a, c, b] } else { [a, b, c] };
            mesh.triangles.push([a, b, c].map(|corner| rim[*corner as usize]));
        }
        filled += usize::from(!corners.is_empty());
    }
    filled
}

/// Returns the normal of the plane that a rim lies in, by the sense that it goes round; `None` if
/// the rim is larger than a diagonal or not flat.
fn plane(points: &[DVec3], max_diagonal: f64) -> Option<DVec3> {
    let low = points.iter().copied().reduce(DVec3::min)?;
    let high = points.iter().copied().reduce(DVec3::max)?;
    let diagonal = (high - low).length();
    if diagonal >= max_diagonal {
        return None;
    }
    let middle = points.iter().sum::<DVec3>() / points.len() as f64;
    // Newell's normal: the sum over the edges is twice the area of the rim in its mean plane.
    let edges = points.iter().zip(points.iter().cycle().skip(1));
    let normal = edges.map(|(a, b)| (*a - middle).cross(*b - middle)).sum::<DVec3>().try_normalize()?;
    let variance = points.iter().map(|p| (*p - middle).dot(normal).powi(2)).sum::<f64>() / points.len() as f64;
    (variance.sqrt() <= FLATNESS * diagonal).then_some(normal)
}

/// Returns the closed loops of edges without a triangle on their other side, in the sense that a
/// triangle there would have. Each begins at its lowest vertex that no other loop began at.
fn rims(mesh: &TriangleMesh) -> Vec<Vec<u32>> {
    let edges = || mesh.triangles.iter().flat_map(|[a, b, c]| [(*a, *b), (*b, *c), (*c, *a)]);
    let directed: HashSet<(u32, u32)> = edges().collect();
    let mut next: Vec<Vec<u32>> = vec![Vec::new(); mesh.positions.len()];
    for (from, to) in edges().filter(|(from, to)| !directed.contains(&(*to, *from))) {
        next[to as usize].push(from);
    }
    let mut rims = Vec::new();
    for start in 0..mesh.positions.len() as u32 {
        while let Some(mut vertex) = next[start as usize].pop() {
            let mut rim = vec![start];
            while vertex != start {
                rim.push(vertex);
                let Some(following) = next[vertex as usize].pop() else { break };
                vertex = following;
            }
            // Where loops touch, one may end in another.
            if vertex == start && rim.len() >= 3 {
                rims.push(rim);
            }
        }
    }
    rims
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of `side` x `side` squares of side 1 without some, its normals up.
    fn sheet(side: u32, is_hole: impl Fn(u32, u32) -> bool) -> TriangleMesh {
        let row = side + 1;
        let positions: Vec<[f32; 3]> = (0..row * row).map(|n| [(n % row) as f32, (n / row) as f32, 0.0]).collect();
        let squares = (0..side * side).map(|n| (n % side, n / side)).filter(|(x, y)| !is_hole(*x, *y));
        let triangles = squares.flat_map(|(x, y)| {
            let a = y * row + x;
            [[a, a + 1, a + row], [a + 1, a + row + 1, a + row]]
        });
        let count = positions.len();
        TriangleMesh { triangles: triangles.collect(), normals: vec![[0.0, 0.0, 1.0]; count], radiance: vec![[1.0; 3]; count], positions }
    }

    fn area(mesh: &TriangleMesh) -> f32 {
        let corner = |vertex: u32| Vec3::from(mesh.positions[vertex as usize]);
        mesh.triangles.iter().map(|[a, b, c]| 0.5 * (corner(*b) - corner(*a)).cross(corner(*c) - corner(*a)).z).sum()
    }

    #[test]
    fn a_hole_is_filled_with_the_same_side_up_and_the_outer_rim_stays_open() {
        let mut mesh = sheet(8, |x, y| (2..5).contains(&x) && (3..5).contains(&y) && (x, y) != (4, 3));
        assert_eq!(area(&mesh), 59.0);
        assert_eq!(fill_holes(&mut mesh, 20.0), 1);
        assert!((area(&mesh) - 64.0).abs() < 1e-4, "an L of five squares, each triangle with its front up");
        assert_eq!(fill_holes(&mut mesh, 20.0), 0);
    }

    #[test]
    fn holes_that_are_large_or_not_flat_stay() {
        let mut mesh = sheet(8, |x, y| (2..5).contains(&x) && (3..5).contains(&y));
        let before = mesh.triangles.len();
        assert_eq!(fill_holes(&mut mesh, 3.0), 0);
        for position in &mut mesh.positions {
            position[2] = 0.3 * (position[0] - 4.0).powi(2);
        }
        assert_eq!(fill_holes(&mut mesh, 20.0), 0);
        assert_eq!(mesh.triangles.len(), before);
    }

    #[test]
    fn holes_that_touch_in_a_corner_are_filled_both() {
        let mut mesh = sheet(6, |x, y| (x, y) == (2, 2) || (x, y) == (3, 3));
        fill_holes(&mut mesh, 8.0);
        assert!((area(&mesh) - 36.0).abs() < 1e-4);
    }
}

//! Fewer triangles, by collapsing edges in the order of their quadric errors (Garland and Heckbert
//! 1997), in the form of meshoptimizer: vertices that stay keep position, normal and radiance.
//!
//! In: a mesh, a number of triangles. Out: the mesh with about as many. Degenerate: where the
//! topology forbids further collapses, more are left.

use crate::TriangleMesh;

/// Simplifies a mesh.
pub(crate) fn simplify(mesh: &mut TriangleMesh, triangles: usize) {
    if mesh.triangles.len() <= triangles {
        return;
    }
    let indices = mesh.triangles.as_flattened().to_vec();
    let mut left = vec![0; indices.len()];
    // The error may be whatever the number asks for.
    let count = meshopt_rs::simplify::simplify(&mut left, &indices, &mesh.positions, 3 * triangles, f32::MAX.sqrt());
    mesh.triangles = left[..count].as_chunks::<3>().0.to_vec();
    mesh.keep(|_| true);
}

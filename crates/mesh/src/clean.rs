//! Islands: parts of a mesh that hang together.
//!
//! In: a mesh, a length. Out: the mesh without the islands whose bounding box has a shorter
//! diagonal. Degenerate: a length of 0 keeps all.

use crate::TriangleMesh;

/// Removes small islands; returns how many.
pub(crate) fn remove_islands(mesh: &mut TriangleMesh, min_diagonal: f64) -> usize {
    let mut parent: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    for [a, b, c] in &mesh.triangles {
        join(&mut parent, *a, *b);
        join(&mut parent, *b, *c);
    }
    let roots: Vec<u32> = (0..parent.len() as u32).map(|vertex| root(&mut parent, vertex)).collect();
    let mut boxes = vec![[[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]; roots.len()];
    for (vertex, position) in mesh.positions.iter().enumerate() {
        let [low, high] = &mut boxes[roots[vertex] as usize];
        *low = [0, 1, 2].map(|c| low[c].min(position[c]));
        *high = [0, 1, 2].map(|c| high[c].max(position[c]));
    }
    let diagonal = |[low, high]: &[[f32; 3]; 2]| (0..3).map(|c| f64::from(high[c] - low[c]).powi(2)).sum::<f64>().sqrt();
    let is_small: Vec<bool> = boxes.iter().map(|corners| diagonal(corners) < min_diagonal).collect();
    let islands = (0..roots.len()).filter(|vertex| roots[*vertex] as usize == *vertex && is_small[*vertex]).count();
    mesh.keep(|[a, ..]| !is_small[roots[*a as usize] as usize]);
    islands
}

/// Returns the vertex that stands for an island, and shortens the way to it.
fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        parent[vertex as usize] = parent[parent[vertex as usize] as usize];
        vertex = parent[vertex as usize];
    }
    vertex
}

fn join(parent: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parent, a), root(parent, b));
    // The first of both stands for them.
    parent[a.max(b) as usize] = a.min(b);
}

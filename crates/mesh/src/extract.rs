//! The surface of a volume, by naive surface nets (Gibson 1998): a vertex in each cell of eight
//! voxels that the surface crosses, and a quad across each edge.
//!
//! In: a [`Volume`]. Out: a [`TriangleMesh`], in blocks that join without seams. Degenerate: cells
//! with a voxel whose distance is unknown have no vertex, so the mesh ends where no view saw.

use std::collections::HashMap;

use fast_surface_nets::ndshape::{ConstShape, ConstShape3u32};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::Vec3;
use rayon::prelude::*;

use crate::TriangleMesh;
use crate::volume::{Place, SIDE, Volume, Voxel};

/// Voxels of a block and two more behind: a cell needs the next voxel, and a quad the next cell.
const PADDED: usize = SIDE + 2;
type PaddedShape = ConstShape3u32<{ PADDED as u32 }, { PADDED as u32 }, { PADDED as u32 }>;

/// A vertex, by the place of its cell.
struct CellVertex {
    cell: Place,
    /// Within the block, voxels.
    position: [f32; 3],
    normal: [f32; 3],
    radiance: [f32; 3],
}

/// The surface in a block; triangles hold numbers of its vertices.
struct BlockSurface {
    vertices: Vec<CellVertex>,
    triangles: Vec<[u32; 3]>,
}

/// Extracts the surface; `voxel` is the side of a voxel.
pub(crate) fn extract(volume: &Volume, voxel: f64) -> TriangleMesh {
    let surfaces: Vec<(Place, BlockSurface)> =
        volume.places.par_iter().filter_map(|place| Some((*place, block_surface(volume, *place)?))).collect();
    let mut mesh = TriangleMesh::default();
    let mut numbers: HashMap<Place, u32> = HashMap::new();
    for (place, surface) in surfaces {
        let base = place.map(|v| f64::from(v) * SIDE as f64 + 0.5);
        let mut number = |vertex: &CellVertex| {
            *numbers.entry(vertex.cell).or_insert_with(|| {
                mesh.positions.push([0, 1, 2].map(|c| (voxel * (base[c] + f64::from(vertex.position[c]))) as f32));
                mesh.normals.push(vertex.normal);
                mesh.radiance.push(vertex.radiance);
                (mesh.positions.len() - 1) as u32
            })
        };
        let in_mesh: Vec<u32> = surface.vertices.iter().map(&mut number).collect();
        mesh.triangles.extend(surface.triangles.iter().map(|corners| corners.map(|corner| in_mesh[corner as usize])));
    }
    mesh
}

/// Extracts the surface in a block; `None` where there is none.
fn block_surface(volume: &Volume, place: Place) -> Option<BlockSurface> {
    let blocks = volume.corner(place);
    let at = |x: usize, y: usize, z: usize| -> Option<&Voxel> {
        let block = blocks[x / SIDE + 2 * (y / SIDE) + 4 * (z / SIDE)]?;
        block.get((z % SIDE * SIDE + y % SIDE) * SIDE + x % SIDE)
    };
    let voxels: Vec<Option<&Voxel>> =
        (0..PADDED * PADDED * PADDED).map(|n| at(n % PADDED, n / PADDED % PADDED, n / (PADDED * PADDED))).collect();
    let known = |n: usize| voxels[n].is_some_and(|voxel| !voxel.distance.is_nan());
    if !(0..voxels.len()).any(|n| known(n) && voxels[n].is_some_and(|voxel| voxel.distance < 0.0)) {
        return None;
    }
    // Unknown counts as free; the faces that come of it are dropped.
    let distances: Vec<f32> = (0..voxels.len()).map(|n| if known(n) { voxels[n].map_or(1.0, |v| v.distance) } else { 1.0 }).collect();
    let mut net = SurfaceNetsBuffer::default();
    surface_nets(&distances, &PaddedShape {}, [0; 3], [PADDED as u32 - 1; 3], &mut net);
    let corners = |[x, y, z]: [u32; 3]| -> [usize; 8] {
        std::array::from_fn(|n| PaddedShape::linearize([0, 1, 2].map(|c| [x, y, z][c] + (n >> c & 1) as u32)) as usize)
    };
    let is_whole: Vec<bool> = net.surface_points.iter().map(|cell| corners(*cell).into_iter().all(known)).collect();
    let triangles: Vec<[u32; 3]> =
        net.indices.as_chunks::<3>().0.iter().copied().filter(|corners| corners.iter().all(|corner| is_whole[*corner as usize])).collect();
    if triangles.is_empty() {
        return None;
    }
    let vertex = |n: usize| {
        let cell = net.surface_points[n];
        CellVertex {
            cell: [0, 1, 2].map(|c| place[c] * SIDE as i32 + cell[c] as i32),
            position: net.positions[n],
            normal: Vec3::from(net.normals[n]).normalize_or(Vec3::Y).to_array(),
            radiance: radiance(&corners(cell), &voxels),
        }
    };
    let mut number = vec![u32::MAX; net.positions.len()];
    let mut vertices = Vec::new();
    let mut renumbered = |old: u32| {
        let new = &mut number[old as usize];
        if *new == u32::MAX {
            *new = vertices.len() as u32;
            vertices.push(vertex(old as usize));
        }
        *new
    };
    let triangles = triangles.into_iter().map(|corners| corners.map(&mut renumbered)).collect();
    Some(BlockSurface { vertices, triangles })
}

/// Returns the mean radiance of a cell's voxels, by weight.
fn radiance(corners: &[usize; 8], voxels: &[Option<&Voxel>]) -> [f32; 3] {
    let (mut sum, mut weight) = ([0.0f32; 3], 0.0);
    for voxel in corners.iter().filter_map(|corner| voxels[*corner]) {
        sum = [0, 1, 2].map(|c| voxel.weight.mul_add(voxel.radiance[c], sum[c]));
        weight += voxel.weight;
    }
    if weight > 0.0 { sum.map(|c| c / weight) } else { sum }
}

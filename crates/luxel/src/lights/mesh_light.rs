//! Lamps of no simple shape: tubes, rings, strings of lamps. They become a mesh around their
//! splats.
//!
//! In: a group of splats, and the light that cameras see of it. Out: a closed surface that shines
//! alike everywhere. Its light towards a direction is its radiance times the area that is seen of
//! it from there, so that a tube shines less along its axis. The surface is that of the splats'
//! ellipsoids, of such a size that its area is the one that the cameras see; the radiance is fitted
//! to what they see.
//!
//! Degenerate: a round group, and one whose light a ball or a flat lamp explains as well, has no
//! mesh.

use glam::{DMat3, DVec2, DVec3};
use luxel_core::Scene;
use luxel_io::LightMesh;
use luxel_mesh::{Grid, TriangleMesh};

use super::emitters::{Emitter, covariance};
use super::fit::{self, Distribution, Fit, Sample};
use super::windows::least_axis;
use crate::photograph::GOLDEN_TURN;

/// Length over the mean of the sides across it, in standard deviations, from which on a group is no
/// ball.
const LEAST_LENGTH: f64 = 2.5;
/// Width over thickness up to which a long group is a tube and no strip.
const MOST_WIDTH: f64 = 2.0;
/// Part of the rectangle around a flat lamp that shines, from which on it is one.
const LEAST_FILL: f64 = 0.5;
/// Area of a rectangle over the product of its standard deviations.
const RECTANGLE: f64 = 12.0;
/// Part of the group's light whose splats make the surface, the strongest first.
const LIGHT_SHARE: f64 = 0.98;
/// Voxels along the longest side.
const MOST_VOXELS: f64 = 64.0;
/// Smallest standard deviation of a splat, voxels: thinner ones would have holes.
const LEAST_SIGMA: f64 = 0.75;
/// Distances from the splats, in standard deviations, between which the surface is.
const LEVELS: [f64; 2] = [0.5, 2.5];
/// Halvings of these in search of the surface.
const HALVINGS: usize = 5;
/// Triangles of the mesh.
const MOST_TRIANGLES: usize = 512;
/// Pixels along a side by which seen areas are counted.
const AREA_PX: usize = 128;
/// Directions of the mean area, on one half of the sphere: the other half sees the same.
const DIRECTIONS: u32 = 48;
/// Steps of the iterations for the longest axis.
const STEPS: usize = 64;

/// A mesh that explains the light of a lamp, local coordinates of the scene and normalised
/// radiance.
#[derive(Clone, Debug)]
pub(super) struct MeshFit {
    pub(super) mesh: LightMesh,
    pub(super) radiance: [f64; 3],
    /// Root mean square error over the mean intensity.
    pub(super) error: f64,
}

/// Returns a mesh if it explains the shape of a group, or its light, better than a simple shape.
pub(super) fn mesh_fit(scene: &Scene, emitter: &Emitter, samples: &[Sample], simple: &Fit) -> Option<MeshFit> {
    let [length, width, thickness] = sides(&emitter.covariance(scene));
    let is_long = length >= LEAST_LENGTH * f64::midpoint(width, thickness);
    let is_another = match simple.distribution {
        Distribution::Ball => is_long,
        // What shines may fill little of the plane that it is in: a bent tube, a ring.
        Distribution::Flat(_) => (is_long && width <= MOST_WIDTH * thickness) || simple.area < LEAST_FILL * RECTANGLE * length * width,
    };
    if !is_another && simple.error < fit::ALIKE {
        return None;
    }
    let grid = distances(scene, emitter)?;
    let mesh = sized(&grid, samples)?;
    let areas: Vec<f64> = samples.iter().map(|sample| seen_area(&mesh, sample.towards)).collect();
    let fit::Scaled { intensity: radiance, error, .. } = fit::scaled(samples, &areas)?;
    let is_better = fit::LEAST_GAIN * error < simple.error || (is_another && error <= simple.error.max(fit::ALIKE));
    is_better.then(|| MeshFit { mesh: light_mesh(&mesh, emitter.middle), radiance, error })
}

/// Returns the standard deviations along the axes of a covariance, the longest first.
fn sides(covariance: &DMat3) -> [f64; 3] {
    let start = DVec3::new(0.61, 0.53, 0.59).normalize();
    let along = |axis: DVec3| axis.dot(*covariance * axis);
    let longest = (0..STEPS).try_fold(start, |v, _| (*covariance * v).try_normalize()).map_or(0.0, along);
    let shortest = least_axis(covariance).map_or(0.0, along);
    let whole = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    [longest, whole - longest - shortest, shortest].map(|square| square.max(0.0).sqrt())
}

/// Returns the distance to the nearest splat that makes the surface, in its standard deviations.
fn distances(scene: &Scene, emitter: &Emitter) -> Option<Grid> {
    let mut splats: Vec<(u32, DVec3, f64)> =
        emitter.splats.iter().zip(emitter.placed(scene)).map(|(i, (p, weight))| (*i, p, weight)).collect();
    splats.sort_by(|a, b| b.2.total_cmp(&a.2));
    let (mut left, least) = (emitter.weight(), (1.0 - LIGHT_SHARE) * emitter.weight());
    let is_needed = |(_, _, weight): &&(u32, DVec3, f64)| {
        let is_needed = left > least;
        left -= weight;
        is_needed
    };
    let strong = splats.iter().take_while(is_needed).count();
    let ellipsoids: Vec<(DVec3, DMat3)> = splats[..strong].iter().map(|(i, p, _)| (*p, covariance(scene, *i))).collect();
    let reach = |covariance: &DMat3| LEVELS[1] * DVec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z).sqrt();
    let low = ellipsoids.iter().map(|(p, covariance)| *p - reach(covariance)).reduce(DVec3::min)?;
    let high = ellipsoids.iter().map(|(p, covariance)| *p + reach(covariance)).reduce(DVec3::max)?;
    let voxel = (high - low).max_element() / MOST_VOXELS;
    if !(voxel.is_finite() && voxel > 0.0) {
        return None;
    }
    // Room for splats that are widened, and a border that none reaches.
    let origin = low - voxel * (LEVELS[1] * LEAST_SIGMA + 2.0);
    let size = ((high - origin) / voxel + LEVELS[1] * LEAST_SIGMA + 3.0).to_array().map(|side| side.ceil() as usize);
    let mut values = vec![2.0 * LEVELS[1] as f32; size.iter().product()];
    for (p, covariance) in ellipsoids {
        let widened = covariance + DMat3::from_diagonal(DVec3::splat((LEAST_SIGMA * voxel).powi(2)));
        let (inverse, reach) = (widened.inverse(), reach(&widened));
        let from = ((p - reach - origin) / voxel).max(DVec3::ONE).to_array().map(|v| v as usize);
        let to = ((p + reach - origin) / voxel).to_array().map(|v| v.ceil() as usize);
        for z in from[2]..=to[2].min(size[2] - 2) {
            for y in from[1]..=to[1].min(size[1] - 2) {
                for x in from[0]..=to[0].min(size[0] - 2) {
                    let d = origin + voxel * DVec3::new(x as f64, y as f64, z as f64) - p;
                    let value = &mut values[(z * size[1] + y) * size[0] + x];
                    *value = value.min(d.dot(inverse * d).max(0.0).sqrt() as f32);
                }
            }
        }
    }
    Some(Grid { size, origin: origin.to_array().map(|v| v as f32), voxel: voxel as f32, values })
}

/// Returns the surface whose area is the one that the cameras see.
fn sized(grid: &Grid, samples: &[Sample]) -> Option<TriangleMesh> {
    let [mut low, mut high] = LEVELS;
    let seen: f64 = samples.iter().map(|sample| sample.area).sum();
    let mut best = None;
    for _ in 0..HALVINGS {
        let level = 0.5 * (low + high);
        let mesh = grid.surface(level as f32, MOST_TRIANGLES);
        let area: f64 = samples.iter().map(|sample| seen_area(&mesh, sample.towards)).sum();
        *(if area < seen { &mut low } else { &mut high }) = level;
        best = Some(mesh);
    }
    best.filter(|mesh| !mesh.triangles.is_empty())
}

/// Returns the area of a closed mesh that is seen from afar in a direction: that of its outline.
fn seen_area(mesh: &TriangleMesh, towards: DVec3) -> f64 {
    let (u, v) = towards.any_orthonormal_pair();
    let across = |p: &[f32; 3]| {
        let p = DVec3::from_array(p.map(f64::from));
        DVec2::new(p.dot(u), p.dot(v))
    };
    let points: Vec<DVec2> = mesh.positions.iter().map(across).collect();
    let (Some(low), Some(high)) = (points.iter().copied().reduce(DVec2::min), points.iter().copied().reduce(DVec2::max)) else {
        return 0.0;
    };
    let pixel = (high - low) / AREA_PX as f64;
    let mut is_covered = vec![false; AREA_PX * AREA_PX];
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|corner| (points[corner as usize] - low) / pixel);
        cover(&mut is_covered, [a, b, c]);
    }
    is_covered.iter().filter(|covered| **covered).count() as f64 * pixel.x * pixel.y
}

/// Marks the pixels whose middles are within a triangle.
fn cover(is_covered: &mut [bool], [a, b, c]: [DVec2; 3]) {
    let area = (b - a).perp_dot(c - a);
    let pixels =
        |low: f64, high: f64| (low - 0.5).ceil().max(0.0) as usize..=(high - 0.5).floor().clamp(-1.0, AREA_PX as f64 - 1.0) as usize;
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    for y in pixels(low.y, high.y) {
        for x in pixels(low.x, high.x) {
            let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let is_within = |from: DVec2, to: DVec2| (to - from).perp_dot(p - from) * area >= 0.0;
            is_covered[y * AREA_PX + x] |= is_within(a, b) && is_within(b, c) && is_within(c, a);
        }
    }
}

fn light_mesh(mesh: &TriangleMesh, middle: DVec3) -> LightMesh {
    // Directions that are spread evenly, as the seeds of a sunflower are.
    let direction = |i: u32| {
        let z = (f64::from(i) + 0.5) / f64::from(DIRECTIONS);
        let (sin, cos) = (std::f64::consts::TAU * GOLDEN_TURN * f64::from(i)).sin_cos();
        DVec3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z)
    };
    let mean_area = (0..DIRECTIONS).map(|i| seen_area(mesh, direction(i))).sum::<f64>() / f64::from(DIRECTIONS);
    let points = mesh.positions.iter().map(|p| DVec3::from_array(p.map(f64::from)) - middle).collect();
    LightMesh { points, triangles: mesh.triangles.clone(), mean_area }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outline_of_a_box_is_its_seen_area() {
        // 1 x 2 x 3, seen along z and along x.
        let corner = |i: u32| [(i & 1) as f32, 2.0 * (i >> 1 & 1) as f32, 3.0 * (i >> 2) as f32];
        let sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        let mesh = TriangleMesh {
            positions: (0..8).map(corner).collect(),
            triangles: sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect(),
            ..TriangleMesh::default()
        };
        assert!((seen_area(&mesh, DVec3::Z) - 2.0).abs() < 1e-9, "{}", seen_area(&mesh, DVec3::Z));
        assert!((seen_area(&mesh, DVec3::NEG_X) - 6.0).abs() < 1e-9);
        // The mean area of a convex body is a quarter of its surface (Cauchy).
        let mean = light_mesh(&mesh, DVec3::ZERO).mean_area;
        assert!((mean / 5.5 - 1.0).abs() < 0.02, "{mean}");
    }

    #[test]
    fn sides_are_standard_deviations_in_order() {
        let near = |found: [f64; 3], expected: [f64; 3]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(sides(&DMat3::from_diagonal(DVec3::new(1.0, 9.0, 4.0))), [3.0, 2.0, 1.0]));
        assert!(near(sides(&DMat3::IDENTITY), [1.0; 3]));
        assert!(near(sides(&DMat3::ZERO), [0.0; 3]));
    }
}

//! The scale by square markers of known size.
//!
//! In: the directions in which views see the corners of markers, each with its number. Out:
//! [`MarkerFit`], the length of a marker's edge in the reconstruction's unit. Corners are where the
//! rays of the views meet best. Degenerate: markers that one view sees, or views from almost one
//! direction, say nothing; rays of one number that do not meet are of several markers, or of one
//! that moved, and corners that form no square are wrong.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use serde::Serialize;

use super::eigen::{median, outer};

/// Least angle between two rays of a corner, radians: below, its distance is a guess.
const MIN_ANGLE: f64 = 0.026;
/// Largest angle between a ray and the corner that it is of, radians.
const MAX_MISS: f64 = 0.01;
/// Largest deviation of an edge from the mean of its marker's edges, and of a diagonal from that of
/// a square, as a fraction.
const MAX_SKEW: f64 = 0.1;

/// A marker in a view.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerSighting {
    /// Number of the marker.
    pub id: usize,
    /// Centre of the camera, in the reconstruction's coordinates.
    pub eye: DVec3,
    /// Directions from there to the corners, one after the other around the marker.
    pub corners: [DVec3; 4],
}

/// The size of markers in a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarkerFit {
    /// Number of markers.
    pub markers: usize,
    /// Edge of a marker, metres, as given.
    pub edge_m: f64,
    /// Metres in a unit of the reconstruction.
    pub metres_per_unit: f64,
    /// Median deviation of the edges from that, as a fraction.
    pub deviation: f64,
}

/// Measures markers with edges of `edge_m` metres.
///
/// # Errors
/// Why no marker gives a scale, for people.
pub fn fit_markers(sightings: &[MarkerSighting], edge_m: f64) -> Result<MarkerFit, String> {
    let mut by_id: BTreeMap<usize, Vec<&MarkerSighting>> = BTreeMap::new();
    for sighting in sightings {
        by_id.entry(sighting.id).or_default().push(sighting);
    }
    if by_id.is_empty() {
        return Err("no marker was found in the views that have poses".to_owned());
    }
    let (mut edges, mut reasons) = (Vec::new(), Vec::new());
    let mut markers = 0;
    for (id, seen) in &by_id {
        match edges_of(seen) {
            Ok(found) => {
                edges.extend(found);
                markers += 1;
            }
            Err(reason) => reasons.push(format!("marker {id} {reason}")),
        }
    }
    if edges.is_empty() {
        return Err(reasons.join("; "));
    }
    let edge = median(edges.iter().copied());
    let deviation = median(edges.iter().map(|other| (other / edge - 1.0).abs()));
    Ok(MarkerFit { markers, edge_m, metres_per_unit: edge_m / edge, deviation })
}

/// Returns the lengths of a marker's edges, or why it has none.
fn edges_of(seen: &[&MarkerSighting]) -> Result<[f64; 4], &'static str> {
    let mut corners = [DVec3::ZERO; 4];
    for (k, corner) in corners.iter_mut().enumerate() {
        let rays: Vec<Ray> = seen.iter().map(|s| Ray { eye: s.eye, direction: s.corners[k].normalize() }).collect();
        *corner = meeting_point(&rays)?;
    }
    let edges: [f64; 4] = std::array::from_fn(|k| corners[k].distance(corners[(k + 1) % 4]));
    let mean = edges.iter().sum::<f64>() / 4.0;
    let diagonals = [corners[0].distance(corners[2]), corners[1].distance(corners[3])].map(|length| length / 2f64.sqrt());
    let is_square = edges.iter().chain(&diagonals).all(|length| (length / mean - 1.0).abs() <= MAX_SKEW);
    if is_square { Ok(edges) } else { Err("is no square as the views see it") }
}

/// A line of sight.
struct Ray {
    eye: DVec3,
    /// Unit vector.
    direction: DVec3,
}

/// Returns the point nearest to all rays.
fn meeting_point(rays: &[Ray]) -> Result<DVec3, &'static str> {
    let is_wide = |a: &Ray| rays.iter().any(|b| a.direction.angle_between(b.direction) >= MIN_ANGLE);
    if !rays.iter().any(is_wide) {
        return Err("is seen from one direction only");
    }
    let (mut matrix, mut sum) = (DMat3::ZERO, DVec3::ZERO);
    for ray in rays {
        let across = DMat3::IDENTITY - outer(ray.direction);
        matrix += across;
        sum += across * ray.eye;
    }
    let point = matrix.inverse() * sum;
    let misses = |ray: &Ray| (point - ray.eye).angle_between(ray.direction) > MAX_MISS;
    if !point.is_finite() || rays.iter().any(misses) {
        return Err("is in different places in different views: each number must be there once, and nothing may move");
    }
    Ok(point)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A marker with an edge of `edge` at `at`, turned about y, seen from `eyes`.
    fn sightings(id: usize, at: DVec3, edge: f64, eyes: &[DVec3]) -> Vec<MarkerSighting> {
        let turn = DMat3::from_rotation_y(0.4);
        let corner = |[x, y]: [f64; 2]| at + turn * DVec3::new(x, y, 0.0) * edge;
        let corners = [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]].map(corner);
        eyes.iter().map(|eye| MarkerSighting { id, eye: *eye, corners: corners.map(|corner| (corner - eye).normalize()) }).collect()
    }

    #[test]
    fn markers_of_known_size_give_the_scale() {
        let eyes = [-0.5, 0.0, 0.5].map(|x| DVec3::new(x, 0.1 * x, 0.0));
        let two = [sightings(7, DVec3::new(0.1, 0.2, 3.0), 0.4, &eyes), sightings(3, DVec3::new(-0.6, 0.0, 4.0), 0.4, &eyes[..2])].concat();
        let fit = fit_markers(&two, 0.1).unwrap();
        assert_eq!((fit.markers, fit.edge_m), (2, 0.1));
        assert!((fit.metres_per_unit - 0.25).abs() < 1e-9 && fit.deviation < 1e-9, "{fit:?}");
    }

    #[test]
    fn what_gives_no_scale_says_why() {
        let eyes = [DVec3::ZERO, DVec3::X];
        let refused = |sightings: &[MarkerSighting]| fit_markers(sightings, 0.1).unwrap_err();
        assert!(refused(&[]).contains("no marker was found"));
        let at = DVec3::new(0.0, 0.0, 3.0);
        assert!(refused(&sightings(1, at, 0.3, &eyes[..1])).contains("marker 1 is seen from one direction only"));
        let moved = [sightings(5, at, 0.3, &eyes[..1]), sightings(5, at + 0.5 * DVec3::Y, 0.3, &eyes[1..])].concat();
        assert!(refused(&moved).contains("marker 5 is in different places"), "{}", refused(&moved));
        let mut skewed = sightings(2, at, 0.3, &eyes);
        skewed.iter_mut().zip(eyes).for_each(|(s, eye)| s.corners[0] = (DVec3::new(-0.5, 0.6, 3.0) - eye).normalize());
        assert!(refused(&skewed).contains("marker 2 is no square"), "{}", refused(&skewed));
        // One that is wrong does not spoil one that is right.
        let fit = fit_markers(&[skewed, sightings(1, at, 0.2, &eyes)].concat(), 0.1).unwrap();
        assert!(fit.markers == 1 && (fit.metres_per_unit - 0.5).abs() < 1e-9, "{fit:?}");
    }
}

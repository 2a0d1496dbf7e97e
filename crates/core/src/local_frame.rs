//! The coordinates in which a data set or a scene is held: near its own origin and of usual size,
//! so that f32 resolves it and all absolute lengths (near plane, noise, regularisers) fit it.
//!
//! In: centre and size of a scene, world units. Out: the [`Similarity`] from held (local)
//! coordinates to the world, the coordinates of the files that people give and get. It is the
//! identity for scenes of usual size near the world's origin. Otherwise the origin moves to the
//! scene, to a round number, and lengths are divided by a power of two, which is exact in floating
//! point.
//!
//! Degenerate: without cameras and points, or with all of them at one place, lengths stay as they
//! are.

use glam::DVec3;

use crate::Similarity;

/// Sizes for which lengths stay as they are, world units.
const USUAL_SIZES: [f64; 2] = [0.5, 256.0];
/// Size that other scenes are brought to, within a factor of two.
const LOCAL_SIZE: f64 = 2.0;
/// Distance from the world's origin, in sizes of the scene, from which the origin moves. Up to it,
/// f32 resolves a scene to 2^-18 of its size.
const FAR: f64 = 32.0;
/// The same in world units for a scene without size.
const FAR_POINT: f64 = 1e4;
/// The part of the cameras that the size is measured by; the others may be strays.
const MOST: f64 = 0.9;
/// Ratio of the typical distance of points to the spread of the cameras up to which points count.
/// Points further away may be in another world.
const NEAR_POINTS: f64 = 64.0;

/// Typical distance of what cameras see, in spreads of the cameras.
const SIGHT: f64 = 8.0;

/// Centre and size of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneBounds {
    /// Median of the cameras, or of the splats of a scene without cameras; world.
    pub center: DVec3,
    /// Typical distance from the centre, world units; 0 for a single point.
    pub size: f64,
}

impl SceneBounds {
    /// Returns the bounds of cameras at `eyes` that see `points`; `None` without cameras.
    pub fn from_views(eyes: &[DVec3], points: &[DVec3]) -> Option<Self> {
        let center = median(eyes)?;
        let spread = quantile(eyes.iter().map(|eye| eye.distance(center)), MOST);
        let typical = quantile(points.iter().map(|point| point.distance(center)), 0.5);
        let limit = if spread > 0.0 { NEAR_POINTS * spread } else { f64::INFINITY };
        // Cameras see further than they are apart: without points, a scene may be of usual size.
        let seen = if points.is_empty() { USUAL_SIZES[0].min(SIGHT * spread) } else { typical.min(limit) };
        Some(Self { center, size: spread.max(seen) })
    }

    /// Returns the bounds of splats or points alone; `None` without any.
    pub fn from_points(points: &[DVec3]) -> Option<Self> {
        let center = median(points)?;
        Some(Self { center, size: quantile(points.iter().map(|point| point.distance(center)), 0.5) })
    }

    /// Returns the transform from local coordinates to the world; the identity for a scene of usual
    /// size near the origin.
    ///
    /// ```
    /// use glam::DVec3;
    /// use luxel_core::{SceneBounds, Similarity};
    ///
    /// let room = SceneBounds { center: DVec3::new(1.0, 0.0, -2.0), size: 3.0 };
    /// assert_eq!(room.world_from_local(), Similarity::IDENTITY);
    /// // A room at UTM coordinates.
    /// let far = SceneBounds { center: DVec3::new(455_123.4, 4_600_321.7, 212.6), size: 3.0 };
    /// assert_eq!(far.world_from_local().translation(), DVec3::new(455_123.0, 4_600_322.0, 213.0));
    /// assert_eq!(far.world_from_local().scale(), 1.0);
    /// ```
    pub fn world_from_local(&self) -> Similarity {
        let is_far = if self.size > 0.0 { self.center.length() > FAR * self.size } else { self.center.length() > FAR_POINT };
        let origin = if is_far { self.round_center() } else { DVec3::ZERO };
        let is_usual = self.size == 0.0 || (USUAL_SIZES[0]..=USUAL_SIZES[1]).contains(&self.size);
        let unit = if is_usual { 1.0 } else { (self.size / LOCAL_SIZE).log2().floor().exp2() };
        Similarity::new(glam::DMat3::IDENTITY, unit, origin).unwrap_or(Similarity::IDENTITY)
    }

    /// Returns the centre, rounded to a power of ten below the size.
    fn round_center(&self) -> DVec3 {
        let digits = if self.size > 0.0 { self.size.log10().floor() as i32 } else { 0 };
        // Powers of ten of 0 or more are exact, so that the results have few digits.
        let step = 10f64.powi(digits.abs());
        if digits >= 0 { (self.center / step).round() * step } else { (self.center * step).round() / step }
    }
}

fn median(points: &[DVec3]) -> Option<DVec3> {
    (!points.is_empty()).then(|| DVec3::from_array([0, 1, 2].map(|axis| quantile(points.iter().map(|p| p[axis]), 0.5))))
}

/// Returns the value below which `part` of the finite values are; 0 for none.
fn quantile(values: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let at = (part * values.len().saturating_sub(1) as f64).round() as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(center: [f64; 3], size: f64) -> Similarity {
        SceneBounds { center: DVec3::from_array(center), size }.world_from_local()
    }

    #[test]
    fn scenes_of_usual_size_near_the_origin_stay_as_they_are() {
        for size in [0.5, 1.0, 3.0, 40.0, 256.0] {
            for center in [[0.0; 3], [size, -2.0 * size, size], [30.0 * size, 0.0, 0.0]] {
                assert!(frame(center, size).is_identity(), "{size} {center:?}");
            }
        }
        // Nothing is known of the size of a single point.
        assert!(frame([40.0, 0.0, 0.0], 0.0).is_identity());
    }

    #[test]
    fn other_sizes_are_divided_by_a_power_of_two() {
        for size in [1e-6, 3e-3, 0.4, 257.0, 3e4, 1e9] {
            let unit = frame([0.0; 3], size).scale();
            assert_eq!(unit.log2().fract(), 0.0, "{size}");
            assert!((2.0..4.0).contains(&(size / unit)), "{size}: {unit}");
        }
    }

    #[test]
    fn far_scenes_get_an_origin_of_round_numbers_within_their_size() {
        for (center, size) in [([2_600_012.34, 1_200_045.67, 455.0], 12.0), ([4.1e6, 6.2e5, 4.8e6], 0.02), ([1.0, 1.0, 1.0], 1e-3)] {
            let origin = frame(center, size).translation();
            assert!(origin.distance(DVec3::from_array(center)) < size, "{origin}");
        }
        assert_eq!(frame([2_600_012.34, 1_200_045.67, 455.0], 12.0).translation(), DVec3::new(2_600_010.0, 1_200_050.0, 460.0));
        assert_eq!(frame([-7e4, 3.0, 2.4], 0.0).translation(), DVec3::new(-7e4, 3.0, 2.0));
    }

    #[test]
    fn stray_cameras_and_points_of_another_world_do_not_set_the_size() {
        let mut eyes: Vec<DVec3> = (0..40).map(|i| 3.0 * DVec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.1)).collect();
        eyes.push(DVec3::splat(1e9));
        let bounds = SceneBounds::from_views(&eyes, &[DVec3::splat(1e8)]).unwrap();
        assert!(bounds.world_from_local().is_identity() && bounds.size < 256.0, "{bounds:?}");
        assert_eq!(SceneBounds::from_views(&[], &[]), None);
        // Without points, cameras near each other may see far.
        let eyes = [DVec3::ZERO, DVec3::X * 0.1, DVec3::Y * 0.1];
        assert!(SceneBounds::from_views(&eyes, &[]).unwrap().world_from_local().is_identity());
        // Cameras at one place: the points tell the size.
        let bounds = SceneBounds::from_views(&[DVec3::ZERO; 3], &[DVec3::X, DVec3::X * 5.0, DVec3::X * 7.0]).unwrap();
        assert_eq!(bounds.size, 5.0);
    }
}

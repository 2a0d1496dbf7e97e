//! Projections: how a direction in camera space becomes a place on the image plane.
//!
//! In: points in camera space (x right, y down, z forward, any unit). Out: coordinates on the
//! plane, which focal lengths scale and the principal point shifts to pixels, with the depth; and
//! back. Depth is z for the pinhole, the distance from the camera for the others, which see further
//! than 90 degrees from their axis. Sources: the fisheye is OpenCV's (Kannala and Brandt 2006): the
//! radius is theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) at the angle theta to
//! the axis. The panorama is equirectangular: longitude to the right, latitude downwards, so that
//! focal lengths are pixels per radian. Degenerate: `None` behind a pinhole, outside of a fisheye's
//! field, at the camera itself, and beyond the poles.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Largest angle to the axis of a fisheye for which no field is stated: 200 degrees across.
pub const USUAL_FISHEYE_ANGLE_RAD: f64 = 100.0 * PI / 180.0;
/// Largest angle to the axis that a fisheye may state: 300 degrees across.
pub const MAX_FISHEYE_ANGLE_RAD: f64 = 150.0 * PI / 180.0;

/// Steps of Newton's method within brackets; each halves them at least.
const INVERSE_STEPS: usize = 60;

/// A fisheye lens of OpenCV's model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fisheye {
    /// k1 to k4.
    pub coefficients: [f64; 4],
    /// Angle to the axis, radians, up to which the lens sees.
    pub max_angle_rad: f64,
}

impl Fisheye {
    /// Returns the lens with its field: up to [`USUAL_FISHEYE_ANGLE_RAD`] from the axis, or less
    /// where its radius stops growing sooner.
    pub fn new(coefficients: [f64; 4]) -> Self {
        let lens = Self { coefficients, max_angle_rad: USUAL_FISHEYE_ANGLE_RAD };
        Self { max_angle_rad: lens.growing_to(USUAL_FISHEYE_ANGLE_RAD), ..lens }
    }

    /// Returns the radius at an angle to the axis, for a focal length of 1.
    pub fn radius(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.coefficients;
        let t2 = angle * angle;
        angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    }

    /// Returns the derivative of the radius by the angle.
    pub fn radius_derivative(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.coefficients;
        let t2 = angle * angle;
        1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
    }

    /// Returns the angle at a radius; `None` beyond the field.
    pub fn angle(&self, radius: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, self.max_angle_rad);
        if !(0.0..=self.radius(high)).contains(&radius) {
            return None;
        }
        let mut angle = radius.min(high);
        for _ in 0..INVERSE_STEPS {
            let excess = self.radius(angle) - radius;
            if excess > 0.0 {
                high = angle;
            } else {
                low = angle;
            }
            let newton = angle - excess / self.radius_derivative(angle);
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            if (next - angle).abs() <= 1e-15 * (1.0 + angle) {
                return Some(next);
            }
            angle = next;
        }
        Some(angle)
    }

    /// Returns the angle up to which the radius grows, at most `limit`.
    pub fn growing_to(&self, limit: f64) -> f64 {
        const STEPS: u32 = 2000;
        let at = |step: u32| limit * f64::from(step) / f64::from(STEPS);
        // A small slope would spread a pixel over degrees: the field ends before it.
        const LEAST_SLOPE: f64 = 0.02;
        (1..=STEPS).find(|step| self.radius_derivative(at(*step)) < LEAST_SLOPE).map_or(limit, |step| at(step - 1))
    }
}

/// The way a camera maps directions to its image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum CameraProjection {
    /// Straight lines stay straight.
    #[default]
    Pinhole,
    /// The radius follows the angle to the axis.
    Fisheye(Fisheye),
    /// A panorama: columns are longitudes, rows latitudes.
    Equirectangular,
}

impl CameraProjection {
    /// Returns whether this is the pinhole.
    pub fn is_pinhole(&self) -> bool {
        *self == Self::Pinhole
    }

    /// Returns the name that users know.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::Fisheye(_) => "fisheye",
            Self::Equirectangular => "equirectangular",
        }
    }

    /// Returns the place on the plane and the depth of a point in camera space.
    pub fn plane_from_point(&self, p: DVec3) -> Option<Placed> {
        match self {
            Self::Pinhole => (p.z > 0.0).then(|| Placed { plane: DVec2::new(p.x / p.z, p.y / p.z), depth: p.z }),
            Self::Fisheye(lens) => {
                let r = p.x.hypot(p.y);
                let angle = r.atan2(p.z);
                let scale = if r > 0.0 { lens.radius(angle) / r } else { 0.0 };
                let is_seen = angle <= lens.max_angle_rad && p != DVec3::ZERO;
                is_seen.then(|| Placed { plane: p.truncate() * scale, depth: p.length() })
            }
            Self::Equirectangular => {
                let latitude = p.y.atan2(p.x.hypot(p.z));
                (p != DVec3::ZERO).then(|| Placed { plane: DVec2::new(p.x.atan2(p.z), latitude), depth: p.length() })
            }
        }
    }

    /// Returns the point in camera space at depth 1 that a place on the plane shows: the inverse of
    /// [`Self::plane_from_point`]. Longitudes continue around the panorama.
    pub fn point_from_plane(&self, plane: DVec2) -> Option<DVec3> {
        match self {
            Self::Pinhole => Some(plane.extend(1.0)),
            Self::Fisheye(lens) => {
                let radius = plane.length();
                let angle = lens.angle(radius)?;
                let scale = if radius > 0.0 { angle.sin() / radius } else { 0.0 };
                Some((plane * scale).extend(angle.cos()))
            }
            Self::Equirectangular => {
                let ((sin_x, cos_x), (sin_y, cos_y)) = (plane.x.sin_cos(), plane.y.sin_cos());
                (plane.y.abs() <= FRAC_PI_2 + 1e-12).then(|| DVec3::new(sin_x * cos_y, sin_y, cos_x * cos_y))
            }
        }
    }

    /// Returns the derivatives of the place on the plane, x and y, by the point in camera space;
    /// `None` where the point is not seen, and at the poles of a panorama.
    pub fn jacobian(&self, p: DVec3) -> Option<[DVec3; 2]> {
        self.plane_from_point(p)?;
        let d2 = p.length_squared();
        match self {
            Self::Pinhole => {
                let (x, y, w) = (p.x / p.z, p.y / p.z, 1.0 / p.z);
                Some([DVec3::new(w, 0.0, -x * w), DVec3::new(0.0, w, -y * w)])
            }
            Self::Fisheye(lens) => {
                let r = p.x.hypot(p.y);
                if r <= 1e-12 * p.z {
                    return Some([DVec3::new(1.0 / p.z, 0.0, 0.0), DVec3::new(0.0, 1.0 / p.z, 0.0)]);
                }
                let angle = r.atan2(p.z);
                let slope = lens.radius_derivative(angle);
                let u = p.truncate() / r;
                let (along, across) = (slope * p.z / d2, lens.radius(angle) / r);
                let row = |e: DVec2| (u * (along * u.dot(e)) + (e - u * u.dot(e)) * across).extend(-slope * r / d2 * u.dot(e));
                Some([row(DVec2::X), row(DVec2::Y)])
            }
            Self::Equirectangular => {
                let h2 = p.x * p.x + p.z * p.z;
                let h = h2.sqrt();
                (h > 0.0).then(|| {
                    let down = DVec3::new(-p.x * p.y / (h * d2), h / d2, -p.z * p.y / (h * d2));
                    [DVec3::new(p.z / h2, 0.0, -p.x / h2), down]
                })
            }
        }
    }
}

/// A point on the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Coordinates for a focal length of 1 and a principal point at the origin.
    pub plane: DVec2,
    /// Depth: z for the pinhole, else the distance.
    pub depth: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: [f64; 4] = [-0.03, 0.012, -0.004, 0.0006];

    fn projections() -> [CameraProjection; 4] {
        let equidistant = Fisheye { coefficients: [0.0; 4], max_angle_rad: 2.2 };
        [
            CameraProjection::Pinhole,
            CameraProjection::Fisheye(Fisheye::new(LENS)),
            CameraProjection::Fisheye(equidistant),
            CameraProjection::Equirectangular,
        ]
    }

    /// Points all around, near the axis, behind, beside the poles.
    fn points() -> Vec<DVec3> {
        let mut points = vec![DVec3::Z, DVec3::new(1e-9, 0.0, 2.0), DVec3::new(0.01, -3.0, 0.02), DVec3::new(-1e-3, 0.2, -4.0)];
        for i in 0..200 {
            let (a, b) = (f64::from(i) * 2.399963, 1.0 - 2.0 * (f64::from(i) + 0.5) / 200.0);
            let flat = (1.0 - b * b).sqrt();
            points.push(DVec3::new(flat * a.cos(), b, flat * a.sin()) * (0.1 + 0.05 * f64::from(i)));
        }
        points
    }

    #[test]
    fn places_and_points_are_inverse() {
        for projection in projections() {
            let mut seen = 0;
            for point in points() {
                let Some(Placed { plane, depth }) = projection.plane_from_point(point) else { continue };
                seen += 1;
                let back = projection.point_from_plane(plane).unwrap() * depth;
                assert!((back - point).length() < 1e-9 * point.length(), "{projection:?} {point} {back}");
            }
            assert!(seen > 90, "{projection:?}: {seen}");
        }
    }

    #[test]
    fn jacobians_are_the_limits_of_differences() {
        for projection in projections() {
            for point in points() {
                let step = 1e-6 * point.length();
                let Some(rows) = projection.jacobian(point) else { continue };
                if point.x.hypot(point.z) < 1e-2 * point.length() || (point.z < 0.0 && point.x.abs() < 1e-2) {
                    continue;
                }
                for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                    let at = |sign: f64| projection.plane_from_point(point + axis * (sign * step)).map(|placed| placed.plane);
                    let (Some(after), Some(before)) = (at(1.0), at(-1.0)) else { continue };
                    let expected = (after - before) / (2.0 * step);
                    let found = DVec2::new(rows[0].dot(axis), rows[1].dot(axis));
                    let scale = rows[0].length() + rows[1].length();
                    assert!((found - expected).length() < 1e-6 * scale, "{projection:?} {point}: {found} {expected}");
                }
            }
        }
    }

    /// The formulas as OpenCV's documentation of the module `fisheye` prints them, with a = x / z
    /// and b = y / z.
    #[test]
    fn the_fisheye_is_that_of_opencv() {
        let projection = CameraProjection::Fisheye(Fisheye::new(LENS));
        let [k1, k2, k3, k4] = LENS;
        for point in points().into_iter().filter(|p| p.z > 0.0) {
            let (a, b) = (point.x / point.z, point.y / point.z);
            let r = (a * a + b * b).sqrt();
            let theta = r.atan();
            let theta_d = theta * (1.0 + k1 * theta.powi(2) + k2 * theta.powi(4) + k3 * theta.powi(6) + k4 * theta.powi(8));
            let expected = if r > 0.0 { DVec2::new(theta_d / r * a, theta_d / r * b) } else { DVec2::ZERO };
            let found = projection.plane_from_point(point).unwrap().plane;
            assert!((found - expected).length() < 1e-12, "{point}: {found} {expected}");
        }
        // A point of OpenCV 4's fisheye.projectPoints with the same coefficients: 45 degrees to the
        // right, worked by hand from the series.
        let theta = std::f64::consts::FRAC_PI_4;
        let (t2, t4) = (theta * theta, theta.powi(4));
        let expected = theta + theta * (-0.03 * t2 + 0.012 * t4 - 0.004 * t2 * t4 + 0.0006 * t4 * t4);
        assert!((projection.plane_from_point(DVec3::new(1.0, 0.0, 1.0)).unwrap().plane.x - expected).abs() < 1e-12);
    }

    #[test]
    fn the_panorama_looks_ahead_in_its_middle() {
        let plane = |p: DVec3| CameraProjection::Equirectangular.plane_from_point(p).unwrap().plane;
        assert_eq!(plane(DVec3::Z), DVec2::ZERO);
        assert_eq!(plane(DVec3::X), DVec2::new(FRAC_PI_2, 0.0));
        assert_eq!(plane(DVec3::Y), DVec2::new(0.0, FRAC_PI_2));
        assert!((plane(DVec3::new(-1e-12, 0.0, -1.0)).x + PI).abs() < 1e-9);
    }

    #[test]
    fn a_fisheye_ends_where_its_radius_stops_growing() {
        assert_eq!(Fisheye::new([0.0; 4]).max_angle_rad, USUAL_FISHEYE_ANGLE_RAD);
        let folding = Fisheye::new([-0.2, 0.0, 0.0, 0.0]);
        // 1 - 0.6 t^2 is 0 at 1.29.
        assert!((1.2..1.29).contains(&folding.max_angle_rad), "{}", folding.max_angle_rad);
        let projection = CameraProjection::Fisheye(folding);
        assert!(projection.plane_from_point(DVec3::new(1.0, 0.0, 0.1)).is_none());
        assert!(projection.point_from_plane(DVec2::new(2.0, 0.0)).is_none());
        for step in 0..=100 {
            let angle = folding.max_angle_rad * f64::from(step) / 100.0;
            assert!((folding.angle(folding.radius(angle)).unwrap() - angle).abs() < 1e-12);
        }
    }
}

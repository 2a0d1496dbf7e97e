//! Base projections: from a direction to a place on the image plane, without polynomials.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, DVec3};

/// Angle from the axis up to which a plane is used, radians: a perspective image of more is of no
/// use, and its radius beyond bounds.
const MAX_PERSPECTIVE_ANGLE: f64 = 89.9 / 180.0 * PI;

/// How the angle `t` from the axis becomes a radius on the image plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Base {
    /// `tan t`.
    Perspective,
    /// `t`.
    Equidistant,
    /// `2 sin(t / 2)`.
    Equisolid,
    /// `atan(2 tan t tan(omega / 2)) / omega` (Devernay and Faugeras).
    FieldOfView {
        /// Radians.
        omega: f64,
    },
    /// The radius r with `tan t = r / (1 + k r²)` (Fitzgibbon).
    Division {
        /// Coefficient.
        k: f64,
    },
    /// `sin t / (alpha sqrt(beta sin² t + cos² t) + (1 - alpha) cos t)` (Khomutenko and others).
    Unified {
        /// From 0 to 1.
        alpha: f64,
        /// Above 0.
        beta: f64,
    },
    /// Longitude and latitude, radians.
    Equirectangular,
}

impl Base {
    /// Returns the name of the projection.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Perspective => "perspective",
            Self::Equidistant => "equidistant fisheye",
            Self::Equisolid => "equisolid fisheye",
            Self::FieldOfView { .. } => "field-of-view",
            Self::Division { .. } => "division",
            Self::Unified { .. } => "enhanced unified",
            Self::Equirectangular => "equirectangular",
        }
    }

    pub(super) fn is_finite(&self) -> bool {
        match *self {
            Self::Perspective | Self::Equidistant | Self::Equisolid | Self::Equirectangular => true,
            Self::FieldOfView { omega: value } | Self::Division { k: value } => value.is_finite(),
            Self::Unified { alpha, beta } => alpha.is_finite() && beta.is_finite(),
        }
    }

    /// Returns the largest angle from the axis that is imaged, radians.
    pub(super) fn max_angle(&self) -> f64 {
        match *self {
            Self::Perspective | Self::FieldOfView { .. } => MAX_PERSPECTIVE_ANGLE,
            Self::Equidistant | Self::Equisolid | Self::Equirectangular => PI,
            Self::Division { k } if k >= 0.0 => MAX_PERSPECTIVE_ANGLE,
            Self::Division { .. } | Self::Unified { .. } => PI,
        }
    }

    /// Returns the radius of an angle from the axis; `None` where it is not imaged, and for the
    /// equirectangular image, which has no radius.
    pub(super) fn radius(&self, angle: f64) -> Option<f64> {
        if *self == Self::Equirectangular {
            return None;
        }
        self.project(DVec3::new(angle.sin(), 0.0, angle.cos())).map(|p| p.x)
    }

    pub(super) fn project(&self, direction: DVec3) -> Option<DVec2> {
        let (DVec3 { x, y, z }, across) = (direction, direction.truncate());
        let rho = across.length();
        let scaled = |scale: f64| Some(across * scale).filter(|p| p.is_finite());
        match *self {
            Self::Perspective if z > 0.0 => scaled(z.recip()),
            Self::FieldOfView { omega } if z > 0.0 => scaled(field_of_view_scale(rho / z, omega) / z),
            Self::Perspective | Self::FieldOfView { .. } => None,
            Self::Equidistant | Self::Equisolid if rho == 0.0 => (z > 0.0).then_some(DVec2::ZERO),
            Self::Equidistant => scaled(rho.atan2(z) / rho),
            Self::Equisolid => scaled(2.0 * (0.5 * rho.atan2(z)).sin() / rho),
            Self::Division { k } => {
                let discriminant = z * z - 4.0 * rho * rho * k;
                let denominator = z + discriminant.max(0.0).sqrt();
                (discriminant >= 0.0 && denominator > 0.0).then(|| across * (2.0 / denominator)).filter(|p| p.is_finite())
            }
            Self::Unified { alpha, beta } => {
                let distance = (beta * rho * rho + z * z).sqrt();
                let denominator = alpha * distance + (1.0 - alpha) * z;
                // Behind this plane two directions share a place.
                let least = if alpha <= 0.5 { alpha / (1.0 - alpha) } else { (1.0 - alpha) / alpha };
                (denominator > 0.0 && z > -least * distance).then(|| across / denominator).filter(|p| p.is_finite())
            }
            Self::Equirectangular => {
                let level = x.hypot(z);
                // At the poles every longitude is right: zeros of either sign give the middle.
                let longitude = if level > 0.0 { x.atan2(z) } else { 0.0 };
                (level > 0.0 || y != 0.0).then(|| DVec2::new(longitude, y.atan2(level)))
            }
        }
    }

    /// Returns a direction of any length.
    pub(super) fn direction(&self, place: DVec2) -> Option<DVec3> {
        let radius = place.length();
        let at_angle = |angle: f64| match radius > 0.0 {
            true => (place * (angle.sin() / radius)).extend(angle.cos()),
            false => DVec3::Z,
        };
        match *self {
            Self::Perspective => Some(place.extend(1.0)),
            Self::Equidistant => (radius <= PI).then(|| at_angle(radius)),
            Self::Equisolid => (radius <= 2.0).then(|| at_angle(2.0 * (0.5 * radius).asin())),
            Self::FieldOfView { omega } => {
                let angle = radius * omega;
                let slope = if omega * omega < SMALL { radius } else { angle.tan() / (2.0 * (0.5 * omega).tan()) };
                (angle.abs() < FRAC_PI_2).then(|| at_angle(slope.atan()))
            }
            Self::Division { k } => {
                let z = 1.0 + k * radius * radius;
                // Beyond it the same directions would be imaged again.
                let is_first = k <= 0.0 || k * radius * radius < 1.0;
                is_first.then(|| place.extend(z))
            }
            Self::Unified { alpha, beta } => {
                let r2 = radius * radius;
                let radicand = 1.0 - (2.0 * alpha - 1.0) * beta * r2;
                let denominator = alpha * radicand.max(0.0).sqrt() + (1.0 - alpha);
                (radicand >= 0.0 && denominator > 0.0).then(|| place.extend((1.0 - alpha * alpha * beta * r2) / denominator))
            }
            Self::Equirectangular => {
                let ((sin_x, cos_x), (sin_y, cos_y)) = (place.x.sin_cos(), place.y.sin_cos());
                let is_inside = place.x.abs() <= PI + SMALL && place.y.abs() <= FRAC_PI_2 + SMALL;
                is_inside.then(|| DVec3::new(cos_y * sin_x, sin_y, cos_y * cos_x))
            }
        }
    }
}

/// Number below which limits replace quotients.
const SMALL: f64 = 1e-9;

/// Returns the distorted over the undistorted radius of the field-of-view model.
fn field_of_view_scale(radius: f64, omega: f64) -> f64 {
    if omega * omega < SMALL {
        return 1.0;
    }
    let slope = 2.0 * (0.5 * omega).tan();
    if radius * radius < SMALL { slope / omega } else { (radius * slope).atan() / (radius * omega) }
}

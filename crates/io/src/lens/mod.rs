//! Lens models: where the image of a direction falls, and which direction a place in the image
//! shows.
//!
//! In: directions in camera coordinates (x right, y down, z forward) of any length. Out: places on
//! the image plane from the principal point, in units of the focal lengths; the caller multiplies
//! by focal lengths in pixels and adds the principal point. A lens is a [`Base`], which maps the
//! angle from the axis to a radius, followed by a [`Warp`], polynomials on the plane.
//!
//! Sources: the camera models of COLMAP 4.2, of Metashape's manual (appendix on camera models) and
//! of RealityScan's reference of camera geometry. Degenerate cases: `None` for what the lens cannot
//! image, such as directions behind a pinhole or beyond the radius at which a polynomial turns
//! back.

mod base;
pub(crate) mod newton;
#[cfg(test)]
mod tests;
mod warp;

use glam::{DVec2, DVec3};
use luxel_core::{CameraProjection, Distortion, Fisheye};

pub(crate) use base::Base;
pub(crate) use warp::{Order, Warp};

/// Steps of angle at which a warp is looked at for a place where it turns back.
const FOLD_STEPS: u32 = 4096;

/// A lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lens {
    /// From the angle to the axis to a radius.
    pub(crate) base: Base,
    /// Polynomials on the image plane.
    pub(crate) warp: Warp,
}

impl Default for Lens {
    /// Returns a pinhole.
    fn default() -> Self {
        Self { base: Base::Perspective, warp: Warp::default() }
    }
}

impl From<Distortion> for Lens {
    fn from(Distortion { k1, k2, p1, p2 }: Distortion) -> Self {
        let warp = Warp { radial: [k1, k2, 0.0, 0.0, 0.0, 0.0], tangential: [p1, p2], ..Warp::default() };
        Self { base: Base::Perspective, warp }
    }
}

impl Lens {
    /// Returns the fisheye lens of Kannala and Brandt.
    pub(crate) fn fisheye([k1, k2, k3, k4]: [f64; 4]) -> Self {
        Self { base: Base::Equidistant, warp: Warp { radial: [k1, k2, k3, k4, 0.0, 0.0], ..Warp::default() } }
    }

    /// Returns the distortion of a pinhole camera that is this lens; `None` if there is none.
    pub(crate) fn distortion(&self) -> Option<Distortion> {
        let Warp { radial: [k1, k2, ..], tangential: [p1, p2], .. } = self.warp;
        let distortion = Distortion { k1, k2, p1, p2 };
        (*self == Self::from(distortion)).then_some(distortion)
    }

    /// Returns the projection of a camera that is this lens; `None` if there is none.
    pub(crate) fn projection(&self) -> Option<CameraProjection> {
        let coefficients = self.fisheye_coefficients();
        match self.base {
            Base::Perspective => self.distortion().map(|_| CameraProjection::Pinhole),
            Base::Equidistant if *self == Self::fisheye(coefficients) => Some(CameraProjection::Fisheye(Fisheye::new(coefficients))),
            Base::Equirectangular if self.warp.is_none() => Some(CameraProjection::Equirectangular),
            _ => None,
        }
    }

    /// Returns the coefficients of the fisheye that a lens is nearest to: its own radial ones, if
    /// it is an equidistant one.
    pub(crate) fn fisheye_coefficients(&self) -> [f64; 4] {
        let [k1, k2, k3, k4, ..] = self.warp.radial;
        if self.base == Base::Equidistant { [k1, k2, k3, k4] } else { [0.0; 4] }
    }

    /// Returns whether all numbers are finite.
    pub(crate) fn is_finite(&self) -> bool {
        self.base.is_finite() && self.warp.is_finite()
    }

    /// Returns the lens with what its queries need.
    pub(crate) fn prepared(&self) -> PreparedLens {
        PreparedLens { lens: *self, max_radius: self.max_radius() }
    }

    /// Returns the radius, before the warp, below which radii grow with the angle.
    fn max_radius(&self) -> f64 {
        if self.warp.is_none() {
            return f64::INFINITY;
        }
        let reach = self.base.max_angle();
        let mut last = 0.0;
        let mut last_radius = 0.0;
        for step in 1..FOLD_STEPS {
            let Some(radius) = self.base.radius(reach * f64::from(step) / f64::from(FOLD_STEPS)) else { break };
            let warped = self.warp.radius(radius);
            if !(warped > last && warped.is_finite()) {
                return last_radius;
            }
            (last, last_radius) = (warped, radius);
        }
        f64::INFINITY
    }
}

/// A lens that can be asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PreparedLens {
    lens: Lens,
    max_radius: f64,
}

impl PreparedLens {
    /// Returns the place of a direction on the image plane.
    pub(crate) fn project(&self, direction: DVec3) -> Option<DVec2> {
        let plane = self.lens.base.project(direction)?;
        if self.lens.warp.is_none() {
            return Some(plane);
        }
        if plane.length() > self.max_radius {
            return None;
        }
        Some(self.lens.warp.apply(plane)).filter(|p| p.is_finite())
    }

    /// Returns the direction that a place on the image plane shows, a unit vector.
    pub(crate) fn direction(&self, place: DVec2) -> Option<DVec3> {
        let plane = if self.lens.warp.is_none() { place } else { self.lens.warp.invert(place, self.max_radius)? };
        self.lens.base.direction(plane).map(DVec3::normalize).filter(|d| d.is_finite())
    }

    /// Returns the largest radius on the image plane that the polynomials reach.
    pub(crate) fn reach(&self) -> f64 {
        if self.max_radius.is_finite() { self.lens.warp.radius(self.max_radius) } else { f64::INFINITY }
    }
}

//! The size of a pixel on the sphere of directions, for projections other than the pinhole.
//!
//! In: a camera. Out: a polynomial in the cosine between a direction and the axis, which engines
//! evaluate without trigonometry. A fisheye's pixel has the solid angle sin(theta) / (fx fy r r')
//! at the angle theta with radius r(theta); its square root is the side. A panorama's pixels are
//! cut from rows of equal height, so their side is that of a row everywhere: towards the poles
//! columns get closer than they need to be. Degenerate: directions outside of the field have the
//! size at its border; a radius that hardly grows is taken to grow at a tenth.

use crate::{Camera, CameraProjection};

/// Number of coefficients.
pub const PIXEL_ANGLE_TERMS: usize = 12;

/// The squared side of a pixel in radians, as a polynomial of t = (cosine - middle) / half_range,
/// with t within -1 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelAngle {
    /// Cosine in the middle of the field.
    pub middle: f64,
    /// Half the range of cosines.
    pub half_range: f64,
    /// Coefficients of t^0, t^1 and so on.
    pub coefficients: [f64; PIXEL_ANGLE_TERMS],
}

impl PixelAngle {
    /// Returns the size for a camera; of a pinhole, the size on its axis.
    pub fn new(camera: &Camera) -> Self {
        let mut this = Self { middle: 0.0, half_range: 1.0, coefficients: [0.0; PIXEL_ANGLE_TERMS] };
        let area = 1.0 / (camera.focal_px.x * camera.focal_px.y);
        let CameraProjection::Fisheye(lens) = camera.projection else {
            this.coefficients[0] = area;
            return this;
        };
        let low = lens.max_angle_rad.cos();
        (this.middle, this.half_range) = (0.5 * (1.0 + low), 0.5 * (1.0 - low));
        let squared_side = |cosine: f64| {
            let angle = cosine.clamp(-1.0, 1.0).acos();
            let slope = lens.radius_derivative(angle).max(0.1);
            if angle < 1e-6 { area } else { area * angle.sin() / (lens.radius(angle) * slope) }
        };
        // Chebyshev's coefficients, then powers of t by T(k + 1) = 2 t T(k) - T(k - 1).
        const NODES: usize = 64;
        let node = |j: usize| std::f64::consts::PI * (j as f64 + 0.5) / NODES as f64;
        let values: Vec<f64> = (0..NODES).map(|j| squared_side(this.middle + this.half_range * node(j).cos())).collect();
        let (mut before, mut polynomial) = ([0.0; PIXEL_ANGLE_TERMS], [0.0; PIXEL_ANGLE_TERMS]);
        polynomial[0] = 1.0;
        for k in 0..PIXEL_ANGLE_TERMS {
            let sum: f64 = values.iter().enumerate().map(|(j, value)| value * (k as f64 * node(j)).cos()).sum();
            let weight = sum * if k == 0 { 1.0 } else { 2.0 } / NODES as f64;
            for (total, term) in this.coefficients.iter_mut().zip(polynomial) {
                *total += weight * term;
            }
            let mut next = [0.0; PIXEL_ANGLE_TERMS];
            for i in 0..PIXEL_ANGLE_TERMS {
                let shifted = if i > 0 { polynomial[i - 1] } else { 0.0 };
                next[i] = if k == 0 { shifted } else { 2.0 * shifted - before[i] };
            }
            (before, polynomial) = (polynomial, next);
        }
        this
    }

    /// Returns the squared side at a cosine.
    pub fn squared(&self, cosine: f64) -> f64 {
        let t = ((cosine - self.middle) / self.half_range).clamp(-1.0, 1.0);
        self.coefficients.iter().rev().fold(0.0, |sum, c| sum * t + c)
    }
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::Fisheye;

    #[test]
    fn a_pixel_of_a_fisheye_has_the_solid_angle_that_its_rays_enclose() {
        let mut camera = Camera::panorama(DAffine3::IDENTITY, 400);
        camera.focal_px = glam::DVec2::new(120.0, 118.0);
        for coefficients in [[0.0; 4], [-0.03, 0.012, -0.004, 0.0006], [0.08, 0.02, 0.0, 0.0]] {
            camera.projection = CameraProjection::Fisheye(Fisheye::new(coefficients));
            let size = PixelAngle::new(&camera);
            for step in 0..60 {
                let at = camera.center_px + glam::DVec2::new(3.0, -1.7) * f64::from(step);
                let ray = |dx: f64, dy: f64| camera.unproject(at + 0.01 * glam::DVec2::new(dx, dy));
                let (Some(a), Some(b), Some(c), Some(d)) = (ray(-1.0, 0.0), ray(1.0, 0.0), ray(0.0, -1.0), ray(0.0, 1.0)) else { continue };
                let expected = ((b - a) / 0.02).cross((d - c) / 0.02).length();
                let found = size.squared(camera.unproject(at).unwrap().z);
                assert!((found - expected).abs() < 2e-4 * expected, "{coefficients:?} {step}: {found} {expected}");
            }
        }
        camera.projection = CameraProjection::Equirectangular;
        assert_eq!(PixelAngle::new(&camera).squared(-0.3), 1.0 / (120.0 * 118.0));
    }
}

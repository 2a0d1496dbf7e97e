//! Polynomials on the image plane: radial, tangential and thin-prism distortion, and shear.

use glam::DVec2;

use super::newton;

/// Steps of the bisection that finds the radius to begin from.
const BISECTIONS: u32 = 24;
/// Residual on the image plane: a ten-thousandth of a pixel at a focal length of 10,000.
const TOLERANCE: f64 = 1e-8;

/// Place that tangential and prism terms are polynomials of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Order {
    /// The undistorted place.
    #[default]
    Parallel,
    /// The radially distorted place (COLMAP's RAD_TAN_THIN_PRISM_FISHEYE).
    Chained,
}

/// Coefficients; all zero for no change.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Warp {
    /// Coefficients of r², r⁴ and so on, added to 1.
    pub(crate) radial: [f64; 6],
    /// The same of the denominator that divides it.
    pub(crate) denominator: [f64; 3],
    /// OpenCV's p1 and p2: `2 p1 x y + p2 (r² + 2 x²)` on x.
    pub(crate) tangential: [f64; 2],
    /// Coefficients of r² and r⁴, added to 1, that multiply tangential terms (Metashape's P3, P4).
    pub(crate) tangential_radial: [f64; 2],
    /// Coefficients of r² and r⁴ on x, then on y.
    pub(crate) prism: [f64; 4],
    /// Share of y that is added to x.
    pub(crate) shear: f64,
    /// Order of the terms.
    pub(crate) order: Order,
}

impl Warp {
    /// Returns whether nothing changes.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self { order: self.order, ..Self::default() }
    }

    pub(super) fn is_finite(&self) -> bool {
        let terms = [self.tangential, self.tangential_radial].concat();
        let all = self.radial.iter().chain(&self.denominator).chain(&terms).chain(&self.prism).chain([&self.shear]);
        all.into_iter().all(|v| v.is_finite())
    }

    /// Returns the factor of a squared radius.
    fn factor(&self, r2: f64) -> f64 {
        let polynomial = |coefficients: &[f64]| 1.0 + coefficients.iter().rev().fold(0.0, |sum, k| (sum + k) * r2);
        polynomial(&self.radial) / polynomial(&self.denominator)
    }

    /// Returns the radius that radial terms make of one.
    pub(super) fn radius(&self, radius: f64) -> f64 {
        radius * self.factor(radius * radius)
    }

    pub(super) fn apply(&self, place: DVec2) -> DVec2 {
        let radial = place * self.factor(place.length_squared());
        let base = if self.order == Order::Chained { radial } else { place };
        let (DVec2 { x, y }, r2) = (base, base.length_squared());
        let ([p1, p2], [t1, t2], [s1, s2, s3, s4]) = (self.tangential, self.tangential_radial, self.prism);
        let growth = 1.0 + r2 * (t1 + r2 * t2);
        let tangential = DVec2::new(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        let prism = DVec2::new(r2 * (s1 + r2 * s2), r2 * (s3 + r2 * s4));
        let out = radial + tangential * growth + prism;
        DVec2::new(out.x + self.shear * out.y, out.y)
    }

    /// Returns the place whose image this is, within `max_radius`; `None` where there is none.
    pub(super) fn invert(&self, image: DVec2, max_radius: f64) -> Option<DVec2> {
        if !image.is_finite() {
            return None;
        }
        let p = newton::inverse(|p| self.apply(p), image, self.start(image, max_radius), TOLERANCE)?;
        // Half a step of the search for the radius that turns back.
        (p.length() <= max_radius * 1.001).then_some(p)
    }

    /// Returns the place that radial terms alone would map to `image`.
    fn start(&self, image: DVec2, max_radius: f64) -> DVec2 {
        let target = image.length();
        let mut high = if max_radius.is_finite() { max_radius } else { 1.0 };
        let mut doublings = 0;
        while max_radius.is_infinite() && self.radius(high) < target && doublings < 12 {
            (high, doublings) = (2.0 * high, doublings + 1);
        }
        let mut low = 0.0;
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if self.radius(middle) < target { low = middle } else { high = middle }
        }
        if target > 0.0 { image * (0.5 * (low + high) / target) } else { DVec2::ZERO }
    }
}

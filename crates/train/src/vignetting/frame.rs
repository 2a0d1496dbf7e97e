//! The frame of a lens, over which vignetting has mean 0.
//!
//! In: a camera at full resolution. Out: functions of r^2 that are orthonormal over the frame and
//! have mean 0 there, and conversions to and from the coefficients of ln gain.
//!
//! r is the distance from the principal point, and 1 at the corner farthest from it (half the
//! diagonal of a frame around it), or at the edge of a fisheye's field if that is nearer. The
//! frame is what of the image lies within. With x_k = r^(2k) - mean r^(2k) and the covariance
//! C = L L^T of x_1 to x_3 over the frame, the functions are the rows of L^-1 x.
//!
//! Degenerate: a frame too small for three functions has fewer; the others are 0.

use luxel_core::{Camera, CameraProjection, VIGNETTING_TERMS};

/// Number of functions.
pub(super) const TERMS: usize = VIGNETTING_TERMS - 1;
/// Numbers for each function.
pub(super) type Terms = [f64; TERMS];

/// Points along a side of the frame at which means are taken.
const POINTS: u32 = 64;
/// Smallest variance of a function that is one of its own.
const MIN_VARIANCE: f64 = 1e-12;

/// The frame of a lens.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    /// Distance from the axis at which r is 1, pixels.
    pub(crate) unit_px: f64,
    /// Means of r^2, r^4 and r^6.
    means: Terms,
    /// The coefficients of each function in x_1 to x_3.
    functions: [Terms; TERMS],
}

impl Frame {
    /// Returns the frame of a camera.
    pub(crate) fn new(camera: &Camera) -> Self {
        let (center, size) = (camera.center_px, camera.size_px.map(f64::from));
        let reach = |i: usize| center[i].abs().max((size[i] - center[i]).abs());
        let corner = reach(0).hypot(reach(1));
        let unit_px = match camera.projection {
            CameraProjection::Fisheye(lens) => corner.min(lens.radius(lens.max_angle_rad) * camera.focal_px.max_element()),
            CameraProjection::Pinhole | CameraProjection::Equirectangular => corner,
        };
        let unit_px = if unit_px.is_finite() && unit_px > 0.0 { unit_px } else { 1.0 };
        let at = |n: u32, i: usize| ((f64::from(n) + 0.5) / f64::from(POINTS) * size[i] - center[i]) / unit_px;
        let squares = (0..POINTS).flat_map(|y| (0..POINTS).map(move |x| at(x, 0).powi(2) + at(y, 1).powi(2)));
        let squares: Vec<f64> = squares.filter(|r2| *r2 <= 1.0).collect();
        let count = squares.len().max(1) as f64;
        let means: Terms = std::array::from_fn(|k| squares.iter().map(|r2| r2.powi(k as i32 + 1)).sum::<f64>() / count);
        let centered = |r2: f64, k: usize| r2.powi(k as i32 + 1) - means[k];
        let covariance: [Terms; TERMS] = std::array::from_fn(|i| {
            std::array::from_fn(|j| squares.iter().map(|r2| centered(*r2, i) * centered(*r2, j)).sum::<f64>() / count)
        });
        Self { unit_px, means, functions: orthonormal(&covariance) }
    }

    /// Returns the coefficients of 1, r^2, r^4 and r^6 in ln gain, for weights of the functions.
    pub(crate) fn log_gain(&self, weights: &Terms) -> [f64; VIGNETTING_TERMS] {
        let mut out = [0.0; VIGNETTING_TERMS];
        for (weight, function) in weights.iter().zip(&self.functions) {
            for (k, coefficient) in function.iter().enumerate() {
                out[k + 1] += weight * coefficient;
                out[0] -= weight * coefficient * self.means[k];
            }
        }
        out
    }

    /// Returns the gradient by the weights, given that by the coefficients of ln gain.
    pub(crate) fn gradient(&self, by_log_gain: &[f32; VIGNETTING_TERMS]) -> Terms {
        let by = by_log_gain.map(f64::from);
        let of_function = |function: &Terms| (0..TERMS).map(|k| function[k] * (by[k + 1] - self.means[k] * by[0])).sum();
        std::array::from_fn(|j| of_function(&self.functions[j]))
    }
}

/// Returns the inverse of the lower triangle L of a covariance L L^T, a row for each function.
fn orthonormal(covariance: &[Terms; TERMS]) -> [Terms; TERMS] {
    let product = |a: &Terms, b: &Terms| {
        (0..TERMS).flat_map(|i| (0..TERMS).map(move |j| (i, j))).map(|(i, j)| a[i] * covariance[i][j] * b[j]).sum::<f64>()
    };
    let mut rows = [[0.0; TERMS]; TERMS];
    for n in 0..TERMS {
        let mut row: Terms = [0.0; TERMS];
        row[n] = 1.0;
        // Twice: the powers are so alike that one pass leaves digits of the others.
        for _ in 0..2 {
            for earlier in &rows[..n] {
                let along = product(&row, earlier);
                row.iter_mut().zip(earlier).for_each(|(v, e)| *v -= along * e);
            }
        }
        let variance = product(&row, &row);
        if variance > MIN_VARIANCE {
            rows[n] = row.map(|v| v / variance.sqrt());
        }
    }
    rows
}

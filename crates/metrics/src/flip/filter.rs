//! FLIP's filters: contrast sensitivity per opponent channel, and detectors of edges and points.
//!
//! In: planes `[H*W]`, pixels per degree. Out: filtered planes, or the strength of edge and point
//! per pixel. All filters are sums of separable filters. Planes are extended by their border
//! pixels.

use std::f32::consts::PI;

use super::color::YCxCz;

/// The size of a plane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Plane {
    /// Filters rows along x by a kernel of odd length.
    fn along_x(self, values: &[f32], kernel: &[f32]) -> Vec<f32> {
        let radius = kernel.len() / 2;
        let mut out = vec![0f32; values.len()];
        let mut padded = vec![0f32; self.width + 2 * radius];
        for (row, out) in values.chunks_exact(self.width).zip(out.chunks_exact_mut(self.width)) {
            padded[..radius].fill(row[0]);
            padded[radius..radius + self.width].copy_from_slice(row);
            padded[radius + self.width..].fill(row[self.width - 1]);
            // One tap at a time over the whole row: both slices advance by one, which the compiler
            // vectorises.
            for (&weight, from) in kernel.iter().zip(0..) {
                accumulate(out, &padded[from..], weight);
            }
        }
        out
    }

    /// Filters columns along y by a kernel of odd length, and adds the result times `factor` to
    /// `out`.
    fn add_along_y(self, out: &mut [f32], values: &[f32], kernel: &[f32], factor: f32) {
        let radius = kernel.len() / 2;
        for (y, out) in out.chunks_exact_mut(self.width).enumerate() {
            for (tap, &weight) in kernel.iter().enumerate() {
                let row = (y + tap).saturating_sub(radius).min(self.height - 1);
                accumulate(out, &values[row * self.width..], factor * weight);
            }
        }
    }

    fn along_y(self, values: &[f32], kernel: &[f32]) -> Vec<f32> {
        let mut out = vec![0f32; values.len()];
        self.add_along_y(&mut out, values, kernel, 1.0);
        out
    }
}

#[inline]
fn accumulate(out: &mut [f32], values: &[f32], weight: f32) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += weight * value;
    }
}

/// The contrast sensitivity of lightness as pairs (a, b): the filter is the sum of Gaussians a
/// sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees, the inverse Fourier transform of the sensitivity
/// curve.
const ACHROMATIC: [(f32, f32); 1] = [(1.0, 0.0047)];
/// The contrast sensitivity of red against green, like [`ACHROMATIC`].
const RED_GREEN: [(f32, f32); 1] = [(1.0, 0.0053)];
/// The contrast sensitivity of blue against yellow, like [`ACHROMATIC`].
const BLUE_YELLOW: [(f32, f32); 2] = [(34.1, 0.04), (13.5, 0.025)];
/// The largest b. All three filters have the radius of the widest: three standard deviations.
const WIDEST: f32 = 0.04;

/// A Gaussian's share of its filter, and its kernel along an axis, which sums to 1.
type Gaussian = (f32, Vec<f32>);

/// Low-pass filters that remove the detail which the eye does not resolve.
pub(super) struct ContrastSensitivity {
    achromatic: Vec<Gaussian>,
    red_green: Vec<Gaussian>,
    blue_yellow: Vec<Gaussian>,
}

impl ContrastSensitivity {
    pub(super) fn new(pixels_per_degree: f32) -> Self {
        let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as usize;
        let filter = |terms: &[(f32, f32)]| {
            let term = |&(a, b): &(f32, f32)| {
                let kernel = kernel(radius, |x| (-PI * PI * (x / pixels_per_degree).powi(2) / b).exp());
                let sum: f32 = kernel.iter().sum();
                // The Gaussian's weight in two dimensions.
                (a * (PI / b).sqrt() * sum * sum, kernel.into_iter().map(|v| v / sum).collect())
            };
            let terms: Vec<Gaussian> = terms.iter().map(term).collect();
            let total: f32 = terms.iter().map(|(weight, _)| weight).sum();
            terms.into_iter().map(|(weight, kernel)| (weight / total, kernel)).collect::<Vec<_>>()
        };
        Self { achromatic: filter(&ACHROMATIC), red_green: filter(&RED_GREEN), blue_yellow: filter(&BLUE_YELLOW) }
    }

    pub(super) fn filter(&self, plane: Plane, image: &YCxCz) -> YCxCz {
        let filter = |values: &[f32], terms: &[Gaussian]| {
            let mut out = vec![0f32; values.len()];
            for (weight, kernel) in terms {
                plane.add_along_y(&mut out, &plane.along_x(values, kernel), kernel, *weight);
            }
            out
        };
        YCxCz { y: filter(&image.y, &self.achromatic), cx: filter(&image.cx, &self.red_green), cz: filter(&image.cz, &self.blue_yellow) }
    }
}

/// The width of the most visible edge, degrees.
const FEATURE_WIDTH_DEGREES: f32 = 0.082;

/// First and second derivatives of a Gaussian, scaled so that their positive parts sum to 1 and
/// their negative parts to -1.
pub(super) struct FeatureFilters {
    gaussian: Vec<f32>,
    edge: Vec<f32>,
    point: Vec<f32>,
}

impl FeatureFilters {
    pub(super) fn new(pixels_per_degree: f32) -> Self {
        let sigma = 0.5 * FEATURE_WIDTH_DEGREES * pixels_per_degree;
        let radius = (3.0 * sigma).ceil() as usize;
        let gaussian = |x: f32| (-x * x / (2.0 * sigma * sigma)).exp();
        Self {
            gaussian: balanced(kernel(radius, gaussian)),
            edge: balanced(kernel(radius, |x| -x * gaussian(x))),
            point: balanced(kernel(radius, |x| (x * x / (sigma * sigma) - 1.0) * gaussian(x))),
        }
    }

    /// Returns the strengths `[edge, point]` of every pixel of a plane of YCxCz' Y.
    pub(super) fn strengths(&self, plane: Plane, y: &[f32]) -> Vec<[f32; 2]> {
        let lightness: Vec<f32> = y.iter().map(|y| (y + 16.0) / 116.0).collect();
        let smooth = plane.along_x(&lightness, &self.gaussian);
        let strength = |kernel: &[f32]| {
            let along_x = plane.along_y(&plane.along_x(&lightness, kernel), &self.gaussian);
            let along_y = plane.along_y(&smooth, kernel);
            along_x.iter().zip(along_y).map(|(x, y)| (x * x + y * y).sqrt()).collect::<Vec<f32>>()
        };
        strength(&self.edge).into_iter().zip(strength(&self.point)).map(|(edge, point)| [edge, point]).collect()
    }
}

fn kernel(radius: usize, value: impl Fn(f32) -> f32) -> Vec<f32> {
    (0..=2 * radius).map(|i| value(i as f32 - radius as f32)).collect()
}

/// Scales positive values to sum to 1, and negative ones to sum to -1.
fn balanced(kernel: Vec<f32>) -> Vec<f32> {
    let sum = |sign: f32| kernel.iter().map(|v| (sign * v).max(0.0)).sum::<f32>();
    let (positive, negative) = (sum(1.0), sum(-1.0));
    kernel.iter().map(|&v| if v < 0.0 { v / negative } else { v / positive }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensitivity_keeps_flat_areas_and_features_ignore_them() {
        let plane = Plane { width: 5, height: 3 };
        let flat = || vec![42.0; 15];
        let filtered = ContrastSensitivity::new(67.0).filter(plane, &YCxCz { y: flat(), cx: flat(), cz: flat() });
        for value in filtered.y.iter().chain(&filtered.cx).chain(&filtered.cz) {
            assert!((value - 42.0).abs() < 1e-3, "{value}");
        }
        for [edge, point] in FeatureFilters::new(67.0).strengths(plane, &flat()) {
            assert!(edge < 1e-5 && point < 1e-5, "{edge} {point}");
        }
    }

    #[test]
    fn a_step_of_full_contrast_is_an_edge_of_one() {
        // All taps of one sign lie on the bright side, and the tap between has weight 0.
        let plane = Plane { width: 41, height: 1 };
        let step: Vec<f32> = (0..41).map(|x| if x < 20 { -16.0 } else { 100.0 }).collect();
        let [edge, _] = FeatureFilters::new(67.0).strengths(plane, &step)[20];
        assert!((edge - 1.0).abs() < 1e-5, "{edge}");
    }
}

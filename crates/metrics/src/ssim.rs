//! Structural similarity, as 3D Gaussian splatting and its successors compute it.
//!
//! In: two planes `[H*W]` in `[0, 1]`. Out: the mean over all pixels of
//!
//! ```text
//! (2 m_p m_t + C1)(2 s_pt + C2) / ((m_p^2 + m_t^2 + C1)(s_p^2 + s_t^2 + C2))
//! ```
//!
//! with means, variances and covariance under an 11x11 Gaussian window of sigma 1.5. The image is
//! padded with zeros. Source: Wang et al. 2004; window and padding of Kerbl et al. 2023.
//!
//! [`ssim_interior`] leaves out the pixels with a window that reaches beyond the border, like
//! scikit-image. [`ssim_replicated`] repeats the border pixels outwards, like MATLAB. Values may be
//! f32 or f64. Sums are f64, because in f32 the variance of a bright, smooth area is lost to
//! cancellation.

use luxel_core::{SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_TAPS as TAPS, ssim_window};

use super::MetricsError;

/// The number of blurred quantities: p, t, p^2 + t^2 and p t. The formula needs the variances only
/// as their sum.
const QUANTITIES: usize = 4;

/// Computes the mean structural similarity of one channel, row-major.
///
/// # Errors
/// [`MetricsError::Planes`] if a plane does not hold `width * height` values,
/// [`MetricsError::NoValidPixels`] if that is 0.
pub fn ssim<T: Copy + Default + Into<f64>>(prediction: &[T], target: &[T], width: usize, height: usize) -> Result<f64, MetricsError> {
    check_planes(prediction, target, width, height)?;
    Ok(mean_similarity([width, height], 0, rows_of(prediction, target, width)))
}

/// Computes [`ssim`] of planes that exist row by row: `fill` writes a row of the prediction and of
/// the target, and is called for each row once, in order. Neither side may be 0.
pub(super) fn ssim_of_rows<T: Copy + Default + Into<f64>>(size: [usize; 2], fill: impl FnMut(usize, &mut [T], &mut [T])) -> f64 {
    mean_similarity(size, 0, fill)
}

/// Computes [`ssim_replicated`] of planes that exist row by row, as [`ssim_of_rows`] does, but that
/// `fill` is called for the first and the last row several times.
pub(super) fn ssim_replicated_of_rows<T: Copy + Default + Into<f64>>(
    [width, height]: [usize; 2],
    mut fill: impl FnMut(usize, &mut [T], &mut [T]),
) -> f64 {
    let inside = SSIM_RADIUS..SSIM_RADIUS + width;
    let extended = [width + 2 * SSIM_RADIUS, height + 2 * SSIM_RADIUS];
    mean_similarity(extended, SSIM_RADIUS, |y, prediction: &mut [T], target: &mut [T]| {
        fill(y.saturating_sub(SSIM_RADIUS).min(height - 1), &mut prediction[inside.clone()], &mut target[inside.clone()]);
        for row in [prediction, target] {
            let ends = [row[inside.start], row[inside.end - 1]];
            row[..inside.start].fill(ends[0]);
            row[inside.end..].fill(ends[1]);
        }
    })
}

/// Returns what copies the rows of two planes.
fn rows_of<'p, T: Copy>(prediction: &'p [T], target: &'p [T], width: usize) -> impl FnMut(usize, &mut [T], &mut [T]) + 'p {
    move |y, prediction_row, target_row| {
        let row = y * width..(y + 1) * width;
        prediction_row.copy_from_slice(&prediction[row.clone()]);
        target_row.copy_from_slice(&target[row]);
    }
}

/// Computes [`ssim`] over the pixels with a window that lies entirely inside the image.
///
/// # Errors
/// The same as of [`ssim`], and [`MetricsError::NoValidPixels`] for an image smaller than the
/// window (11 pixels).
pub fn ssim_interior<T: Copy + Default + Into<f64>>(
    prediction: &[T],
    target: &[T],
    width: usize,
    height: usize,
) -> Result<f64, MetricsError> {
    check_planes(prediction, target, width, height)?;
    if width.min(height) < TAPS {
        return Err(MetricsError::NoValidPixels);
    }
    Ok(mean_similarity([width, height], SSIM_RADIUS, rows_of(prediction, target, width)))
}

/// Computes [`ssim`] of an image that is extended by its border pixels instead of zeros.
///
/// # Errors
/// The same as of [`ssim`].
pub fn ssim_replicated<T: Copy + Default + Into<f64>>(
    prediction: &[T],
    target: &[T],
    width: usize,
    height: usize,
) -> Result<f64, MetricsError> {
    check_planes(prediction, target, width, height)?;
    Ok(ssim_replicated_of_rows([width, height], rows_of(prediction, target, width)))
}

fn check_planes<T>(prediction: &[T], target: &[T], width: usize, height: usize) -> Result<(), MetricsError> {
    let pixels = width.saturating_mul(height);
    if prediction.len() != pixels || target.len() != pixels {
        return Err(MetricsError::Planes { prediction: prediction.len(), target: target.len(), width, height });
    }
    if pixels == 0 { Err(MetricsError::NoValidPixels) } else { Ok(()) }
}

/// Returns the mean over all pixels except a frame `margin` pixels wide, of rows that `fill` writes
/// in order. The image must be larger than the frame.
fn mean_similarity<T: Copy + Default + Into<f64>>(
    [width, height]: [usize; 2],
    margin: usize,
    mut fill: impl FnMut(usize, &mut [T], &mut [T]),
) -> f64 {
    let mut rows = BlurredRows::new(width);
    let (mut prediction, mut target) = (vec![T::default(); width], vec![T::default(); width]);
    let mut sum = 0.0;
    let mut filled = 0;
    for y in 0..height - margin {
        while filled < height.min(y + SSIM_RADIUS + 1) {
            fill(filled, &mut prediction, &mut target);
            rows.push(filled, &prediction, &target);
            filled += 1;
        }
        if y >= margin {
            sum += rows.similarity(y, height, margin);
        }
    }
    sum / ((width - 2 * margin) * (height - 2 * margin)) as f64
}

/// The last [`TAPS`] rows, blurred along x: everything that a row of the result depends on.
struct BlurredRows {
    width: usize,
    window: [f64; TAPS],
    /// One row of each of the [`QUANTITIES`], with [`SSIM_RADIUS`] zeros on either side.
    padded: [Vec<f64>; QUANTITIES],
    /// Blurred rows `[TAPS][QUANTITIES * W]`, row y at y % TAPS.
    ring: Vec<Vec<f64>>,
    /// Sums `[QUANTITIES * W]` of a row of the result.
    blurred: Vec<f64>,
}

impl BlurredRows {
    fn new(width: usize) -> Self {
        Self {
            width,
            window: ssim_window(),
            padded: std::array::from_fn(|_| vec![0.0; width + 2 * SSIM_RADIUS]),
            ring: vec![vec![0.0; QUANTITIES * width]; TAPS],
            blurred: vec![0.0; QUANTITIES * width],
        }
    }

    /// Blurs row `y` of both planes along x.
    fn push<T: Copy + Into<f64>>(&mut self, y: usize, prediction: &[T], target: &[T]) {
        for (x, (&p, &t)) in prediction.iter().zip(target).enumerate() {
            let (p, t): (f64, f64) = (p.into(), t.into());
            for (quantity, value) in self.padded.iter_mut().zip([p, t, p * p + t * t, p * t]) {
                quantity[x + SSIM_RADIUS] = value;
            }
        }
        let ring = &mut self.ring[y % TAPS];
        for (out, padded) in ring.chunks_exact_mut(self.width).zip(&self.padded) {
            out.fill(0.0);
            // One tap at a time over the whole row: both slices advance by one, which the compiler
            // vectorises.
            for (&weight, from) in self.window.iter().zip(0..) {
                accumulate(out, &padded[from..], weight);
            }
        }
    }

    /// Returns the sum of the similarity over row `y`, without `margin` pixels at either end.
    fn similarity(&mut self, y: usize, height: usize, margin: usize) -> f64 {
        self.blurred.fill(0.0);
        for (tap, &weight) in self.window.iter().enumerate() {
            // Rows outside of the image are zeros.
            if let Some(row) = (y + tap).checked_sub(SSIM_RADIUS).filter(|&row| row < height) {
                accumulate(&mut self.blurred, &self.ring[row % TAPS], weight);
            }
        }
        let (p, rest) = self.blurred.split_at(self.width);
        let (t, rest) = rest.split_at(self.width);
        let (squares, product) = rest.split_at(self.width);
        let mut sum = 0.0;
        let pixels = p.iter().zip(t).zip(squares).zip(product).take(self.width - margin).skip(margin);
        for (((&p, &t), &squares), &product) in pixels {
            let (mean_product, mean_squares) = (p * t, p * p + t * t);
            let covariance = product - mean_product;
            let variances = squares - mean_squares;
            sum += (2.0 * mean_product + SSIM_C1) * (2.0 * covariance + SSIM_C2) / ((mean_squares + SSIM_C1) * (variances + SSIM_C2));
        }
        sum
    }
}

#[inline]
fn accumulate(out: &mut [f64], values: &[f64], weight: f64) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += weight * value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values in `[0, 1]` without a pattern: a fraction of a large multiple.
    fn plane(seed: f64, width: usize, height: usize) -> Vec<f64> {
        (0..width * height).map(|i| ((i as f64 + seed) * 0.754_877_666).sin() * 43_758.545).map(|v| v - v.floor()).collect()
    }

    /// Computes the SSIM by its definition: a two-dimensional window around every pixel, with
    /// central moments about the window's mean.
    fn brute_force(p: &[f64], t: &[f64], width: usize, height: usize) -> f64 {
        let w = ssim_window();
        let mut total = 0.0;
        for y in 0..height as isize {
            for x in 0..width as isize {
                let mut samples = Vec::new();
                for dy in -5..=5isize {
                    for dx in -5..=5isize {
                        let (sx, sy) = (x + dx, y + dy);
                        let inside = sx >= 0 && sy >= 0 && sx < width as isize && sy < height as isize;
                        let at = if inside { Some((sy * width as isize + sx) as usize) } else { None };
                        let value = |plane: &[f64]| at.map_or(0.0, |i| plane[i]);
                        samples.push((w[(dx + 5) as usize] * w[(dy + 5) as usize], value(p), value(t)));
                    }
                }
                let mean = |f: &dyn Fn(f64, f64) -> f64| samples.iter().map(|&(w, p, t)| w * f(p, t)).sum::<f64>();
                let (mp, mt) = (mean(&|p, _| p), mean(&|_, t| t));
                let (vp, vt) = (mean(&|p, _| (p - mp).powi(2)), mean(&|_, t| (t - mt).powi(2)));
                let cov = mean(&|p, t| (p - mp) * (t - mt));
                total += (2.0 * mp * mt + SSIM_C1) * (2.0 * cov + SSIM_C2) / ((mp * mp + mt * mt + SSIM_C1) * (vp + vt + SSIM_C2));
            }
        }
        total / (width * height) as f64
    }

    #[test]
    fn ssim_equals_the_two_dimensional_window() {
        // Smaller than the window, as large, larger, wide and tall.
        for (width, height) in [(1, 1), (3, 2), (11, 11), (23, 9), (7, 30)] {
            let (p, t) = (plane(0.3, width, height), plane(7.1, width, height));
            let mixed: Vec<f64> = p.iter().zip(&t).map(|(p, t)| 0.7 * p + 0.3 * t).collect();
            for other in [&t, &mixed] {
                let (fast, slow) = (ssim(&p, other, width, height).unwrap(), brute_force(&p, other, width, height));
                assert!((fast - slow).abs() < 1e-12, "{width}x{height}: {fast} {slow}");
            }
        }
    }

    #[test]
    fn borders_differ_by_what_lies_beyond() {
        // An image with a frame of zeros has the interior that zero padding gives the image itself.
        let (width, height) = (9, 6);
        let (p, t) = (plane(0.3, width, height), plane(7.1, width, height));
        let framed = |plane: &[f64]| {
            let mut framed = vec![0.0; (width + 10) * (height + 10)];
            for y in 0..height {
                framed[(y + 5) * (width + 10) + 5..][..width].copy_from_slice(&plane[y * width..][..width]);
            }
            framed
        };
        let (inside, zeros) =
            (ssim_interior(&framed(&p), &framed(&t), width + 10, height + 10).unwrap(), ssim(&p, &t, width, height).unwrap());
        assert!((inside - zeros).abs() < 1e-12, "{inside} {zeros}");
        // One pixel, repeated, is a flat image: only the means count.
        let flat = ssim_replicated(&[0.2], &[0.4], 1, 1).unwrap();
        assert!((flat - (2.0 * 0.08 + SSIM_C1) / (0.04 + 0.16 + SSIM_C1)).abs() < 1e-12, "{flat}");
        assert!(matches!(ssim_interior(&p, &t, width, height), Err(MetricsError::NoValidPixels)));
    }

    #[test]
    fn ssim_of_equal_planes_is_one() {
        let p = plane(0.3, 20, 15);
        assert!((ssim(&p, &p, 20, 15).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn ssim_is_symmetric_and_the_same_for_both_precisions() {
        let (p, t) = (plane(0.3, 20, 15), plane(4.0, 20, 15));
        let forth = ssim(&p, &t, 20, 15).unwrap();
        assert!((forth - ssim(&t, &p, 20, 15).unwrap()).abs() < 1e-12);
        let narrow = |plane: &[f64]| plane.iter().map(|&v| v as f32).collect::<Vec<f32>>();
        assert!((forth - ssim(&narrow(&p), &narrow(&t), 20, 15).unwrap()).abs() < 1e-6);
    }

    #[test]
    fn planes_of_the_wrong_length_are_an_error() {
        assert!(matches!(ssim(&[0f32; 6], &[0f32; 5], 3, 2), Err(MetricsError::Planes { .. })));
        assert!(matches!(ssim::<f32>(&[], &[], 0, 2), Err(MetricsError::NoValidPixels)));
    }
}

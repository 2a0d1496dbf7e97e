//! Metrics of a view before anything is reconstructed: range, level, sharpness.
//!
//! In: radiance, or an 8-bit proxy for sharpness. Out: [`CaptureMetrics`]. Degenerate: a view
//! without light has no range, one of a single colour no sharpness (0).

use luxel_core::{Image, luminance_rec709};
use serde::{Deserialize, Serialize};

use crate::Proxy;

/// The metrics of one view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CaptureMetrics {
    /// Luminance that a thousandth of the lit pixels is below.
    pub dark_luminance: f32,
    /// Median luminance of the lit pixels.
    pub median_luminance: f32,
    /// Luminance that a thousandth of the lit pixels is above.
    pub bright_luminance: f32,
    /// Largest luminance.
    pub max_luminance: f32,
    /// Mean of the Laplacian against that of the gradient, of the proxy: falls with blur.
    pub sharpness: f32,
}

impl CaptureMetrics {
    /// Returns the stops between a thousandth from below and from above.
    pub fn range_stops(&self) -> f32 {
        if self.dark_luminance > 0.0 { (self.bright_luminance / self.dark_luminance).log2() } else { 0.0 }
    }
}

/// Computes the metrics of a view and its proxy.
pub fn capture_metrics(image: &Image, proxy: &Proxy) -> CaptureMetrics {
    let mut lit: Vec<f32> = image.pixels.iter().map(|p| luminance_rec709(*p)).filter(|l| *l > 0.0 && l.is_finite()).collect();
    let Some(last) = lit.len().checked_sub(1) else { return CaptureMetrics::default() };
    let mut at = |share: f64| {
        let index = ((share * last as f64).round() as usize).min(last);
        *lit.select_nth_unstable_by(index, f32::total_cmp).1
    };
    CaptureMetrics {
        dark_luminance: at(0.001),
        median_luminance: at(0.5),
        bright_luminance: at(0.999),
        max_luminance: at(1.0),
        sharpness: sharpness(proxy),
    }
}

/// Computes the sharpness: mean absolute Laplacian over mean absolute gradient of green, over
/// pixels with texture. Both grow alike with contrast, so that content weighs less than focus does.
pub fn sharpness(proxy: &Proxy) -> f32 {
    let (width, height) = (proxy.width, proxy.height);
    let at = |x: usize, y: usize| f32::from(proxy.rgb8.get((y * width + x) * 3 + 1).copied().unwrap_or(0));
    let (mut laplacian, mut gradient) = (0.0f64, 0.0f64);
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let (dx, dy) = (at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1));
            let slope = 0.5 * dx.hypot(dy);
            // Rounding and noise are no texture.
            if slope < 4.0 {
                continue;
            }
            gradient += f64::from(slope);
            laplacian += f64::from((at(x + 1, y) + at(x - 1, y) + at(x, y + 1) + at(x, y - 1) - 4.0 * at(x, y)).abs());
        }
    }
    if gradient > 0.0 { (laplacian / gradient) as f32 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ProxyOptions, proxy};

    fn stripes(blur: f32) -> Image {
        let pixel = |i: usize| {
            let (x, y) = ((i % 160) as f32, (i / 160) as f32);
            let wave = ((x * 0.35 + y * 0.2).sin() / blur.max(0.05)).tanh();
            [0.2 + 0.15 * wave; 3]
        };
        Image { width: 160, height: 120, pixels: (0..160 * 120).map(pixel).collect() }
    }

    #[test]
    fn blur_lowers_sharpness() {
        let of = |blur| sharpness(&proxy(&stripes(blur), &ProxyOptions { max_side_px: 4000 }));
        let (sharp, soft) = (of(0.1), of(2.0));
        assert!(sharp > 1.5 * soft && soft > 0.0, "{sharp} {soft}");
    }

    #[test]
    fn range_is_between_thousandths() {
        let image = Image { width: 100, height: 100, pixels: (0..10_000).map(|i| [(i as f32 * 1e-3 - 5.0).exp2(); 3]).collect() };
        let found = capture_metrics(&image, &proxy(&image, &ProxyOptions { max_side_px: 100 }));
        assert!((found.range_stops() - 10.0 * 0.998).abs() < 0.05, "{}", found.range_stops());
        assert!((found.median_luminance - 1.0).abs() < 0.01);
        let black = Image::filled(4, 4, [0.0; 3]);
        assert_eq!(capture_metrics(&black, &proxy(&black, &ProxyOptions { max_side_px: 10 })).range_stops(), 0.0);
    }
}

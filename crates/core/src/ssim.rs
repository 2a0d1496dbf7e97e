//! The window and the constants of structural similarity, which loss and metrics share.
//!
//! Out: a Gaussian window of 11 taps and sigma 1.5, and the constants C1 and C2 for peak 1.
//! Source: Wang et al. 2004, "Image Quality Assessment: From Error Visibility to Structural
//! Similarity".

/// Pixels on either side of the window's centre.
pub const SSIM_RADIUS: usize = 5;
/// Standard deviation of the window, pixels.
pub const SSIM_SIGMA_PX: f64 = 1.5;
/// (0.01 peak)^2, peak 1: keeps the luminance term finite in the dark.
pub const SSIM_C1: f64 = 1e-4;
/// (0.03 peak)^2, peak 1: keeps the contrast term finite in flat areas.
pub const SSIM_C2: f64 = 9e-4;

/// Values of the window along one axis.
pub const SSIM_TAPS: usize = 2 * SSIM_RADIUS + 1;

/// Returns the window along one axis, which sums to 1. The window in two dimensions is the product
/// of two of these.
pub fn ssim_window() -> [f64; SSIM_TAPS] {
    let mut window = std::array::from_fn(|i| {
        let x = i as f64 - SSIM_RADIUS as f64;
        (-x * x / (2.0 * SSIM_SIGMA_PX * SSIM_SIGMA_PX)).exp()
    });
    let sum: f64 = window.iter().sum();
    for value in &mut window {
        *value /= sum;
    }
    window
}

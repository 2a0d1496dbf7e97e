//! Errors that depend on no display: the error of the logarithm, and relative errors by decade.
//!
//! In: a pair of images in linear Rec.709, normalised units. Out: [`log_rmse`] in decades (0.301 is
//! a factor of two) and the [`DecadeError`]s, binned by the target's luminance (Rec.709 weights).
//! Values below [`LOG_FLOOR`] are raised to it, both in the logarithm and as divisor, because black
//! has neither a logarithm nor a relative error.

use serde::{Deserialize, Serialize};

use super::Pair;
use luxel_core::luminance_rec709;

/// The radiance below which ratios have no meaning, normalised units: five decades below 1, as in
/// the luminance-error profile.
pub const LOG_FLOOR: f32 = 1e-5;
/// The decades that are reported. Everything below 1e-4 is in decade -5, everything from 1e4 on in
/// decade 4.
const DECADES: std::ops::RangeInclusive<i32> = -5..=4;

/// Relative error over the pixels where the target's luminance lies in `[10^decade, 10^(decade +
/// 1))`. The first decade (-5) has no lower end, the last one (4) no upper end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DecadeError {
    /// log10 of the lower edge, normalised units.
    pub decade: i32,
    /// Number of pixels.
    pub count: u64,
    /// Mean over pixels of the absolute error (mean of the channels) divided by the target's
    /// luminance.
    pub relative_error: f64,
    /// Mean over pixels of the luminance's signed error divided by the target's luminance: positive
    /// where the prediction is too bright.
    pub bias: f64,
}

impl DecadeError {
    fn merge(&mut self, other: &Self) {
        let count = self.count + other.count;
        // Without pixels in either, the share would be 0 / 0, which is NaN.
        let share = if count == 0 { 0.0 } else { other.count as f64 / count as f64 };
        self.relative_error += share * (other.relative_error - self.relative_error);
        self.bias += share * (other.bias - self.bias);
        self.count = count;
    }

    /// Returns the errors over all pixels of several images: the decades that have pixels, from the
    /// darkest.
    pub fn pooled<'a>(images: impl IntoIterator<Item = &'a [Self]>) -> Vec<Self> {
        let mut pooled = std::collections::BTreeMap::new();
        for error in images.into_iter().flatten() {
            pooled.entry(error.decade).or_insert(Self { decade: error.decade, ..Self::default() }).merge(error);
        }
        pooled.into_values().filter(|error| error.count > 0).collect()
    }
}

/// Returns the root of the mean over pixels and channels of the squared difference of log10.
pub(super) fn log_rmse(pair: &Pair) -> f64 {
    let log = |value: f32| f64::from(value.max(LOG_FLOOR)).log10();
    let squares: f64 = pair.valid().map(|(p, t)| (0..3).map(|c| (log(p[c]) - log(t[c])).powi(2)).sum::<f64>()).sum();
    (squares / (3.0 * pair.valid_count as f64)).sqrt()
}

/// Returns the errors of the decades that have pixels, from the darkest.
pub(super) fn relative_error_by_decade(pair: &Pair) -> Vec<DecadeError> {
    let mut sums: Vec<DecadeError> = DECADES.map(|decade| DecadeError { decade, ..DecadeError::default() }).collect();
    for (p, t) in pair.valid() {
        let luminance = luminance_rec709(t);
        let divisor = f64::from(luminance.max(LOG_FLOOR));
        let error: f64 = (0..3).map(|c| (f64::from(p[c]) - f64::from(t[c])).abs()).sum();
        if let Some(bin) = sums.get_mut(bin_of(luminance)) {
            bin.count += 1;
            bin.relative_error += error / 3.0 / divisor;
            bin.bias += (f64::from(luminance_rec709(p)) - f64::from(luminance)) / divisor;
        }
    }
    let mean = |sum: DecadeError| {
        let n = sum.count as f64;
        DecadeError { relative_error: sum.relative_error / n, bias: sum.bias / n, ..sum }
    };
    sums.into_iter().filter(|sum| sum.count > 0).map(mean).collect()
}

/// Returns the index of the decade of a luminance. It compares edges instead of logarithms, so that
/// rounding cannot put 0.001 below the decade that begins with it.
fn bin_of(luminance: f32) -> usize {
    const EDGES: [f32; 9] = [1e-4, 1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4];
    EDGES.iter().take_while(|&&edge| luminance >= edge).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::Image;

    fn pair<'a>(prediction: &'a Image, target: &'a Image) -> Pair<'a> {
        Pair::new(prediction, target, None).unwrap()
    }

    #[test]
    fn a_factor_has_its_logarithm_and_its_relative_error_in_every_decade() {
        let target = Image::from_pixels(4, 1, [1e-3, 0.05, 2.0, 7000.0].map(|v| [v; 3]).to_vec()).unwrap();
        let mut prediction = target.clone();
        prediction.scale(2.0);
        let pair = pair(&prediction, &target);
        assert!((log_rmse(&pair) - 2f64.log10()).abs() < 1e-6);
        let errors = relative_error_by_decade(&pair);
        assert_eq!(errors.iter().map(|e| (e.decade, e.count)).collect::<Vec<_>>(), [(-3, 1), (-2, 1), (0, 1), (3, 1)]);
        for error in errors {
            assert!((error.relative_error - 1.0).abs() < 1e-6 && (error.bias - 1.0).abs() < 1e-6, "{error:?}");
        }
    }

    #[test]
    fn black_is_finite() {
        let (black, target) = (Image::filled(3, 2, [0.0; 3]), Image::filled(3, 2, [0.1; 3]));
        assert!((log_rmse(&pair(&black, &target)) - 4.0).abs() < 1e-6);
        assert_eq!(log_rmse(&pair(&black, &black)), 0.0);
        let errors = relative_error_by_decade(&pair(&black, &black));
        assert_eq!(errors, [DecadeError { decade: -5, count: 6, relative_error: 0.0, bias: 0.0 }]);
    }

    #[test]
    fn pooling_weighs_by_pixels() {
        let error = |decade, count, relative_error| DecadeError { decade, count, relative_error, bias: -relative_error };
        let pooled = DecadeError::pooled([&[error(0, 1, 0.4), error(1, 0, 9.0)][..], &[error(-1, 2, 0.5), error(0, 3, 0.8)]]);
        assert_eq!(pooled.iter().map(|e| (e.decade, e.count)).collect::<Vec<_>>(), [(-1, 2), (0, 4)]);
        assert!((pooled[1].relative_error - 0.7).abs() < 1e-12 && (pooled[1].bias + 0.7).abs() < 1e-12);
    }
}

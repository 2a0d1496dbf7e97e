//! The radiance of one normalised unit.
//!
//! In: the training views [H,W,3] in the data set's units, with masks. Out: one factor > 0 by which
//! all radiance is divided in training. It matters because the mu-law of the loss is linear below
//! 1/mu and logarithmic above. A typical pixel has to lie well above 1/mu, so that the loss sees
//! the dark, and at most near 1, so that metrics are comparable with published ones. If all pixels
//! are black, the result is an error.

use luxel_core::{RadianceScale, View};

use crate::TrainError;
use crate::config::ScaleRule;
use crate::start_views::StartViews;
use crate::views::pixels;

/// The median radiance after [`ScaleRule::Median20`], which is typical of HDR-NeRF's synthetic
/// scenes.
const MEDIAN_TARGET: f32 = 0.05;

/// Largest number of pixels that a percentile is computed from; it is stable with that many.
const MAX_SAMPLES: usize = 1 << 21;

/// How the pixels of a view are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sampling {
    /// Pixels from one that is looked at to the next.
    stride: usize,
    /// Whether the brightest channel of all pixels is wanted.
    wants_brightest: bool,
}

impl Sampling {
    /// Returns what `rule` needs to know of these views.
    pub(crate) fn new(train: &[View], rule: ScaleRule) -> Self {
        let total = pixels(train) as usize;
        // An odd stride does not fall in step with even image widths.
        Self { stride: (total / MAX_SAMPLES + 1) | 1, wants_brightest: rule == ScaleRule::Max }
    }
}

/// Radiance of pixels, of one view or of many, data-set units.
#[derive(Default)]
pub(crate) struct Luminances {
    /// (R + G + B) / 3 of some valid pixels. Black pixels are left out, because they often stand
    /// for a mask.
    positive: Vec<f32>,
    any_valid: bool,
    /// The brightest channel of all valid pixels, if it was looked for.
    brightest: f32,
}

impl Luminances {
    /// Returns those of a view in memory.
    pub(crate) fn new(view: &View, sampling: Sampling) -> Self {
        let mut found = Self::default();
        for i in (0..view.image.pixels.len()).step_by(sampling.stride).filter(|i| view.is_valid(*i)) {
            found.any_valid = true;
            let [r, g, b] = view.image.pixels[i];
            found.positive.push(r / 3.0 + g / 3.0 + b / 3.0);
        }
        found.positive.retain(|v| *v > 0.0 && v.is_finite());
        if sampling.wants_brightest {
            let valid = view.image.pixels.iter().enumerate().filter(|(i, _)| view.is_valid(*i));
            found.brightest = valid.flat_map(|(_, rgb)| rgb).copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
        }
        found
    }

    /// Returns those of all views, in their order. Where no pixel of those that were looked at is
    /// bright, all pixels are looked at.
    ///
    /// # Errors
    /// An image that cannot be read.
    pub(crate) fn of_all(parts: Vec<Self>, views: &StartViews<'_>, sampling: Sampling) -> Result<Self, TrainError> {
        let all = Self::joined(parts);
        if !all.positive.is_empty() || sampling.stride == 1 {
            return Ok(all);
        }
        let every = Sampling { stride: 1, ..sampling };
        Ok(Self::joined(views.look(&views.all(), |_, view| Self::new(view, every))?))
    }

    fn joined(parts: Vec<Self>) -> Self {
        let mut all = Self::default();
        for part in parts {
            all.positive.extend(part.positive);
            all.any_valid |= part.any_valid;
            all.brightest = all.brightest.max(part.brightest);
        }
        all
    }

    /// Returns the median, or `None` where every pixel is black or masked.
    pub(crate) fn median(&self) -> Option<f32> {
        self.percentile(0.5)
    }

    /// Returns the radiance of one normalised unit by `rule`.
    ///
    /// # Errors
    /// Returns [`TrainError::NoPixels`] or [`TrainError::AllBlack`].
    pub(crate) fn radiance_scale(&self, rule: ScaleRule) -> Result<RadianceScale, TrainError> {
        let typical = |part| self.percentile(part).ok_or(if self.any_valid { TrainError::AllBlack } else { TrainError::NoPixels });
        let scale = match rule {
            ScaleRule::Raw => 1.0,
            // Without a bright pixel there is no brightest one.
            ScaleRule::Max => typical(1.0).map(|_| self.brightest)?,
            ScaleRule::P99 => typical(0.99)?,
            ScaleRule::Median20 => typical(0.5)? / MEDIAN_TARGET,
        };
        // Denormal radiance would make 1 / scale infinite.
        RadianceScale::new(scale.clamp(f32::MIN_POSITIVE * 16.0, f32::MAX / 16.0)).ok_or(TrainError::NoPixels)
    }

    /// Returns the value below which the fraction `part` of the values lies.
    fn percentile(&self, part: f64) -> Option<f32> {
        let mut values = self.positive.clone();
        let at = (values.len().checked_sub(1)? as f64 * part).round() as usize;
        Some(*values.select_nth_unstable_by(at, f32::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {

    use luxel_core::{Image, Mask};

    use super::*;
    use crate::testing::{camera_at, dataset_of, on_demand, view_of};

    fn luminances(train: Vec<View>, rule: ScaleRule) -> Luminances {
        let dataset = dataset_of(train);
        let (views, sampling) = (StartViews::new(&dataset, None), Sampling::new(&dataset.train, rule));
        let parts = views.look(&views.all(), |_, view| Luminances::new(view, sampling)).unwrap();
        Luminances::of_all(parts, &views, sampling).unwrap()
    }

    fn scale(train: &[View], rule: ScaleRule) -> Result<RadianceScale, TrainError> {
        luminances(train.to_vec(), rule).radiance_scale(rule)
    }

    fn ramp() -> Vec<View> {
        // 101 grey pixels of radiance 0, 1, ..., 100.
        let pixels = (0..101).map(|i| [i as f32; 3]).collect();
        vec![view_of("ramp", camera_at([0.0; 3], [101, 1]), Image::from_pixels(101, 1, pixels).unwrap())]
    }

    #[test]
    fn rules_put_the_typical_pixel_where_they_say() {
        let views = ramp();
        // The black pixel is left out: the median of 1..=100 by nearest rank is 51.
        assert!((scale(&views, ScaleRule::Median20).unwrap().get() * 0.05 - 51.0).abs() < 1e-3);
        assert!((scale(&views, ScaleRule::P99).unwrap().get() - 99.0).abs() < 1e-3);
        assert_eq!(scale(&views, ScaleRule::Max).unwrap().get(), 100.0);
        assert_eq!(scale(&views, ScaleRule::Raw).unwrap(), RadianceScale::ONE);
    }

    #[test]
    fn masked_pixels_are_left_out() {
        let mut views = ramp();
        views[0].mask = Some(Mask::from_valid((0..101).map(|i| i <= 10)).into());
        assert_eq!(scale(&views, ScaleRule::Max).unwrap().get(), 10.0);
        views[0].mask = Some(Mask::from_valid(vec![false; 101]).into());
        assert!(matches!(scale(&views, ScaleRule::Max), Err(TrainError::NoPixels)));
    }

    #[test]
    fn black_images_are_an_error() {
        let views = [view_of("black", camera_at([0.0; 3], [4, 4]), Image::filled(4, 4, [0.0; 3]))];
        for rule in [ScaleRule::Median20, ScaleRule::P99, ScaleRule::Max] {
            assert!(matches!(scale(&views, rule), Err(TrainError::AllBlack)));
        }
    }

    #[test]
    fn every_pixel_is_looked_at_where_none_of_some_is_bright() {
        let mut image = Image::filled(2048, 1500, [0.0; 3]);
        // Between two of the pixels that a stride of 3 looks at.
        image.pixels[4] = [0.5; 3];
        let view = view_of("dark", camera_at([0.0; 3], [2048, 1500]), image);
        for view in [on_demand(&view), view] {
            assert_eq!(luminances(vec![view], ScaleRule::Median20).median(), Some(0.5));
        }
    }
}

//! Settings of the measurement of views.
//!
//! In: a scene's radiance scale, mu and what else is asked for. Out: [`Measures`], which brings
//! predictions and images of views to the units of the protocols.

use std::borrow::Cow;

use luxel_core::{Image, Knots, PixelValues, RadianceScale, View};

use crate::{FieldOptions, GainFit, Lpips};

/// Largest number of pixels of images that are read on demand to be measured in parallel.
const BATCH_PIXELS: u64 = 16_000_000;

/// Settings of the measurement.
#[derive(Clone, Copy, Debug)]
pub struct Measures<'a> {
    /// The data-set radiance of one normalised unit.
    pub radiance_scale: RadianceScale,
    /// The data-set radiance that is 1 in protocol `scene`, in the decades and on the display of
    /// PU21; `None` for that of a normalised unit.
    pub protocol_scale: Option<RadianceScale>,
    /// The mu of the mu-law.
    pub mu: f32,
    /// Options of the metrics that need no mu-law.
    pub field: FieldOptions,
    /// The LPIPS network, if the user has weights for one.
    pub lpips: Option<&'a Lpips>,
    /// The response of the camera that captured the LDR views.
    pub response: Option<&'a Knots>,
    /// The gains by which the predictions are multiplied.
    pub gain_fit: GainFit<'a>,
}

impl Measures<'_> {
    /// Returns settings for images in linear Rec.709, with the default display, without HDR-FLIP
    /// and LPIPS.
    pub fn new(radiance_scale: RadianceScale, mu: f32) -> Self {
        let field = FieldOptions::default();
        Self { radiance_scale, protocol_scale: None, mu, field, lpips: None, response: None, gain_fit: GainFit::None }
    }

    /// Returns a prediction in units of the protocol's scale.
    pub(crate) fn in_protocol_units<'i>(&self, view: &View, prediction: &'i Image) -> Cow<'i, Image> {
        match self.protocol_scale {
            Some(scale) if scale != self.radiance_scale && view.values == PixelValues::Radiance => {
                let mut image = prediction.clone();
                image.scale(scale.normalised_value(self.radiance_scale.get()));
                Cow::Owned(image)
            }
            _ => Cow::Borrowed(prediction),
        }
    }

    /// Returns the image of a view in units of the protocol's scale, or its captured values.
    pub(crate) fn target(&self, view: &View) -> Image {
        let mut target = Image::clone(&view.image);
        if view.values == PixelValues::Radiance {
            self.protocol_scale.unwrap_or(self.radiance_scale).normalise(&mut target);
        }
        target
    }

    /// Returns the number of views that are measured in parallel. A network is parallel in itself,
    /// and its features of one view can take gigabytes. Of images that are read on demand, which
    /// are those that memory has no room for, no more are read at a time than [`BATCH_PIXELS`] say.
    pub(crate) fn batch(&self, views: &[View]) -> usize {
        let largest = views.iter().filter(|view| !view.is_in_memory()).map(View::pixel_count).max().unwrap_or(0);
        let threads = if self.lpips.is_some() { 1 } else { rayon::current_num_threads().max(1) };
        threads.min(usize::try_from(BATCH_PIXELS / largest.max(1)).unwrap_or(usize::MAX)).max(1)
    }
}

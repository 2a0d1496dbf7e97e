//! The metrics of a pair of images.
//!
//! In: a [`Pair`] and [`Settings`]. Out: [`ImageMetrics`], and the error map if it is asked for.
//! Degenerate: pixels of the reference that are not finite are left out with a warning; those of
//! the test are an error. Black references have the scale 1.

use std::path::Path;

use luxel_core::tone::rec709_of;
use luxel_core::{ColorSpace, Image, Mask, RadianceScale, luminance_rec709};
use luxel_io::{ReadOptions, Transfer};
use luxel_metrics::{FieldMetrics, FieldOptions, FlipChoice, FlipMap, Lpips, ViewMetrics, field_metrics, hdr_flip, view_metrics};

use super::pairs::{Pair, Pairs};
use super::{CompareOptions, ImageMetrics};
use crate::error::{Context, bail};
use crate::radiance::RADIANCE_SCALE;
use crate::{Observer, Result};
use luxel_metrics::colormap::magma;

/// Share of the references' pixels that are darker than the scale, unless one is given.
const SCALE_PERCENTILE: f64 = 0.999;

/// The rule by which a scale is found from luminances.
const RULE_OF_REFERENCES: &str = "99.9th percentile of the luminance of the references";

/// Number of luminances that a percentile is taken of; more would not move it.
const MAX_SAMPLES: usize = 1 << 22;

/// Colour of masked pixels in an error map.
const MASKED: [u8; 3] = [0x60, 0x68, 0x70];

/// The settings that all pairs share.
pub(super) struct Settings {
    /// Radiance of one normalised unit.
    pub(super) scale: f32,
    /// How it was found, for people.
    pub(super) scale_rule: &'static str,
    pub(super) mu: f32,
    pub(super) peak_luminance: f32,
    pub(super) flip: FlipChoice,
    lpips: Option<Lpips>,
    transfer: Option<Transfer>,
    layer: Option<String>,
    color_space: ColorSpace,
}

impl Settings {
    /// Reads the weights of LPIPS, and finds the scale if it is not given.
    pub(super) fn new(options: &CompareOptions, pairs: &Pairs, observer: &dyn Observer) -> Result<Self> {
        let mut settings = Self::given(options)?;
        match options.scale {
            Some(_) => {}
            None => match stated_scale(pairs, observer) {
                Some(scale) => {
                    settings.scale = scale;
                    settings.scale_rule = "radiance scale that the files state";
                }
                None => {
                    settings.scale = scale_of_references(pairs, &settings)?;
                    settings.scale_rule = RULE_OF_REFERENCES;
                }
            },
        }
        Ok(settings)
    }

    /// Reads the weights of LPIPS; for an image in memory, whose luminance gives the scale if it is
    /// not given.
    pub(super) fn of_image(options: &CompareOptions, reference: &Image, mask: Option<&Mask>, color_space: ColorSpace) -> Result<Self> {
        let mut settings = Self::given(options)?;
        if options.scale.is_none() {
            let mut luminances = Vec::new();
            add_luminances(&mut luminances, reference, mask, color_space, 1);
            settings.scale = scale_of_luminances(luminances);
            settings.scale_rule = RULE_OF_REFERENCES;
        }
        Ok(settings)
    }

    /// Reads the weights of LPIPS; the scale is the one given, or 1.
    fn given(options: &CompareOptions) -> Result<Self> {
        // Error maps are those of HDR-FLIP.
        let flip = if options.heatmap.is_some() { FlipChoice::Compute } else { options.flip };
        Ok(Self {
            scale: options.scale.unwrap_or(1.0),
            scale_rule: "given",
            mu: options.mu,
            peak_luminance: options.peak_luminance,
            flip,
            lpips: super::read_lpips(options.lpips_weights.as_deref())?,
            transfer: options.transfer,
            layer: options.layer.clone(),
            color_space: options.color_space.unwrap_or_default(),
        })
    }

    /// Returns how many pairs are measured side by side. A network is parallel by itself, and its
    /// features of one image may fill gigabytes.
    pub(super) fn batch(&self) -> usize {
        if self.lpips.is_some() { 1 } else { rayon::current_num_threads().max(1) }
    }

    fn read(&self, path: &Path) -> Result<SpacedImage> {
        let options = ReadOptions { transfer: self.transfer, layer: self.layer.clone() };
        let mut decoded = luxel_io::read_image(path, &options).context("cannot read an image")?;
        decoded.composite_over_black();
        let (stated, image) = (decoded.color_space, decoded.image);
        Ok(SpacedImage { image, color_space: stated.unwrap_or(self.color_space), is_stated: stated.is_some() })
    }
}

/// Returns the radiance scale that the references state, or if none does the tests: that of the
/// scene they were rendered from, by which `luxel eval` measures, too. `None` if none is stated, or
/// if scenes of several scales were rendered.
fn stated_scale(pairs: &Pairs, observer: &dyn Observer) -> Option<f32> {
    let stated = |path: &Path| {
        let found = luxel_io::read_exr_attributes(path).ok()?.numbers.get(RADIANCE_SCALE).copied()?;
        RadianceScale::new(found).map(RadianceScale::get)
    };
    let references: Vec<f32> = pairs.pairs.iter().filter_map(|pair| stated(&pair.reference)).collect();
    let scales = if references.is_empty() { pairs.pairs.iter().filter_map(|pair| stated(&pair.test)).collect() } else { references };
    let first = *scales.first()?;
    if let Some(other) = scales.iter().find(|scale| **scale != first) {
        observer.warn(&format!(
            "the images state several radiance scales, {first} and {other}: the scale is taken from the luminance of the references"
        ));
        return None;
    }
    Some(first)
}

/// Returns the radiance of 1 by the references' luminance; 1 if all references are black.
fn scale_of_references(pairs: &Pairs, settings: &Settings) -> Result<f32> {
    let mut luminances: Vec<f32> = Vec::new();
    for pair in &pairs.pairs {
        let SpacedImage { image, color_space, .. } = settings.read(&pair.reference)?;
        let mask = mask(pair, &image)?;
        add_luminances(&mut luminances, &image, mask.as_ref(), color_space, pairs.pairs.len());
    }
    Ok(scale_of_luminances(luminances))
}

/// Appends luminances of an image, one of `images` that take part equally.
fn add_luminances(luminances: &mut Vec<f32>, image: &Image, mask: Option<&Mask>, color_space: ColorSpace, images: usize) {
    let valid = |i: &usize| mask.is_none_or(|mask| mask.is_valid(*i));
    // An odd stride does not fall in step with even image widths.
    let stride = (image.pixels.len().saturating_mul(images) / MAX_SAMPLES + 1) | 1;
    let found = (0..image.pixels.len()).step_by(stride).filter(valid);
    let found = found.filter_map(|i| Some(luminance_rec709(rec709_of(color_space, *image.pixels.get(i)?))));
    luminances.extend(found.filter(|luminance| luminance.is_finite()));
}

/// Returns the percentile of luminances that is shown as 1; 1 if all are black.
fn scale_of_luminances(mut luminances: Vec<f32>) -> f32 {
    if luminances.is_empty() {
        return 1.0;
    }
    let at = ((luminances.len() - 1) as f64 * SCALE_PERCENTILE).round() as usize;
    let found = *luminances.select_nth_unstable_by(at, f32::total_cmp).1;
    // A lamp of few pixels may be all the light there is.
    let brightest = luminances.iter().copied().fold(0.0, f32::max);
    let scale = if found > 0.0 { found } else { brightest };
    if scale > 0.0 { scale.clamp(f32::MIN_POSITIVE * 16.0, f32::MAX / 16.0) } else { 1.0 }
}

/// Memory for a pixel: both images, their luminances and the planes of SSIM and HDR-FLIP.
const BYTES_PER_PIXEL: u64 = 130;

/// Returns the metrics of a pair; writes its error map if that is asked for.
pub(super) fn measure(pair: &Pair, settings: &Settings) -> Result<ImageMetrics> {
    let (mut reference, mut test) = (settings.read(&pair.reference)?, settings.read(&pair.test)?);
    check_sizes(pair, &reference.image, &test.image)?;
    let [width, height] = [reference.image.width, reference.image.height];
    let work = format!("comparing {width} x {height} pixels");
    crate::memory::check(&work, (width * height) as u64 * BYTES_PER_PIXEL, "compare smaller images")?;
    let states_primaries = reference.is_stated && test.is_stated;
    let color_space = common_space(&mut reference, &mut test);
    let (mut reference, mut test) = (reference.image, test.image);
    let given = mask(pair, &reference)?;
    let bad = reference.pixels.iter().filter(|p| !p.iter().all(|v| v.is_finite())).count();
    let warning = (bad > 0).then(|| format!("{}: {bad} pixels are not finite; left out", pair.reference.display()));
    let failed = || format!("cannot compare {} with {}", pair.test.display(), pair.reference.display());
    let measured = measure_pixels(&mut reference, &mut test, given, color_space, settings).with_context(failed)?;
    if let (Some(path), Some(map)) = (&pair.heatmap, &measured.flip) {
        write_heatmap(path, map, measured.mask.as_ref())?;
    }
    Ok(ImageMetrics {
        name: pair.name.clone(),
        reference: pair.reference.display().to_string(),
        test: pair.test.display().to_string(),
        width: reference.width,
        height: reference.height,
        color_space,
        masked_pixels: measured.masked_pixels(),
        hdr_flip_exposures_ev: measured.exposures_ev(),
        mu_law: measured.mu_law,
        field: measured.field,
        states_primaries,
        warning,
    })
}

/// The metrics of pixels.
pub(super) struct Measured {
    pub(super) mu_law: ViewMetrics,
    pub(super) field: FieldMetrics,
    /// The pixels that took part; `None` for all.
    mask: Option<Mask>,
    /// The map of HDR-FLIP, if it is measured.
    flip: Option<FlipMap>,
}

impl Measured {
    /// Returns the number of pixels left out.
    pub(super) fn masked_pixels(&self) -> usize {
        self.mask.as_ref().map_or(0, |mask| mask.weights.iter().filter(|weight| **weight == 0.0).count())
    }

    /// Returns the first and last exposure of HDR-FLIP, stops.
    pub(super) fn exposures_ev(&self) -> Option<[f32; 2]> {
        self.flip.as_ref()?.exposures.map(|exposures| [exposures.start_ev, exposures.stop_ev])
    }
}

/// Returns the metrics of two images of one size, which are brought to normalised units. Pixels of
/// the reference that are not finite are left out.
pub(super) fn measure_pixels(
    reference: &mut Image,
    test: &mut Image,
    given: Option<Mask>,
    color_space: ColorSpace,
    settings: &Settings,
) -> Result<Measured> {
    let mask = without_bad_pixels(given, reference);
    reference.scale(1.0 / settings.scale);
    test.scale(1.0 / settings.scale);
    let mu_law = view_metrics(test, reference, mask.as_ref(), settings.mu)?;
    let options = FieldOptions { peak_luminance: settings.peak_luminance, color_space, flip: FlipChoice::Skip };
    let mut field = field_metrics(test, reference, mask.as_ref(), &options)?;
    if let Some(lpips) = &settings.lpips {
        let distance = lpips.radiance_distance(test, reference, mask.as_ref(), settings.mu, color_space);
        lpips.record(distance?, &mut field);
    }
    let mut flip = None;
    if settings.flip == FlipChoice::Compute {
        let map = hdr_flip(test, reference, mask.as_ref(), color_space)?;
        field.hdr_flip = Some(map.mean);
        flip = Some(map);
    }
    Ok(Measured { mu_law, field, mask, flip })
}

fn check_sizes(pair: &Pair, reference: &Image, test: &Image) -> Result<()> {
    if (reference.width, reference.height) != (test.width, test.height) {
        bail!(
            "{} is {}x{}, {} is {}x{}: expected equal sizes; scale or crop one of them",
            pair.reference.display(),
            reference.width,
            reference.height,
            pair.test.display(),
            test.width,
            test.height
        );
    }
    Ok(())
}

/// An image with its primaries.
struct SpacedImage {
    image: Image,
    color_space: ColorSpace,
    /// Whether the file states its primaries.
    is_stated: bool,
}

/// Returns the colour space of both; where they differ, converts both to linear Rec.709.
fn common_space(reference: &mut SpacedImage, test: &mut SpacedImage) -> ColorSpace {
    if reference.color_space != test.color_space {
        for SpacedImage { image, color_space, .. } in [reference, test] {
            for pixel in &mut image.pixels {
                *pixel = rec709_of(*color_space, *pixel);
            }
            *color_space = ColorSpace::LinearRec709;
        }
        return ColorSpace::LinearRec709;
    }
    reference.color_space
}

/// Reads the pair's mask, which has the size of `image`.
fn mask(pair: &Pair, image: &Image) -> Result<Option<Mask>> {
    let Some(path) = &pair.mask else { return Ok(None) };
    // Any transfer curve keeps black black.
    let found = luxel_io::read_codes(path).context("cannot read a mask")?.image;
    if (found.width, found.height) != (image.width, image.height) {
        bail!(
            "{} is {}x{}, the image {} is {}x{}: a mask needs the size of its image",
            path.display(),
            found.width,
            found.height,
            pair.reference.display(),
            image.width,
            image.height
        );
    }
    Ok(Some(Mask::from_valid(found.pixels.iter().map(|p| p.iter().any(|v| *v > 0.0)))))
}

/// Returns the mask without pixels of the reference that are not finite. Those of the test are an
/// error.
fn without_bad_pixels(mask: Option<Mask>, reference: &Image) -> Option<Mask> {
    let finite = |i: usize| reference.pixels[i].iter().all(|v| v.is_finite());
    if (0..reference.pixels.len()).all(finite) {
        return mask;
    }
    let valid = (0..reference.pixels.len()).map(|i| finite(i) && mask.as_ref().is_none_or(|mask| mask.is_valid(i)));
    Some(Mask::from_valid(valid))
}

fn write_heatmap(path: &Path, map: &FlipMap, mask: Option<&Mask>) -> Result<()> {
    let valid = |i: usize| mask.is_none_or(|mask| mask.is_valid(i));
    let color = |(i, &error): (usize, &f32)| if valid(i) { magma(error) } else { MASKED };
    let rgb8: Vec<[u8; 3]> = map.error.iter().enumerate().map(color).collect();
    luxel_io::write_png(path, map.width, map.height, rgb8.as_flattened()).context("cannot write the error map")
}

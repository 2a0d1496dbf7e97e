//! Displays of an OpenColorIO configuration: scene-linear radiance becomes what a screen shows.

use std::path::{Path, PathBuf};

use ::ocio::Config;
use ::ocio::processor::CpuProcessor;
use luxel_core::{ColorSpace, Conversion, Image};
use rayon::prelude::*;

use super::{CHUNK, content, listed};
use crate::IoError;
use crate::image::guard::contain;
use crate::image::{DisplayCurve, DisplayEncoding};

/// From linear light to a display, by one of its views.
pub struct OcioDisplay {
    config: PathBuf,
    display_from_aces: CpuProcessor,
    display: String,
    view: String,
    digest: String,
    encoding: Option<DisplayEncoding>,
}

impl OcioDisplay {
    /// Reads the configuration. `None` is its first display, and the display's first view.
    ///
    /// # Errors
    /// No such file, one that is damaged, without the display or the view, or without a way from
    /// ACES2065-1.
    pub fn open(config: &Path, display: Option<&str>, view: Option<&str>) -> Result<Self, IoError> {
        let content = content(config)?;
        let (display_from_aces, display, view, encoding) = contain(config, || {
            let (parsed, interchange) = content.parse()?;
            let (display, view) = chosen(config, &parsed, display, view)?;
            let processor = parsed.get_display_view_processor(interchange, &display, &view);
            let processor =
                processor.map_err(|e| IoError::invalid(config, format!("from {interchange} to {display}, view {view}: {e}")))?;
            let encoding = encoding_of(&parsed, &display, &view);
            Ok((processor.default_cpu_processor(), display, view, encoding))
        })?;
        let digest = content.digest(&format!("{display} {view}"));
        Ok(Self { config: config.to_owned(), display_from_aces, display, view, digest, encoding })
    }

    /// Returns the name of the display.
    pub fn display(&self) -> &str {
        &self.display
    }

    /// Returns the name of the view.
    pub fn view(&self) -> &str {
        &self.view
    }

    /// Returns what its code values are for; `None` if the configuration does not say it in a way
    /// that is known.
    pub fn encoding(&self) -> Option<DisplayEncoding> {
        self.encoding
    }

    /// Returns the digest of configuration, display and view, for keys of images that were made
    /// with them.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Converts radiance of `space`, in which 1 is diffuse white, to code values of the display
    /// from 0 to 1.
    ///
    /// # Errors
    /// The library failed on it.
    pub fn encode(&self, image: &mut Image, space: ColorSpace) -> Result<(), IoError> {
        let conversion = Conversion::between(space.linear(), ColorSpace::Aces2065);
        image.pixels.par_chunks_mut(CHUNK).try_for_each(|pixels| {
            contain(&self.config, || {
                pixels.iter_mut().for_each(|p| *p = conversion.apply(space.light(*p)));
                self.display_from_aces.apply_rgb_slice(pixels.as_flattened_mut());
                // NaN becomes black.
                pixels.as_flattened_mut().iter_mut().for_each(|v| *v = if *v > 0.0 { v.min(1.0) } else { 0.0 });
                Ok(())
            })
        })
    }
}

impl std::fmt::Debug for OcioDisplay {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "OcioDisplay({})", self.digest)
    }
}

/// Returns the encoding of a display by its colour space's id, or else by names that only sRGB's
/// and Rec.709's displays have.
fn encoding_of(config: &Config, display: &str, view: &str) -> Option<DisplayEncoding> {
    let name = match config.display_view_color_space_name(display, view) {
        "<USE_DISPLAY_NAME>" => display,
        name => name,
    };
    let space = config.get_color_space(name)?;
    if !space.interop_id().is_empty() {
        return DisplayEncoding::from_interop_id(space.interop_id());
    }
    let curve = match name.to_lowercase() {
        name if name.contains("srgb") => DisplayCurve::Srgb,
        name if name.contains("709") => DisplayCurve::Gamma24,
        _ => return None,
    };
    Some(DisplayEncoding { curve, ..DisplayEncoding::default() })
}

/// Returns the display and the view, which the configuration has.
fn chosen(path: &Path, config: &Config, display: Option<&str>, view: Option<&str>) -> Result<(String, String), IoError> {
    let invalid = |message: String| IoError::invalid(path, message);
    let displays = config.num_displays();
    let display = match display {
        Some(name) if (0..displays).any(|i| config.display(i) == name) => name.to_owned(),
        Some(name) => {
            let named = listed(displays, |i| config.display(i));
            return Err(invalid(format!("no display \"{name}\", expected one of the configuration's: {named}")));
        }
        None => config.default_display(),
    };
    let views = config.num_views(&display);
    let view = match view {
        Some(name) if (0..views).any(|i| config.view(&display, i) == name) => name.to_owned(),
        Some(name) => {
            let named = listed(views, |i| config.view(&display, i));
            return Err(invalid(format!("no view \"{name}\" of display {display}, expected one of: {named}")));
        }
        None => config.default_view(&display),
    };
    if display.is_empty() || view.is_empty() {
        return Err(invalid("no display with a view, expected one".to_owned()));
    }
    Ok((display, view))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACES_2: &str = "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5";

    fn error(display: Option<&str>, view: Option<&str>) -> String {
        OcioDisplay::open(Path::new(ACES_2), display, view).unwrap_err().to_string()
    }

    #[test]
    fn aces_2_shows_grey_as_grey_and_rolls_off_highlights() {
        let display = OcioDisplay::open(Path::new(ACES_2), None, None).unwrap();
        assert!(display.display().contains("sRGB") && display.view().contains("ACES 2.0"), "{} {}", display.display(), display.view());
        let mut image = Image::filled(2, 3, [0.18; 3]);
        image.pixels[1] = [50.0; 3];
        image.pixels[2] = [-1.0, f32::NAN, 0.0];
        display.encode(&mut image, ColorSpace::LinearRec709).unwrap();
        // ACES 2.0's mid grey is 10 cd/m2 of a display of 100.
        let grey = image.pixels[0];
        assert!(grey.iter().all(|v| (v - 0.349).abs() < 0.01), "{grey:?}");
        assert!(image.pixels[1].iter().all(|v| (0.97..=1.0).contains(v)), "{:?}", image.pixels[1]);
        assert!(image.pixels[2].iter().all(|v| (0.0..=1.0).contains(v)));
    }

    #[test]
    fn code_values_are_for_the_display_that_the_configuration_names() {
        let encoding = |display, view| OcioDisplay::open(Path::new(ACES_2), Some(display), view).unwrap().encoding();
        assert_eq!(encoding("sRGB - Display", None), Some(DisplayEncoding::default()));
        assert_eq!(encoding("Display P3 - Display", None), DisplayEncoding::from_interop_id("srgb_p3d65_display"));
        assert_eq!(encoding("Rec.2100-PQ - Display", None), DisplayEncoding::from_interop_id("pq_rec2020_display"));
        // Data as it is has no display.
        assert_eq!(encoding("Display P3 - Display", Some("Raw")), None);
    }

    #[test]
    fn names_that_the_configuration_does_not_have_are_refused_with_those_that_it_has() {
        let found = error(Some("cinema"), None);
        assert!(found.contains("no display \"cinema\"") && found.contains("sRGB"), "{found}");
        let found = error(None, Some("Technicolor"));
        assert!(found.contains("no view \"Technicolor\"") && found.contains("Raw"), "{found}");
    }
}

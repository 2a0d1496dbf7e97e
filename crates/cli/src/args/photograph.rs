//! Arguments of photographs: aperture, focus and shutter of `luxel render`.

use clap::{ArgGroup, Args};
use luxel::photograph::{BLADES, SAMPLE_COUNTS};

use crate::args::values::{parse_pixel, parse_positive_f64};

/// Heading of the options in help texts.
const HEADING: &str = "Aperture and shutter";

/// Aperture and shutter.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("opening").args(["f_stop", "aperture"])),
    group(ArgGroup::new("exposed").args(["f_stop", "aperture", "shutter"]).multiple(true))
)]
pub(crate) struct PhotographArgs {
    /// Render through a thin lens with this f-number: 2.8. The diameter of its aperture is the
    /// focal length, by --sensor-width, over N; it needs a scene whose unit is known in metres.
    /// Things out of focus become discs, as bright as they are in the scene.
    #[arg(long, value_name = "N", value_parser = parse_positive_f64, help_heading = HEADING)]
    pub(crate) f_stop: Option<f64>,
    /// Render through a thin lens whose aperture has this diameter in world units.
    #[arg(long, value_name = "DIAMETER", value_parser = parse_positive_f64, help_heading = HEADING)]
    pub(crate) aperture: Option<f64>,
    /// Width of the sensor, millimetres, which gives --f-stop the focal length.
    #[arg(long, default_value_t = 36.0, value_name = "MM", value_parser = parse_positive_f64, requires = "f_stop", help_heading = HEADING)]
    pub(crate) sensor_width: f64,
    /// Distance in focus, along the camera's axis in world units [default: focus_distance of the
    /// frames of --cameras, focusDistance in OpenUSD].
    #[arg(long, value_name = "DISTANCE", allow_negative_numbers = true, value_parser = parse_focus, requires = "opening", help_heading = HEADING)]
    pub(crate) focus: Option<f64>,
    /// Focus on the surface at this pixel of the image, column and row from 0 at the top left. With
    /// --path or --cameras it is measured in the first frame and kept, else in each view.
    #[arg(long, value_name = "PX,PY", value_parser = parse_pixel, requires = "opening", conflicts_with = "focus", help_heading = HEADING)]
    pub(crate) focus_at: Option<[u32; 2]>,
    /// Number of straight blades of the aperture, 3 to 32, a corner up [default: a circle].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(i64::from(*BLADES.start())..=i64::from(*BLADES.end())), requires = "opening", help_heading = HEADING)]
    pub(crate) blades: Option<u8>,
    /// Open the shutter for this part of the time from frame to frame, in degrees of 360: 180 is
    /// half of it, around the moment of the frame. Frames of --path or --cameras only.
    #[arg(long, value_name = "DEGREES", value_parser = parse_shutter, help_heading = HEADING)]
    pub(crate) shutter: Option<f64>,
    /// Number of renders that an image is the mean of, 1 to 4096 [default: as many as bring the
    /// estimate of the error to 1 %, 16 to 1024].
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(i64::from(*SAMPLE_COUNTS.start())..=i64::from(*SAMPLE_COUNTS.end())),
        requires = "exposed",
        help_heading = HEADING
    )]
    pub(crate) lens_samples: Option<u32>,
    /// Take another set of samples in each frame: what is left of their pattern moves like grain in
    /// place of standing still.
    #[arg(long, requires = "exposed", help_heading = HEADING)]
    pub(crate) vary_samples: bool,
}

impl PhotographArgs {
    /// Returns whether images are more than a plain render.
    pub(crate) fn is_given(&self) -> bool {
        self.f_stop.is_some() || self.aperture.is_some() || self.shutter.is_some()
    }
}

fn parse_focus(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|distance: &f64| distance.is_normal() && *distance > 0.0);
    found.ok_or_else(|| format!("expected a distance in front of the camera, a finite number above 0, got \"{text}\""))
}

fn parse_shutter(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|degrees: &f64| *degrees > 0.0 && *degrees <= 360.0);
    found.ok_or_else(|| format!("expected degrees above 0 and up to 360, got \"{text}\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_focus_or_shutter_is_refused() {
        assert_eq!((parse_focus("1.35"), parse_shutter("180")), (Ok(1.35), Ok(180.0)));
        for bad in ["-1", "0", "nan", "inf", "near"] {
            assert!(parse_focus(bad).unwrap_err().contains("in front of the camera"), "{bad}");
        }
        for bad in ["0", "361", "-180", "nan"] {
            assert!(parse_shutter(bad).is_err(), "{bad}");
        }
    }
}

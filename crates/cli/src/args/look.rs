//! Arguments of OpenColorIO's displays: previews of `luxel render` and `luxel probe`, the page of
//! `luxel view`.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use clap::Args;
use luxel::preview::Curve;
use luxel_io::OcioDisplay;

use super::values::TonemapArg;

/// A view of a display of an OpenColorIO configuration.
#[derive(Debug, Args)]
pub(crate) struct OcioLookArgs {
    /// Make previews and SDR video with a display of this OpenColorIO configuration instead of
    /// --tonemap: a file, or a built-in one such as
    /// ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5.
    #[arg(long, value_name = "CONFIG", help_heading = "Images")]
    pub(crate) ocio: Option<PathBuf>,
    /// Display of --ocio [default: its first].
    #[arg(long, value_name = "NAME", requires = "ocio", help_heading = "Images")]
    pub(crate) display: Option<String>,
    /// View of the display [default: its first].
    #[arg(long, value_name = "NAME", requires = "ocio", help_heading = "Images")]
    pub(crate) view: Option<String>,
}

impl OcioLookArgs {
    /// Returns the curve of previews: this display's, or else a tone curve; `None` if there are to
    /// be none.
    pub(crate) fn curve(&self, tonemap: Option<TonemapArg>) -> Result<Option<Curve>> {
        let tonemap = || tonemap.map(|tonemap| Curve::Tonemap(tonemap.into()));
        Ok(self.open()?.map(|display| Curve::Ocio(Arc::new(display))).or_else(tonemap))
    }

    /// Opens the display, if there is one.
    pub(crate) fn open(&self) -> Result<Option<OcioDisplay>> {
        let Some(config) = &self.ocio else { return Ok(None) };
        Ok(Some(OcioDisplay::open(config, self.display.as_deref(), self.view.as_deref())?))
    }
}

/// Returns what to say of pictures of a display that their files cannot name.
pub(crate) fn note_of_pictures(curve: &Curve) -> Option<String> {
    let Curve::Ocio(display) = curve else { return None };
    let name = display.display();
    match display.encoding() {
        Some(encoding) if encoding.ffmpeg().is_some() => None,
        Some(_) => Some(format!("a PNG says that it is for the display {name}; programs take an SDR video for sRGB")),
        None => Some(format!("pictures are for the display {name}; programs take a PNG and an SDR video for sRGB")),
    }
}

//! Values of the options about captures: what is trained on, and where masks come from.

use clap::ValueEnum;
use luxel_io::{MaskSource, Supervision};

/// `--supervision`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum SupervisionArg {
    /// Radiance.
    #[default]
    Hdr,
    /// Captured LDR images (JPEG, PNG, TIFF) with their exposures; the camera's response is learned
    /// beside the scene.
    Ldr,
    /// Radiance, and the captured LDR images of the same poses, for the methods that train on both.
    Both,
}

impl From<SupervisionArg> for Supervision {
    fn from(arg: SupervisionArg) -> Self {
        match arg {
            SupervisionArg::Hdr => Self::Hdr,
            SupervisionArg::Ldr => Self::Ldr,
            SupervisionArg::Both => Self::Both,
        }
    }
}

/// Parses `--masks`; a folder is made absolute, so that the run finds it from anywhere.
pub(crate) fn parse_masks(text: &str) -> Result<MaskSource, String> {
    match text.parse()? {
        MaskSource::Folder(folder) => match std::path::absolute(&folder) {
            Ok(folder) => Ok(MaskSource::Folder(folder)),
            Err(error) => Err(format!("{}: {error}", folder.display())),
        },
        other => Ok(other),
    }
}

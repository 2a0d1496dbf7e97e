//! Values of the options about captures: what is trained on, and where masks come from.

use std::fmt;
use std::str::FromStr;

use clap::ValueEnum;
use luxel_io::{Exposures, MaskSource, Supervision};
use serde::{Deserialize, Serialize};

/// `--supervision`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum SupervisionArg {
    /// Radiance.
    #[default]
    Hdr,
    /// Recordings (JPEG, PNG, TIFF) with their exposures; the camera's response is learned beside the scene.
    Ldr,
}

impl From<SupervisionArg> for Supervision {
    fn from(arg: SupervisionArg) -> Self {
        match arg {
            SupervisionArg::Hdr => Self::Hdr,
            SupervisionArg::Ldr => Self::Ldr,
        }
    }
}

/// A value that is text on the command line and in config.toml.
macro_rules! textual {
    ($(#[doc = $doc:literal])+ $name:ident($inner:ty), $resolved:expr) => {
        $(#[doc = $doc])+
        #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(into = "String", try_from = "String")]
        pub(crate) struct $name(pub(crate) $inner);

        impl FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                text.parse::<$inner>().and_then($resolved).map(Self)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl From<$name> for String {
            fn from(arg: $name) -> Self {
                arg.to_string()
            }
        }

        impl TryFrom<String> for $name {
            type Error = String;

            fn try_from(text: String) -> Result<Self, String> {
                text.parse()
            }
        }
    };
}

textual!(
    /// `--exposures`.
    ExposuresArg(Exposures),
    Ok
);

textual!(
    /// `--masks`; a folder is made absolute, so that the run finds it from anywhere.
    MasksArg(MaskSource),
    |source| match source {
        MaskSource::Folder(folder) => match std::path::absolute(&folder) {
            Ok(folder) => Ok(MaskSource::Folder(folder)),
            Err(error) => Err(format!("{}: {error}", folder.display())),
        },
        other => Ok(other),
    }
);

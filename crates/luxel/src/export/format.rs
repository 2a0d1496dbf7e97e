//! Formats of scene files that are written.

use std::path::Path;

use super::UpAxis;
use crate::Result;
use crate::error::bail;

/// A format of scene files, by the extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `.ply`
    Ply,
    /// `.usda` or `.usd`, text.
    Usda,
    /// `.usdc`, OpenUSD's binary form.
    Usdc,
    /// `.usdz`, a package of it.
    Usdz,
    /// `.glb`
    Glb,
    /// `.spz`
    Spz,
    /// `.sog`
    Sog,
}

impl Format {
    /// Returns the format of a path.
    ///
    /// # Errors
    /// An extension of another format.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        Ok(match extension.as_str() {
            "ply" => Self::Ply,
            "usda" | "usd" => Self::Usda,
            "usdc" => Self::Usdc,
            "usdz" => Self::Usdz,
            "glb" => Self::Glb,
            "spz" => Self::Spz,
            "sog" => Self::Sog,
            "gltf" => bail!("{}: glTF is written as one file; write .glb", path.display()),
            _ => bail!("{}: unknown extension, expected .ply, .usda, .usd, .usdc, .usdz, .glb, .spz, .sog or .html", path.display()),
        })
    }

    /// Returns whether its files are OpenUSD.
    pub(super) fn is_usd(self) -> bool {
        matches!(self, Self::Usda | Self::Usdc | Self::Usdz)
    }

    /// Returns the axis that is up in its files.
    pub(super) fn up_axis(self) -> UpAxis {
        match self {
            Self::Ply | Self::Spz | Self::Sog => UpAxis::MinusY,
            Self::Usda | Self::Usdc | Self::Usdz | Self::Glb => UpAxis::PlusY,
        }
    }
}

//! The way in which another program renders its splats, as it states it in words.
//!
//! Flat splats of 2D Gaussian splatting (Huang et al. 2024) have two axes and are met by rays
//! there. Here they are Gaussians that are a thousandth as thick as wide.

use luxel_core::{Antialias, Splats};

/// Thickness of a flat splat as a fraction of the smaller of its two axes, at any size of scene.
const FLATNESS: f32 = 1e-3;

/// A way of rendering splats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum SplatModel {
    /// The way of 3D Gaussian splatting, or one without a name here.
    #[default]
    Plain,
    /// With anti-aliasing, as Mip-splatting.
    Antialiased,
    /// Flat splats.
    Flat,
}

impl SplatModel {
    /// Returns the model of a name: Brush's in PLY, splat-transform's in SOG.
    pub(crate) fn from_name(name: &str) -> Self {
        match name {
            "mip" | "antialiased" => Self::Antialiased,
            "2dgs" => Self::Flat,
            _ => Self::Plain,
        }
    }

    pub(crate) fn antialias(self) -> Antialias {
        if self == Self::Antialiased { Antialias::Mip } else { Antialias::Off }
    }

    /// Gives flat splats their thickness; the warning says so. Others stay as they are.
    pub(crate) fn flatten(self, splats: &mut Splats) -> Option<String> {
        if self != Self::Flat {
            return None;
        }
        for [a, b, thickness] in &mut splats.log_scale {
            *thickness = log_thickness(*a, *b);
        }
        Some(FLAT.to_owned())
    }
}

/// The warning about flat splats.
pub(crate) const FLAT: &str = "flat splats of 2DGS: read as 0.001 times as thick as wide, and rendered as Gaussians";

/// Returns the logarithm of the thickness of a flat splat from those of its axes.
pub(crate) fn log_thickness(a: f32, b: f32) -> f32 {
    a.min(b) + FLATNESS.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_no_program_writes_mean_nothing() {
        let found = ["mip", "antialiased", "2dgs", "default", "banana", ""].map(SplatModel::from_name);
        assert_eq!(found[..3], [SplatModel::Antialiased, SplatModel::Antialiased, SplatModel::Flat]);
        assert_eq!(found[3..], [SplatModel::Plain; 3]);
        assert!(FLAT.contains(&FLATNESS.to_string()));
    }
}

//! The colours of an exported file: options, resolved for the file's format.
//!
//! In: a [`Bake`], whose open options take the usual values of the format and the scene. Out: a
//! [`Plan`]. Degenerate: options that contradict each other or the format are errors.

use std::path::Path;

use luxel_core::tone::Tonemap;
use luxel_core::{ColorSpace, Scene};
use luxel_io::{Appearance, BakeOptions};

use super::format::Format;
use crate::{Error, Remedy, Result};

/// The kind of colours in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BakeKind {
    /// Tone-mapped colours for a screen.
    Display,
    /// Scene-linear radiance as spherical harmonics.
    Linear,
    /// A display bake, and the radiance model beside it.
    Exact,
}

/// The colours of a file.
///
/// ```
/// use luxel::{Bake, ColorSpace};
///
/// let bake = Bake { exposure_ev: 1.0, ..Bake::linear(ColorSpace::AcesCg) };
/// assert_eq!(bake.color_space, Some(ColorSpace::AcesCg));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bake {
    /// Kind of colours; `None` for exact in PLY and GLB, linear in USD, display in SPZ and SOG, and
    /// for colours that are a display's already.
    pub kind: Option<BakeKind>,
    /// Colour space of a linear bake; `None` for that of the scene, in GLB linear Rec.709.
    pub color_space: Option<ColorSpace>,
    /// Curve of a display bake; `None` for AgX, and for colours that are a display's already, which
    /// stay what they are.
    pub tonemap: Option<Tonemap>,
    /// Stops: on radiance in the units of the data set for linear and exact bakes, on top of its
    /// own exposure for a display bake.
    pub exposure_ev: f32,
    /// Highest degree of the baked harmonics, 0 to 3.
    pub max_degree: u8,
    /// Steps of training a display bake against tone-mapped renders of the data set's views; `None`
    /// for [`super::DEFAULT_REFINE_STEPS`] within a bounded time where there are views.
    pub refine_steps: Option<u32>,
}

impl Default for Bake {
    fn default() -> Self {
        Self { kind: None, color_space: None, tonemap: None, exposure_ev: 0.0, max_degree: 3, refine_steps: None }
    }
}

impl Bake {
    /// Returns a bake of scene-linear radiance in a colour space.
    pub fn linear(color_space: ColorSpace) -> Self {
        Self { kind: Some(BakeKind::Linear), color_space: Some(color_space), ..Self::default() }
    }

    /// Returns a bake of tone-mapped colours.
    pub fn display(tonemap: Tonemap) -> Self {
        Self { kind: Some(BakeKind::Display), tonemap: Some(tonemap), ..Self::default() }
    }

    /// Returns a tone-mapped bake with the exact radiance model beside it.
    pub fn exact() -> Self {
        Self { kind: Some(BakeKind::Exact), ..Self::default() }
    }

    /// Checks whether the options go together in a file at `path`. [`super::export`] does so, too.
    ///
    /// # Errors
    /// Options that contradict each other or the format.
    pub fn check_for(&self, path: &Path) -> Result<()> {
        let format = Format::from_path(path)?;
        self.check(path, format, self.kind_in(format))
    }

    pub(super) fn kind_in(&self, format: Format) -> BakeKind {
        self.kind.unwrap_or(match format {
            Format::Ply | Format::Glb => BakeKind::Exact,
            Format::Usda | Format::Usdc | Format::Usdz => BakeKind::Linear,
            Format::Spz | Format::Sog => BakeKind::Display,
        })
    }

    /// Resolves what is left open for a format.
    pub(super) fn plan(&self, path: &Path, scene: &Scene) -> Result<Plan> {
        let format = Format::from_path(path)?;
        let is_display = !scene.color_space.is_linear();
        // Harmonics of a display's colours without a conversion are a display bake.
        let kind = match self.kind_in(format) {
            BakeKind::Linear if is_display && self.color_space.is_none() => BakeKind::Display,
            kind => kind,
        };
        self.check(path, format, if self.kind == Some(BakeKind::Linear) { BakeKind::Linear } else { kind })?;
        if is_display && kind == BakeKind::Exact && self.exposure_ev != 0.0 {
            let message = "the colours are a display's, whose exposure is a matter of a display bake";
            return Err(Error::new(message).with_remedy(Remedy::set("bake", "display").or(Remedy::leave_out("exposure"))));
        }
        let appearance = match kind {
            BakeKind::Linear => {
                let default = if format == Format::Glb { ColorSpace::LinearRec709 } else { scene.color_space };
                Appearance::Linear { color_space: self.color_space.unwrap_or(default), exposure_ev: self.exposure_ev }
            }
            BakeKind::Display | BakeKind::Exact => {
                let usual = if is_display { Tonemap::None } else { Tonemap::default() };
                Appearance::Display { tonemap: self.tonemap.unwrap_or(usual), exposure_ev: self.exposure_ev }
            }
        };
        let options = BakeOptions { appearance, max_degree: self.max_degree };
        Ok(Plan { format, options, is_exact: kind == BakeKind::Exact })
    }

    fn check(&self, path: &Path, format: Format, kind: BakeKind) -> Result<()> {
        let name = path.display();
        let bake = |kind: &'static str| Remedy::set("bake", kind);
        match (format, kind) {
            (Format::Spz | Format::Sog, BakeKind::Linear | BakeKind::Exact) => {
                let called = if format == Format::Spz { "SPZ" } else { "SOG" };
                let error = Error::new(format!("{name}: {called} has 8 bits a colour, for display bakes only"));
                return Err(error.with_remedy(bake("display").or(Remedy::advice("write .usda, .ply or .glb"))));
            }
            (Format::Usda | Format::Usdc | Format::Usdz, BakeKind::Exact) => {
                let error = Error::new(format!("{name}: USD holds harmonics only, not the exact model"));
                return Err(error.with_remedy(bake("linear").or(Remedy::advice("write .ply or .glb"))));
            }
            _ => {}
        }
        if kind != BakeKind::Linear && self.color_space.is_some() {
            let message = "a colour space is for linear bakes: display bakes are sRGB, and the exact model keeps its space";
            return Err(Error::new(message).with_remedy(bake("linear").or(Remedy::leave_out("output_color_space"))));
        }
        if kind == BakeKind::Linear && (self.tonemap.is_some() || self.refine_steps.is_some_and(|steps| steps > 0)) {
            let remedy = bake("display").or(Remedy::leave_out("tonemap")).or(Remedy::leave_out("refine"));
            return Err(Error::new("tone curves and refinement are for display bakes").with_remedy(remedy));
        }
        Ok(())
    }
}

/// A bake whose options are resolved for a format.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plan {
    pub(super) format: Format,
    pub(super) options: BakeOptions,
    /// Whether the radiance model is beside it.
    pub(super) is_exact: bool,
}

//! From the world of the data set to that of a file.
//!
//! In: [`ExportOptions`](super::ExportOptions). Out: a similarity. In this order, the scene moves
//! so that the chosen origin becomes the file's, turns about axes of the data set's world, turns by
//! quarters so that the up axis becomes the format's, and is scaled.

use glam::{DMat3, DVec3};
use luxel_core::{Dataset, Scene, Similarity};

use super::ExportOptions;
use crate::error::Context;
use crate::up::{UpAxis, turn_to_up};
use crate::{Error, Remedy, Result};

/// Lengths of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FileScale {
    /// Those of the scene times this, above 0.
    Factor(f32),
    /// A unit of the file is this long, metres; the scene's scale must be known.
    MetresPerUnit(f64),
}

impl FileScale {
    /// Returns the factor of lengths, of a scene whose unit has this length.
    fn factor(self, metres_per_unit: Option<f64>) -> Result<f64> {
        match (self, metres_per_unit) {
            (Self::Factor(factor), _) => Ok(factor.into()),
            (Self::MetresPerUnit(wanted), Some(metres)) => Ok(metres / wanted),
            (Self::MetresPerUnit(_), None) => {
                let error = Error::new("the scale of the scene is unknown: its data set states no metres per unit");
                Err(error.with_remedy(Remedy::give("metres_per_unit").or(Remedy::give("scale"))))
            }
        }
    }
}

/// Holds a scene relative to the origin of a file, so that positions have their digits there.
///
/// # Errors
/// An origin that is not finite.
pub(super) fn move_to_origin(scene: &mut Scene, origin: Option<[f64; 3]>) -> Result<()> {
    let Some(origin) = origin else { return Ok(()) };
    let frame = Similarity::new(DMat3::IDENTITY, scene.world_from_local.scale(), DVec3::from_array(origin));
    scene.move_to(frame.context("the origin is out of range")?);
    Ok(())
}

/// Returns the similarity from the world of the data set to that of a file.
///
/// # Errors
/// A scale that is unknown, or out of range.
pub(super) fn placement(
    options: &ExportOptions,
    target: UpAxis,
    dataset: Option<&Dataset>,
    metres_per_unit: Option<f64>,
) -> Result<Similarity> {
    let scale = options.scale.factor(metres_per_unit)?;
    let rotation = turn_to_up(options.up, target, dataset, &options.rotation) * options.rotation;
    let origin = options.origin.map_or(DVec3::ZERO, DVec3::from_array);
    Similarity::new(rotation, scale, -(scale * (rotation * origin))).context("the origin or the factor of lengths is out of range")
}

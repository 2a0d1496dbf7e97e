//! The radiance scale of a scene, its colour space, and its place in the world.
//!
//! In: a [`Scene`] without splats, or its record in a file. Out: the other of both.

use glam::{DMat3, DVec3};
use luxel_core::{ColorModel, ColorSpace, Dataset, RadianceScale, RasterConfig, Scene, Similarity, Splats};
use luxel_train::TrainError;
use serde::{Deserialize, Serialize};

use crate::FileError;

/// Returns a scene without splats.
pub(crate) fn place_of(
    radiance_scale: RadianceScale,
    color_space: ColorSpace,
    world_from_local: Similarity,
    metres_per_unit: Option<f64>,
) -> Scene {
    Scene {
        splats: Splats::empty(ColorModel::Sh { degree: 0 }),
        radiance_scale,
        color_space,
        raster: RasterConfig::default(),
        edits: Vec::new(),
        world_from_local,
        metres_per_unit,
    }
}

/// Returns the scene without splats of a training on `dataset`.
pub(crate) fn place_in(dataset: &Dataset, radiance_scale: RadianceScale) -> Scene {
    let Dataset { color_space, world_from_local, metres_per_unit, .. } = *dataset;
    place_of(radiance_scale, color_space, world_from_local, metres_per_unit)
}

/// Checks that a checkpoint is of a run on this data set.
///
/// # Errors
/// Another digest of the data.
pub(crate) fn check_fingerprint(fingerprint: &str, dataset: &Dataset) -> Result<(), TrainError> {
    match fingerprint == dataset.fingerprint {
        true => Ok(()),
        false => Err(TrainError::Fingerprint { checkpoint: fingerprint.to_owned(), dataset: dataset.fingerprint.clone() }),
    }
}

/// The place in the description of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PlaceRecord {
    radiance_scale: RadianceScale,
    color_space: ColorSpace,
    /// Place of the local origin and length of a local unit, world.
    origin: [f64; 3],
    unit: f64,
    metres_per_unit: Option<f64>,
}

impl PlaceRecord {
    /// Returns the record of a scene whose axes are those of the world.
    pub(crate) fn of(scene: &Scene) -> Self {
        Self {
            radiance_scale: scene.radiance_scale,
            color_space: scene.color_space,
            origin: scene.world_from_local.translation().to_array(),
            unit: scene.world_from_local.scale(),
            metres_per_unit: scene.metres_per_unit,
        }
    }

    /// Returns the scene of the record, without splats.
    pub(crate) fn scene(&self) -> Result<Scene, FileError> {
        let Self { radiance_scale, color_space, origin, unit, metres_per_unit } = *self;
        let world_from_local = Similarity::new(DMat3::IDENTITY, unit, DVec3::from_array(origin))
            .ok_or_else(|| FileError::new(format!("a unit of {unit}, expected a number above 0")))?;
        Ok(place_of(radiance_scale, color_space, world_from_local, metres_per_unit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_comes_back_from_its_record_and_one_without_size_is_refused() {
        let world_from_local = Similarity::new(DMat3::IDENTITY, 2.5, DVec3::new(1.0, -2.0, 3.0)).unwrap();
        let scene = place_of(RadianceScale::new(4.0).unwrap(), ColorSpace::AcesCg, world_from_local, Some(0.5));
        let record = PlaceRecord::of(&scene);
        assert_eq!(record.scene().unwrap(), scene);
        let read: PlaceRecord = serde_json::from_str(&serde_json::to_string(&record).unwrap()).unwrap();
        assert_eq!(read, record);
        let error = PlaceRecord { unit: 0.0, ..record }.scene().unwrap_err();
        assert!(error.to_string().contains("a unit of 0"), "{error}");
    }
}

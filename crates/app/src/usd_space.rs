//! Cameras of OpenUSD in the world of a scene, by the stage that the scene is exported to.
//!
//! In: cameras of a layer, or of the world. Out: the others. The stage is that of `luxel export`
//! with its defaults: quarter turns take the scene's up to +Y, lengths are the data set's. A layer
//! with +Z up is turned; lengths of a layer that states another `metersPerUnit` are converted,
//! those of one that states none are taken as they are. Degenerate: a scene whose unit is unknown
//! counts as one in metres, as in its export.

use std::path::Path;

use glam::{DMat3, DVec3};
use luxel_core::{Dataset, Similarity};
use luxel_io::{PathCamera, StageCameras, StageChoice, StageMotion};

use luxel::Result;
use luxel::error::Context;
use luxel::export::{Up, UpAxis, file_from_world};

/// The stage of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UsdSpace {
    stage_from_world: Similarity,
    metres_per_unit: Option<f64>,
}

/// Cameras of a layer in the world.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LayerCameras {
    /// In the world of the data set.
    pub cameras: Vec<PathCamera>,
    /// Factor that lengths of the layer were multiplied by.
    pub factor: f64,
    /// Metres of a unit that the layer states.
    pub metres_per_unit: Option<f64>,
}

/// Returns whether a file is of OpenUSD, by its first bytes.
pub fn is_usd_file(path: &Path) -> bool {
    use std::io::Read;
    let mut head = [0u8; 8];
    luxel_io::open_regular(path).is_ok_and(|(mut file, _)| file.read_exact(&mut head).is_ok() && luxel_io::is_usd(&head))
}

impl UsdSpace {
    /// Returns the stage of a scene with this unit, whose up direction is that of the data set's
    /// cameras.
    ///
    /// # Errors
    /// An axis that is no unit vector.
    pub fn new(metres_per_unit: Option<f64>, up: Up, dataset: Option<&Dataset>) -> Result<Self> {
        Ok(Self { stage_from_world: file_from_world(up, UpAxis::PlusY, dataset, 1.0)?, metres_per_unit })
    }

    /// Reads the cameras of a layer.
    ///
    /// # Errors
    /// A file that cannot be read; no camera, or several of which none is chosen; a size that is
    /// neither given nor stated; cameras that are not pinholes.
    pub fn read_cameras(&self, path: &Path, choice: StageChoice<'_>) -> Result<LayerCameras> {
        let bytes = luxel_io::read_file(path).context("cannot read the cameras")?;
        let mut found = luxel_io::decode_stage_cameras(path, &bytes, choice).context("cannot read the cameras")?;
        let factor = found.metres_per_unit.map_or(1.0, |metres| metres / self.metres_per_unit.unwrap_or(1.0));
        // +Z becomes +Y, +Y becomes -Z.
        let upright = if found.is_z_up { DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y) } else { DMat3::IDENTITY };
        let upright = Similarity::new(upright, factor, DVec3::ZERO).context("metersPerUnit is out of range")?;
        let world_from_layer = upright.then(&self.stage_from_world.inverse());
        for named in &mut found.cameras {
            world_from_layer.apply_to_camera(&mut named.camera);
            named.focus_distance = named.focus_distance.map(|distance| factor * distance);
        }
        Ok(LayerCameras { cameras: found.cameras, factor, metres_per_unit: found.metres_per_unit })
    }

    /// Returns the text of a layer with cameras of the world; `name` is for errors.
    ///
    /// # Errors
    /// Cameras that are not undistorted pinholes.
    pub fn cameras_text(&self, name: &Path, cameras: &[PathCamera], motion: StageMotion) -> Result<String> {
        let mut cameras = cameras.to_vec();
        cameras.iter_mut().for_each(|named| self.stage_from_world.apply_to_camera(&mut named.camera));
        let cameras = StageCameras { cameras, metres_per_unit: self.metres_per_unit, is_z_up: false };
        luxel_io::stage_cameras_text(name, &cameras, motion).context("cannot write the cameras")
    }
}

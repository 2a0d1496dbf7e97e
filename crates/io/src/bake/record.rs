//! The record of a bake in its file, so that it is read back as a bake: one JSON object under
//! the key `luxel`, wherever the format has a place for it (PLY: a comment; USD: custom layer data;
//! glTF: the asset's extras).

use glam::DMat3;
use luxel_core::tone::Tonemap;
use luxel_core::{ColorSpace, RadianceScale, RasterConfig, Scene, Similarity, Splats};
use serde::{Deserialize, Serialize};

use super::{Appearance, Baked};
use crate::validity::is_usable;

/// Key of the record.
pub(crate) const RECORD_KEY: &str = "luxel";

/// Version of the record.
const VERSION: u32 = 1;

/// A bake in words.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct BakeRecord {
    /// Version of this record.
    version: u32,
    /// `linear` or `display`.
    bake: Kind,
    /// Tone curve of a display bake.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    tonemap: Option<Tonemap>,
    /// Factor on the scene's normalised radiance.
    exposure: f32,
    /// Space of the harmonics' colours; a display bake is sRGB.
    color_space: ColorSpace,
    /// How to rasterise.
    raster: RasterConfig,
    /// How the file's world came from that of the data set.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    file_from_world: Option<WorldRecord>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Linear,
    Display,
}

/// A similarity without translation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct WorldRecord {
    /// Rows.
    rotation: [[f64; 3]; 3],
    scale: f64,
}

impl WorldRecord {
    /// Returns the record of a similarity; `None` for the identity.
    pub(crate) fn from_similarity(similarity: &Similarity) -> Option<Self> {
        let rotation = similarity.rotation();
        let record = Self { rotation: [0, 1, 2].map(|row| rotation.row(row).to_array()), scale: similarity.scale() };
        (!similarity.is_identity()).then_some(record)
    }

    /// Returns the similarity; `None` if the record describes none, or of a scale that no length in
    /// f32 has.
    pub(crate) fn similarity(&self) -> Option<Similarity> {
        if !(self.scale as f32).is_normal() {
            return None;
        }
        Similarity::new(DMat3::from_cols_array_2d(&self.rotation).transpose(), self.scale, glam::DVec3::ZERO)
    }

    /// Moves a file's splats to the world of the data set; the error names the splat that is not
    /// finite there.
    pub(crate) fn undo(&self, splats: &mut Splats) -> Result<(), String> {
        let similarity = self.similarity().ok_or("the file's world is not a rotation and a positive scale of the data set's")?;
        similarity.inverse().apply(splats);
        splats.validate().map_err(|e| format!("in the world of the data set, of which the file's is {} times the size: {e}", self.scale))
    }
}

impl BakeRecord {
    /// Returns the record of a bake.
    pub(crate) fn from_bake(baked: &Baked) -> Self {
        let (bake, tonemap) = match baked.appearance {
            Appearance::Linear { .. } => (Kind::Linear, None),
            Appearance::Display { tonemap, .. } => (Kind::Display, Some(tonemap)),
        };
        Self {
            version: VERSION,
            bake,
            tonemap,
            exposure: baked.exposure,
            color_space: baked.scene.color_space,
            raster: baked.scene.raster,
            file_from_world: WorldRecord::from_similarity(&baked.file_from_world),
        }
    }

    /// Returns the record as JSON on one line.
    pub(crate) fn json(&self) -> serde_json::Result<String> {
        serde_json::to_string(self)
    }

    /// Parses a record from JSON; the error explains what is wrong.
    pub(crate) fn parse(json: &str) -> Result<Self, String> {
        let record: Self = serde_json::from_str(json).map_err(|e| format!("record of the bake: {e}"))?;
        if record.version != VERSION {
            return Err(format!("record of the bake is of version {}, expected {VERSION}; use a newer release of luxel", record.version));
        }
        if !is_usable(&record.raster) {
            return Err("record of the bake: cut-offs are out of range".into());
        }
        if record.file_from_world.is_some_and(|world| world.similarity().is_none()) {
            return Err("record of the bake: \"file_from_world\" is not a rotation and a positive scale".into());
        }
        Ok(record)
    }

    /// Returns the scene of a file's splats, in the world of the data set; the error names the
    /// splat that is not finite there.
    pub(crate) fn scene(&self, mut splats: Splats) -> Result<Scene, String> {
        if let Some(world) = self.file_from_world {
            world.undo(&mut splats)?;
        }
        Ok(Scene { splats, radiance_scale: RadianceScale::ONE, color_space: self.color_space, raster: self.raster, edits: Vec::new() })
    }
}

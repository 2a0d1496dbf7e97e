//! The record of a bake in its file, so that it is read back as a bake: one JSON object under
//! the key `luxel`, wherever the format has a place for it (PLY: a comment; USD: custom layer data;
//! glTF: the asset's extras).

use glam::{DMat3, DVec3};
use luxel_core::tone::Tonemap;
use luxel_core::{ColorSpace, RadianceScale, RasterConfig, Scene, Similarity, Splats};
use serde::{Deserialize, Serialize};

use super::{Appearance, Baked};
use crate::local_frame::{LocalFrame, origin_of, settle};
use crate::validity::{is_length, is_usable};

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
    /// Space of the harmonics' colours in a linear bake; a display bake is sRGB, and has linear Rec.709
    /// here.
    color_space: ColorSpace,
    /// How to rasterise.
    pub(crate) raster: RasterConfig,
    /// How the file's world came from that of the data set.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) file_from_world: Option<WorldRecord>,
    /// Local coordinates of the scene, whose origin is that of the file.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) local_frame: Option<LocalFrame>,
    /// Length of a unit of the data set's world, metres.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) metres_per_unit: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Linear,
    Display,
}

/// A similarity: p' = scale rotation p + translation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct WorldRecord {
    /// Rows.
    rotation: [[f64; 3]; 3],
    scale: f64,
    /// Left out where it is zero.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    translation: Option<[f64; 3]>,
}

impl WorldRecord {
    /// Returns the record of a similarity; `None` for the identity.
    pub(crate) fn from_similarity(similarity: &Similarity) -> Option<Self> {
        let rotation = similarity.rotation();
        let translation = Some(similarity.translation()).filter(|t| *t != DVec3::ZERO).map(|t| t.to_array());
        let record = Self { rotation: [0, 1, 2].map(|row| rotation.row(row).to_array()), scale: similarity.scale(), translation };
        (!similarity.is_identity()).then_some(record)
    }

    /// Returns the similarity; `None` if the record describes none, or of a scale that no length in
    /// f32 has.
    pub(crate) fn similarity(&self) -> Option<Similarity> {
        if !(self.scale as f32).is_normal() {
            return None;
        }
        let translation = self.translation.map_or(DVec3::ZERO, DVec3::from_array);
        Similarity::new(DMat3::from_cols_array_2d(&self.rotation).transpose(), self.scale, translation)
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
            color_space: if baked.scene.color_space.is_linear() { baked.scene.color_space } else { ColorSpace::LinearRec709 },
            raster: baked.scene.raster,
            file_from_world: WorldRecord::from_similarity(&baked.file_from_world),
            local_frame: LocalFrame::from_similarity(&baked.scene.world_from_local),
            metres_per_unit: baked.scene.metres_per_unit,
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
        if record.local_frame.is_some_and(|frame| frame.world_from_local().is_none()) {
            return Err("record of the bake: \"local_frame\" is not an origin and a positive unit".into());
        }
        if record.metres_per_unit.is_some_and(|metres| !is_length(&metres)) {
            return Err("record of the bake: \"metres_per_unit\" is not a number above 0".into());
        }
        Ok(record)
    }

    /// Returns the space of the colours.
    pub(crate) fn color_space(&self) -> ColorSpace {
        if self.bake == Kind::Display { ColorSpace::DisplaySrgb } else { self.color_space }
    }

    /// Returns the place of the scene's local origin in the file.
    pub(crate) fn origin_in_file(&self) -> DVec3 {
        let origin = self.local_frame.and_then(|frame| frame.world_from_local()).map_or(DVec3::ZERO, |frame| frame.translation());
        self.file_from_world.and_then(|world| world.similarity()).map_or(origin, |world| world.point(origin))
    }

    /// Returns the scene of a file's splats; the error names the splat that is not finite in the
    /// world of the data set.
    pub(crate) fn scene(&self, splats: Splats) -> Result<Scene, String> {
        let (edits, world_from_local) = (Vec::new(), Similarity::IDENTITY);
        let mut scene = Scene {
            splats,
            radiance_scale: RadianceScale::ONE,
            color_space: self.color_space(),
            raster: self.raster,
            edits,
            world_from_local,
            metres_per_unit: self.metres_per_unit,
        };
        place(
            &mut scene,
            &Similarity::IDENTITY,
            self.file_from_world.as_ref(),
            self.local_frame.map(|frame| Origin { frame, is_in_move: false }),
        )?;
        Ok(scene)
    }
}

/// The local coordinates that a file states.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin {
    pub(crate) frame: LocalFrame,
    /// Whether the file moves its splats to the origin.
    pub(crate) is_in_move: bool,
}

/// Takes the splats of a file, which `moved` takes to their place in it, to the local coordinates
/// that it states, else to the world of the data set.
pub(crate) fn place(scene: &mut Scene, moved: &Similarity, world: Option<&WorldRecord>, origin: Option<Origin>) -> Result<(), String> {
    let Some(Origin { frame, is_in_move }) = origin else {
        moved.apply(&mut scene.splats);
        return world.map_or(Ok(()), |world| world.undo(&mut scene.splats));
    };
    let world_from_local = frame.world_from_local().ok_or("\"local_frame\" is not an origin and a positive unit")?;
    let turned = world.map_or(Some(Similarity::IDENTITY), WorldRecord::similarity).ok_or("the file's world is not that of a scene")?;
    // Without a move, positions are relative to the local origin, wherever that is in the file.
    let world_from_file = match is_in_move {
        true => moved.then(&turned.inverse()),
        false => moved.then(&turned.linear().inverse()).then(&origin_of(&world_from_local)),
    };
    settle(scene, None, &world_from_file, world_from_local);
    scene.splats.validate().map_err(|e| format!("in the local coordinates of the scene: {e}"))
}

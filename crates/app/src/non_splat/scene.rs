//! [`NonSplatScene`]: a field or anchors, with what is needed to render them in the radiance of
//! their data set.

use std::path::Path;

use luxel::error::Context;
use luxel::{Error, Remedy, Result, SelectedEngine};
use luxel_core::{Knots, Scene};
use luxel_io::Arrays;
use luxel_methods::{AnchorEngine, AnchorFile, AnchorScene, ColorHead, Field, FieldEngine, FieldNetwork, read_anchors, read_field};
use luxel_train::{ANCHOR_FORMAT, FIELD_FORMAT};
use serde_json::Value;

use crate::text;

/// The scene that an image is computed from.
#[derive(Clone, Debug, PartialEq)]
enum Content {
    /// A radiance field, which holds the camera's response if it has learned one; normalised units.
    Field(Box<Field>),
    /// Anchors, normalised units.
    Anchors {
        /// The anchors with their networks.
        scene: Box<AnchorScene>,
        /// The camera's response, if it was learned.
        response: Option<Box<Knots>>,
    },
}

/// A scene that is not stored as splats.
#[derive(Clone, Debug, PartialEq)]
pub struct NonSplatScene {
    /// The field or the anchors.
    content: Content,
    /// Its units and place: a scene without splats.
    pub place: Scene,
}

impl NonSplatScene {
    /// Reads the scene of a file, that of a checkpoint too.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let name = || path.display().to_string();
        if luxel_io::holds_arrays(path, ANCHOR_FORMAT) {
            let Arrays { description, tensors } = luxel_io::read_arrays(path, ANCHOR_FORMAT)?;
            let AnchorFile { scene, response, place } = read_anchors(&description, tensors).with_context(name)?;
            return Ok(Self { content: Content::Anchors { scene: Box::new(scene), response: response.map(Box::new) }, place });
        }
        let Arrays { description, tensors } = luxel_io::read_arrays(path, FIELD_FORMAT)?;
        let (field, place) = read_field(&description, tensors).with_context(name)?;
        Ok(Self { content: Content::Field(Box::new(field)), place })
    }

    /// Returns the number of trained numbers.
    pub fn parameter_count(&self) -> usize {
        match &self.content {
            Content::Field(field) => field.parameter_count(),
            Content::Anchors { scene, .. } => scene.parameter_count(),
        }
    }

    /// Returns the camera's response, if it was learned.
    pub fn response(&self) -> Option<Knots> {
        match &self.content {
            Content::Field(field) => field.response(),
            Content::Anchors { response, .. } => response.as_deref().copied(),
        }
    }

    /// Returns what the scene is, in a few words: `anchors: 4,000 with 40,000 splats`.
    pub fn summary(&self) -> String {
        match &self.content {
            Content::Field(field) => format!("field: {}", text::plural(field.parameter_count(), "parameter")),
            Content::Anchors { scene, .. } => {
                format!("{} of {}", text::plural(scene.anchors.len(), "anchor"), text::plural(scene.splats(), "splat"))
            }
        }
    }

    /// Returns what the scene is: `radiance field`, `anchors`.
    pub fn kind(&self) -> &'static str {
        match self.content {
            Content::Field(_) => "radiance field",
            Content::Anchors { .. } => "anchors",
        }
    }

    /// Returns the size and the place of the scene, by name.
    pub fn facts(&self) -> Vec<(&'static str, Value)> {
        let length = self.place.world_from_local.scale();
        let mut facts: Vec<(&'static str, Value)> = vec![("parameters", self.parameter_count().into())];
        match &self.content {
            Content::Field(field) => {
                let shape = field.shape();
                match shape.network {
                    FieldNetwork::Grid(grid) => facts.extend([
                        ("grid_levels", grid.levels.into()),
                        ("grid_entries", (1u32 << grid.log2_entries).into()),
                        ("finest_grid", grid.finest.into()),
                    ]),
                    FieldNetwork::Layers { layers, units } => facts.extend([("layers", layers.into()), ("units", units.into())]),
                }
                let colors = match shape.head {
                    ColorHead::Softplus => "radiance",
                    ColorHead::Log => "log radiance, with tone mappers",
                    ColorHead::Lifted => "captured values, lifted to radiance",
                };
                let (side, occupied) = (shape.space.side * length, field.occupied_part());
                facts.extend([("colors", colors.into()), ("cube_side", side.into()), ("occupied_part", occupied.into())]);
            }
            Content::Anchors { scene, response } => facts.extend([
                ("anchors", scene.anchors.len().into()),
                ("splats", scene.splats().into()),
                ("color_model", scene.color_model().name().into()),
                ("camera_response", if response.is_some() { "learned" } else { "none" }.into()),
            ]),
        }
        facts.extend([("radiance_scale", self.place.radiance_scale.get().into()), ("color_space", self.place.color_space.name().into())]);
        facts
    }

    /// Returns a digest of the content: images of equal ones are equal.
    pub fn digest(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        let mut add = |values: &[f32]| {
            values.chunks(1 << 12).for_each(|values| {
                let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
                hasher.update(&bytes);
            });
        };
        let shape = match &self.content {
            Content::Field(field) => {
                let arrays = field.arrays();
                [&arrays.table, &arrays.weights, &arrays.occupancy].into_iter().for_each(|values| add(values));
                format!("{:?}", field.shape())
            }
            Content::Anchors { scene, .. } => {
                scene.arrays().iter().for_each(|array| add(&array.values));
                format!("{} {:?}", scene.color_model().name(), self.place.raster)
            }
        };
        hasher.update(shape.as_bytes());
        hasher.finalize().to_hex().to_string()
    }

    /// Puts the scene into an engine that renders it, in place of the one that was opened for its
    /// run.
    ///
    /// # Errors
    /// An engine of a GPU; threads that the system refuses.
    pub fn into_engine(self, selected: SelectedEngine) -> Result<SelectedEngine> {
        if selected.gpu.is_some() {
            let reason = match self.content {
                Content::Field(_) => super::FIELD_ON_PROCESSOR,
                Content::Anchors { .. } => super::ANCHORS_ON_PROCESSOR,
            };
            return Err(Error::new(reason).with_remedy(Remedy::set("device", "cpu")));
        }
        match self.content {
            Content::Field(field) => {
                let engine = FieldEngine::new(*field, selected.threads).context("cannot render the field")?;
                Ok(SelectedEngine { instruction_set: Some(engine.instruction_set()), engine: Box::new(engine), ..selected })
            }
            Content::Anchors { scene, .. } => {
                let engine = AnchorEngine::new(*scene, selected.engine);
                Ok(SelectedEngine { engine: Box::new(engine), ..selected })
            }
        }
    }
}

//! [`ImplicitScene`]: a field or anchors, with what is needed to render them in the radiance of
//! their data set.

use luxel_core::{Knots, Scene};
use luxel_field::{Field, FieldEngine};
use luxel_train::{AnchorEngine, AnchorScene};

use crate::error::Context;
use crate::{Error, Remedy, Result, SelectedEngine, text};

/// The scene that an image is computed from.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
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
pub struct ImplicitScene {
    /// The field or the anchors.
    pub content: Content,
    /// Its units and place: a scene without splats.
    pub place: Scene,
}

impl ImplicitScene {
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

//! Anchors and their networks: all that an image is rendered from.

use luxel_core::ColorModel;
use luxel_train::TrainError;

use super::decoders::Decoders;
use super::numbers::check_numbers;
use super::{FEATURE, OFFSETS, SCALES, SPLATS_PER_ANCHOR};

/// A set of N anchors, world units of the scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Anchors {
    /// Positions `[N,3]`, which training leaves as they are.
    pub position: Vec<[f32; 3]>,
    /// Offsets of the splats `[N,10,3]`, in units of the first three scales.
    pub offset: Vec<f32>,
    /// Features `[N,32]`.
    pub feature: Vec<f32>,
    /// Natural logarithms `[N,6]` of the unit of offsets along the axes, and of the largest
    /// standard deviations of the splats along theirs.
    pub log_scale: Vec<f32>,
}

/// Anchors with the networks that decode their splats.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorScene {
    /// The anchors.
    pub anchors: Anchors,
    pub(super) decoders: Decoders,
}

impl Anchors {
    /// Returns N.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Returns whether there are no anchors.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Appends an anchor without offsets, of one size in every direction.
    pub(super) fn push(&mut self, position: [f32; 3], size: f32, feature: [f32; FEATURE]) {
        self.position.push(position);
        self.offset.extend([0.0; OFFSETS]);
        self.feature.extend(feature);
        self.log_scale.extend([size.ln(); SCALES]);
    }

    /// Returns the anchors at the indices of `order`, in its order.
    pub(super) fn select(&self, order: &[usize]) -> Self {
        let rows = |values: &[f32], width: usize| order.iter().flat_map(|i| values[i * width..(i + 1) * width].to_vec()).collect();
        Self {
            position: order.iter().map(|i| self.position[*i]).collect(),
            offset: rows(&self.offset, OFFSETS),
            feature: rows(&self.feature, FEATURE),
            log_scale: rows(&self.log_scale, SCALES),
        }
    }

    /// Checks lengths and finiteness.
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        let arrays = [
            ("anchors.position", self.position.as_flattened(), 3),
            ("anchors.offset", &self.offset, OFFSETS),
            ("anchors.feature", &self.feature, FEATURE),
            ("anchors.log_scale", &self.log_scale, SCALES),
        ];
        for (name, values, width) in arrays {
            check_numbers(name, values, self.len() * width)?;
        }
        Ok(())
    }
}

impl AnchorScene {
    /// Returns the colour model of the decoded splats, of degree 0: the networks see the direction.
    pub fn color_model(&self) -> ColorModel {
        self.decoders.color_model()
    }

    /// Returns the number of splats that the anchors have, drawn or not.
    pub fn splats(&self) -> usize {
        self.anchors.len() * SPLATS_PER_ANCHOR
    }

    /// Returns the number of trained numbers.
    pub fn parameter_count(&self) -> usize {
        self.anchors.len() * (OFFSETS + FEATURE + SCALES) + self.decoders.len()
    }

    pub(super) fn validate(&self) -> Result<(), TrainError> {
        self.anchors.validate()?;
        self.decoders.validate()
    }
}

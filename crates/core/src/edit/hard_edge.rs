//! Hard edges of selections that cut through many splats.
//!
//! In: a selection and a scene. Out: each test without a soft edge whose level has many splats on
//! both sides. Splats that share a pixel then part, and a map on one side makes blotches. Tests of
//! shapes and masks are not looked at: a cut in space is usually meant. Degenerate: a scene without
//! splats has no such edges.

use super::select::{Comparison, Facts, Level, Quantity, Selection};
use crate::Scene;

/// Part of the splats on either side of a level, within half the width of the soft edge, from which
/// a hard edge cuts through them.
const POPULATED_PART: f64 = 0.01;

/// A hard edge of a selection that cuts through many splats.
#[derive(Clone, Debug, PartialEq)]
pub struct HardEdge {
    /// The test in its text form: `L < 0.05`.
    pub test: String,
    /// The same test with a soft edge: `L < 0.05 ~2`.
    pub soft: String,
    /// Part of the scene's splats that the soft edge would fade, 0 to 1.
    pub part: f64,
    /// The width of that edge in words: `2 stops`.
    pub width: &'static str,
}

impl Quantity {
    /// Returns a width of soft edges that hides them in most scenes, and its words.
    fn usual_feather(self) -> (f32, &'static str) {
        match self {
            Self::Luminance => (2.0, "2 stops"),
            Self::Hue => (30.0, "30 degrees"),
            Self::Saturation => (0.2, "0.2 of saturation"),
        }
    }
}

impl Selection {
    /// Returns the hard edges that cut through many splats of `scene`, in the order of the text.
    pub fn hard_edges(&self, scene: &Scene) -> Vec<HardEdge> {
        let mut found = Vec::new();
        self.add_hard_edges(&Facts::new(scene), &mut found);
        found
    }

    fn add_hard_edges(&self, facts: &Facts<'_>, found: &mut Vec<HardEdge>) {
        match self {
            Self::Compare { quantity, level, feather: 0.0, .. } => self.add_if_populated(*quantity, &[*level], facts, found),
            Self::Within { quantity, low, high, feather: 0.0 } => self.add_if_populated(*quantity, &[*low, *high], facts, found),
            Self::Not(inner) => inner.add_hard_edges(facts, found),
            Self::And(parts) | Self::Or(parts) => parts.iter().for_each(|part| part.add_hard_edges(facts, found)),
            _ => {}
        }
    }

    fn add_if_populated(&self, quantity: Quantity, levels: &[Level], facts: &Facts<'_>, found: &mut Vec<HardEdge>) {
        let (feather, width) = quantity.usual_feather();
        let count = facts.scene.splats.len().max(1) as f64;
        // The soft edge is where the weight of a soft comparison lies between 0 and 1.
        let parts = |level: &Level| {
            let weights = facts.compare(quantity, Comparison::AtLeast, *level, feather);
            let below = weights.iter().filter(|weight| (f32::MIN_POSITIVE..0.5).contains(*weight)).count() as f64 / count;
            let above = weights.iter().filter(|weight| (0.5..1.0).contains(*weight)).count() as f64 / count;
            [below, above]
        };
        let most = levels.iter().map(parts).filter(|sides| sides.iter().all(|part| *part >= POPULATED_PART)).map(|[a, b]| a + b);
        if let Some(part) = most.reduce(f64::max) {
            let mut soft = self.clone();
            if let Self::Compare { feather: edge, .. } | Self::Within { feather: edge, .. } = &mut soft {
                *edge = feather;
            }
            found.push(HardEdge { test: self.to_string(), soft: soft.to_string(), part, width });
        }
    }
}

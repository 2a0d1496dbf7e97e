//! Selection of the splats that an edit changes, with weights.
//!
//! In: a scene, and each splat's share of painted masks. Out: one weight per splat, from 0 (the
//! splat keeps its bits) to 1. Tests read a splat's colour at degree 0 (the same in every
//! direction) and its centre. A soft edge of width w extends w / 2 to either side of the hard edge,
//! so `not` of a soft selection is equally soft. Its width is in stops for luminance, degrees for
//! hue, world units for shapes, and in the quantity's own unit for saturation and masks. And, or,
//! not are minimum, maximum, 1 - weight.
//!
//! Hue and saturation are those of HSV on linear Rec.709. Degenerate: grey has no hue and lies in
//! no range of hues.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use super::EditError;
use crate::Scene;
use crate::tone::rec709_of;

/// A quantity of a splat that can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Luminance R + G + B, units of the data set.
    Luminance,
    /// Hue in degrees, 0 to 360.
    Hue,
    /// Saturation, 0 (grey) to 1.
    Saturation,
}

/// A level to compare with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Level {
    /// The value itself.
    Absolute(f32),
    /// A percentile of the scene's splats: the value below which this percentage of them lies;
    /// nearest rank.
    Percentile(f32),
}

/// A comparison with a level: `<`, `<=`, `>`, `>=`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// Less than: `<`.
    Below,
    /// At most: `<=`.
    AtMost,
    /// Greater than: `>`.
    Above,
    /// At least: `>=`.
    AtLeast,
}

/// A painted mask: an image file, and the view of the data set that it was painted over.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MaskName {
    /// Name of the file.
    pub file: String,
    /// Name of the view, or the last part of its name.
    pub view: String,
}

/// Share of each splat that lies in the painted part, `[N]`, 0 to 1, by mask: see
/// [`super::Contributions::shares`].
pub type MaskShares = BTreeMap<MaskName, Vec<f32>>;

/// A selection of splats.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Selection {
    /// All splats.
    #[default]
    All,
    /// Splats on one side of a level.
    Compare {
        /// Quantity to compare.
        quantity: Quantity,
        /// Comparison with the level.
        comparison: Comparison,
        /// Level to compare with.
        level: Level,
        /// Width of the soft edge.
        feather: f32,
    },
    /// Splats between two levels, both included. Hues ascend from `low` and may pass 360.
    Within {
        /// Quantity to compare.
        quantity: Quantity,
        /// Lower level.
        low: Level,
        /// Upper level.
        high: Level,
        /// Width of the soft edges.
        feather: f32,
    },
    /// Splats in a box along the world's axes.
    Cuboid {
        /// Smallest coordinates, world.
        min: [f64; 3],
        /// Largest coordinates, world.
        max: [f64; 3],
        /// Width of the soft edge.
        feather: f32,
    },
    /// Splats in a sphere.
    Sphere {
        /// Centre, world coordinates.
        center: [f64; 3],
        /// Radius, world units.
        radius: f32,
        /// Width of the soft edge.
        feather: f32,
    },
    /// Splats of which at least half is visible through the painted part of a mask.
    Mask {
        /// Mask.
        name: MaskName,
        /// Width of the soft edge, centred on a share of one half.
        feather: f32,
    },
    /// Splats outside a selection.
    Not(Box<Self>),
    /// Splats in every one of these.
    And(Vec<Self>),
    /// Splats in at least one of these.
    Or(Vec<Self>),
}

/// The data that selections read, `[N]` each.
pub(super) struct Facts<'s> {
    pub(super) scene: &'s Scene,
    luminance: Vec<f32>,
    saturation: Vec<f32>,
    hue_deg: Vec<Option<f32>>,
}

impl Selection {
    /// Returns the weight of every splat of `scene`. `masks` holds the shares of [`Self::masks`].
    ///
    /// # Errors
    /// [`EditError`] if a parameter is out of range, or a mask is missing or of another scene.
    pub fn weights(&self, scene: &Scene, masks: &MaskShares) -> Result<Vec<f32>, EditError> {
        self.check()?;
        self.shares(&Facts::new(scene), masks)
    }

    /// Returns the masks that the selection uses.
    pub fn masks(&self) -> Vec<&MaskName> {
        match self {
            Self::Mask { name, .. } => vec![name],
            Self::Not(inner) => inner.masks(),
            Self::And(parts) | Self::Or(parts) => parts.iter().flat_map(Self::masks).collect(),
            _ => Vec::new(),
        }
    }

    /// Checks that the parameters are in range.
    ///
    /// # Errors
    /// [`EditError::Parameter`].
    pub fn check(&self) -> Result<(), EditError> {
        match self {
            Self::All => Ok(()),
            Self::Compare { quantity, level, feather, .. } => check_level(*quantity, *level).and_then(|()| check_feather(*feather)),
            Self::Within { quantity, low, high, feather } => {
                check_level(*quantity, *low)?;
                check_level(*quantity, *high)?;
                if let (Level::Absolute(low), Level::Absolute(high)) | (Level::Percentile(low), Level::Percentile(high)) = (low, high)
                    && low > high
                    && *quantity != Quantity::Hue
                {
                    return Err(EditError::Parameter { name: "end of the range", found: *high, expected: "no less than its start" });
                }
                check_feather(*feather)
            }
            Self::Cuboid { min, max, feather } => {
                for (low, high) in min.iter().zip(max) {
                    within("corner of the box", *low as f32, f32::MIN..=f32::MAX, "a finite number")?;
                    let range = if high < low { *low as f32..=f32::MAX } else { f32::MIN..=f32::MAX };
                    within("corner of the box", *high as f32, range, "no less than the opposite one")?;
                }
                check_feather(*feather)
            }
            Self::Sphere { center, radius, feather } => {
                for c in center {
                    within("centre of the sphere", *c as f32, f32::MIN..=f32::MAX, "a finite number")?;
                }
                within("radius", *radius, f32::MIN_POSITIVE..=f32::MAX, "a number above 0")?;
                check_feather(*feather)
            }
            Self::Mask { feather, .. } => within("soft edge of a mask", *feather, 0.0..=1.0, "a number from 0 to 1"),
            Self::Not(inner) => inner.check(),
            Self::And(parts) | Self::Or(parts) => parts.iter().try_for_each(Self::check),
        }
    }

    fn shares(&self, facts: &Facts<'_>, masks: &MaskShares) -> Result<Vec<f32>, EditError> {
        let position = &facts.scene.splats.position;
        let weights = match self {
            Self::All => vec![1.0; position.len()],
            Self::Compare { quantity, comparison, level, feather } => facts.compare(*quantity, *comparison, *level, *feather),
            Self::Within { quantity: Quantity::Hue, low, high, feather } => facts.hue_within([*low, *high], *feather),
            Self::Within { quantity, low, high, feather } => {
                let above = facts.compare(*quantity, Comparison::AtLeast, *low, *feather);
                let below = facts.compare(*quantity, Comparison::AtMost, *high, *feather);
                above.into_iter().zip(below).map(|(a, b)| a.min(b)).collect()
            }
            Self::Cuboid { min, max, feather } => {
                let [min, max] = [min, max].map(|corner| facts.local_point(*corner));
                let inside = |p: &[f32; 3]| (0..3).map(|i| (p[i] - min[i]).min(max[i] - p[i])).fold(f32::INFINITY, f32::min);
                position.iter().map(|p| edge(inside(p), facts.local_length(*feather))).collect()
            }
            Self::Sphere { center, radius, feather } => {
                let (center, radius) = (facts.local_point(*center), facts.local_length(*radius));
                let distance = |p: &[f32; 3]| (0..3).map(|i| f64::from(p[i] - center[i]).powi(2)).sum::<f64>().sqrt() as f32;
                position.iter().map(|p| edge(radius - distance(p), facts.local_length(*feather))).collect()
            }
            Self::Mask { name, feather } => {
                let shares = masks.get(name).filter(|shares| shares.len() == position.len());
                let shares = shares.ok_or_else(|| EditError::Mask(name.clone()))?;
                shares.iter().map(|share| edge(share - 0.5, *feather)).collect()
            }
            Self::Not(inner) => inner.shares(facts, masks)?.into_iter().map(|w| 1.0 - w).collect(),
            Self::And(parts) => combine(parts, 1.0, f32::min, facts, masks)?,
            Self::Or(parts) => combine(parts, 0.0, f32::max, facts, masks)?,
        };
        Ok(weights)
    }
}

fn combine(
    parts: &[Selection],
    start: f32,
    pick: fn(f32, f32) -> f32,
    facts: &Facts<'_>,
    masks: &MaskShares,
) -> Result<Vec<f32>, EditError> {
    let mut weights = vec![start; facts.luminance.len()];
    for part in parts {
        weights.iter_mut().zip(part.shares(facts, masks)?).for_each(|(w, v)| *w = pick(*w, v));
    }
    Ok(weights)
}

fn within(name: &'static str, found: f32, range: RangeInclusive<f32>, expected: &'static str) -> Result<(), EditError> {
    if range.contains(&found) { Ok(()) } else { Err(EditError::Parameter { name, found, expected }) }
}

fn check_feather(feather: f32) -> Result<(), EditError> {
    within("soft edge", feather, 0.0..=f32::MAX, "a finite number, 0 or more")
}

fn check_level(quantity: Quantity, level: Level) -> Result<(), EditError> {
    match (quantity, level) {
        (_, Level::Percentile(p)) => within("percentile", p, 0.0..=100.0, "a number from 0 to 100"),
        (Quantity::Luminance, Level::Absolute(v)) => within("luminance", v, 0.0..=f32::MAX, "a finite number, 0 or more"),
        (Quantity::Hue, Level::Absolute(v)) => within("hue", v, 0.0..=360.0, "degrees from 0 to 360"),
        (Quantity::Saturation, Level::Absolute(v)) => within("saturation", v, 0.0..=1.0, "a number from 0 to 1"),
    }
}

/// Returns the weight at `depth` inside (negative: outside) an edge that is `feather` wide.
fn edge(depth: f32, feather: f32) -> f32 {
    if feather > 0.0 { smoothstep(0.5 + depth / feather) } else { f32::from(depth >= 0.0) }
}

fn smoothstep(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl<'s> Facts<'s> {
    pub(super) fn new(scene: &'s Scene) -> Self {
        let count = scene.splats.len();
        let mut facts =
            Self { scene, luminance: Vec::with_capacity(count), saturation: Vec::with_capacity(count), hue_deg: Vec::with_capacity(count) };
        for i in 0..count {
            facts.luminance.push(scene.luminance(i));
            let (hue, saturation) = hue_saturation(rec709_of(scene.color_space, scene.splats.base_radiance(i)));
            facts.hue_deg.push(hue);
            facts.saturation.push(saturation);
        }
        facts
    }

    /// Returns a point of the world in the coordinates of the splats.
    fn local_point(&self, world: [f64; 3]) -> [f32; 3] {
        self.scene.world_from_local.inverse().point(world.into()).as_vec3().to_array()
    }

    /// Returns a length of the world in the units of the splats.
    fn local_length(&self, world: f32) -> f32 {
        (f64::from(world) / self.scene.world_from_local.scale()) as f32
    }

    /// Returns the values of all splats that have one.
    fn values(&self, quantity: Quantity) -> Vec<f32> {
        match quantity {
            Quantity::Luminance => self.luminance.clone(),
            Quantity::Saturation => self.saturation.clone(),
            Quantity::Hue => self.hue_deg.iter().flatten().copied().collect(),
        }
    }

    fn level(&self, quantity: Quantity, level: Level) -> f32 {
        match level {
            Level::Absolute(value) => value,
            Level::Percentile(percent) => percentile(self.values(quantity), percent).unwrap_or(0.0),
        }
    }

    pub(super) fn compare(&self, quantity: Quantity, comparison: Comparison, level: Level, feather: f32) -> Vec<f32> {
        let level = self.level(quantity, level);
        let weight = |value: f32| {
            if feather > 0.0 {
                let above = match quantity {
                    Quantity::Luminance => (value.max(f32::MIN_POSITIVE) / level.max(f32::MIN_POSITIVE)).log2(),
                    Quantity::Hue | Quantity::Saturation => value - level,
                };
                return match comparison {
                    Comparison::Below | Comparison::AtMost => edge(-above, feather),
                    Comparison::Above | Comparison::AtLeast => edge(above, feather),
                };
            }
            f32::from(match comparison {
                Comparison::Below => value < level,
                Comparison::AtMost => value <= level,
                Comparison::Above => value > level,
                Comparison::AtLeast => value >= level,
            })
        };
        match quantity {
            Quantity::Luminance => self.luminance.iter().copied().map(weight).collect(),
            Quantity::Saturation => self.saturation.iter().copied().map(weight).collect(),
            Quantity::Hue => self.hue_deg.iter().map(|hue| hue.map_or(0.0, weight)).collect(),
        }
    }

    fn hue_within(&self, levels: [Level; 2], feather: f32) -> Vec<f32> {
        let [low, high] = levels.map(|level| self.level(Quantity::Hue, level));
        // The range 0 to 360 is the whole circle, 360 degrees wide and not 0.
        let width = if high - low >= 360.0 { 360.0 } else { (high - low).rem_euclid(360.0) };
        let depth = |hue: f32| {
            let from_low = (hue - low).rem_euclid(360.0);
            if from_low <= width { from_low.min(width - from_low) } else { -(from_low - width).min(360.0 - from_low) }
        };
        let weight = |hue: &Option<f32>| match hue {
            Some(_) if width >= 360.0 => 1.0,
            Some(hue) => edge(depth(*hue), feather),
            None => 0.0,
        };
        self.hue_deg.iter().map(weight).collect()
    }
}

/// Returns the percentile by nearest rank; `None` if there are no values.
pub(super) fn percentile(mut values: Vec<f32>, percent: f32) -> Option<f32> {
    values.sort_unstable_by(f32::total_cmp);
    let last = values.len().checked_sub(1)?;
    values.get((f64::from(percent) / 100.0 * last as f64).round() as usize).copied()
}

/// Returns HSV hue in degrees (`None` for grey) and saturation; channels below 0 (out of gamut)
/// count as 0.
fn hue_saturation(rgb: [f32; 3]) -> (Option<f32>, f32) {
    let [r, g, b] = rgb.map(|c| c.max(0.0));
    let (low, high) = (r.min(g).min(b), r.max(g).max(b));
    let span = high - low;
    // Three equal channels with rounding errors have no hue.
    if span <= 1e-6 * high {
        return (None, 0.0);
    }
    let sixths = if high == r {
        ((g - b) / span).rem_euclid(6.0)
    } else if high == g {
        (b - r) / span + 2.0
    } else {
        (r - g) / span + 4.0
    };
    (Some(60.0 * sixths), span / high)
}

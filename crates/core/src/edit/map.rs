//! Maps on luminance, and chains of them.
//!
//! In: luminance >= 0 in the units of the data set (R + G + B; [`Map::Gain`] and [`Map::Stops`]
//! depend on ratios only). Out: luminance >= 0. All maps are continuous, do not decrease, and keep
//! 0 at 0. All are invertible by another map, except [`Map::ClampMax`], a gain of 0, and level
//! parts of a [`Curve`].

use std::fmt;

use super::EditError;
use crate::MAX_LIGHTS;

/// A map on luminance.
#[derive(Clone, Debug, PartialEq)]
pub enum Map {
    /// L' = gain L; gain >= 0.
    Gain(f32),
    /// L' = 2^stops L.
    Stops(f32),
    /// L' = pivot (L / pivot)^exponent: contrast about `pivot`. An exponent below 1 lifts shadows
    /// and dims lights.
    Power {
        /// Exponent, above 0; 1 changes nothing.
        exponent: f32,
        /// Luminance that stays unchanged, above 0; `None`: the median of the scene's splats.
        pivot: Option<f32>,
    },
    /// A curve through given points.
    Curve(Curve),
    /// L' = min(L, max); max is above 0.
    ClampMax(f32),
    /// L' = t (L / t)^(1 / ratio) above the threshold t: `ratio` stops above it become one.
    CompressAbove {
        /// Threshold t, above 0.
        threshold: f32,
        /// Ratio, above 0; 1 changes nothing, below 1 expands.
        ratio: f32,
    },
    /// L' = t (L / t)^(1 - amount) below the threshold t: `amount` is the part by which the
    /// distance to it, in stops, shrinks.
    LiftBelow {
        /// Threshold t, above 0.
        threshold: f32,
        /// Amount, below 1; 0 changes nothing, below 0 darkens.
        amount: f32,
    },
    /// Multiplies one light of a mix ([`crate::Mix`]); the other lights, and so chromaticities of
    /// the sum, are not kept. On its own, luminance is unchanged: see [`MapChain`].
    Light {
        /// Number of the light, 1 for the first.
        number: u8,
        /// Factor, 0 or more.
        gain: f32,
    },
}

/// Default ratio of [`Map::CompressAbove`].
pub const DEFAULT_RATIO: f32 = 4.0;
/// Default amount of [`Map::LiftBelow`].
pub const DEFAULT_AMOUNT: f32 = 0.5;

impl Map {
    /// Checks that the parameters are in range.
    ///
    /// # Errors
    /// [`EditError::Parameter`].
    pub fn check(&self) -> Result<(), EditError> {
        let positive = |name, found: f32| {
            let fits = found.is_finite() && found > 0.0;
            if fits { Ok(()) } else { Err(EditError::Parameter { name, found, expected: "a finite number above 0" }) }
        };
        let gain_of = |found: f32| {
            let fits = found.is_finite() && found >= 0.0;
            if fits { Ok(()) } else { Err(EditError::Parameter { name: "gain", found, expected: "a finite number, 0 or more" }) }
        };
        match *self {
            Self::Gain(found) => gain_of(found),
            Self::Light { number, gain } if (1..=MAX_LIGHTS).contains(&number.into()) => gain_of(gain),
            Self::Light { number, .. } => {
                Err(EditError::Parameter { name: "light", found: number.into(), expected: "the number of a light, 1 to 8" })
            }
            Self::Stops(stops) if stops.is_finite() && stops.exp2().is_finite() => Ok(()),
            Self::Stops(found) => Err(EditError::Parameter { name: "stops", found, expected: "a finite number below 128" }),
            Self::Power { exponent, pivot } => {
                positive("exponent", exponent)?;
                pivot.map_or(Ok(()), |pivot| positive("pivot", pivot))
            }
            Self::Curve(_) => Ok(()),
            Self::ClampMax(max) => positive("maximum", max),
            Self::CompressAbove { threshold, ratio } => {
                positive("threshold", threshold)?;
                positive("ratio", ratio)
            }
            Self::LiftBelow { threshold, amount } => {
                positive("threshold", threshold)?;
                let fits = amount.is_finite() && amount < 1.0;
                if fits { Ok(()) } else { Err(EditError::Parameter { name: "amount", found: amount, expected: "a number below 1" }) }
            }
        }
    }

    /// Maps a `luminance` > 0; `median` replaces a pivot that is not given.
    fn apply(&self, luminance: f64, median: f64) -> f64 {
        let about = |pivot: f64, exponent: f64| pivot * (luminance / pivot).powf(exponent);
        match *self {
            Self::Gain(gain) => luminance * f64::from(gain),
            Self::Stops(stops) => luminance * f64::from(stops.exp2()),
            Self::Power { exponent, pivot } => about(pivot.map_or(median, f64::from), exponent.into()),
            Self::Curve(ref curve) => curve.apply(luminance),
            Self::ClampMax(max) => luminance.min(max.into()),
            Self::CompressAbove { threshold, ratio } if luminance > f64::from(threshold) => about(threshold.into(), 1.0 / f64::from(ratio)),
            Self::LiftBelow { threshold, amount } if luminance < f64::from(threshold) => about(threshold.into(), 1.0 - f64::from(amount)),
            Self::CompressAbove { .. } | Self::LiftBelow { .. } | Self::Light { .. } => luminance,
        }
    }
}

/// A chain of maps, ready for evaluation. [`Map::Light`] counts as no map: it changes a light, not
/// a luminance.
#[derive(Clone, Debug, PartialEq)]
pub struct MapChain<'m> {
    maps: &'m [Map],
    median: f32,
}

impl<'m> MapChain<'m> {
    /// Returns the chain of `maps`; `median` (above 0) replaces pivots that are not given.
    pub fn new(maps: &'m [Map], median: f32) -> Self {
        Self { maps, median }
    }

    /// Returns the luminance after all maps.
    pub fn apply(&self, luminance: f32) -> f32 {
        self.of_exact(f64::from(luminance)) as f32
    }

    /// Returns L' / L to the power of `weight` (0 to 1); `None` where L is 0, unless all maps are
    /// gains: black has no other factor.
    ///
    /// The power makes a selection's soft edge fade the change in stops.
    pub fn factor(&self, luminance: f32, weight: f32) -> Option<f32> {
        if let Some(gain) = self.constant_gain() {
            return Some(if weight >= 1.0 { gain } else { gain.powf(weight) });
        }
        if luminance.is_nan() || luminance <= 0.0 {
            return None;
        }
        let luminance = f64::from(luminance);
        let mapped = self.of_exact(luminance);
        // Exact comparison: a luminance that the maps do not change keeps its bits.
        if mapped == luminance {
            return Some(1.0);
        }
        Some((mapped / luminance).powf(weight.into()) as f32)
    }

    /// Returns the factor, if it is the same for all luminances.
    pub fn constant_gain(&self) -> Option<f32> {
        self.maps.iter().try_fold(1.0, |product, map| match map {
            Map::Gain(gain) => Some(product * gain),
            Map::Stops(stops) => Some(product * stops.exp2()),
            Map::Light { .. } => Some(product),
            _ => None,
        })
    }

    fn of_exact(&self, luminance: f64) -> f64 {
        let median = f64::from(self.median);
        self.maps.iter().fold(luminance, |l, map| if l > 0.0 { map.apply(l, median) } else { 0.0 })
    }
}

/// A monotone cubic through points, on logarithmic axes (Fritsch and Butland 1984).
///
/// Luminance is a ratio scale: on logarithmic axes three decades of shadow are as long as three of
/// highlight. Tangents never overshoot. At the ends they are those of the secants, so that two
/// points make a power law. Beyond the first and last point the gain is constant.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    points: Vec<[f32; 2]>,
    /// Knots: log2 of x, log2 of y, tangent.
    knots: Vec<[f64; 3]>,
}

impl Curve {
    /// Returns the curve through points (luminance before, luminance after), all above 0.
    ///
    /// Luminance before ascends, luminance after does not decrease.
    ///
    /// # Errors
    /// [`EditError::Curve`].
    pub fn new(points: Vec<[f32; 2]>) -> Result<Self, EditError> {
        let invalid = |message: String| Err(EditError::Curve(message));
        if points.len() < 2 {
            return invalid(format!("has {} point, expected two or more", points.len()));
        }
        if let Some([x, y]) = points.iter().find(|p| p.iter().any(|v| !v.is_normal() || *v < 0.0)) {
            return invalid(format!("has the point {x}:{y}, expected luminances above 0"));
        }
        if let Some((a, b)) = points.iter().zip(points.iter().skip(1)).find(|(a, b)| a[0] >= b[0] || a[1] > b[1]) {
            let message = format!("goes from {}:{} to {}:{}, expected x to ascend and y not to fall", a[0], a[1], b[0], b[1]);
            return invalid(message);
        }
        let mut knots: Vec<[f64; 3]> = points.iter().map(|&[x, y]| [f64::from(x).log2(), f64::from(y).log2(), 0.0]).collect();
        let steps: Vec<[f64; 2]> =
            knots.iter().zip(knots.iter().skip(1)).map(|(a, b)| [b[0] - a[0], (b[1] - a[1]) / (b[0] - a[0])]).collect();
        for (i, knot) in knots.iter_mut().enumerate() {
            knot[2] = match (i.checked_sub(1).and_then(|before| steps.get(before)), steps.get(i)) {
                (Some(&[h0, d0]), Some(&[h1, d1])) if d0 > 0.0 && d1 > 0.0 => {
                    3.0 * (h0 + h1) / ((2.0 * h1 + h0) / d0 + (h1 + 2.0 * h0) / d1)
                }
                (Some(_), Some(_)) => 0.0,
                (Some(&[_, d]), None) | (None, Some(&[_, d])) => d,
                (None, None) => 1.0,
            };
        }
        Ok(Self { points, knots })
    }

    /// Returns the points as given.
    pub fn points(&self) -> &[[f32; 2]] {
        &self.points
    }

    fn apply(&self, luminance: f64) -> f64 {
        let x = luminance.log2();
        let next = self.knots.partition_point(|knot| knot[0] < x);
        let y = match (next.checked_sub(1).and_then(|before| self.knots.get(before)), self.knots.get(next)) {
            (Some(&[x0, y0, m0]), Some(&[x1, y1, m1])) => {
                let h = x1 - x0;
                let t = (x - x0) / h;
                let s = 1.0 - t;
                // The cubic Hermite basis.
                (1.0 + 2.0 * t) * s * s * y0 + t * s * s * h * m0 + t * t * (3.0 - 2.0 * t) * y1 - t * t * s * h * m1
            }
            (Some(end), None) | (None, Some(end)) => x + end[1] - end[0],
            (None, None) => x,
        };
        y.exp2()
    }
}

impl fmt::Display for Map {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gain(gain) => write!(f, "gain {gain}"),
            Self::Stops(stops) => write!(f, "stops {stops}"),
            Self::Power { exponent, pivot: None } => write!(f, "power {exponent}"),
            Self::Power { exponent, pivot: Some(pivot) } => write!(f, "power {exponent}; pivot {pivot}"),
            Self::Curve(curve) => {
                let points: Vec<String> = curve.points.iter().map(|[x, y]| format!("{x}:{y}")).collect();
                write!(f, "curve {}", points.join(","))
            }
            Self::ClampMax(max) => write!(f, "clamp-max {max}"),
            Self::CompressAbove { threshold, ratio } => write!(f, "compress-above {threshold}:{ratio}"),
            Self::LiftBelow { threshold, amount } => write!(f, "lift-below {threshold}:{amount}"),
            Self::Light { number, gain } => write!(f, "light {number}:{gain}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn mapped(map: &Map, luminance: f32) -> f32 {
        MapChain::new(std::slice::from_ref(map), 0.7).apply(luminance)
    }

    fn close(a: f32, b: f32) -> bool {
        (a - b).abs() <= 2e-6 * b.abs()
    }

    #[test]
    fn maps_do_what_they_say() {
        let curve = Curve::new(vec![[0.1, 0.2], [1.0, 1.0], [100.0, 10.0]]).unwrap();
        let cases = [
            (Map::Gain(4.0), 0.5, 2.0),
            (Map::Stops(-3.0), 4.0, 0.5),
            (Map::Power { exponent: 2.0, pivot: Some(0.5) }, 2.0, 8.0),
            (Map::Power { exponent: 2.0, pivot: None }, 0.7, 0.7),
            (Map::ClampMax(3.0), 50.0, 3.0),
            (Map::ClampMax(3.0), 2.0, 2.0),
            (Map::CompressAbove { threshold: 2.0, ratio: 4.0 }, 32.0, 4.0),
            (Map::CompressAbove { threshold: 2.0, ratio: 4.0 }, 1.5, 1.5),
            (Map::LiftBelow { threshold: 1.0, amount: 0.5 }, 0.0625, 0.25),
            (Map::LiftBelow { threshold: 1.0, amount: 0.5 }, 3.0, 3.0),
            (Map::Curve(curve.clone()), 0.1, 0.2),
            (Map::Curve(curve.clone()), 1.0, 1.0),
            (Map::Curve(curve.clone()), 100.0, 10.0),
            // The gains at the ends continue.
            (Map::Curve(curve.clone()), 0.01, 0.02),
            (Map::Curve(curve), 1000.0, 100.0),
        ];
        for (map, before, after) in cases {
            map.check().unwrap();
            assert!(close(mapped(&map, before), after), "{map}: {before} became {}, expected {after}", mapped(&map, before));
            assert_eq!(mapped(&map, 0.0), 0.0);
        }
    }

    #[test]
    fn curves_that_fall_or_stand_on_one_point_are_refused() {
        for points in [vec![], vec![[1.0, 1.0]], vec![[1.0, 1.0], [1.0, 2.0]], vec![[1.0, 2.0], [2.0, 1.0]], vec![[0.0, 1.0], [1.0, 1.0]]] {
            assert!(Curve::new(points.clone()).is_err(), "{points:?}");
        }
        assert!(Curve::new(vec![[1.0, f32::NAN], [2.0, 1.0]]).is_err());
    }

    #[test]
    fn a_chain_is_in_the_order_given() {
        let maps = [Map::Gain(4.0), Map::ClampMax(1.0)];
        let reversed = [Map::ClampMax(1.0), Map::Gain(4.0)];
        assert_eq!((MapChain::new(&maps, 1.0).apply(5.0), MapChain::new(&reversed, 1.0).apply(5.0)), (1.0, 4.0));
        let chain = MapChain::new(&maps, 1.0);
        assert_eq!((chain.factor(0.0, 1.0), chain.factor(0.1, 0.5)), (None, Some(2.0)));
        assert_eq!(MapChain::new(&[Map::Gain(4.0), Map::Stops(-1.0)], 1.0).constant_gain(), Some(2.0));
    }

    proptest! {
        #[test]
        fn maps_never_decrease(
            a in -12f32..12.0, b in -12f32..12.0,
            curve in prop::collection::vec((0.01f32..3.0, 0f32..3.0), 2..6),
            exponent in 0.1f32..3.0, threshold in 0.01f32..10.0, ratio in 0.2f32..8.0, amount in -1f32..0.99,
        ) {
            let mut at = [0.01f32, 0.02];
            let points = curve.iter().map(|(dx, dy)| { at = [at[0] * (1.0 + dx), at[1] * (1.0 + dy)]; at }).collect();
            let maps = [
                Map::Curve(Curve::new(points).unwrap()),
                Map::Power { exponent, pivot: Some(threshold) },
                Map::CompressAbove { threshold, ratio },
                Map::LiftBelow { threshold, amount },
                Map::ClampMax(threshold),
            ];
            let (low, high) = (a.min(b).exp2(), a.max(b).exp2());
            for map in maps {
                // Exact up to rounding of the logarithms.
                prop_assert!(mapped(&map, low) <= mapped(&map, high) * (1.0 + 1e-6), "{}: {} {}", map, low, high);
            }
        }
    }
}

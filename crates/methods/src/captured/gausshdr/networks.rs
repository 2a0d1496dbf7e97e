//! The numbers that GaussHDR trains beside splats: tone networks, and a context feature of each
//! splat.
//!
//! In: gradients, and what becomes of splats. Out: the numbers, updated by Adam. Features begin at
//! 0. A splat that is made from another takes over its feature.

use luxel_core::engine::PlanRow;
use luxel_core::response::exposure_of_knot;
use luxel_core::{Knots, RESPONSE_KNOTS};
use luxel_lanes::LANES;
use luxel_train::{TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

use super::tone::{FEATURES, GaussTone, Items};
use crate::captured::arithmetic::adam::Adam;

/// Exposure that black counts as in the response.
const DARKEST: f64 = 1e-5;

/// The numbers of a run, with the state of their optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct GaussNetworks {
    pub(crate) tone: GaussTone,
    pub(super) features: Features,
}

/// Learning rates of a step.
#[derive(Clone, Copy)]
pub(crate) struct GaussRates {
    pub(crate) tone: f64,
    pub(crate) features: f64,
}

/// Part of their first rate that tone networks have at the end; in between it falls evenly in the
/// logarithm.
const LAST_TONE_RATE: f64 = 0.1;

/// Returns the rate of the tone networks at a step of a run planned for so many.
pub(crate) fn tone_rate(config: &TrainConfig, step: u32, planned: u32) -> f64 {
    let along = f64::from(step) / f64::from(planned.max(1));
    f64::from(config.tone_lr) * LAST_TONE_RATE.powf(along.min(1.0))
}

/// A feature of each splat, `[N, 4]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Features {
    values: Vec<f32>,
    adam: Adam,
}

impl Features {
    fn new(splats: usize) -> Self {
        Self { values: vec![0.0; splats * FEATURES], adam: Adam::new(splats * FEATURES) }
    }

    /// Updates the features.
    pub(super) fn update(&mut self, gradient: &[f32], rate: f64) {
        self.adam.step(&mut self.values, gradient, rate);
    }

    /// Follows splats through densification.
    fn densify(&mut self, rows: &[PlanRow]) {
        let of = |row: &PlanRow| row.source as usize * FEATURES..(row.source as usize + 1) * FEATURES;
        self.values = rows.iter().flat_map(|row| self.values[of(row)].to_vec()).collect();
        self.adam.rearrange(rows.iter().flat_map(|row| of(row).map(|at| row.keep_moments.then_some(at))));
    }
}

impl GaussNetworks {
    /// Makes the numbers at the start of a run.
    pub(crate) fn new(splats: usize, seed: u64) -> Self {
        Self { tone: GaussTone::new(seed), features: Features::new(splats) }
    }

    /// Checks numbers read from a file.
    pub(crate) fn validate(&self, splats: usize) -> Result<(), TrainError> {
        self.tone.validate()?;
        let expected = splats * FEATURES;
        if self.features.values.len() != expected || !self.features.values.iter().all(|v| v.is_finite()) {
            return Err(TrainError::State(format!("features of {splats} splats have other numbers than their {expected}")));
        }
        self.features.adam.validate(expected)
    }

    /// Returns the tone networks.
    pub(crate) fn tone(&self) -> &GaussTone {
        &self.tone
    }

    /// Returns the features of all splats, `[N, 4]`.
    pub(crate) fn features(&self) -> &[f32] {
        &self.features.values
    }

    /// Updates networks and features by a step's gradients.
    pub(crate) fn update(&mut self, by_numbers: &[f64], by_features: &[f32], rates: GaussRates) {
        self.tone.update(by_numbers, rates.tone);
        self.features.update(by_features, rates.features);
    }

    /// Follows splats through densification.
    pub(crate) fn densify(&mut self, rows: &[PlanRow]) {
        self.features.densify(rows);
    }
}

impl GaussTone {
    /// Returns the values of the global networks as the response of a camera, which never falls.
    pub(crate) fn response(&self) -> Knots {
        let s = |k: usize| exposure_of_knot(k.min(RESPONSE_KNOTS - 1)).max(DARKEST).ln() as f32;
        let items: Vec<Items> = (0..RESPONSE_KNOTS.div_ceil(LANES))
            .map(|n| {
                let s = std::array::from_fn(|lane| s(n * LANES + lane));
                std::array::from_fn(|row| if row < 3 { s } else { [0.0; LANES] })
            })
            .collect();
        let values = self.apply(&items);
        [0, 1, 2].map(|c| {
            let mut highest = 0.0f32;
            std::array::from_fn(|k| {
                highest = highest.max(values[k / LANES][c][k % LANES]);
                highest
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_follow_their_splats() {
        let mut networks = GaussNetworks::new(3, 1);
        networks.features.update(&(0..12).map(|i| i as f32 - 5.0).collect::<Vec<_>>(), 0.1);
        let before = networks.clone();
        let split = PlanRow { keep_moments: false, ..PlanRow::keep(0) };
        networks.densify(&[PlanRow::keep(2), split, split]);
        networks.validate(3).unwrap();
        let feature = |of: &GaussNetworks, i: usize| of.features()[i * FEATURES..(i + 1) * FEATURES].to_vec();
        assert_eq!([0, 1, 2].map(|i| feature(&networks, i)), [2, 0, 0].map(|i| feature(&before, i)));
        assert!(networks.validate(4).is_err());
        // Moments begin anew for the two that were split.
        let (mut again, zero) = (networks.clone(), vec![0.0; 12]);
        again.features.update(&zero, 0.1);
        assert_ne!(feature(&again, 0), feature(&networks, 0));
        assert_eq!([1, 2].map(|i| feature(&again, i)), [1, 2].map(|i| feature(&networks, i)));
        let json = serde_json::to_string(&networks).unwrap();
        assert_eq!(serde_json::from_str::<GaussNetworks>(&json).unwrap(), networks);
    }

    #[test]
    fn the_response_rises_through_the_unit_exposure() {
        let response = GaussTone::new(1).response();
        for curve in response {
            assert!(curve.windows(2).all(|pair| pair[1] >= pair[0]) && curve[0] < 0.2 && curve[RESPONSE_KNOTS - 1] > 0.8, "{curve:?}");
        }
    }
}

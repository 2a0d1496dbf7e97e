//! A step of Mono-HDR-GS (Zhang et al. 2025, "High Dynamic Range Novel View Synthesis with Single
//! Exposure").
//!
//! In: splats of harmonics that are captured values, the lift and the network of pixels, a view of
//! radiance with a captured image. Out: a [`PairChannels`], in which the radiance of splats is
//! lifted from their captured values.

pub(super) mod cycle;
pub(super) mod fold;
pub(super) mod lift;
pub(super) mod lifted_engine;

use luxel_train::{TrainConfig, TrainError};
use serde::{Deserialize, Serialize};

use self::cycle::Cycle;
use self::lift::{Lift, LiftTables};
use crate::captured::images::pair_channels::{Mapped, PairChannels, PairGradients, PairTargets};

/// The networks of a run, with the state of their optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MonoNetworks {
    pub(crate) lift: Lift,
    pub(crate) cycle: Cycle,
}

impl MonoNetworks {
    /// Makes the networks at the start of a run.
    pub(crate) fn new(config: &TrainConfig) -> Self {
        Self { lift: Lift::new(config.lift_width, config.seed), cycle: Cycle::new(config.seed) }
    }

    /// Checks networks read from a file.
    pub(crate) fn validate(&self, units: u32) -> Result<(), TrainError> {
        self.lift.validate(units)?;
        self.cycle.validate()
    }

    /// Updates the networks by a step's gradients.
    pub(crate) fn update(&mut self, found: &PairGradients<LiftTables>, config: &TrainConfig) {
        if let Some(sums) = &found.sums {
            self.lift.update(&found.map, sums, config.lift_lr.into());
        }
        if let Some(gradient) = &found.cycle {
            self.cycle.update(gradient, config.cycle_lr.into());
        }
    }
}

impl PairTargets<'_> {
    /// Returns a step of Mono-HDR-GS.
    pub(crate) fn mono_hdr_gs<'a>(&'a self, networks: &'a MonoNetworks) -> PairChannels<'a, LiftTables> {
        PairChannels::new(*self, networks.lift.tables(), Mapped::Radiance, Some(&networks.cycle))
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorModel;

    use super::*;
    use crate::captured::testing::method_oracles::{joined, mono_hdr_gs};
    use crate::captured::testing::oracle::Point;
    use crate::captured::testing::{GradientScene, check_shared, check_splats};
    use luxel_train::HdrNormalisation;
    use luxel_train::{Method, TrainConfig};

    #[test]
    fn gradients_of_the_whole_step_are_those_of_the_oracle() {
        let scene = GradientScene::new(ColorModel::Sh { degree: 1 });
        let base = TrainConfig { method: Method::MonoHdrGs, lift_width: 16, mu: 20.0, cycle_weight: 0.5, ..TrainConfig::default() };
        let networks = MonoNetworks::new(&base);
        let numbers = joined(networks.lift.numbers().into_iter().chain([networks.cycle.numbers()]));
        let point = Point::new(&scene.splats, numbers, &[]);
        for config in [
            base.clone(),
            TrainConfig { ldr_weight: 0.0, ..base.clone() },
            TrainConfig { hdr_normalisation: HdrNormalisation::Own, ..base.clone() },
        ] {
            let targets = scene.targets(&config);
            let mut step = targets.mono_hdr_gs(&networks);
            let (report, splats) = scene.gradients(&mut step);
            let loss = |point: &Point| mono_hdr_gs(&scene, &config, point);
            assert!((f64::from(report.loss) - loss(&point)).abs() < 1e-5, "{} {}", report.loss, loss(&point));
            check_splats(&splats, &point, loss);
            let PairGradients { map, sums, cycle } = step.gradients();
            let mut found = networks.lift.gradient(&map, &sums.unwrap()).concat();
            found.extend(cycle.unwrap().by_numbers);
            check_shared(&found, &point, loss);
        }
    }

    #[test]
    fn radiance_and_cycle_without_weight_are_not_rendered() {
        let scene = GradientScene::new(ColorModel::Sh { degree: 1 });
        let config = TrainConfig { method: Method::MonoHdrGs, hdr_weight: 0.0, cycle_weight: 0.0, ..TrainConfig::default() };
        let networks = MonoNetworks::new(&config);
        let targets = scene.targets(&config);
        let mut step = targets.mono_hdr_gs(&networks);
        let (report, _) = scene.gradients(&mut step);
        let found = step.gradients();
        assert!(found.sums.is_none() && found.cycle.is_none() && report.loss > 0.0);
        let mut after = networks.clone();
        after.update(&found, &config);
        assert_eq!(after, networks);
    }
}

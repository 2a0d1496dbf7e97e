//! A step of HDR-GS (Cai et al. 2024, "HDR-GS: Efficient High Dynamic Range Novel View Synthesis at
//! 1000x Speed via Gaussian Splatting").
//!
//! In: splats of log harmonics, tone mappers, a view of radiance with a captured image. Out: a
//! [`PairChannels`], in which the captured values of splats are g(ln x + ln t) of their radiance x.

pub(super) mod tone_mappers;

use self::tone_mappers::{ToneMappers, ToneTables};
use crate::captured::images::checks::exposure_of;
use crate::captured::images::pair_channels::{Mapped, PairChannels, PairGradients, PairTargets};

impl PairTargets<'_> {
    /// Returns a step of HDR-GS.
    pub(crate) fn hdr_gs(&self, mappers: &ToneMappers) -> PairChannels<'_, ToneTables> {
        let tables = mappers.tables(exposure_of(self.recording).unwrap_or(1.0));
        PairChannels::new(*self, tables, Mapped::Captured, None)
    }
}

impl ToneMappers {
    /// Updates the networks by the gradients of a step.
    pub(crate) fn learn(&mut self, found: &PairGradients<ToneTables>, rate: f64) {
        if let Some(sums) = &found.sums {
            self.update(&found.map, sums, rate);
        }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorModel;

    use super::*;
    use crate::captured::testing::method_oracles::{hdr_gs, joined};
    use crate::captured::testing::oracle::Point;
    use crate::captured::testing::{GradientScene, check_shared, check_splats};
    use luxel_train::HdrNormalisation;
    use luxel_train::{Method, TrainConfig};

    #[test]
    fn gradients_of_the_whole_step_are_those_of_the_oracle() {
        let scene = GradientScene::new(ColorModel::LogSh { degree: 1 });
        let mappers = ToneMappers::new(32, [0.5, 2.0].into_iter(), 9);
        let point = Point::new(&scene.splats, joined(mappers.numbers()), &[]);
        let base = TrainConfig { method: Method::HdrGs, mu: 20.0, ..TrainConfig::default() };
        for config in [
            TrainConfig { hdr_weight: 0.0, ..base.clone() },
            base.clone(),
            TrainConfig { hdr_normalisation: HdrNormalisation::Own, ..base.clone() },
        ] {
            let targets = scene.targets(&config);
            let mut step = targets.hdr_gs(&mappers);
            let (report, splats) = scene.gradients(&mut step);
            // The captured image has 2 s, and the mean exposure is 1 s.
            let loss = |point: &Point| hdr_gs(&scene, &config, 2f64.ln(), point);
            assert!((f64::from(report.loss) - loss(&point)).abs() < 1e-5, "{} {}", report.loss, loss(&point));
            check_splats(&splats, &point, loss);
            let PairGradients { map, sums, .. } = step.gradients();
            check_shared(&mappers.gradient(&map, &sums.unwrap()).concat(), &point, loss);
        }
    }
}

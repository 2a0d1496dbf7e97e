//! A step of Mono-HDR-GS (Zhang et al. 2025, "High Dynamic Range Novel View Synthesis with Single
//! Exposure").
//!
//! In: splats of harmonics that are captured values, the lift and the network of pixels, a view of
//! radiance with a captured image. Out: the gradients by the splats and by both networks. The
//! splats' captured values and their lifted radiance are blended with the same weights over black.
//! The loss is `ldr_weight` times that of the captured image, `hdr_weight` times that of radiance
//! under the mu-law, and `cycle_weight` times that of the captured values that the network of
//! pixels makes of the rendered radiance under the mu-law. Gradients of the captured image alone
//! decide where splats are added, as published; of the radiance, if the captured image has no
//! weight. An image without weight is not rendered.

use luxel_core::engine::SparseGradients;
use luxel_core::{LossWeights, StepReport, View};
use serde::{Deserialize, Serialize};

use super::cycle::{Cycle, CycleGradient};
use super::hdr_gs::{add, compare_captured, interleaved};
use super::image_loss::Comparison;
use super::lift::{Lift, LiftGradient, LiftTables};
use super::pair::PairStep;
use super::radiance_loss::RadianceLoss;
use super::rasterised::{BlendedImage, ImageGradients, Rasterised};
use crate::{TrainConfig, TrainError};

/// The networks of a run, with the state of their optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MonoNetworks {
    pub(crate) lift: Lift,
    cycle: Cycle,
}

/// The results of a step.
pub(crate) struct MonoGradients {
    pub(crate) report: StepReport,
    pub(crate) splats: SparseGradients,
    /// Tables and gradient of the lift, if its radiance has any weight.
    lift: Option<(LiftTables, LiftGradient)>,
    /// Gradient of the network of pixels, if its image has any weight.
    cycle: Option<CycleGradient>,
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
    pub(crate) fn update(&mut self, found: &MonoGradients, config: &TrainConfig) {
        if let Some((tables, gradient)) = &found.lift {
            self.lift.update(tables, gradient, config.lift_lr.into());
        }
        if let Some(gradient) = &found.cycle {
            self.cycle.update(gradient, config.cycle_lr.into());
        }
    }
}

/// The comparisons of the rendered radiance, and the gradient of the loss by its pixels.
struct OfRadiance {
    radiance: Comparison,
    cycle: Option<(Comparison, CycleGradient)>,
    by_pixel: Vec<[f32; 3]>,
}

impl PairStep<'_> {
    /// Computes the gradients of Mono-HDR-GS.
    pub(crate) fn mono_hdr_gs(&self, networks: &MonoNetworks) -> Result<MonoGradients, TrainError> {
        let Self { view, recording, config, step, .. } = self;
        let scene = Rasterised::new(self.raster, self.splats, &view.camera, step)?;
        let colors = scene.colors()?;
        let mut by_color = vec![[0.0; 3]; colors.len()];
        let mut images = ImageGradients::default();
        let mut report = StepReport { step: step.step, visible: scene.visible_count(), ..StepReport::default() };

        let captured: Option<BlendedImage> = (config.ldr_weight > 0.0).then(|| scene.blend(&colors)).transpose()?;
        let radiance = (config.hdr_weight > 0.0 || config.cycle_weight > 0.0).then(|| {
            let tables = networks.lift.tables();
            let image = scene.blend(&tables.apply(&colors, scene.visible()))?;
            Ok::<_, TrainError>((tables, image))
        });
        let radiance = radiance.transpose()?;
        let targets = Targets { view, recording, config, loss: step.loss };
        // The losses of the two images do not depend on each other.
        let (of_captured, of_radiance) = rayon::join(
            || captured.as_ref().map(|image| compare_captured(&image.pixels, recording, &step.loss)),
            || radiance.as_ref().map(|(_, image)| targets.compare(&image.pixels, &networks.cycle)),
        );

        if let (Some(image), Some(found)) = (&captured, of_captured) {
            let mut gradient = image.backward(&interleaved(&found.by_value, config.ldr_weight))?;
            add(&mut by_color, &std::mem::take(&mut gradient.channels), 1.0);
            images.add_with_statistics(gradient, scene.size_px());
            report.loss += config.ldr_weight * found.loss;
            (report.l1, report.ssim) = (found.l1, found.ssim);
        }
        let (mut lift, mut cycle) = (None, None);
        if let (Some((tables, image)), Some(found)) = (radiance, of_radiance) {
            let mut gradient = image.backward(&found.by_pixel)?;
            let by_radiance = std::mem::take(&mut gradient.channels);
            let of_lift = tables.backward(&colors, scene.visible(), by_radiance.as_chunks::<3>().0);
            add(&mut by_color, of_lift.by_color.as_flattened(), 1.0);
            match captured {
                Some(_) => images.add(gradient),
                None => images.add_with_statistics(gradient, scene.size_px()),
            }
            report.loss += config.hdr_weight * found.radiance.loss;
            // Where several are compared, those of radiance are reported, as by other methods.
            (report.l1, report.ssim) = (found.radiance.l1, found.radiance.ssim);
            if let Some((compared, gradient)) = found.cycle {
                report.loss += config.cycle_weight * compared.loss;
                cycle = Some(gradient);
            }
            lift = Some((tables, of_lift));
        }
        let splats = scene.gradients(&images, &by_color, step.stats)?;
        scene.recycle(images);
        Ok(MonoGradients { report, splats, lift, cycle })
    }
}

/// The images that the rendered radiance is compared with.
struct Targets<'a> {
    view: &'a View,
    recording: &'a View,
    config: &'a TrainConfig,
    loss: LossWeights,
}

impl Targets<'_> {
    /// Compares the rendered radiance with the view, and what the network of pixels makes of it
    /// with the captured image.
    fn compare(&self, pixels: &[[f32; 3]], cycle: &Cycle) -> OfRadiance {
        let Self { view, recording, config, .. } = self;
        let loss = RadianceLoss { view, weights: self.loss, mu: config.mu, normalisation: config.hdr_normalisation };
        let values = loss.values(pixels);
        let radiance = loss.compare(&values);
        let mut by_value = radiance.by_value.clone();
        by_value.values.iter_mut().flatten().for_each(|g| *g *= config.hdr_weight);
        let of_cycle = (config.cycle_weight > 0.0).then(|| {
            let inputs: Vec<[f32; 3]> = (0..pixels.len()).map(|i| values.pixel(i)).collect();
            let captured = cycle.apply(&inputs);
            let compared = compare_captured(&captured.values, recording, &self.loss);
            let gradient = cycle.backward(&inputs, &captured, &interleaved(&compared.by_value, config.cycle_weight));
            (compared, gradient)
        });
        if let Some((_, gradient)) = &of_cycle {
            for (i, by_pixel) in gradient.by_pixel.iter().enumerate() {
                (0..3).for_each(|c| by_value.values[c][i] += by_pixel[c]);
            }
        }
        let by_pixel = loss.by_radiance(pixels, &by_value);
        OfRadiance { radiance, cycle: of_cycle, by_pixel }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorModel;

    use super::*;
    use crate::config::HdrNormalisation;
    use crate::peers::testing::GradientScene;
    use crate::{Method, TrainConfig};

    #[test]
    fn gradients_of_all_losses_by_every_parameter_are_those_of_differences() {
        let scene = GradientScene::new(ColorModel::Sh { degree: 1 });
        let base = TrainConfig { method: Method::MonoHdrGs, lift_width: 16, mu: 20.0, cycle_weight: 0.5, ..TrainConfig::default() };
        let networks = MonoNetworks::new(&base);
        for config in [
            base.clone(),
            TrainConfig { ldr_weight: 0.0, ..base.clone() },
            TrainConfig { hdr_normalisation: HdrNormalisation::Own, ..base.clone() },
        ] {
            scene.check(&config, |step| {
                let found = step.mono_hdr_gs(&networks).unwrap();
                (found.report.loss, found.splats)
            });
        }
    }

    #[test]
    fn radiance_and_cycle_without_weight_are_not_rendered() {
        let scene = GradientScene::new(ColorModel::Sh { degree: 1 });
        let config = TrainConfig { method: Method::MonoHdrGs, hdr_weight: 0.0, cycle_weight: 0.0, ..TrainConfig::default() };
        let networks = MonoNetworks::new(&config);
        let found = scene.of(&config, |step| step.mono_hdr_gs(&networks).unwrap());
        assert!(found.lift.is_none() && found.cycle.is_none() && found.report.loss > 0.0);
        let mut after = networks.clone();
        after.update(&found, &config);
        assert_eq!(after, networks);
    }
}

//! A step of HDR-GS (Cai et al. 2024, "HDR-GS: Efficient High Dynamic Range Novel View Synthesis at
//! 1000x Speed via Gaussian Splatting").
//!
//! In: splats of log harmonics, tone mappers, a view of radiance with a captured image. Out: the
//! gradients by the splats and the tone mappers' numbers. The splats' radiance x and their captured
//! values g(ln x + ln t) are blended with the same weights over black; the loss is `ldr_weight`
//! times that of the captured image plus `hdr_weight` times that of radiance under the mu-law.
//! Gradients of the captured image alone decide where splats are added, as published; of the
//! radiance, if the captured image has no weight. An image without weight is not rendered.

use luxel_core::engine::SparseGradients;
use luxel_core::{LossWeights, StepReport, View};

use super::image_loss::{Comparison, Planes, compare};
use super::pair::{PairStep, exposure_of};
use super::radiance_loss::RadianceLoss;
use super::rasterised::{BlendedImage, ImageGradients, Rasterised};
use super::tone_mappers::{ToneGradient, ToneMappers, ToneTables};
use crate::TrainError;

/// The results of a step.
pub(crate) struct HdrGsGradients {
    pub(crate) report: StepReport,
    pub(crate) splats: SparseGradients,
    /// Tables and gradient of the tone mappers, if the captured image has any weight.
    pub(crate) tone: Option<(ToneTables, ToneGradient)>,
}

/// Adds a part times a factor to a sum.
pub(super) fn add(sum: &mut [[f32; 3]], part: &[f32], factor: f32) {
    sum.as_flattened_mut().iter_mut().zip(part).for_each(|(sum, part)| *sum += factor * part);
}

/// Compares a rendered image of captured values with the captured one.
pub(super) fn compare_captured(image: &[[f32; 3]], recording: &View, loss: &LossWeights) -> Comparison {
    let [width, height] = recording.camera.size_px.map(|side| side as usize);
    let planes = |pixels: &[[f32; 3]]| Planes::from_pixels(width, height, pixels, |_, value| value);
    let weights = recording.mask.as_deref().map(|mask| &mask.weights[..]);
    compare(&planes(image), &planes(&recording.image.pixels), weights, loss)
}

/// Returns the pixels' gradient, interleaved and multiplied by `factor`.
pub(super) fn interleaved(by_value: &Planes, factor: f32) -> Vec<[f32; 3]> {
    (0..by_value.values[0].len()).map(|i| by_value.pixel(i).map(|g| factor * g)).collect()
}

impl PairStep<'_> {
    /// Computes the gradients of HDR-GS.
    pub(crate) fn hdr_gs(&self, mappers: &ToneMappers) -> Result<HdrGsGradients, TrainError> {
        let Self { view, recording, config, step, .. } = self;
        let scene = Rasterised::new(self.raster, self.splats, &view.camera, step)?;
        let colors = scene.colors()?;
        let mut by_color = vec![[0.0; 3]; colors.len()];
        let mut images = ImageGradients::default();
        let mut report = StepReport { step: step.step, visible: scene.visible_count(), ..StepReport::default() };

        let captured = (config.ldr_weight > 0.0).then(|| {
            let tables = mappers.tables(exposure_of(recording).unwrap_or(1.0));
            let values = tables.apply(&colors, scene.visible());
            Ok::<_, TrainError>((tables, scene.blend(&values)?))
        });
        let captured = captured.transpose()?;
        let radiance: Option<BlendedImage> = (config.hdr_weight > 0.0).then(|| scene.blend(&colors)).transpose()?;
        let loss = RadianceLoss { view, weights: step.loss, mu: config.mu, normalisation: config.hdr_normalisation };
        // The two losses do not depend on each other.
        let (of_captured, of_radiance) = rayon::join(
            || captured.as_ref().map(|(_, image)| compare_captured(&image.pixels, recording, &step.loss)),
            || radiance.as_ref().map(|image| loss.compare(&loss.values(&image.pixels))),
        );

        let mut tone = None;
        if let (Some((tables, image)), Some(found)) = (captured, of_captured) {
            let mut gradient = image.backward(&interleaved(&found.by_value, config.ldr_weight))?;
            let by_value = std::mem::take(&mut gradient.channels);
            images.add_with_statistics(gradient, scene.size_px());
            let gradient = tables.backward(&colors, scene.visible(), by_value.as_chunks::<3>().0);
            add(&mut by_color, gradient.by_color.as_flattened(), 1.0);
            report.loss += config.ldr_weight * found.loss;
            (report.l1, report.ssim) = (found.l1, found.ssim);
            tone = Some((tables, gradient));
        }
        if let (Some(image), Some(found)) = (radiance, of_radiance) {
            let mut by_pixel = loss.by_radiance(&image.pixels, &found.by_value);
            by_pixel.as_flattened_mut().iter_mut().for_each(|g| *g *= config.hdr_weight);
            let mut gradient = image.backward(&by_pixel)?;
            add(&mut by_color, &std::mem::take(&mut gradient.channels), 1.0);
            match tone {
                Some(_) => images.add(gradient),
                None => images.add_with_statistics(gradient, scene.size_px()),
            }
            report.loss += config.hdr_weight * found.loss;
            // Where both are compared, those of radiance are reported, as by other methods.
            (report.l1, report.ssim) = (found.l1, found.ssim);
        }
        let splats = scene.gradients(&images, &by_color, step.stats)?;
        scene.recycle(images);
        Ok(HdrGsGradients { report, splats, tone })
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorModel;

    use super::*;
    use crate::peers::testing::GradientScene;
    use crate::{Method, TrainConfig};

    #[test]
    fn gradients_of_both_images_by_every_parameter_are_those_of_differences() {
        let scene = GradientScene::new(ColorModel::LogSh { degree: 1 });
        let mappers = ToneMappers::new(32, [0.5, 2.0].into_iter(), 9);
        for (ldr_weight, hdr_weight) in [(1.0, 0.0), (1.0, 0.6)] {
            let config = TrainConfig { method: Method::HdrGs, mu: 20.0, ldr_weight, hdr_weight, ..TrainConfig::default() };
            scene.check(&config, |step| {
                let found = step.hdr_gs(&mappers).unwrap();
                (found.report.loss, found.splats)
            });
        }
    }
}

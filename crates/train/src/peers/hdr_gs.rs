//! A step of HDR-GS (Cai et al. 2024, "HDR-GS: Efficient High Dynamic Range Novel View Synthesis at
//! 1000x Speed via Gaussian Splatting").
//!
//! In: splats of log harmonics, tone mappers, a view of radiance with a captured image. Out: the
//! gradients by the splats and the tone mappers' numbers. The splats' radiance x and their captured
//! values g(ln x + ln t) are blended with the same weights over black; the loss is `ldr_weight`
//! times that of the captured image plus `hdr_weight` times that of radiance under the mu-law.
//! Gradients of the captured image alone decide where splats are added, as published; of the
//! radiance, if the captured image has no weight. An image without weight is not rendered.

use luxel_core::engine::{Differentiable, SparseGradients, StepConfig};
use luxel_core::{LossWeights, Splats, StepReport, View};

use super::image_loss::{Comparison, Planes, compare};
use super::pair::exposure_of;
use super::radiance_loss::RadianceLoss;
use super::rasterised::{BlendedImage, ImageGradients, Rasterised};
use super::tone_mappers::{ToneGradient, ToneMappers, ToneTables};
use crate::{TrainConfig, TrainError};

/// A step to be computed.
pub(crate) struct HdrGsStep<'a> {
    pub(crate) raster: &'a dyn Differentiable,
    pub(crate) splats: &'a Splats,
    /// Radiance, with its target.
    pub(crate) view: &'a View,
    /// The captured image.
    pub(crate) recording: &'a View,
    pub(crate) config: &'a TrainConfig,
    pub(crate) step: &'a StepConfig,
}

/// The results of a step.
pub(crate) struct HdrGsGradients {
    pub(crate) report: StepReport,
    pub(crate) splats: SparseGradients,
    /// Tables and gradient of the tone mappers, if the captured image has any weight.
    pub(crate) tone: Option<(ToneTables, ToneGradient)>,
}

/// Adds a part times a factor to a sum.
fn add(sum: &mut [[f32; 3]], part: &[f32], factor: f32) {
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

impl HdrGsStep<'_> {
    /// Computes the gradients.
    pub(crate) fn gradients(&self, mappers: &ToneMappers) -> Result<HdrGsGradients, TrainError> {
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
    use luxel_core::engine::{AdamBetas, CameraGradientChoice, LearningRates, ParameterRows, SPLATS_PER_BLOCK, StatsCollection};
    use luxel_core::random::standard_normal;
    use luxel_core::{Antialias, ColorModel, Cutoffs, Engine, Image, PixelValues, RasterConfig, RenderOptions, Splat, logit};
    use luxel_cpu::CpuEngine;

    use super::*;
    use crate::Method;
    use crate::testing::{camera_at, view_of};

    const SIDE: u32 = 40;

    /// Splats of a few pixels to half the image, in front of a camera at the origin.
    fn splats() -> Splats {
        let mut splats = Splats::empty(ColorModel::LogSh { degree: 1 });
        for i in 0..20u64 {
            let [x, y, z] = standard_normal(1, i).map(|v: f32| v);
            let sh: Vec<f32> = (0..12).map(|k| if k < 3 { 0.0 } else { 0.2 } * standard_normal(2, 20 * i + k)[0] - 0.5).collect();
            splats.push(&Splat {
                position: [0.6 * x, 0.6 * y, 4.0 + 0.4 * z],
                rotation: [1.0, 0.2 * x, 0.1, -0.1],
                log_scale: [0.25f32.ln() + 0.2 * y, 0.4f32.ln(), 0.3f32.ln()],
                opacity_logit: logit(0.6),
                sh: &sh,
                raw_luminance: &[],
            });
        }
        splats
    }

    fn step() -> StepConfig {
        // Where a splat is cut off, its image is not continuous.
        let cutoffs = Cutoffs { min_alpha: 1e-5, alpha_floor: 1e-5, min_transmittance: 1e-6, ..Cutoffs::PARITY };
        let raster = RasterConfig { cutoffs, antialias: Antialias::Pixel, samples: 1 };
        StepConfig {
            step: 1,
            render: RenderOptions { raster, background: [0.0; 3], active_degree: 1 },
            loss: LossWeights { squared_share: 0.5, ..LossWeights::default() },
            learning_rates: LearningRates::ZERO,
            betas: AdamBetas::default(),
            position_noise: None,
            dropout: None,
            stats: StatsCollection::Off,
            camera_gradient: CameraGradientChoice::default(),
        }
    }

    /// Changes a number of a splat by its row.
    fn moved(splats: &Splats, i: usize, row: usize, by: f32) -> Splats {
        let mut splats = splats.clone();
        match row {
            0..3 => splats.position[i][row] += by,
            3..7 => splats.rotation[i][row - 3] += by,
            7..10 => splats.log_scale[i][row - 7] += by,
            ParameterRows::OPACITY => splats.opacity_logit[i] += by,
            _ => splats.sh[12 * i + row - ParameterRows::SH] += by,
        }
        splats
    }

    #[test]
    fn gradients_of_both_images_by_every_parameter_are_those_of_differences() {
        let (engine, splats, step) = (CpuEngine::new(2).unwrap(), splats(), step());
        let camera = camera_at([0.0; 3], [SIDE, SIDE]);
        let image = |seed: u64| {
            let pixel = |i: u64| standard_normal(seed, i).map(|v: f32| 0.4 + 0.05 * v.abs() + 0.3 * (i as f32 * 0.01).sin().abs());
            Image::from_pixels(SIDE as usize, SIDE as usize, (0..u64::from(SIDE * SIDE)).map(pixel).collect()).unwrap()
        };
        let view = view_of("a", camera.clone(), image(3));
        let recording = View { values: PixelValues::Recorded { exposure_s: 2.0 }, ..view_of("a_0", camera, image(4)) };
        let mappers = ToneMappers::new(32, [0.5, 2.0].into_iter(), 9);
        for (ldr_weight, hdr_weight) in [(1.0, 0.0), (1.0, 0.6)] {
            let config = TrainConfig { method: Method::HdrGs, mu: 20.0, ldr_weight, hdr_weight, ..TrainConfig::default() };
            let of = |splats: &Splats| {
                let raster = Engine::differentiable(&engine).unwrap();
                HdrGsStep { raster, splats, view: &view, recording: &recording, config: &config, step: &step }.gradients(&mappers).unwrap()
            };
            let exact = of(&splats).splats;
            let rows = exact.rows().count();
            let at = |i: usize, row: usize| {
                f64::from(exact.values_of((i / SPLATS_PER_BLOCK) as u32).unwrap()[row * SPLATS_PER_BLOCK + i % SPLATS_PER_BLOCK])
            };
            let largest = |row: usize| (0..splats.len()).map(|i| at(i, row).abs()).fold(0.0, f64::max);
            for (i, row) in [2, 7, 13, 19].into_iter().flat_map(|i| (0..rows).map(move |row| (i, row))) {
                let loss = |by: f32| f64::from(of(&moved(&splats, i, row, by)).report.loss);
                let (numeric, found) = ((loss(5e-3) - loss(-5e-3)) / 1e-2, at(i, row));
                assert!((numeric - found).abs() < 0.06 * largest(row) + 2e-5, "splat {i}, row {row}: {numeric:e} {found:e}");
            }
        }
    }
}

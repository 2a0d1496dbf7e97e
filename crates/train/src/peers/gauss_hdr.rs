//! A step of GaussHDR (Liu et al. 2025, "GaussHDR: High Dynamic Range Gaussian Splatting via
//! Learning Unified 3D and 2D Local Tone Mapping"), on plain splats.
//!
//! In: splats of log harmonics with a context feature each, the tone networks, a view of captured
//! values. Out: the gradients by the splats, the features and the networks.
//!
//! Captured values are made twice. On splats: y = clip(g + r - 1/2, 0, 1) of the networks' global
//! value g and local shift r, blended to Y. On pixels: radiance and features are blended, and the
//! same networks make z and Z of ln(X t + [`BLACK`]). Uncertainties of both, blended ones U3 and
//! those of pixels U2, weight their losses: the loss E of Y counts w = U2^2 / (U2^2 + U3^2), that
//! of Z 1 - w. To that come [`GLOBAL_WEIGHT`] times E of the pixels' global value, the
//! uncertainties' own loss D / (2 U^2) + ln(U) / 2 with D = 1 - SSIM, and that of the unit
//! exposure. Radiance has no other loss.
//!
//! As published, uncertainty has no gradient by radiance, features or geometry, and weights and D
//! none at all. Gradients of all blended channels but uncertainty decide where splats are added.

use luxel_core::engine::{Differentiable, SparseGradients, StepConfig};
use luxel_core::{Splats, StepReport, View};

use super::gauss_networks::GaussNetworks;
use super::gauss_tone::{FEATURES, Item, LEAST_UNCERTAINTY, OUTPUTS, Values};
use super::image_loss::{Comparison, Planes, compare_mapped};
use super::rasterised::{BlendedChannels, BlendedImage, ImageGradients, Rasterised};
use crate::TrainError;

/// Exposure that is added before the logarithm of a pixel's.
const BLACK: f32 = 1e-5;
/// Radiance of splats that counts as black, far below every cut-off.
const DARKEST: f32 = 1e-30;
/// Weight of the loss of the pixels' global value.
const GLOBAL_WEIGHT: f32 = 0.5;
/// Blended channels with a gradient by geometry: values y, radiance, feature.
const CHANNELS: usize = 6 + FEATURES;

/// A step to be computed.
pub(crate) struct GaussStep<'a> {
    pub(crate) raster: &'a dyn Differentiable,
    pub(crate) splats: &'a Splats,
    /// Captured values.
    pub(crate) view: &'a View,
    /// Exposure of normalised radiance 1: seconds times the radiance of a unit.
    pub(crate) exposure: f32,
    /// Value that the camera records where radiance times seconds is 1.
    pub(crate) unit_value: f32,
    pub(crate) step: &'a StepConfig,
}

/// The results of a step.
pub(crate) struct GaussGradients {
    pub(crate) report: StepReport,
    pub(crate) splats: SparseGradients,
    /// By the features, `[N, 4]`.
    pub(crate) by_features: Vec<f32>,
    /// By the networks' numbers.
    pub(crate) by_numbers: Vec<f64>,
}

/// A value that is clipped to 0 to 1, and whether its gradient passes.
fn local_value(values: &Values, c: usize) -> (f32, bool) {
    let y = values[c] + values[3 + c] - 0.5;
    (y.clamp(0.0, 1.0), (0.0..=1.0).contains(&y))
}

fn planes(size: [usize; 2], value: impl Fn(usize, usize) -> f32) -> Planes {
    let [width, height] = size;
    Planes { width, height, values: [0, 1, 2].map(|c| (0..width * height).map(|i| value(i, c)).collect()) }
}

/// The losses of an image, and their gradients.
struct ImageLosses {
    /// Loss of the captured values.
    loss: f32,
    /// Loss of the uncertainties.
    uncertainty_loss: f32,
    of_pixels: Comparison,
    by_y: Planes,
    /// By the pixels' values: global, local shift, uncertainty.
    by_values: Vec<Values>,
    by_blended_uncertainty: Vec<[f32; 3]>,
}

/// Splats and pixels with their values.
struct Forward {
    colors: Vec<[f32; 3]>,
    /// Indices of the splats that the view shows, and their items.
    shown: Vec<usize>,
    items: Vec<Item>,
    values: Vec<Values>,
    image: BlendedChannels,
    uncertainty: BlendedImage,
    pixel_items: Vec<Item>,
    pixel_values: Vec<Values>,
}

impl Forward {
    fn pixels(&self) -> &[[f32; CHANNELS]] {
        self.image.channels.as_chunks::<CHANNELS>().0
    }
}

impl GaussStep<'_> {
    /// Renders splats and pixels.
    fn forward(&self, scene: &Rasterised<'_>, networks: &GaussNetworks) -> Result<Forward, TrainError> {
        let colors = scene.colors()?;
        let shown: Vec<usize> = (0..colors.len()).filter(|i| scene.visible()[*i]).collect();
        let items: Vec<Item> = shown.iter().map(|i| self.item(colors[*i], networks.feature(*i))).collect();
        let values = networks.tone.apply(&items);

        let mut channels = vec![0.0; colors.len() * CHANNELS];
        let mut uncertainty = vec![[0.0; 3]; colors.len()];
        for ((i, item), values) in shown.iter().zip(&items).zip(&values) {
            let row = &mut channels[i * CHANNELS..][..CHANNELS];
            (0..3).for_each(|c| row[c] = local_value(values, c).0);
            row[3..6].copy_from_slice(&colors[*i]);
            row[6..].copy_from_slice(&item[3..]);
            uncertainty[*i] = [values[6], values[7], values[8]];
        }
        let image = scene.blend_channels(&channels, CHANNELS)?;
        let uncertainty = scene.blend(&uncertainty)?;
        let pixels = image.channels.as_chunks::<CHANNELS>().0;
        let pixel_items: Vec<Item> = pixels.iter().map(|pixel| self.pixel_item(pixel)).collect();
        let pixel_values = networks.tone.apply(&pixel_items);
        Ok(Forward { colors, shown, items, values, image, uncertainty, pixel_items, pixel_values })
    }

    /// Computes the gradients.
    pub(crate) fn gradients(&self, networks: &GaussNetworks) -> Result<GaussGradients, TrainError> {
        let scene = Rasterised::new(self.raster, self.splats, &self.view.camera, self.step)?;
        let forward = self.forward(&scene, networks)?;
        let losses = self.losses(&forward, &self.share(&forward));
        self.backward(&scene, networks, &forward, losses)
    }

    fn backward(
        &self,
        scene: &Rasterised<'_>,
        networks: &GaussNetworks,
        forward: &Forward,
        losses: ImageLosses,
    ) -> Result<GaussGradients, TrainError> {
        let (step, pixels) = (self.step, forward.pixels());
        let Forward { colors, shown, items, values, image, uncertainty, pixel_items, pixel_values } = forward;
        let of_pixels = networks.tone.backward(pixel_items, pixel_values, &losses.by_values);
        let by_channels: Vec<[f32; CHANNELS]> = (0..pixels.len())
            .map(|i| {
                let (by_item, y) = (of_pixels.by_item[i], losses.by_y.pixel(i));
                std::array::from_fn(|k| match k {
                    0..3 => y[k],
                    // d ln(X e + b) = e dX / (X e + b).
                    3..6 => by_item[k - 3] * self.exposure / (pixels[i][k].max(0.0) * self.exposure + BLACK),
                    _ => by_item[k - 3],
                })
            })
            .collect();
        let mut gradient = image.backward(by_channels.as_flattened())?;
        let by_splat = std::mem::take(&mut gradient.channels);
        let mut images = ImageGradients::default();
        images.add_with_statistics(gradient, scene.size_px());
        let by_uncertainty = uncertainty.backward(&losses.by_blended_uncertainty)?.channels;

        let by_values: Vec<Values> = shown
            .iter()
            .zip(values)
            .map(|(i, values)| {
                let (by, by_u) = (&by_splat[i * CHANNELS..], &by_uncertainty[3 * i..]);
                std::array::from_fn(|k| match k {
                    0..6 if local_value(values, k % 3).1 => by[k % 3],
                    0..6 => 0.0,
                    _ => by_u[k - 6],
                })
            })
            .collect();
        let of_splats = networks.tone.backward(items, values, &by_values);
        let (mut by_color, mut by_features) = (vec![[0.0; 3]; colors.len()], vec![0.0; colors.len() * FEATURES]);
        for (i, by_item) in shown.iter().zip(&of_splats.by_item) {
            let by = &by_splat[i * CHANNELS..][..CHANNELS];
            (0..3).for_each(|c| {
                let of_log = if colors[*i][c] > DARKEST { by_item[c] / colors[*i][c] } else { 0.0 };
                by_color[*i][c] = by[3 + c] + of_log;
            });
            (0..FEATURES).for_each(|k| by_features[i * FEATURES + k] = by[6 + k] + by_item[3 + k]);
        }
        let mut by_numbers = of_pixels.by_numbers;
        by_numbers.iter_mut().zip(of_splats.by_numbers).for_each(|(sum, part)| *sum += part);
        let unit_loss = networks.tone.add_unit_loss(&mut by_numbers, self.unit_value);

        let splats = scene.gradients(&images, &by_color, step.stats)?;
        let report = StepReport {
            step: step.step,
            loss: losses.loss + losses.uncertainty_loss + unit_loss,
            l1: losses.of_pixels.l1,
            ssim: losses.of_pixels.ssim,
            visible: scene.visible_count(),
            ..StepReport::default()
        };
        Ok(GaussGradients { report, splats, by_features, by_numbers })
    }

    /// Returns the networks' input of a splat.
    fn item(&self, color: [f32; 3], feature: [f32; FEATURES]) -> Item {
        std::array::from_fn(|k| if k < 3 { color[k].max(DARKEST).ln() + self.exposure.ln() } else { feature[k - 3] })
    }

    /// Returns the networks' input of a pixel of blended channels.
    fn pixel_item(&self, pixel: &[f32; CHANNELS]) -> Item {
        std::array::from_fn(|k| if k < 3 { (pixel[3 + k].max(0.0) * self.exposure + BLACK).ln() } else { pixel[3 + k] })
    }

    fn size(&self) -> [usize; 2] {
        self.view.camera.size_px.map(|side| side as usize)
    }

    /// Returns the weight of Y, of which Z has the rest.
    fn share(&self, forward: &Forward) -> Planes {
        planes(self.size(), |i, c| {
            let (u2, u3) = (forward.pixel_values[i][6 + c], forward.uncertainty.pixels[i][c].max(LEAST_UNCERTAINTY));
            u2 * u2 / (u2 * u2 + u3 * u3)
        })
    }

    /// Compares the images with the view.
    fn losses(&self, forward: &Forward, share: &Planes) -> ImageLosses {
        let Self { view, step, .. } = self;
        let (pixels, values, blended_uncertainty) = (forward.pixels(), &forward.pixel_values, &forward.uncertainty.pixels);
        let size = self.size();
        let mask = view.mask.as_deref().map(|mask| &mask.weights[..]);
        let target = planes(size, |i, c| view.image.pixels[i][c]);
        let of_splats = |i: usize, c: usize| blended_uncertainty[i][c].max(LEAST_UNCERTAINTY);
        let rest = planes(size, |i, c| 1.0 - share.values[c][i]);
        let (y, z) = (planes(size, |i, c| pixels[i][c]), planes(size, |i, c| local_value(&values[i], c).0));
        let global = planes(size, |i, c| values[i][c]);
        let (of_y, (of_z, of_global)) = rayon::join(
            || compare_mapped(&y, &target, Some(share), mask, &step.loss),
            || {
                rayon::join(
                    || compare_mapped(&z, &target, Some(&rest), mask, &step.loss),
                    || compare_mapped(&global, &target, None, mask, &step.loss),
                )
            },
        );
        let each = ((3 * size[0] * size[1]).max(1) as f32).recip();
        let counts = |i: usize| mask.map_or(1.0, |mask| mask[i]);
        // D / (2 U^2) + ln(U) / 2 and its derivative by U.
        let of_uncertainty = |u: f32, d: f32| (d / (2.0 * u * u) + 0.5 * u.ln(), 0.5 / u - d / (u * u * u));
        let mut uncertainty_loss = 0.0;
        let loss = of_y.comparison.loss + of_z.comparison.loss + GLOBAL_WEIGHT * of_global.comparison.loss;
        let mut by_values = vec![[0.0; OUTPUTS]; pixels.len()];
        let mut by_blended_uncertainty = vec![[0.0; 3]; pixels.len()];
        for (i, by) in by_values.iter_mut().enumerate() {
            for c in 0..3 {
                let by_z = of_z.comparison.by_value.values[c][i];
                let passed = if local_value(&values[i], c).1 { by_z } else { 0.0 };
                by[c] = passed + GLOBAL_WEIGHT * of_global.comparison.by_value.values[c][i];
                by[3 + c] = passed;
                let (u2, u3, factor) = (values[i][6 + c], of_splats(i, c), each * counts(i));
                let (of_u2, by_u2) = of_uncertainty(u2, of_z.dissimilarity.values[c][i]);
                let (of_u3, by_u3) = of_uncertainty(u3, of_y.dissimilarity.values[c][i]);
                uncertainty_loss += f64::from(factor) * f64::from(of_u2 + of_u3);
                by[6 + c] = factor * by_u2;
                by_blended_uncertainty[i][c] = if blended_uncertainty[i][c] > LEAST_UNCERTAINTY { factor * by_u3 } else { 0.0 };
            }
        }
        let (uncertainty_loss, by_y) = (uncertainty_loss as f32, of_y.comparison.by_value);
        ImageLosses { loss, uncertainty_loss, of_pixels: of_z.comparison, by_y, by_values, by_blended_uncertainty }
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::{ColorModel, Engine};

    use super::*;
    use crate::peers::gauss_networks::GaussRates;
    use crate::peers::testing::GradientScene;

    fn networks(splats: usize) -> GaussNetworks {
        let mut networks = GaussNetworks::new(splats, 3);
        // Features that are not 0, so that gradients pass through all networks.
        let by: Vec<f32> = (0..splats * FEATURES).map(|i| (0.7 * i as f32).sin()).collect();
        networks.features.update(&by, 0.3);
        networks
    }

    /// Returns the loss of captured values and its gradients, with the weights of the first call.
    struct Frozen<'a> {
        scene: &'a GradientScene,
        share: Planes,
    }

    impl Frozen<'_> {
        fn of(&self, splats: &Splats, networks: &GaussNetworks) -> (f32, GaussGradients) {
            let GradientScene { engine, recording, step, .. } = self.scene;
            let raster = Engine::differentiable(engine).unwrap();
            let of = GaussStep { raster, splats, view: recording, exposure: 3.0, unit_value: 0.5, step };
            let scene = Rasterised::new(raster, splats, &recording.camera, step).unwrap();
            let forward = of.forward(&scene, networks).unwrap();
            let losses = of.losses(&forward, &self.share);
            let loss = losses.loss;
            (loss, of.backward(&scene, networks, &forward, losses).unwrap())
        }
    }

    fn frozen(scene: &GradientScene) -> Frozen<'_> {
        let size = [scene.view.image.width, scene.view.image.height];
        Frozen { scene, share: planes(size, |i, c| 0.2 + 0.6 * ((i + 7 * c) as f32 * 0.013).sin().abs()) }
    }

    #[test]
    fn gradients_by_every_parameter_and_feature_are_those_of_differences() {
        let scene = GradientScene::new(ColorModel::LogSh { degree: 1 });
        let (frozen, networks) = (frozen(&scene), networks(scene.splats.len()));
        scene.check_by(|splats| {
            let (loss, found) = frozen.of(splats, &networks);
            (loss, found.splats)
        });
        let exact = frozen.of(&scene.splats, &networks).1.by_features;
        for at in [0, 13, 30, 55, 79] {
            let loss = |by: f32| {
                let mut networks = networks.clone();
                networks.features.values_mut()[at] += by;
                f64::from(frozen.of(&scene.splats, &networks).0)
            };
            let (numeric, found) = ((loss(1e-2) - loss(-1e-2)) / 2e-2, f64::from(exact[at]));
            assert!((numeric - found).abs() < 3e-5 + 0.05 * found.abs(), "{at}: {numeric:e} {found:e}");
        }
    }

    #[test]
    fn a_step_brings_the_loss_down() {
        let scene = GradientScene::new(ColorModel::LogSh { degree: 1 });
        let raster = Engine::differentiable(&scene.engine).unwrap();
        let of = GaussStep { raster, splats: &scene.splats, view: &scene.recording, exposure: 3.0, unit_value: 0.5, step: &scene.step };
        let mut networks = networks(scene.splats.len());
        let first = of.gradients(&networks).unwrap().report.loss;
        for _ in 0..60 {
            let found = of.gradients(&networks).unwrap();
            networks.update(&found.by_numbers, &found.by_features, GaussRates { tone: 2e-3, features: 1e-2 });
        }
        let last = of.gradients(&networks).unwrap().report.loss;
        assert!(last < first - 0.05, "{first} {last}");
    }
}

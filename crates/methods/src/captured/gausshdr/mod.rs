//! A step of GaussHDR (Liu et al. 2025, "GaussHDR: High Dynamic Range Gaussian Splatting via
//! Learning Unified 3D and 2D Local Tone Mapping"), on plain splats.
//!
//! In: splats of log harmonics with a context feature each, the tone networks, a view of captured
//! values. Out: channels, the loss, and gradients by radiance, features and networks.
//!
//! Captured values are made twice. On splats: y = clip(g + r - 1/2, 0, 1) of the networks' global
//! value g and local shift r, blended to Y. On pixels: radiance and features are blended, and the
//! same networks make z and Z of ln(X t + [`BLACK`]). Uncertainties of both, blended ones U3 and
//! those of pixels U2, weight their losses ([`loss`]); to these comes that of the unit
//! exposure. Radiance has no other loss.
//!
//! As published, uncertainty has no gradient by radiance, features or geometry. Gradients of all
//! blended channels but uncertainty decide where splats are added.

mod loss;
pub(super) mod networks;
mod soft_network;
pub(super) mod tone;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};
use luxel_core::engine::{ChannelLoss, ChannelRoles, ChannelSource, ChannelStep, MeasuredChannels, SeenSplats};
use luxel_core::{LossWeights, View};
use luxel_lanes::LANES;
use luxel_lanes::functions::ln;
use rayon::prelude::*;

use self::loss::{GaussImages, compare_images};
use self::tone::{FEATURES, GaussTone, Items, OUTPUTS, Values, local_value};
use crate::captured::arithmetic::blocks::{CHUNK, from_planes, to_planes};
use crate::captured::arithmetic::elementwise::{Elementwise, LnAbove, map_all};

/// Exposure that is added before the logarithm of a pixel's.
const BLACK: f32 = 1e-5;
/// Radiance of splats that counts as black, far below every cut-off.
const DARKEST: f32 = 1e-30;
/// First channel of each kind, and their number: values y, radiance, feature, uncertainty.
const RADIANCE: usize = 3;
const FEATURE: usize = 6;
const UNCERTAINTY: usize = FEATURE + FEATURES;
const CHANNELS: usize = UNCERTAINTY + 3;
/// Mark of a block without a splat that the view shows.
const HIDDEN: u32 = u32::MAX;

/// The target of a step, and how it is compared.
#[derive(Clone, Copy)]
pub(crate) struct GaussTarget<'a> {
    /// Captured values.
    pub(crate) view: &'a View,
    /// Exposure of normalised radiance 1: seconds times the radiance of a unit.
    pub(crate) exposure: f32,
    /// Value that the camera records where radiance times seconds is 1.
    pub(crate) unit_value: f32,
    pub(crate) loss: LossWeights,
}

/// A step.
pub(crate) struct GaussStep<'a> {
    target: GaussTarget<'a>,
    tone: &'a GaussTone,
    /// Context features of the splats, `[N, 4]`.
    features: &'a [f32],
    /// Number of each block of splats among those that are shown, or [`HIDDEN`].
    slots: Vec<u32>,
    /// The splats of the blocks that are shown.
    items: Vec<Items>,
    values: Vec<Values>,
    gradients: GaussGradients,
}

/// The gradients of a step by what the method trains beside splats.
#[derive(Default)]
pub(crate) struct GaussGradients {
    /// By the features, `[N, 4]`.
    pub(crate) by_features: Vec<f32>,
    /// By the networks' numbers.
    pub(crate) by_numbers: Vec<f64>,
}

/// ln(max(x, 0) exposure + BLACK).
struct LnExposure {
    exposure: f32,
}

impl Elementwise for LnExposure {
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: f32x16<S>) -> f32x16<S> {
        let c = |value: f32| f32x16::splat(simd, value);
        ln(x.max(c(0.0)).mul_add(c(self.exposure), c(BLACK)))
    }
}

impl<'a> GaussStep<'a> {
    pub(crate) fn new(target: GaussTarget<'a>, tone: &'a GaussTone, features: &'a [f32]) -> Self {
        Self { target, tone, features, slots: Vec::new(), items: Vec::new(), values: Vec::new(), gradients: GaussGradients::default() }
    }

    /// Returns the gradients, after the step.
    pub(crate) fn gradients(self) -> GaussGradients {
        self.gradients
    }

    fn size(&self) -> [usize; 2] {
        self.target.view.camera.size_px.map(|side| side as usize)
    }

    /// Collects the splats of the blocks that the view shows.
    fn collect_items(&mut self, splats: &SeenSplats<'_>) {
        let mut shown = Vec::new();
        self.slots.clear();
        for (block, visible) in (0u32..).zip(splats.visible.chunks(LANES)) {
            let is_shown = visible.contains(&true);
            self.slots.push(if is_shown { shown.len() as u32 } else { HIDDEN });
            if is_shown {
                shown.push(block);
            }
        }
        let (log_exposure, features) = (self.target.exposure.ln(), self.features);
        self.items = vec![[[0.0; LANES]; 3 + FEATURES]; shown.len()];
        self.items.par_iter_mut().zip(&shown).with_min_len(CHUNK).for_each(|(item, block)| {
            let first = *block as usize * LANES;
            for (lane, rgb) in splats.radiance[first..].iter().take(LANES).enumerate() {
                (0..3).for_each(|c| item[c][lane] = rgb[c]);
                (0..FEATURES).for_each(|k| item[3 + k][lane] = features[(first + lane) * FEATURES + k]);
            }
            let logarithms = item[..3].as_flattened_mut();
            map_all(&LnAbove { floor: DARKEST }, logarithms);
            logarithms.iter_mut().for_each(|s| *s += log_exposure);
        });
    }
}

impl ChannelSource for GaussStep<'_> {
    fn count(&self) -> usize {
        CHANNELS
    }

    fn fill(&mut self, splats: &SeenSplats<'_>, out: &mut [f32]) {
        self.collect_items(splats);
        self.values = self.tone.apply(&self.items);
        let blocks = out.par_chunks_mut(LANES * CHANNELS).zip(splats.radiance.par_chunks(LANES)).zip(&self.slots);
        blocks.with_min_len(CHUNK).filter(|(_, slot)| **slot != HIDDEN).for_each(|((out, radiance), slot)| {
            let (item, values) = (&self.items[*slot as usize], &self.values[*slot as usize]);
            for (lane, (row, rgb)) in out.chunks_exact_mut(CHANNELS).zip(radiance).enumerate() {
                for (c, x) in rgb.iter().enumerate() {
                    row[c] = local_value(values[c][lane], values[3 + c][lane]).0;
                    row[RADIANCE + c] = *x;
                    row[UNCERTAINTY + c] = values[6 + c][lane];
                }
                (0..FEATURES).for_each(|k| row[FEATURE + k] = item[3 + k][lane]);
            }
        });
    }
}

impl ChannelStep for GaussStep<'_> {
    fn roles(&self) -> ChannelRoles {
        ChannelRoles { shaping: UNCERTAINTY, measured: MeasuredChannels::All }
    }

    fn compare(&mut self, image: &[f32], gradient: &mut [f32]) -> ChannelLoss {
        let (tone, exposure) = (self.tone, self.target.exposure);
        let len = image.len() / CHANNELS;
        // ln exposure and feature of the pixels, which follow one another.
        let mut inputs = image[RADIANCE * len..UNCERTAINTY * len].to_vec();
        inputs[..3 * len].par_chunks_mut(len.max(1)).for_each(|plane| map_all(&LnExposure { exposure }, plane));
        let items: Vec<Items> = from_planes(&inputs);
        let values = tone.apply(&items);
        let mut planes = vec![0.0; OUTPUTS * len];
        to_planes(&values, 0, len, &mut planes);

        let images = GaussImages {
            size: self.size(),
            captured: &image[..3 * len],
            uncertainty: &image[UNCERTAINTY * len..],
            pixels: &planes,
            view: self.target.view,
            weights: &self.target.loss,
        };
        let mut by_values = vec![0.0; OUTPUTS * len];
        let (by_captured, rest) = gradient.split_at_mut(3 * len);
        let (by_inputs, by_uncertainty) = rest.split_at_mut((UNCERTAINTY - RADIANCE) * len);
        let mut report = compare_images(&images, by_captured, &mut by_values, by_uncertainty);

        let by_values: Vec<Values> = from_planes(&by_values);
        let mut found = tone.backward(&items, &values, &by_values);
        to_planes(&found.by_item, 0, len, by_inputs);
        let radiance = &image[RADIANCE * len..FEATURE * len];
        by_inputs[..3 * len].par_chunks_mut(len.max(1)).zip(radiance.par_chunks(len.max(1))).for_each(|(by, radiance)| {
            // d ln(X e + b) = e dX / (X e + b).
            by.iter_mut().zip(radiance).for_each(|(by, x)| *by *= exposure / (x.max(0.0) * exposure + BLACK));
        });
        report.loss += tone.add_unit_loss(&mut found.by_numbers, self.target.unit_value);
        self.gradients.by_numbers = found.by_numbers;
        report
    }

    fn backward(&mut self, splats: &SeenSplats<'_>, by_channels: &[f32], out: &mut [[f32; 3]]) {
        let mut by_values = vec![[[0.0; LANES]; OUTPUTS]; self.items.len()];
        let shown: Vec<usize> = (0..self.slots.len()).filter(|block| self.slots[*block] != HIDDEN).collect();
        by_values.par_iter_mut().zip(&shown).zip(&self.values).with_min_len(CHUNK).for_each(|((by, block), values)| {
            let first = block * LANES;
            let rows = by_channels[first * CHANNELS..].chunks_exact(CHANNELS).zip(&splats.visible[first..]).take(LANES);
            for (lane, (row, _)) in rows.enumerate().filter(|(_, (_, visible))| **visible) {
                for c in 0..3 {
                    let passes = local_value(values[c][lane], values[3 + c][lane]).1;
                    let by_value = if passes { row[c] } else { 0.0 };
                    (by[c][lane], by[3 + c][lane], by[6 + c][lane]) = (by_value, by_value, row[UNCERTAINTY + c]);
                }
            }
        });
        let found = self.tone.backward(&self.items, &self.values, &by_values);
        self.gradients.by_numbers.iter_mut().zip(found.by_numbers).for_each(|(sum, part)| *sum += part);

        self.gradients.by_features = vec![0.0; out.len() * FEATURES];
        let blocks = (
            out.par_chunks_mut(LANES),
            self.gradients.by_features.par_chunks_mut(LANES * FEATURES),
            by_channels.par_chunks(LANES * CHANNELS),
            splats.radiance.par_chunks(LANES),
            splats.visible.par_chunks(LANES),
            &self.slots,
        );
        blocks.into_par_iter().with_min_len(CHUNK).filter(|block| *block.5 != HIDDEN).for_each(
            |(out, by_features, by_channels, radiance, visible, slot)| {
                let by_item = &found.by_item[*slot as usize];
                let rows = by_channels.chunks_exact(CHANNELS).zip(visible).enumerate();
                for (lane, (row, _)) in rows.filter(|(_, (_, visible))| **visible) {
                    for (c, by_log) in by_item[..3].iter().enumerate() {
                        let x = radiance[lane][c];
                        out[lane][c] = row[RADIANCE + c] + if x > DARKEST { by_log[lane] / x } else { 0.0 };
                    }
                    for k in 0..FEATURES {
                        by_features[lane * FEATURES + k] = row[FEATURE + k] + by_item[3 + k][lane];
                    }
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorModel;

    use super::networks::{GaussNetworks, GaussRates};
    use super::*;
    use crate::captured::testing::method_oracles::{GaussOracle, joined};
    use crate::captured::testing::oracle::Point;
    use crate::captured::testing::{GradientScene, check_features, check_shared, check_splats};

    fn networks(splats: usize) -> GaussNetworks {
        let mut networks = GaussNetworks::new(splats, 3);
        // Features that are not 0, so that gradients pass through all networks.
        let by: Vec<f32> = (0..splats * FEATURES).map(|i| (0.7 * i as f32).sin()).collect();
        networks.features.update(&by, 0.3);
        networks
    }

    fn target(scene: &GradientScene) -> GaussTarget<'_> {
        GaussTarget { view: &scene.recording, exposure: 3.0, unit_value: 0.5, loss: scene.step.loss }
    }

    #[test]
    fn gradients_of_the_whole_step_are_those_of_the_oracle() {
        let scene = GradientScene::new(ColorModel::LogSh { degree: 1 });
        let networks = networks(scene.splats.len());
        let point = Point::new(&scene.splats, joined(networks.tone.numbers()), networks.features());
        let mut step = GaussStep::new(target(&scene), &networks.tone, networks.features());
        let (report, splats) = scene.gradients(&mut step);
        let oracle = GaussOracle { scene: &scene, exposure: 3.0, unit_value: 0.5, fixed: &point };
        let loss = |point: &Point| oracle.loss(point);
        assert!((f64::from(report.loss) - loss(&point)).abs() < 1e-5, "{} {}", report.loss, loss(&point));
        check_splats(&splats, &point, loss);
        let found = step.gradients();
        check_shared(&found.by_numbers, &point, loss);
        check_features(&found.by_features, &point, loss);
    }

    #[test]
    fn a_step_brings_the_loss_down() {
        let scene = GradientScene::new(ColorModel::LogSh { degree: 1 });
        let mut networks = networks(scene.splats.len());
        let losses: Vec<f32> = (0..61)
            .map(|_| {
                let mut step = GaussStep::new(target(&scene), &networks.tone, networks.features());
                let loss = scene.gradients(&mut step).0.loss;
                let found = step.gradients();
                networks.update(&found.by_numbers, &found.by_features, GaussRates { tone: 2e-3, features: 1e-2 });
                loss
            })
            .collect();
        assert!(losses[60] < losses[0] - 0.05, "{losses:?}");
    }
}

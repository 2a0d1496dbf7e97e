//! The losses of the methods' whole steps in f64, as published, of every number that they train.
//!
//! In: a [`Point`], the images of a step. Out: the loss, of which central differences are taken.
//! What a method takes as constant in its gradient comes from another point, at which it is fixed.

use super::oracle::{Pixels, Point, Weights, all, blend, dissimilarity, exact, image_loss, relu_network, sigmoid, softplus};
use super::{GradientScene, SIDE};
use crate::captured::gausshdr::tone::GaussTone;
use luxel_core::View;
use luxel_train::HdrNormalisation;
use luxel_train::TrainConfig;

const WIDTH: usize = SIDE as usize;

/// Units of the network of pixels, and of the tone networks.
const CYCLE_UNITS: usize = 128;
const TONE_UNITS: usize = 64;

fn pixels(view: &View) -> Pixels {
    view.image.pixels.iter().map(|rgb| rgb.map(f64::from)).collect()
}

fn weights(scene: &GradientScene, point: &Point) -> Weights {
    point.weights(&scene.view.camera, &scene.step.render.raster)
}

fn mu_law(config: &TrainConfig, image: &Pixels) -> Pixels {
    let most = image.iter().flatten().fold(0.0f64, |a, b| a.max(*b));
    let divisor = if config.hdr_normalisation == HdrNormalisation::Own { most } else { 1.0 };
    let mu = f64::from(config.mu);
    image.iter().map(|rgb| rgb.map(|x| (1.0 + mu * x / divisor).ln() / (1.0 + mu).ln())).collect()
}

/// Loss of the captured image and of radiance, as HDR-GS and Mono-HDR-GS add them.
fn pair_loss(scene: &GradientScene, config: &TrainConfig, captured: &Pixels, radiance: &Pixels) -> f64 {
    let d = |x: &Pixels, y: &Pixels| image_loss(WIDTH, x, y, &all(x.len()), &scene.step.loss);
    let of_radiance = d(&mu_law(config, radiance), &mu_law(config, &pixels(&scene.view)));
    f64::from(config.ldr_weight) * d(captured, &pixels(&scene.recording)) + f64::from(config.hdr_weight) * of_radiance
}

/// HDR-GS: radiance is e^response; captured values are those of the tone mappers, of which the
/// point has one a channel. `log_exposure` is ln t - ln t_0.
pub(crate) fn hdr_gs(scene: &GradientScene, config: &TrainConfig, log_exposure: f64, point: &Point) -> f64 {
    let (weights, responses) = (weights(scene, point), point.responses());
    let len = point.shared.len() / 3;
    let value = |c: usize, s: f64| sigmoid(relu_network::<1>(&point.shared[c * len..(c + 1) * len], s + log_exposure)[0]);
    let captured: Pixels = responses.iter().map(|s| [0, 1, 2].map(|c| value(c, s[c]))).collect();
    let radiance: Pixels = responses.iter().map(|s| s.map(f64::exp)).collect();
    pair_loss(scene, config, &blend(&weights, &captured), &blend(&weights, &radiance))
}

/// Mono-HDR-GS: captured values are the rectified responses; radiance is lifted from them by the
/// first numbers of the point, and goes back to captured values by the others, of the network of
/// pixels.
pub(crate) fn mono_hdr_gs(scene: &GradientScene, config: &TrainConfig, point: &Point) -> f64 {
    let weights = weights(scene, point);
    let (of_lift, of_cycle) = point.shared.split_at(point.shared.len() - (10 * CYCLE_UNITS + 6));
    let len = of_lift.len() / 3;
    let captured: Pixels = point.responses().iter().map(|s| s.map(|s| s.max(0.0))).collect();
    let lifted = |c: usize, l: f64| {
        let [x, r, y] = relu_network::<3>(&of_lift[c * len..(c + 1) * len], l);
        softplus(l + x.max(0.0) * r.max(0.0) + y)
    };
    let radiance: Pixels = captured.iter().map(|l| [0, 1, 2].map(|c| lifted(c, l[c]))).collect();
    let (captured, radiance) = (blend(&weights, &captured), blend(&weights, &radiance));
    let back: Pixels = mu_law(config, &radiance).iter().map(|p| cycle(of_cycle, *p)).collect();
    let of_back = image_loss(WIDTH, &back, &pixels(&scene.recording), &all(back.len()), &scene.step.loss);
    pair_loss(scene, config, &captured, &radiance) + f64::from(config.cycle_weight) * of_back
}

/// The network of pixels: weights by input and unit, biases, outgoing weights of six heads by unit,
/// biases of the heads.
fn cycle(numbers: &[f64], p: [f64; 3]) -> [f64; 3] {
    let n = CYCLE_UNITS;
    let hidden = |j: usize| ((0..3).map(|c| numbers[c * n + j] * p[c]).sum::<f64>() + numbers[3 * n + j]).max(0.0);
    let head = |k: usize| numbers[10 * n + k] + (0..n).map(|j| numbers[(4 + k) * n + j] * hidden(j)).sum::<f64>();
    [0, 1, 2].map(|c| sigmoid(head(c).max(0.0) + head(3 + c).tanh()))
}

/// GaussHDR at one point, with what its gradient takes as constant at another.
pub(crate) struct GaussOracle<'a> {
    pub(crate) scene: &'a GradientScene,
    pub(crate) exposure: f64,
    pub(crate) unit_value: f64,
    /// The point at which constants are fixed.
    pub(crate) fixed: &'a Point,
}

/// The images of a point.
struct GaussImages {
    /// Blended values, and local and global values of pixels.
    y: Pixels,
    z: Pixels,
    global: Pixels,
    /// Inputs of the uncertainty network: of splats, and of pixels.
    splat_inputs: Vec<[[f64; 5]; 3]>,
    pixel_inputs: Vec<[[f64; 5]; 3]>,
    weights: Weights,
}

/// A network of smooth units: by unit its weights, bias and outgoing weight, and last a bias.
fn tone_network<const INPUTS: usize>(numbers: &[f64], x: [f64; INPUTS]) -> f64 {
    let bend = 4.0 * std::f64::consts::LN_2 * std::f64::consts::LN_2;
    let unit = |n: &[f64]| {
        let z = n[INPUTS] + (0..INPUTS).map(|k| n[k] * x[k]).sum::<f64>();
        n[INPUTS + 1] * (z + (z * z + bend).sqrt()) / 2.0
    };
    numbers.chunks_exact(INPUTS + 2).map(unit).sum::<f64>() + numbers[numbers.len() - 1]
}

const GLOBAL: usize = 3 * TONE_UNITS + 1;
const LOCAL: usize = 7 * TONE_UNITS + 1;

fn global_value(numbers: &[f64], c: usize, s: f64) -> f64 {
    sigmoid(tone_network(&numbers[c * GLOBAL..(c + 1) * GLOBAL], [s]))
}

fn local_value(numbers: &[f64], c: usize, input: [f64; 5]) -> f64 {
    let own = &numbers[3 * GLOBAL + c * LOCAL..][..LOCAL];
    (global_value(numbers, c, input[0]) + sigmoid(tone_network(own, input)) - 0.5).clamp(0.0, 1.0)
}

fn uncertainty(numbers: &[f64], input: [f64; 5]) -> f64 {
    softplus(tone_network(&numbers[3 * GLOBAL + 3 * LOCAL..], input)).max(0.1)
}

impl GaussOracle<'_> {
    fn images(&self, point: &Point) -> GaussImages {
        let weights = weights(self.scene, point);
        let numbers = &point.shared[..];
        let input = |s: f64, f: [f64; 4]| [s, f[0], f[1], f[2], f[3]];
        let radiance: Pixels = point.responses().iter().map(|s| s.map(f64::exp)).collect();
        let splat_inputs: Vec<[[f64; 5]; 3]> =
            radiance.iter().zip(&point.features).map(|(x, f)| x.map(|x| input((x * self.exposure).ln(), *f))).collect();
        let values: Pixels = splat_inputs.iter().map(|of| [0, 1, 2].map(|c| local_value(numbers, c, of[c]))).collect();
        let (image, features) = (blend(&weights, &radiance), blend(&weights, &point.features));
        let pixel_inputs: Vec<[[f64; 5]; 3]> =
            image.iter().zip(&features).map(|(x, f)| x.map(|x| input((x * self.exposure + 1e-5).ln(), *f))).collect();
        let z = pixel_inputs.iter().map(|of| [0, 1, 2].map(|c| local_value(numbers, c, of[c]))).collect();
        let global = pixel_inputs.iter().map(|of| [0, 1, 2].map(|c| global_value(numbers, c, of[c][0]))).collect();
        GaussImages { y: blend(&weights, &values), z, global, splat_inputs, pixel_inputs, weights }
    }

    /// Returns the uncertainties U3 and U2 of fixed inputs and weights.
    fn uncertainties(&self, fixed: &GaussImages, numbers: &[f64]) -> [Pixels; 2] {
        let of = |inputs: &[[[f64; 5]; 3]]| -> Pixels { inputs.iter().map(|of| of.map(|input| uncertainty(numbers, input))).collect() };
        let u3: Pixels = blend(&fixed.weights, &of(&fixed.splat_inputs));
        [u3.iter().map(|u| u.map(|u| u.max(0.1))).collect(), of(&fixed.pixel_inputs)]
    }

    /// Returns the loss at a point.
    pub(crate) fn loss(&self, point: &Point) -> f64 {
        let (images, fixed) = (self.images(point), self.images(self.fixed));
        let target = pixels(&self.scene.recording);
        let [fixed_u3, fixed_u2] = self.uncertainties(&fixed, &self.fixed.shared);
        let share = |i: usize, c: usize| fixed_u2[i][c].powi(2) / (fixed_u2[i][c].powi(2) + fixed_u3[i][c].powi(2));
        let len = target.len();
        let shares: Pixels = (0..len).map(|i| [0, 1, 2].map(|c| share(i, c))).collect();
        let others: Pixels = shares.iter().map(|w| w.map(|w| 1.0 - w)).collect();
        let loss = |x: &Pixels, counts: &Pixels| image_loss(WIDTH, x, &target, counts, &self.scene.step.loss);
        let of_images = loss(&images.y, &shares) + loss(&images.z, &others) + 0.5 * loss(&images.global, &all(len));

        let [u3, u2] = self.uncertainties(&fixed, &point.shared);
        let (d3, d2) = (dissimilarity(WIDTH, &fixed.y, &target), dissimilarity(WIDTH, &fixed.z, &target));
        let of_uncertainty = |u: &Pixels, d: &Pixels| {
            let values = u.iter().flatten().zip(d.iter().flatten());
            values.map(|(u, d)| d / (2.0 * u * u) + 0.5 * u.ln()).sum::<f64>() / (3 * len) as f64
        };
        let unit = |c: usize| (global_value(&point.shared, c, 0.0) - self.unit_value).powi(2);
        of_images + of_uncertainty(&u3, &d3) + of_uncertainty(&u2, &d2) + 0.5 * (0..3).map(unit).sum::<f64>() / 3.0
    }
}

/// Returns the numbers of tone networks, one after another.
pub(crate) fn tone_numbers(tone: &GaussTone) -> Vec<f64> {
    joined(tone.numbers())
}

/// Returns numbers of networks, one after another, in f64.
pub(crate) fn joined<'a>(networks: impl IntoIterator<Item = &'a [f32]>) -> Vec<f64> {
    networks.into_iter().flat_map(exact).collect()
}

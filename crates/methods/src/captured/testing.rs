//! A small scene for tests of gradients: splats of a few pixels to half the image, in front of a
//! camera at the origin, and a pair of images that they do not match; and the methods' losses in
//! f64, with whose central differences gradients are compared.

pub(crate) mod method_oracles;
pub(crate) mod oracle;

use luxel_core::engine::{
    AdamBetas, CameraGradientChoice, ChannelStep, LearningRates, SPLATS_PER_BLOCK, SparseGradients, StatsCollection, StepConfig,
};
use luxel_core::random::standard_normal;
use luxel_core::{
    Antialias, Camera, ColorModel, Cutoffs, Engine, Image, LossWeights, PixelValues, RasterConfig, RenderOptions, Splat, Splats,
    StepReport, View, logit,
};
use luxel_cpu::CpuEngine;
use luxel_train::TrainConfig;

use self::oracle::{Point, ROWS};
use crate::captured::images::pair_channels::PairTargets;
use crate::testing::{camera_at, view_of};

pub(crate) const SIDE: u32 = 40;
/// Largest error of a gradient, of the largest one by the same parameter.
const SPLAT_BOUND: f64 = 1e-3;
const SHARED_BOUND: f64 = 1e-3;

/// The scene.
pub(crate) struct GradientScene {
    pub(crate) splats: Splats,
    pub(crate) view: View,
    pub(crate) recording: View,
    pub(crate) step: StepConfig,
}

fn splats(color_model: ColorModel) -> Splats {
    let mut splats = Splats::empty(color_model);
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

fn image(seed: u64) -> Image {
    let pixel = |i: u64| standard_normal(seed, i).map(|v: f32| 0.4 + 0.05 * v.abs() + 0.3 * (i as f32 * 0.01).sin().abs());
    Image::from_pixels(SIDE as usize, SIDE as usize, (0..u64::from(SIDE * SIDE)).map(pixel).collect()).unwrap()
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

impl GradientScene {
    /// Makes the scene of a colour model of degree 1.
    pub(crate) fn new(color_model: ColorModel) -> Self {
        let camera: Camera = camera_at([0.0; 3], [SIDE, SIDE]);
        let view = view_of("a", camera.clone(), image(3));
        let recording = View { values: PixelValues::Recorded { exposure_s: 2.0 }, ..view_of("a_0", camera, image(4)) };
        Self { splats: splats(color_model), view, recording, step: step() }
    }

    /// Returns the images of a pair, and how they are compared.
    pub(crate) fn targets<'a>(&'a self, config: &'a TrainConfig) -> PairTargets<'a> {
        PairTargets { view: &self.view, recording: &self.recording, config, loss: self.step.loss }
    }

    /// Computes the gradients of a step.
    pub(crate) fn gradients(&self, method: &mut dyn ChannelStep) -> (StepReport, SparseGradients) {
        let mut engine = CpuEngine::new(2).unwrap();
        engine.load(&self.splats, None).unwrap();
        engine.channel_gradients(&self.view.camera, method, &self.step).unwrap()
    }
}

/// Returns the central difference of a loss by one number.
fn difference(point: &Point, number: impl Fn(&mut Point) -> &mut f64, loss: &impl Fn(&Point) -> f64) -> f64 {
    let moved = |h: f64| {
        let mut point = point.clone();
        *number(&mut point) += h;
        loss(&point)
    };
    (moved(1e-5) - moved(-1e-5)) / 2e-5
}

/// Compares gradients by every parameter of some splats with differences of the loss.
pub(crate) fn check_splats(found: &SparseGradients, point: &Point, loss: impl Fn(&Point) -> f64) {
    let at = |i: usize, row: usize| {
        let block = found.values_of((i / SPLATS_PER_BLOCK) as u32).unwrap();
        f64::from(block[row * SPLATS_PER_BLOCK + i % SPLATS_PER_BLOCK])
    };
    assert_eq!(found.rows().count(), ROWS);
    let mut worst = 0.0f64;
    for row in 0..ROWS {
        let largest = (0..point.splats.len()).map(|i| at(i, row).abs()).fold(0.0, f64::max);
        for i in [2, 7, 13, 19] {
            let numeric = difference(point, |point| &mut point.splats[i][row], &loss);
            worst = worst.max((numeric - at(i, row)).abs() / largest);
            assert!(
                (numeric - at(i, row)).abs() < SPLAT_BOUND * largest,
                "splat {i}, row {row}: {numeric:e} {:e} of {largest:e}",
                at(i, row)
            );
        }
    }
    println!("gradients by splats: worst error {worst:.1e} of the largest of a parameter");
}

/// Compares gradients by some of the numbers that splats share with differences of the loss.
pub(crate) fn check_shared(found: &[f64], point: &Point, loss: impl Fn(&Point) -> f64) {
    assert_eq!(found.len(), point.shared.len());
    let largest = found.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    let mut worst = 0.0f64;
    for at in (0..found.len()).step_by(found.len() / 60).chain([found.len() - 1]) {
        let numeric = difference(point, |point| &mut point.shared[at], &loss);
        worst = worst.max((numeric - found[at]).abs() / largest);
        assert!((numeric - found[at]).abs() < SHARED_BOUND * largest, "number {at}: {numeric:e} {:e} of {largest:e}", found[at]);
    }
    println!("gradients by shared numbers: worst error {worst:.1e} of the largest");
}

/// Compares gradients by some features with differences of the loss.
pub(crate) fn check_features(found: &[f32], point: &Point, loss: impl Fn(&Point) -> f64) {
    let largest = found.iter().fold(0.0f64, |m, g| m.max(f64::from(g.abs())));
    for at in [0, 13, 30, 55, 79] {
        let numeric = difference(point, |point| &mut point.features[at / 4][at % 4], &loss);
        assert!((numeric - f64::from(found[at])).abs() < SHARED_BOUND * largest, "feature {at}: {numeric:e} {:e}", found[at]);
    }
}

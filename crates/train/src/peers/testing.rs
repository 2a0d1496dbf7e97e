//! A small scene for tests of gradients: splats of a few pixels to half the image, in front of a
//! camera at the origin, and a pair of images that they do not match.

use luxel_core::engine::{
    AdamBetas, CameraGradientChoice, LearningRates, ParameterRows, SPLATS_PER_BLOCK, SparseGradients, StatsCollection, StepConfig,
};
use luxel_core::random::standard_normal;
use luxel_core::{
    Antialias, Camera, ColorModel, Cutoffs, Engine, Image, LossWeights, PixelValues, RasterConfig, RenderOptions, Splat, Splats, View,
    logit,
};
use luxel_cpu::CpuEngine;

use super::pair::PairStep;
use crate::TrainConfig;
use crate::testing::{camera_at, view_of};

const SIDE: u32 = 40;

/// The scene.
pub(crate) struct GradientScene {
    pub(crate) engine: CpuEngine,
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

impl GradientScene {
    /// Makes the scene of a colour model of degree 1.
    pub(crate) fn new(color_model: ColorModel) -> Self {
        let camera: Camera = camera_at([0.0; 3], [SIDE, SIDE]);
        let view = view_of("a", camera.clone(), image(3));
        let recording = View { values: PixelValues::Recorded { exposure_s: 2.0 }, ..view_of("a_0", camera, image(4)) };
        Self { engine: CpuEngine::new(2).unwrap(), splats: splats(color_model), view, recording, step: step() }
    }

    /// Returns what a step returns.
    pub(crate) fn of<R>(&self, config: &TrainConfig, run: impl Fn(PairStep<'_>) -> R) -> R {
        self.with(&self.splats, config, run)
    }

    fn with<R>(&self, splats: &Splats, config: &TrainConfig, run: impl Fn(PairStep<'_>) -> R) -> R {
        let raster = Engine::differentiable(&self.engine).unwrap();
        run(PairStep { raster, splats, view: &self.view, recording: &self.recording, config, step: &self.step })
    }

    /// Compares a step's gradients by every parameter of some splats with differences of its loss.
    pub(crate) fn check(&self, config: &TrainConfig, run: impl Fn(PairStep<'_>) -> (f32, SparseGradients)) {
        self.check_by(|splats| self.with(splats, config, &run));
    }

    /// Compares gradients by every parameter of some splats with differences of the loss.
    pub(crate) fn check_by(&self, of: impl Fn(&Splats) -> (f32, SparseGradients)) {
        let splats = &self.splats;
        let exact = of(splats).1;
        let rows = exact.rows().count();
        let at = |i: usize, row: usize| {
            f64::from(exact.values_of((i / SPLATS_PER_BLOCK) as u32).unwrap()[row * SPLATS_PER_BLOCK + i % SPLATS_PER_BLOCK])
        };
        let largest = |row: usize| (0..splats.len()).map(|i| at(i, row).abs()).fold(0.0, f64::max);
        for (i, row) in [2, 7, 13, 19].into_iter().flat_map(|i| (0..rows).map(move |row| (i, row))) {
            let loss = |by: f32| f64::from(of(&moved(splats, i, row, by)).0);
            let (numeric, found) = ((loss(5e-3) - loss(-5e-3)) / 1e-2, at(i, row));
            assert!((numeric - found).abs() < 0.06 * largest(row) + 2e-5, "splat {i}, row {row}: {numeric:e} {found:e}");
        }
    }
}

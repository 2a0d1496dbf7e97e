//! The gradient of a whole step, from the images' loss to anchors and networks, against central
//! differences of images in f64: of one image of radiance, and of the images that GaussHDR makes.

use luxel_core::engine::{LearningRates, StatsCollection, StepConfig};
use luxel_core::{ColorModel, Engine, LossWeights, Target, ToneCurve, View};
use luxel_cpu::CpuEngine;
use luxel_train::{Method, TrainConfig};

use super::super::gradients::SplatGradients;
use super::super::scene::AnchorScene;
use super::decoding::{check_groups, of_groups};
use super::oracle::{Decoded, Point};
use super::{MODELS, scene};
use crate::captured::testing::method_oracles::{GaussOracle, tone_numbers};
use crate::captured::testing::oracle::{self as images, all, blend, image_loss};
use crate::captured::testing::{GradientScene, SIDE, check_shared};
use crate::captured::{GaussStep, GaussTarget, SharedNetworks};
use crate::testing::dataset_of;

const MU: f32 = 50.0;

/// Returns the view with the mu-law, and the step of gradients.
fn target() -> (View, StepConfig) {
    let GradientScene { view, step, .. } = GradientScene::new(ColorModel::LogSh { degree: 1 });
    let target = Target { curve: ToneCurve::MuLaw { mu: MU }, ..Target::default() };
    let loss = LossWeights { squared_share: 0.5, ..LossWeights::default() };
    (View { target, ..view }, StepConfig { loss, learning_rates: LearningRates::ZERO, stats: StatsCollection::Gradients, ..step })
}

/// Returns decoded splats as the images' oracle takes them, with constant harmonics and `shared`
/// numbers of networks.
fn shown(splats: &[Decoded], shared: Vec<f64>) -> images::Point {
    let row = |splat: &Decoded| {
        let mut row = [0.0; images::ROWS];
        row[..14].copy_from_slice(&splat.row[..14]);
        row
    };
    images::Point { splats: splats.iter().map(row).collect(), shared, features: splats.iter().map(|splat| splat.context).collect() }
}

/// The loss of the image in f64.
fn exact_loss(point: &Point, view: &View, step: &StepConfig) -> f64 {
    let splats = point.splats();
    let shown = shown(&splats, Vec::new());
    let weights = shown.weights(&view.camera, &step.render.raster);
    let radiance: Vec<[f64; 3]> = splats.iter().map(|splat| splat.radiance).collect();
    let curve = |rgb: [f64; 3]| rgb.map(|x| (1.0 + f64::from(MU) * x).ln() / (1.0 + f64::from(MU)).ln());
    let image: Vec<[f64; 3]> = blend(&weights, &radiance).into_iter().map(curve).collect();
    let expected: Vec<[f64; 3]> = view.image.pixels.iter().map(|rgb| curve(rgb.map(f64::from))).collect();
    image_loss(SIDE as usize, &image, &expected, &all(image.len()), &step.loss)
}

fn step_of(scene: &AnchorScene, view: &View, step: &StepConfig, threads: usize) -> (f32, [Vec<f64>; 7]) {
    let mut engine = CpuEngine::new(threads).unwrap();
    let mut decoded = scene.decode(&view.camera, step.render.raster.cutoffs.near);
    engine.load(&decoded.splats, None).unwrap();
    let (report, gradients) = engine.view_gradients(view, step).unwrap();
    let by_splats = SplatGradients::new(&gradients, decoded.splats.len());
    assert!((0..decoded.splats.len()).any(|splat| by_splats.statistics(splat).1));
    (report.loss, of_groups(decoded.backward(scene, &by_splats, &[])))
}

#[test]
fn gradients_of_a_whole_step_are_those_of_differences() {
    let (view, step) = target();
    for model in MODELS {
        let scene = scene(model, false, 12);
        let (loss, found) = step_of(&scene, &view, &step, 2);
        let point = Point::new(&scene);
        let exact = exact_loss(&point, &view, &step);
        assert!((f64::from(loss) - exact).abs() < 1e-5, "{loss} {exact}");
        check_groups(&found, &point, 1e-4, |point| exact_loss(point, &view, &step));
    }
}

#[test]
fn threads_change_no_bit_of_a_gradient() {
    let (view, step) = target();
    let scene = scene(MODELS[0], false, 700);
    assert_eq!(step_of(&scene, &view, &step, 1), step_of(&scene, &view, &step, 3));
}

#[test]
fn gradients_of_a_whole_step_of_gausshdr_are_those_of_differences() {
    let captured = GradientScene::new(ColorModel::LogSh { degree: 1 });
    let scene = scene(ColorModel::LogSh { degree: 0 }, true, 12);
    let networks =
        SharedNetworks::new(&TrainConfig { method: Method::GaussHdrAnchors, ..TrainConfig::default() }, &dataset_of(Vec::new()), 0);
    let Some(SharedNetworks::GaussHdrAnchors(tone)) = networks else { panic!("{networks:?}") };
    let mut decoded = scene.decode(&captured.view.camera, captured.step.render.raster.cutoffs.near);
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&decoded.splats, None).unwrap();
    let target = GaussTarget { view: &captured.recording, exposure: 3.0, unit_value: 0.5, loss: captured.step.loss };
    let mut channels = GaussStep::new(target, &tone, &decoded.context);
    let (report, gradients) = engine.channel_gradients(&captured.view.camera, &mut channels, &captured.step).unwrap();
    let found = channels.gradients();
    let by_splats = SplatGradients::new(&gradients, decoded.splats.len());
    let by_groups = of_groups(decoded.backward(&scene, &by_splats, &found.by_features));

    let (point, numbers) = (Point::new(&scene), tone_numbers(&tone));
    let fixed = shown(&point.splats(), numbers.clone());
    let oracle = GaussOracle { scene: &captured, exposure: 3.0, unit_value: 0.5, fixed: &fixed };
    assert!((f64::from(report.loss) - oracle.loss(&fixed)).abs() < 1e-5, "{} {}", report.loss, oracle.loss(&fixed));
    check_groups(&by_groups, &point, 1e-4, |point| oracle.loss(&shown(&point.splats(), numbers.clone())));
    check_shared(&found.by_numbers, &fixed, |shown| oracle.loss(shown));
}

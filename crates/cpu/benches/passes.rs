//! Every pass of a training step, whole steps and renders, on the synthetic room:
//! `room_20k/lcd/rasterize`.
//!
//! Passes are private to the engine, so a pass's time is the difference of [`Engine::timings`] over
//! whole steps. `color` and `color_backward` run within `project` and `project_backward`; `densify`
//! is not part of a step. Splats lie in Z-order and the target is the room before its parameters
//! were perturbed, as `luxel bench --generate` has it; cut-offs are 3DGS's.
//!
//! `cargo bench -p luxel-cpu -- room_20k/lcd` measures a part; `-- --save-baseline NAME` and `--
//! --baseline NAME` compare.
#![allow(missing_docs, clippy::unwrap_used, reason = "a bench is no interface, and may panic")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, SamplingMode, criterion_group, criterion_main};
use luxel_core::engine::{AdamBetas, CameraGradientChoice, LearningRates, StatsCollection, StepConfig};
use luxel_core::{
    Activation, Antialias, ColorModel, Cutoffs, Engine, LossWeights, Pass, PixelValues, RasterConfig, RenderOptions, Target, View,
    spatial_order, synthetic,
};
use luxel_cpu::CpuEngine;

const WORKLOADS: [(&str, usize); 2] = [("room_20k", 20_000), ("room_100k", 100_000)];
const METHODS: [ColorModel; 2] =
    [ColorModel::Sh { degree: 3 }, ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus }];
const SIZE_PX: [u32; 2] = [400, 400];
const SEED: u64 = 42;
/// The passes that the engine times separately.
const PASSES: [Pass; 8] =
    [Pass::Project, Pass::Sort, Pass::Bin, Pass::Rasterize, Pass::Loss, Pass::RasterizeBackward, Pass::ProjectBackward, Pass::Adam];

/// An engine with a scene and its target.
struct Session {
    engine: CpuEngine,
    view: View,
    render: RenderOptions,
    step: u32,
}

impl Session {
    fn new(count: usize, model: ColorModel) -> Self {
        let mut room = synthetic::room(count, SEED).with_color_model(model).unwrap();
        let camera = synthetic::room_camera(SIZE_PX);
        let raster =
            RasterConfig { cutoffs: Cutoffs { near: 0.01, ..Cutoffs::PARITY }, antialias: Antialias::Off, ..RasterConfig::default() };
        let render = RenderOptions { raster, ..RenderOptions::default() };
        let mut engine = CpuEngine::new(0).unwrap();
        engine.load(&room, None).unwrap();
        let image = engine.render(&camera, &render).unwrap().into();
        synthetic::perturb(&mut room, SEED);
        engine.load(&room.select(spatial_order(&room.position)), None).unwrap();
        Self {
            engine,
            view: View {
                name: "room".into(),
                camera,
                image,
                values: PixelValues::Radiance,
                noise: None,
                mask: None,
                recordings: Vec::new(),
                target: Target::default(),
            },
            render,
            step: 0,
        }
    }

    fn forward(&mut self) {
        black_box(self.engine.render(&self.view.camera, &self.render).unwrap());
    }

    /// A training step at rates so small that the scene does not change.
    fn step(&mut self) {
        self.step += 1;
        let rate = 1e-9;
        let config = StepConfig {
            step: self.step,
            render: self.render,
            loss: LossWeights::default(),
            learning_rates: LearningRates {
                position: rate,
                rotation: rate,
                log_scale: rate,
                opacity_logit: rate,
                sh_dc: rate,
                sh_rest: rate,
                luminance_dc: rate,
                luminance_rest: rate,
            },
            betas: AdamBetas::default(),
            position_noise: None,
            dropout: None,
            stats: StatsCollection::Gradients,
            camera_gradient: CameraGradientChoice::Skip,
        };
        black_box(self.engine.train_step(&self.view, &config).unwrap());
    }

    /// Returns the time spent in `pass` so far.
    fn spent(&self, pass: Pass) -> Duration {
        self.engine.timings().iter().filter(|timed| timed.pass == pass).map(|timed| timed.time).sum()
    }
}

fn passes(criterion: &mut Criterion) {
    for (name, count) in WORKLOADS {
        for model in METHODS {
            // Made when the first benchmark of the group that is asked for runs.
            let mut session = None;
            let mut group = criterion.benchmark_group(format!("{name}/{}", model.name()));
            // A step takes tens of milliseconds: ten samples of a few steps each.
            group.sample_size(10).sampling_mode(SamplingMode::Flat);
            group.warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_millis(1500));
            let mut bench = |name: &str, time_of: &dyn Fn(&mut Session, u64) -> Duration| {
                group.bench_function(name, |bencher| {
                    let session = session.get_or_insert_with(|| Session::new(count, model));
                    bencher.iter_custom(|iterations| time_of(session, iterations));
                });
            };
            bench("forward", &|session, iterations| {
                let start = Instant::now();
                (0..iterations).for_each(|_| session.forward());
                start.elapsed()
            });
            bench("step", &|session, iterations| {
                let start = Instant::now();
                (0..iterations).for_each(|_| session.step());
                start.elapsed()
            });
            for pass in PASSES {
                bench(pass.name(), &|session, iterations| {
                    let before = session.spent(pass);
                    (0..iterations).for_each(|_| session.step());
                    session.spent(pass) - before
                });
            }
            group.finish();
        }
    }
}

criterion_group!(benches, passes);
criterion_main!(benches);

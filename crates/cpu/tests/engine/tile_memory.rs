//! Any memory for records and gradients of tiles gives the same bits.

use luxel_core::engine::{Evaluations, StatsCollection, StepConfig};
use luxel_core::{
    Activation, Antialias, Camera, CameraProjection, ColorModel, Cutoffs, Engine, Image, Layers, RenderOptions, Splats, View,
};
use luxel_cpu::CpuEngine;

use crate::fixture;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 0, activation: Activation::Softplus };
/// Room for no record and gradients band by band, for some, and for all.
const MEMORY_BYTES: [usize; 3] = [0, 64 << 10, 1 << 30];

/// The results of an engine for some views.
#[derive(Debug, PartialEq)]
struct Results {
    losses: Vec<f32>,
    splats: Splats,
    image: Image,
    layers: Layers,
    evaluations: Option<Evaluations>,
    blended: Vec<f32>,
}

fn results(memory_bytes: usize, splats: &Splats, views: &[View], options: &RenderOptions) -> Results {
    let mut engine = CpuEngine::new(2).unwrap();
    engine.set_tile_memory(memory_bytes);
    engine.load(splats, None).unwrap();
    let mut losses = Vec::new();
    // Renders between steps change nothing.
    for (n, view) in (0..).zip(views.iter().chain(views)) {
        let step = StepConfig { stats: StatsCollection::GradientsAndAbsolute, ..fixture::step(n + 1, *options) };
        losses.push(engine.train_step(view, &step).unwrap().loss);
        engine.render(&views[0].camera, options).unwrap();
    }
    let camera = &views[0].camera;
    let mask = vec![1.0; (camera.size_px[0] * camera.size_px[1]) as usize];
    Results {
        losses,
        image: engine.render(camera, options).unwrap(),
        layers: engine.render_layers(camera, options).unwrap(),
        evaluations: engine.evaluations(camera, options).unwrap(),
        blended: engine.contributions(camera, options, &mask).unwrap().blended,
        splats: engine.save().unwrap().0,
    }
}

#[test]
fn results_do_not_depend_on_the_memory_for_tiles() {
    let cameras: [Camera; 2] = [fixture::camera(150, 90), fixture::wide_camera(CameraProjection::Equirectangular, 128, 64)];
    for (camera, samples) in cameras.iter().zip([2, 1]) {
        let splats = fixture::splats(LCD, 400, camera, 5);
        let views = [1, 2].map(|seed| fixture::view(camera, seed == 2, seed));
        let mut options = fixture::options(Cutoffs::HDR, Antialias::Off);
        options.raster.samples = samples;
        let [none, some, all] = MEMORY_BYTES.map(|bytes| results(bytes, &splats, &views, &options));
        assert!(none == all && some == all, "{}", camera.projection.name());
        assert!(all.losses.iter().all(|loss| *loss > 0.0) && all.blended.iter().any(|sum| *sum > 0.0));
    }
}

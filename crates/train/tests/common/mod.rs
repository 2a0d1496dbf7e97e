//! A small scene with a lamp, rendered from known splats by the engine under test.

#![allow(clippy::unwrap_used, reason = "a helper of tests may panic as they do")]

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{
    Camera, CameraProjection, ColorModel, ColorSpace, Dataset, Distortion, Engine, Image, OnDemand, Point, RenderOptions, Splat, Splats,
    View, logit,
};
use luxel_cpu::CpuEngine;
use luxel_train::TrainConfig;

/// Side of the images, pixels.
pub(crate) const SIDE: u32 = 48;

/// An engine on two threads.
pub(crate) fn engine() -> Box<CpuEngine> {
    Box::new(CpuEngine::new(2).unwrap())
}

/// A camera at `eye` that looks at the origin; y is down.
pub(crate) fn camera(eye: DVec3) -> Camera {
    let forward = -eye.normalize();
    let right = DVec3::Y.cross(forward).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Camera {
        camera_from_world: DAffine3 { matrix3: rotation, translation: -(rotation * eye) },
        focal_px: DVec2::splat(f64::from(SIDE)),
        center_px: DVec2::splat(f64::from(SIDE) / 2.0),
        size_px: [SIDE, SIDE],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

/// The splats of a room: dark and coloured blobs, and among them a lamp a thousand times brighter.
fn truth() -> Splats {
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    for i in 0..216u32 {
        let cell = [i % 6, i / 6 % 6, i / 36].map(|c| c as f32 / 2.5 - 1.0);
        let shade = 0.02 + 0.06 * ((i * 37 % 11) as f32 / 10.0);
        let rgb = if i == 86 { [40.0, 30.0, 20.0] } else { [shade, shade * 0.7, shade * (0.4 + 0.6 * (i % 2) as f32)] };
        let (dc, _) = splats.color_model.constant(rgb);
        splats.push(&Splat {
            position: cell,
            rotation: [1.0, 0.0, 0.0, 0.0],
            log_scale: [0.17f32.ln(); 3],
            opacity_logit: logit(0.8),
            sh: &dc,
            raw_luminance: &[],
        });
    }
    splats
}

/// Six training views and one test view of the room. Its points are moved a little, like those of
/// structure from motion.
pub(crate) fn dataset() -> Dataset {
    let truth = truth();
    let mut engine = engine();
    engine.load(&truth, None).unwrap();
    let mut view = |name: &str, eye: DVec3| {
        let camera = camera(eye);
        let image = engine.render(&camera, &RenderOptions::default()).unwrap();
        View::of_radiance(name, camera, image)
    };
    let ring = |i: f64| DVec3::new((i * 0.5).sin() * 4.0, -0.8 + 0.3 * i, -(i * 0.5).cos() * 4.0);
    let train = (0..6).map(|i| view(&format!("train/{i}"), ring(f64::from(i)))).collect();
    let test = vec![view("test/0", ring(2.5))];
    let moved = |i: usize, p: &[f32; 3]| std::array::from_fn(|c| p[c] + 0.05 * luxel_core::random::standard_normal(9, i as u64)[c]);
    let points = truth.position.iter().enumerate().map(|(i, p)| Point { position: moved(i, p), rgb8: None, observations: Vec::new() });
    Dataset {
        format: "synthetic".to_owned(),
        train,
        test,
        points: points.collect(),
        color_space: ColorSpace::default(),
        bad_pixels: Vec::new(),
        fingerprint: "room".to_owned(),
        warnings: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
        is_developed: false,
        readers: 2,
    }
}

/// Options for a run of `iterations` steps that densifies every tenth step, starting after the
/// fifth.
pub(crate) fn config(iterations: u32) -> TrainConfig {
    TrainConfig {
        iterations,
        densify_from: Some(5),
        densify_interval: Some(10),
        opacity_reset_interval: 0,
        sh_interval: Some(20),
        ..TrainConfig::default()
    }
}

/// An image without content.
#[allow(dead_code, reason = "not every test file that shares this module needs it")]
pub(crate) fn black() -> OnDemand<Image> {
    Image::filled(SIDE as usize, SIDE as usize, [0.0; 3]).into()
}

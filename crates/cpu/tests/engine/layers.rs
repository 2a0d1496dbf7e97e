//! Alpha and depth, rendered with the image.

use luxel_core::{
    Antialias, Camera, CameraProjection, ColorModel, Cutoffs, Engine, RasterConfig, RenderOptions, Similarity, Splat, Splats,
};
use luxel_cpu::CpuEngine;

use crate::fixture;

fn options(background: [f32; 3]) -> RenderOptions {
    let raster = RasterConfig { cutoffs: Cutoffs::HDR, antialias: Antialias::Off, ..RasterConfig::default() };
    RenderOptions { raster, background, ..RenderOptions::default() }
}

#[test]
fn image_is_that_of_render_and_alpha_is_what_hides_the_background() {
    let camera = fixture::camera(70, 50);
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&fixture::splats(ColorModel::Sh { degree: 2 }, 200, &camera, 5), None).unwrap();
    let layers = engine.render_layers(&camera, &options([0.0; 3])).unwrap();
    let (black, white) = (engine.render(&camera, &options([0.0; 3])).unwrap(), engine.render(&camera, &options([1.0; 3])).unwrap());
    assert_eq!(layers.image, black);
    let mut covered = 0;
    for ((alpha, b), w) in layers.alpha.iter().zip(&black.pixels).zip(&white.pixels) {
        assert!((1.0 - alpha - (w[0] - b[0])).abs() < 1e-5 * (1.0 + b[0]), "{alpha} {b:?} {w:?}");
        covered += usize::from(*alpha > 0.5);
    }
    assert!(covered > 100, "{covered}");
}

#[test]
fn layers_and_shares_of_samples_are_means_of_finer_ones() {
    let camera = fixture::camera(37, 50);
    let mut engine = CpuEngine::new(2).unwrap();
    engine.load(&fixture::splats(ColorModel::Sh { degree: 2 }, 200, &camera, 5), None).unwrap();
    let one = options([0.1; 3]);
    let four = RenderOptions { raster: RasterConfig { samples: 2, ..one.raster }, ..one };
    let fine_camera = camera.upscaled(2);
    let (layers, fine) = (engine.render_layers(&camera, &four).unwrap(), engine.render_layers(&fine_camera, &one).unwrap());
    assert_eq!((layers.image.width, layers.image.height), (37, 50));
    assert_eq!(layers.image, engine.render(&camera, &four).unwrap());
    let expected = fine.image.block_means(2);
    let near = |a: f32, b: f32| (a - b).abs() <= 1e-6 * (1.0 + b.abs());
    assert!(layers.image.pixels.as_flattened().iter().zip(expected.pixels.as_flattened()).all(|(a, b)| near(*a, *b)));
    for i in 0..37 * 50 {
        let at = (0..4).map(|n| (i / 37 * 2 + n / 2) * 74 + i % 37 * 2 + n % 2);
        let (alpha, depth) = at.fold((0.0f32, 0.0f32), |(alpha, depth), at| {
            let share = 0.25 * fine.alpha[at];
            (alpha + share, depth + if share > 0.0 { share * fine.depth[at] } else { 0.0 })
        });
        assert!(near(layers.alpha[i], alpha), "{i}");
        assert!(alpha == 0.0 || (layers.depth[i] - depth / alpha).abs() < 1e-4 * layers.depth[i], "{i}");
    }
    // A mask of the image's pixels; a sample counts as its share of a pixel.
    let mask: Vec<f32> = (0..37 * 50).map(|i| (i % 3) as f32).collect();
    let fine_mask: Vec<f32> = (0..74 * 100).map(|i| mask[i / 74 / 2 * 37 + i % 74 / 2]).collect();
    let (shares, fine) =
        (engine.contributions(&camera, &four, &mask).unwrap(), engine.contributions(&fine_camera, &one, &fine_mask).unwrap());
    let pairs =
        [(shares.masked, fine.masked), (shares.blended, fine.blended), (shares.unoccluded, fine.unoccluded), (shares.light, fine.light)];
    assert!(pairs.iter().all(|(shares, fine)| shares.iter().zip(fine).all(|(a, b)| near(*a, b / 4.0))));
}

#[test]
fn depth_is_the_blended_mean_of_distances() {
    let camera = fixture::camera(33, 33);
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    // Two half-opaque splats on the axis, one in front of the other.
    let world_from_camera = camera.camera_from_world.inverse();
    for depth in [2.0, 3.0] {
        splats.push(&Splat {
            position: world_from_camera.transform_point3(glam::DVec3::new(0.0, 0.0, depth)).to_array().map(|v| v as f32),
            rotation: [1.0, 0.0, 0.0, 0.0],
            log_scale: [-1.0; 3],
            opacity_logit: 0.0,
            sh: &[1.0, 1.0, 1.0],
            raw_luminance: &[],
        });
    }
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&splats, None).unwrap();
    let layers = engine.render_layers(&camera, &options([7.0; 3])).unwrap();
    let [x, y] = camera.center_px.to_array().map(|c| c as usize);
    let at = y * 33 + x;
    assert!((layers.alpha[at] - 0.75).abs() < 0.02, "{}", layers.alpha[at]);
    let expected = (0.5 * 2.0 + 0.25 * 3.0) / 0.75;
    assert!((layers.depth[at] - expected).abs() < 0.02, "{}", layers.depth[at]);
    engine.load(&Splats::empty(ColorModel::Sh { degree: 0 }), None).unwrap();
    let nothing = engine.render_layers(&camera, &options([7.0; 3])).unwrap();
    assert!(nothing.alpha.iter().all(|a| *a == 0.0) && nothing.depth.iter().all(|d| d.is_infinite()));
}

/// Returns a half-opaque splat on the camera's axis, short along the axis `turn` makes of x.
fn flat(splats: &mut Splats, camera: &Camera, depth: f64, turn: glam::DQuat) {
    splats.push(&Splat {
        position: camera.camera_from_world.inverse().transform_point3(glam::DVec3::new(0.0, 0.0, depth)).to_array().map(|v| v as f32),
        rotation: [turn.w, turn.x, turn.y, turn.z].map(|v| 2.0 * v as f32),
        log_scale: [-5.0, -1.0, -1.5],
        opacity_logit: 0.0,
        sh: &[1.0, 1.0, 1.0],
        raw_luminance: &[],
    });
}

#[test]
fn normals_are_blended_means_of_shortest_axes_towards_the_camera() {
    let camera = fixture::camera(33, 33);
    let world_from_camera = camera.camera_from_world.matrix3.transpose();
    let forward = world_from_camera * glam::DVec3::Z;
    let mut splats = Splats::empty(ColorModel::Sh { degree: 0 });
    // The first looks away from the camera, by 0.3 to the side; the second looks back at it.
    let aside = [forward + 0.3 * (world_from_camera * glam::DVec3::X), -forward + 0.5 * (world_from_camera * glam::DVec3::Y)];
    let axes = aside.map(glam::DVec3::normalize);
    for (depth, axis) in [2.0, 3.0].into_iter().zip(axes) {
        flat(&mut splats, &camera, depth, glam::DQuat::from_rotation_arc(glam::DVec3::X, axis));
    }
    let mut engine = CpuEngine::new(1).unwrap();
    engine.load(&splats, None).unwrap();
    let normals = engine.render_normals(&camera, &options([7.0; 3])).unwrap();
    let [x, y] = camera.center_px.to_array().map(|c| c as usize);
    let expected = (0.5 * -axes[0] + 0.25 * axes[1]).normalize();
    let found = glam::Vec3::from(normals[y * 33 + x]).as_dvec3();
    assert!(found.distance(expected) < 0.01, "{found} {expected}");
    let far_away = normals[0];
    assert_eq!(far_away, [0.0; 3]);
    assert!(normals.iter().all(|n| *n == [0.0; 3] || (glam::Vec3::from(*n).length() - 1.0).abs() < 1e-6));
    engine.load(&Splats::empty(ColorModel::Sh { degree: 0 }), None).unwrap();
    assert!(engine.render_normals(&camera, &options([7.0; 3])).unwrap().iter().all(|n| *n == [0.0; 3]));
}

#[test]
fn normals_turn_with_the_scene_and_leave_the_image_as_it_is() {
    let turn = glam::DMat3::from_quat(glam::DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize());
    let similarity = Similarity::new(turn, 1.0, glam::DVec3::new(0.3, -0.2, 0.1)).unwrap();
    for projection in [CameraProjection::Pinhole, CameraProjection::Equirectangular] {
        let mut camera = match projection {
            CameraProjection::Pinhole => fixture::camera(48, 40),
            other => fixture::wide_camera(other, 48, 24),
        };
        let supersampled = RenderOptions { raster: RasterConfig { samples: 2, ..options([0.1; 3]).raster }, ..options([0.1; 3]) };
        let mut splats = fixture::splats(ColorModel::Sh { degree: 1 }, 150, &camera, 11);
        let mut engine = CpuEngine::new(2).unwrap();
        engine.load(&splats, None).unwrap();
        let image = engine.render(&camera, &supersampled).unwrap();
        let before = engine.render_normals(&camera, &supersampled).unwrap();
        assert_eq!(engine.render(&camera, &supersampled).unwrap(), image);
        similarity.apply(&mut splats);
        similarity.apply_to_camera(&mut camera);
        engine.load(&splats, None).unwrap();
        let after = engine.render_normals(&camera, &supersampled).unwrap();
        let moved = |(a, b): (&[f32; 3], &[f32; 3])| (turn * glam::Vec3::from(*b).as_dvec3()).distance(glam::Vec3::from(*a).as_dvec3());
        // A sum of few splats at the edge of a threshold may differ.
        let mut distances: Vec<f64> = after.iter().zip(&before).map(moved).collect();
        distances.sort_by(f64::total_cmp);
        assert!(before.iter().filter(|n| **n != [0.0; 3]).count() > 500);
        assert!(distances[distances.len() * 99 / 100] < 1e-2, "{}", distances[distances.len() * 99 / 100]);
    }
}

#[test]
fn a_turned_scene_looks_the_same_to_a_turned_camera() {
    let turn = glam::DMat3::from_quat(glam::DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize());
    let similarity = Similarity::new(turn, 1.0, glam::DVec3::new(0.3, -0.2, 0.1)).unwrap();
    let lcd = ColorModel::Lcd { chroma_degree: 3, luminance_degree: 1, activation: luxel_core::Activation::Softplus };
    for model in [ColorModel::Sh { degree: 3 }, lcd] {
        let mut camera = fixture::camera(48, 40);
        let mut splats = fixture::splats(model, 150, &camera, 11);
        let mut engine = CpuEngine::new(2).unwrap();
        engine.load(&splats, None).unwrap();
        let before = engine.render(&camera, &options([0.0; 3])).unwrap();
        similarity.apply(&mut splats);
        similarity.apply_to_camera(&mut camera);
        engine.load(&splats, None).unwrap();
        let after = engine.render(&camera, &options([0.0; 3])).unwrap();
        for (a, b) in after.pixels.as_flattened().iter().zip(before.pixels.as_flattened()) {
            assert!((a - b).abs() < 2e-3 * (1.0 + b), "{}: {a} {b}", model.name());
        }
    }
}

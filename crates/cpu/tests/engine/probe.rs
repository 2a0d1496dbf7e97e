//! Environment maps, compared with single rays.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::environment::{MapSize, Projection, Rig, Summary};
use luxel_core::{Camera, CameraProjection, Distortion, Engine, Image, RenderOptions, sh, synthetic};
use luxel_cpu::CpuEngine;

/// Width of the map.
const WIDTH: usize = 192;
/// The size of all renders: a splat smaller than a pixel covers a pixel's area.
const FOCAL_PX: f64 = 60.0;

/// The odd width of the image whose middle pixel is a ray.
const RAY_IMAGE_PX: u32 = 21;

/// Returns the radiance along one direction: the middle pixel of an image that looks along it, so
/// no splat is off the axis.
fn along(engine: &mut CpuEngine, at: DVec3, direction: DVec3) -> [f32; 3] {
    let side = direction.any_orthonormal_vector();
    let matrix3 = DMat3::from_cols(side, direction.cross(side), direction).transpose();
    let camera = Camera {
        camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * at) },
        focal_px: DVec2::splat(FOCAL_PX),
        center_px: DVec2::splat(0.5 * f64::from(RAY_IMAGE_PX)),
        size_px: [RAY_IMAGE_PX; 2],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    };
    engine.render(&camera, &RenderOptions::default()).unwrap().at(RAY_IMAGE_PX as usize / 2, RAY_IMAGE_PX as usize / 2)
}

#[test]
fn irradiance_of_a_probe_is_that_of_rays_one_by_one() {
    let at = DVec3::new(0.3, -0.2, 2.6);
    let mut engine = CpuEngine::new(2).unwrap();
    // Large splats look different off the axis, which is not tested here.
    let mut room = synthetic::room(3000, 5);
    room.log_scale.as_flattened_mut().iter_mut().for_each(|s| *s -= 1.2);
    engine.load(&room, None).unwrap();
    let mut maps = Vec::new();
    for projection in [Projection::LatitudeLongitude, Projection::Cube] {
        let width = if projection == Projection::Cube { WIDTH / 3 } else { WIDTH };
        let rig = Rig::new(at, DMat3::IDENTITY, MapSize { projection, width }, Some(FOCAL_PX));
        let renders: Vec<Image> = rig.cameras.iter().map(|c| engine.render(c, &RenderOptions::default()).unwrap()).collect();
        maps.push(Summary::new(&rig.assemble(&renders), projection));
    }
    // Directions spread evenly: each stands for an equal part of the sphere.
    const RAYS: usize = 12_000;
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let part = 4.0 * std::f64::consts::PI / RAYS as f64;
    let (mut irradiance, mut mean) = ([[0f64; 3]; 6], [0f64; 3]);
    for direction in sh::lattice(RAYS) {
        let direction = DVec3::from_array(direction.map(f64::from)).normalize();
        let radiance = along(&mut engine, at, direction).map(f64::from);
        for c in 0..3 {
            mean[c] += radiance[c] / RAYS as f64;
            for (sum, axis) in irradiance.iter_mut().zip(axes) {
                sum[c] += part * radiance[c] * direction.dot(axis).max(0.0);
            }
        }
    }
    // Splats are blown up by a part of a pixel, and off the axis a pixel is less of the sphere:
    // maps are a little darker than rays.
    for map in &maps {
        for c in 0..3 {
            assert!((map.mean_radiance[c] / mean[c] - 1.0).abs() < 0.04, "mean {:?} {mean:?}", map.mean_radiance);
            for (face, (found, expected)) in map.irradiance.iter().zip(&irradiance).enumerate() {
                assert!((found[c] / expected[c] - 1.0).abs() < 0.05, "face {face}: {found:?} {expected:?}");
            }
        }
    }
}

/// Returns the largest step between neighbouring columns, or rows, of a map, relative to the
/// median step around it: about 1 without seams. A step is the mean difference of the logarithm.
fn largest_seam(map: &Image) -> f64 {
    const AROUND: usize = 16;
    let luminance = |pixel: &[f32; 3]| pixel.iter().map(|c| f64::from(*c)).sum::<f64>();
    let floor = 1e-3 * map.pixels.iter().map(luminance).sum::<f64>() / map.pixels.len() as f64;
    let log = |x: usize, y: usize| (luminance(&map.at(x, y)).max(0.0) + floor).log2();
    let (width, height) = (map.width, map.height);
    let step_of_column = |x: usize| (0..height).map(|y| (log(x, y) - log((x + 1) % width, y)).abs()).sum::<f64>() / height as f64;
    let step_of_row = |y: usize| (0..width).map(|x| (log(x, y) - log(x, y + 1)).abs()).sum::<f64>() / width as f64;
    let columns: Vec<f64> = (0..width).map(step_of_column).collect();
    // Rows near the poles are points.
    let rows: Vec<f64> = (height / 8..height * 7 / 8).map(step_of_row).collect();
    let ratio = |around: &[f64]| {
        let mut sorted = around.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        around[AROUND] / sorted[AROUND]
    };
    [columns, rows].iter().flat_map(|steps| steps.windows(2 * AROUND + 1)).map(ratio).fold(0.0, f64::max)
}

#[test]
fn a_map_has_no_seams_where_its_cameras_meet() {
    let mut engine = CpuEngine::new(2).unwrap();
    // Splats so near and large that they look different from camera to camera.
    engine.load(&synthetic::room(300, 5), None).unwrap();
    for at in [DVec3::new(0.3, -0.2, 2.6), DVec3::new(-0.9, 0.4, 1.5)] {
        let size = MapSize { projection: Projection::LatitudeLongitude, width: 512 };
        let rig = Rig::new(at, DMat3::IDENTITY, size, None);
        let renders: Vec<Image> = rig.cameras.iter().map(|c| engine.render(c, &RenderOptions::default()).unwrap()).collect();
        let map = rig.assemble(&renders);
        assert!(map == rig.assemble(&renders));
        // The same cameras without a fade: each direction from the camera that looks there.
        let mut hard = map.clone();
        for (i, pixel) in hard.pixels.iter_mut().enumerate() {
            let direction = size.projection.direction([(i % 512) as f64 + 0.5, (i / 512) as f64 + 0.5], 512);
            let cosine = |camera: &Camera| camera.forward().dot(direction);
            let nearest = (0..rig.cameras.len()).max_by(|a, b| cosine(&rig.cameras[*a]).total_cmp(&cosine(&rig.cameras[*b]))).unwrap();
            let (px, _) = rig.cameras[nearest].project(at + direction).unwrap();
            let render = &renders[nearest];
            *pixel = render.at((px.x as usize).min(render.width - 1), (px.y as usize).min(render.height - 1));
        }
        let [soft, hard] = [&map, &hard].map(largest_seam);
        assert!(soft < 3.0 && hard > 2.0 * soft, "{at}: {soft} {hard}");
    }
}

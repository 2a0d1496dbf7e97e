//! Environment maps, compared with single rays.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::environment::{MapSize, PanoramaRig, Projection, Summary};
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

/// Returns the map of what the engine's scene sends to the point of a rig.
fn map(engine: &mut CpuEngine, rig: &PanoramaRig) -> Image {
    let mut map = rig.empty_map();
    for (band, camera) in rig.cameras.iter().enumerate() {
        map.add_band(rig, band, &engine.render(camera, &RenderOptions::default()).unwrap(), None);
    }
    map.into_map(rig).0
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
        let rig = PanoramaRig::new(at, DMat3::IDENTITY, MapSize { projection, width }, Some(FOCAL_PX));
        maps.push(Summary::new(&map(&mut engine, &rig), projection));
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

/// A step between a column, or a row, of a map and the next one, relative to the median step around
/// it: about 1 without seams. A step is the mean difference of the logarithm.
struct Step {
    at: usize,
    ratio: f64,
}

/// Returns the steps between columns, with that from the last one to the first, and between rows.
fn steps(map: &Image) -> [Vec<Step>; 2] {
    const AROUND: usize = 16;
    let luminance = |pixel: &[f32; 3]| pixel.iter().map(|c| f64::from(*c)).sum::<f64>();
    let floor = 1e-3 * map.pixels.iter().map(luminance).sum::<f64>() / map.pixels.len() as f64;
    let log = |x: usize, y: usize| (luminance(&map.at(x, y)).max(0.0) + floor).log2();
    let (width, height) = (map.width, map.height);
    let step_of_column = |x: usize| (0..height).map(|y| (log(x, y) - log((x + 1) % width, y)).abs()).sum::<f64>() / height as f64;
    let step_of_row = |y: usize| (0..width).map(|x| (log(x, y) - log(x, y + 1)).abs()).sum::<f64>() / width as f64;
    let columns: Vec<f64> = (0..width + 2 * AROUND).map(|x| step_of_column(x % width)).collect();
    // Rows near the poles are points.
    let first_row = height / 8;
    let rows: Vec<f64> = (first_row..height - first_row).map(step_of_row).collect();
    let ratio = |around: &[f64]| {
        let mut sorted = around.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        around[AROUND] / sorted[AROUND]
    };
    let relative = |steps: &[f64], first: usize, count: usize| {
        let step = |(i, around)| Step { at: (first + AROUND + i) % count, ratio: ratio(around) };
        steps.windows(2 * AROUND + 1).enumerate().map(step).collect()
    };
    [relative(&columns, 0, width), relative(&rows, first_row, height)]
}

fn largest<'a>(steps: impl Iterator<Item = &'a Step>) -> f64 {
    steps.map(|step| step.ratio).fold(0.0, f64::max)
}

/// Returns whether a row of a map, with the next one, is where bands of a rig meet.
fn is_where_bands_meet(row: usize, rig: &PanoramaRig, map: &Image) -> bool {
    let middle = rig.cameras[0].center_px.y;
    let scale = map.height as f64 / (2.0 * middle);
    // Each band begins with a row of the one before.
    rig.cameras[1..].iter().any(|camera| (row as f64 + 1.0 - (middle - camera.center_px.y + 1.0) * scale).abs() < 1.5)
}

/// Returns the cameras of a cube around a point, which each see a quarter of the horizon.
fn cube(at: DVec3, side_px: u32) -> [Camera; 6] {
    [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z].map(|forward| {
        let right = forward.any_orthonormal_vector();
        let matrix3 = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        Camera {
            camera_from_world: DAffine3 { matrix3, translation: -(matrix3 * at) },
            focal_px: DVec2::splat(0.5 * f64::from(side_px)),
            center_px: DVec2::splat(0.5 * f64::from(side_px)),
            size_px: [side_px; 2],
            distortion: Distortion::default(),
            projection: CameraProjection::Pinhole,
        }
    })
}

#[test]
fn a_map_has_no_seams_and_one_from_a_cube_of_pinholes_has() {
    let mut engine = CpuEngine::new(2).unwrap();
    // Splats so near and large that they look different from pinhole to pinhole.
    engine.load(&synthetic::room(300, 5), None).unwrap();
    for at in [DVec3::new(0.3, -0.2, 2.6), DVec3::new(-0.9, 0.4, 1.5)] {
        let size = MapSize { projection: Projection::LatitudeLongitude, width: 512 };
        let rig = PanoramaRig::new(at, DMat3::IDENTITY, size, None);
        let whole = map(&mut engine, &rig);
        let cameras = cube(at, 256);
        let renders = cameras.each_ref().map(|camera| engine.render(camera, &RenderOptions::default()).unwrap());
        let mut pieces = whole.clone();
        for (i, pixel) in pieces.pixels.iter_mut().enumerate() {
            let direction = size.projection.direction([(i % 512) as f64 + 0.5, (i / 512) as f64 + 0.5], 512);
            let cosine = |n: &usize| cameras[*n].forward().dot(direction);
            let nearest = (0..cameras.len()).max_by(|a, b| cosine(a).total_cmp(&cosine(b))).unwrap();
            let (px, _) = cameras[nearest].project(at + direction).unwrap();
            *pixel = renders[nearest].at((px.x as usize).min(255), (px.y as usize).min(255));
        }
        // A splat that ends at a right angle to its direction has an edge anywhere.
        let [columns, rows] = steps(&whole);
        let meeting = rows.iter().filter(|step| is_where_bands_meet(step.at, &rig, &whole));
        assert!(meeting.clone().count() > 12);
        let seam = largest(columns.iter().filter(|step| step.at == size.width - 1).chain(meeting));
        let expected_seam = largest(steps(&pieces).iter().flatten());
        assert!(seam < 3.0 && expected_seam > 2.0 * seam, "{at}: {seam} {expected_seam}");
    }
}

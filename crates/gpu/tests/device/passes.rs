//! The passes up to the image, each compared with its formulas.

use std::sync::Arc;

use glam::{DMat3, DVec2, DVec3};
use luxel_core::{Antialias, Camera, Cutoffs, Engine, Splats};
use luxel_gpu::{Footprint, ForwardPasses, Gpu, GpuEngine};

use crate::Body;
use crate::compare::assert_close;
use crate::fixture::{camera, options, splats};
use crate::parity::models;

pub const ALL: &[(&str, Body)] = &[
    ("projected_splats_are_where_the_formula_says", projected_splats_are_where_the_formula_says),
    ("colors_are_those_of_the_color_model", colors_are_those_of_the_color_model),
    ("tiles_hold_every_splat_that_can_be_seen_in_them", tiles_hold_every_splat_that_can_be_seen_in_them),
    ("blocks_have_the_bits_of_every_splat_that_can_be_seen_in_them", blocks_have_the_bits_of_every_splat_that_can_be_seen_in_them),
    ("tiles_are_sorted_by_depth_then_index", tiles_are_sorted_by_depth_then_index),
    ("a_near_plane_at_the_camera_leaves_the_order", a_near_plane_at_the_camera_leaves_the_order),
    ("many_splats_are_sorted_over_several_blocks", many_splats_are_sorted_over_several_blocks),
];

/// Runs the passes on a scene of many splats.
fn forward(gpu: &Arc<Gpu>, scene: &Splats, camera: &Camera) -> ForwardPasses {
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(scene, None).unwrap();
    engine.forward_passes(camera, &options(Cutoffs::HDR, Antialias::Off)).unwrap()
}

/// Computes the covariance on the screen by its definition: J R S S^T R^T J^T, dilated.
fn covariance(scene: &Splats, i: usize, camera: &Camera) -> (DVec2, [f64; 3]) {
    let position = DVec3::from_array(scene.position[i].map(f64::from));
    let p = camera.camera_from_world.transform_point3(position);
    let [w, x, y, z] = scene.rotation[i].map(f64::from);
    let rotation = DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w).normalize());
    let sigma = scene.log_scale[i].map(|s| f64::from(s).exp());
    let root = camera.camera_from_world.matrix3 * rotation * DMat3::from_diagonal(DVec3::from_array(sigma));
    let (focal, inverse_z) = (camera.focal_px, 1.0 / p.z);
    let row = |axis: usize| {
        let scale = focal[axis] * inverse_z;
        scale * (root.row(axis) - p[axis] * inverse_z * root.row(2))
    };
    let dilation = f64::from(Antialias::Off.dilation_px2());
    let (a, b) = (row(0), row(1));
    let mean = DVec2::new(p.x * inverse_z, p.y * inverse_z) * focal + camera.center_px;
    (mean, [a.dot(a) + dilation, a.dot(b), b.dot(b) + dilation])
}

fn projected_splats_are_where_the_formula_says(gpu: &Arc<Gpu>) {
    let camera = camera(90, 70);
    let scene = splats(models()[0], 200, &camera, 21);
    let passes = forward(gpu, &scene, &camera);
    let (mut found, mut expected) = (Vec::new(), Vec::new());
    for (i, footprint) in passes.footprints.iter().enumerate() {
        let Some(f) = footprint else { continue };
        // Beyond the margin of the field of view the Jacobian is clamped.
        let (mean, [xx, xy, yy]) = covariance(&scene, i, &camera);
        if mean.x < -10.0 || mean.y < -8.0 || mean.x > 100.0 || mean.y > 78.0 {
            continue;
        }
        let determinant = xx * yy - xy * xy;
        let scale = (std::f64::consts::LOG2_E / 2.0).sqrt();
        let m = (yy / determinant).sqrt();
        found.extend([f.mean_px[0] / 90.0, f.mean_px[1] / 90.0, f.root[0], f.root[1], f.root[2]]);
        expected.extend([mean.x / 90.0, mean.y / 90.0, scale * m, -scale * m * xy / yy, scale / yy.sqrt()].map(|v| v as f32));
    }
    assert!(found.len() > 5 * 100, "{} splats are seen", found.len() / 5);
    assert_close("project, centre and root of the covariance", &found, &expected, 1e-5);
}

fn colors_are_those_of_the_color_model(gpu: &Arc<Gpu>) {
    let camera = camera(90, 70);
    for model in models() {
        let scene = splats(model, 100, &camera, 22);
        let passes = forward(gpu, &scene, &camera);
        let eye = camera.eye();
        let (mut found, mut expected) = (Vec::new(), Vec::new());
        for (i, footprint) in passes.footprints.iter().enumerate() {
            let Some(f) = footprint else { continue };
            let direction = (DVec3::from_array(scene.position[i].map(f64::from)) - eye).normalize().as_vec3().to_array();
            let radiance = scene.radiance(i, direction);
            let largest = radiance.iter().fold(1e-6f32, |m, v| m.max(*v));
            // In units of the splat's own brightness: they span four decades.
            found.extend(f.radiance.map(|v| v / largest));
            expected.extend(radiance.map(|v| v / largest));
        }
        assert!(found.len() > 100);
        assert_close(&format!("color, radiance: {}", model.name()), &found, &expected, 2e-5);
    }
}

/// Reports whether a splat reaches its threshold at a pixel's centre, by more (or by less) than
/// rounding.
fn reaches(f: &Footprint, pixel: [u32; 2], by: f32) -> bool {
    let (dx, dy) = (pixel[0] as f32 + 0.5 - f.mean_px[0], pixel[1] as f32 + 0.5 - f.mean_px[1]);
    let (u, v) = (f.root[0] * dx + f.root[1] * dy, f.root[2] * dy);
    f.log2_opacity - u * u - v * v >= f.log2_threshold + by
}

fn tiles_hold_every_splat_that_can_be_seen_in_them(gpu: &Arc<Gpu>) {
    let camera = camera(83, 59);
    let scene = splats(models()[0], 300, &camera, 23);
    let passes = forward(gpu, &scene, &camera);
    let side = ForwardPasses::TILE_PX;
    let (mut needed, mut listed) = (0usize, 0usize);
    for (tile, list) in passes.tile_splats.iter().enumerate() {
        let origin = [tile as u32 % passes.tiles[0] * side, tile as u32 / passes.tiles[0] * side];
        listed += list.len();
        for (splat, f) in passes.footprints.iter().enumerate().filter_map(|(i, f)| Some((i as u32, f.as_ref()?))) {
            let mut pixels = (0..side * side).map(|n| [origin[0] + n % side, origin[1] + n / side]);
            let is_seen = pixels.any(|pixel| pixel[0] < camera.size_px[0] && pixel[1] < camera.size_px[1] && reaches(f, pixel, 1e-4));
            needed += usize::from(is_seen);
            assert!(!is_seen || list.contains(&splat), "splat {splat} is missing in tile {tile}");
        }
        let mut once = list.clone();
        once.sort_unstable();
        once.dedup();
        assert_eq!(once.len(), list.len(), "tile {tile} lists a splat twice");
    }
    // Bounding boxes alone would list half as many again.
    assert!(listed * 10 <= needed * 12, "{listed} are listed, {needed} needed");
}

/// Tests that no pixel misses a splat because its block's bit is missing, and that bits are few.
fn blocks_have_the_bits_of_every_splat_that_can_be_seen_in_them(gpu: &Arc<Gpu>) {
    let camera = camera(83, 59);
    // Round and large ones, and needles: long edges in all directions.
    let mut scene = splats(models()[0], 300, &camera, 29);
    for (i, scale) in scene.log_scale.iter_mut().enumerate() {
        *scale = [[-1.5; 3], [0.5, -6.0, -6.0], [-4.0, -1.0, -4.0]][i % 3];
    }
    let passes = forward(gpu, &scene, &camera);
    let [side, [width, height]] = [[ForwardPasses::TILE_PX; 2], ForwardPasses::BLOCK_PX];
    let columns = side[0] / width;
    let (mut needed, mut set, mut all) = (0usize, 0usize, 0usize);
    for (tile, (list, blocks)) in passes.tile_splats.iter().zip(&passes.tile_blocks).enumerate() {
        let tile = [tile as u32 % passes.tiles[0], tile as u32 / passes.tiles[0]];
        for (splat, blocks) in list.iter().zip(blocks) {
            let f = passes.footprints[*splat as usize].as_ref().unwrap();
            for block in 0..columns * side[1] / height {
                let corner = [tile[0] * side[0] + block % columns * width, tile[1] * side[1] + block / columns * height];
                let mut pixels = (0..width * height).map(|n| [corner[0] + n % width, corner[1] + n / width]);
                let is_seen = pixels.any(|pixel| reaches(f, pixel, 0.0));
                let is_set = blocks >> block & 1 == 1;
                assert!(!is_seen || is_set, "splat {splat} lacks the bit of block {block} of tile {tile:?}");
                needed += usize::from(is_seen);
                set += usize::from(is_set);
                all += 1;
            }
        }
    }
    // An ellipse may lie between the centres of pixels.
    assert!(needed > 1000 && set * 10 <= needed * 11 && set * 10 < all * 6, "{needed} bits are needed, {set} of {all} are set");
}

fn depths(scene: &Splats, camera: &Camera) -> Vec<f32> {
    let depth = |p: &[f32; 3]| camera.camera_from_world.transform_point3(DVec3::from_array(p.map(f64::from))).z as f32;
    scene.position.iter().map(depth).collect()
}

fn assert_sorted(list: &[u32], depths: &[f32]) {
    for pair in list.windows(2) {
        let [a, b] = [depths[pair[0] as usize], depths[pair[1] as usize]];
        // Depths that differ only by rounding may have either order.
        assert!(a <= b * (1.0 + 1e-6), "splat {} at {a} stands before {} at {b}", pair[0], pair[1]);
        assert!(a != b || pair[0] < pair[1], "splats {pair:?} of one depth");
    }
}

fn tiles_are_sorted_by_depth_then_index(gpu: &Arc<Gpu>) {
    let camera = camera(83, 59);
    let mut scene = splats(models()[0], 300, &camera, 24);
    // Some splats have the same position.
    for i in 0..20 {
        scene.position[100 + 7 * i] = scene.position[i];
    }
    let passes = forward(gpu, &scene, &camera);
    let depths = depths(&scene, &camera);
    let mut listed = 0;
    for list in &passes.tile_splats {
        assert_sorted(list, &depths);
        listed += list.len();
    }
    assert!(listed > 300);
}

/// Tests a near plane at 0: keys count octaves from the near plane on, and from 0 they would reach
/// no common depth.
fn a_near_plane_at_the_camera_leaves_the_order(gpu: &Arc<Gpu>) {
    let camera = camera(83, 59);
    let scene = splats(models()[0], 300, &camera, 26);
    let depths = depths(&scene, &camera);
    let mut engine = GpuEngine::new(gpu).unwrap();
    engine.load(&scene, None).unwrap();
    for near in [0.0, 1e-30, 1e-6] {
        let passes = engine.forward_passes(&camera, &options(Cutoffs { near, ..Cutoffs::HDR }, Antialias::Off)).unwrap();
        passes.tile_splats.iter().for_each(|list| assert_sorted(list, &depths));
        assert!(passes.tile_splats.iter().map(Vec::len).sum::<usize>() > 300);
    }
}

fn many_splats_are_sorted_over_several_blocks(gpu: &Arc<Gpu>) {
    let camera = camera(40, 30);
    let mut scene = splats(models()[0], 5000, &camera, 25);
    for scale in &mut scene.log_scale {
        *scale = [-4.0; 3];
    }
    let passes = forward(gpu, &scene, &camera);
    let visible = passes.footprints.iter().flatten().count();
    assert!(visible > 2000, "{visible}");
    assert_sorted(&passes.depth_order, &depths(&scene, &camera));
    let mut all = passes.depth_order.clone();
    all.sort_unstable();
    let seen = (0..).zip(&passes.footprints).filter_map(|(splat, footprint)| footprint.map(|_| splat));
    assert!(all.into_iter().eq(seen), "the order is not of the splats that are seen");
}

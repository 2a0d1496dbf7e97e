//! Fusion of depth images of surfaces that are known.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{Camera, CameraProjection, Distortion};
use luxel_mesh::{DepthFrame, FusionOptions, MeshError, TriangleMesh, fuse};

const SIDE_PX: u32 = 64;
const RADIUS: f64 = 0.5;

/// Returns a camera at `eye` that looks at the origin.
fn camera(eye: DVec3) -> Camera {
    let forward = -eye.normalize();
    let right = forward.cross(if forward.z.abs() < 0.9 { DVec3::NEG_Z } else { DVec3::X }).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Camera {
        camera_from_world: DAffine3 { matrix3: rotation, translation: -(rotation * eye) },
        focal_px: DVec2::splat(f64::from(SIDE_PX)),
        center_px: DVec2::splat(0.5 * f64::from(SIDE_PX)),
        size_px: [SIDE_PX; 2],
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

/// Returns the image of a surface; `hit` returns the distance along a ray, in rays.
fn image(eye: DVec3, hit: impl Fn(DVec3, DVec3) -> Option<f64>) -> DepthFrame {
    let camera = camera(eye);
    let pixels = (SIDE_PX * SIDE_PX) as usize;
    let mut frame = DepthFrame { camera, depth: vec![], spread: vec![0.0; pixels], alpha: vec![], radiance: vec![] };
    for pixel in 0..pixels as u32 {
        let at = DVec2::new(f64::from(pixel % SIDE_PX) + 0.5, f64::from(pixel / SIDE_PX) + 0.5);
        let ray = ((at - frame.camera.center_px) / frame.camera.focal_px).extend(1.0);
        let direction = frame.camera.camera_from_world.matrix3.transpose() * ray;
        let depth = hit(eye, direction);
        frame.depth.push(depth.map_or(f32::INFINITY, |depth| depth as f32));
        frame.alpha.push(if depth.is_some() { 1.0 } else { 0.0 });
        // Light that depends on the place: brighter than any display, and never the same twice.
        let point = eye + depth.unwrap_or(0.0) * direction;
        frame.radiance.push([1000.0, (2.0 + point.x) as f32, 0.25]);
    }
    frame
}

fn sphere(center: DVec3, radius: f64) -> impl Fn(DVec3, DVec3) -> Option<f64> {
    move |eye, ray| {
        let (from, a) = (eye - center, ray.length_squared());
        let b = from.dot(ray);
        let root = b * b - a * (from.length_squared() - radius * radius);
        (root >= 0.0).then(|| (-b - root.sqrt()) / a).filter(|t| *t > 0.0)
    }
}

fn cube(half: f64) -> impl Fn(DVec3, DVec3) -> Option<f64> {
    move |eye, ray| {
        let [a, b] = [(-half - eye) / ray, (half - eye) / ray];
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        (near <= far && near > 0.0).then_some(near)
    }
}

/// Returns eyes all around, spread evenly (Fibonacci's lattice).
fn around(count: usize, distance: f64) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let eye = |n: usize| {
        let z = 1.0 - (2.0 * n as f64 + 1.0) / count as f64;
        let (across, turn) = ((1.0 - z * z).sqrt(), golden * n as f64);
        distance * DVec3::new(across * turn.cos(), across * turn.sin(), z)
    };
    (0..count).map(eye).collect()
}

fn sphere_seen_from_all_around() -> Vec<DepthFrame> {
    around(60, 1.8).into_iter().map(|eye| image(eye, sphere(DVec3::ZERO, RADIUS))).collect()
}

fn point(mesh: &TriangleMesh, vertex: u32) -> DVec3 {
    DVec3::from_array(mesh.positions[vertex as usize].map(f64::from))
}

/// Returns the number of edges that are not shared by two triangles in opposite directions.
fn open_edges(mesh: &TriangleMesh) -> usize {
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    for [a, b, c] in mesh.triangles.iter().copied() {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
    }
    edges.values().filter(|balance| **balance != 0).count()
}

#[test]
fn a_sphere_is_closed_smooth_and_where_it_is() {
    let voxel = 0.04;
    let (mesh, report) = fuse(sphere_seen_from_all_around(), &FusionOptions { voxel: Some(voxel), ..FusionOptions::default() }).unwrap();
    assert_eq!((report.lengths.voxel, report.islands_removed, open_edges(&mesh)), (voxel, 0, 0));
    // Euler's formula: no handles, and a vertex where two sheets of the surface cross one cell.
    assert!((1..=2).contains(&(mesh.positions.len() as i64 - mesh.triangles.len() as i64 / 2)));
    for (vertex, normal) in mesh.normals.iter().enumerate() {
        let place = point(&mesh, vertex as u32);
        // Distances are along the axes of the cameras, and a pixel is as wide as a voxel here.
        assert!((place.length() - RADIUS).abs() < 0.5 * voxel, "{place}");
        assert!(place.normalize().dot(DVec3::from_array(normal.map(f64::from))) > 0.8, "{place} {normal:?}");
    }
    // Twice the area that faces outwards and inwards: pixels as wide as voxels may fold a sliver.
    let (mut outwards, mut inwards) = (0.0, 0.0);
    for [a, b, c] in mesh.triangles.iter().map(|corners| corners.map(|corner| point(&mesh, corner))) {
        let cross = (b - a).cross(c - a);
        *(if cross.dot(a + b + c) >= 0.0 { &mut outwards } else { &mut inwards }) += cross.length();
    }
    assert!(inwards < 0.01 * outwards, "{inwards} of {outwards}");
    let mean = mesh.positions.iter().map(|p| f64::from(p.map(f32::abs)[0])).sum::<f64>() / mesh.positions.len() as f64;
    assert!((mean - 0.5 * RADIUS).abs() < 0.1 * RADIUS, "{mean}");
}

#[test]
fn radiance_is_that_of_the_place_and_is_not_clamped() {
    let (mesh, _) = fuse(sphere_seen_from_all_around(), &FusionOptions { voxel: Some(0.04), ..FusionOptions::default() }).unwrap();
    for (place, [r, g, b]) in mesh.positions.iter().zip(&mesh.radiance) {
        assert!((r / 1000.0 - 1.0).abs() < 1e-4 && (b / 0.25 - 1.0).abs() < 1e-4, "{r} {b}");
        // Within the footprint of a pixel and a voxel.
        assert!((g - (2.0 + place[0])).abs() < 0.1, "{place:?} {g}");
    }
}

#[test]
fn a_cube_has_its_faces() {
    let (half, voxel) = (0.4, 0.04);
    let frames = around(60, 1.8).into_iter().map(|eye| image(eye, cube(half))).collect();
    let (mesh, _) = fuse(frames, &FusionOptions { voxel: Some(voxel), ..FusionOptions::default() }).unwrap();
    let error = |vertex: usize| (point(&mesh, vertex as u32).abs().max_element() - half).abs();
    let mut errors: Vec<f64> = (0..mesh.positions.len()).map(error).collect();
    errors.sort_by(f64::total_cmp);
    // Edges and corners are rounded by a voxel; faces are flat.
    assert!(errors[errors.len() * 9 / 10] < 0.5 * voxel && errors[errors.len() - 1] < 2.0 * voxel, "{errors:?}");
}

#[test]
fn unseen_space_is_cut_away() {
    // From one side: half of the sphere, and no back.
    let eyes = around(120, 1.8).into_iter().filter(|eye| eye.z > 1.2);
    let frames = eyes.map(|eye| image(eye, sphere(DVec3::ZERO, RADIUS))).collect();
    let (mesh, _) = fuse(frames, &FusionOptions { voxel: Some(0.04), ..FusionOptions::default() }).unwrap();
    assert!(mesh.positions.iter().all(|[_, _, z]| *z > -0.2), "{:?}", mesh.bounds());
    assert!(open_edges(&mesh) > 0);
}

#[test]
fn islands_are_removed_by_their_size() {
    let near = |eye: DVec3, ray: DVec3| {
        let hits = [sphere(DVec3::ZERO, RADIUS)(eye, ray), sphere(DVec3::new(0.0, 0.0, 0.85), 0.2)(eye, ray)];
        hits.into_iter().flatten().min_by(f64::total_cmp)
    };
    let frames: Vec<DepthFrame> = around(60, 2.4).into_iter().map(|eye| image(eye, near)).collect();
    let options = FusionOptions { voxel: Some(0.04), ..FusionOptions::default() };
    let (all, report) = fuse(frames.clone(), &FusionOptions { min_island: Some(0.1), ..options }).unwrap();
    assert_eq!(report.islands_removed, 0);
    let (large, report) = fuse(frames.clone(), &FusionOptions { min_island: Some(1.0), ..options }).unwrap();
    assert_eq!(report.islands_removed, 1);
    assert!(all.bounds()[1][2] > 0.95 && large.bounds()[1][2] < 0.6);
    let error = fuse(frames, &FusionOptions { min_island: Some(9.0), ..options }).unwrap_err();
    assert_eq!(error, MeshError::OnlyIslands { islands: 2, min_island: 9.0 });
}

#[test]
fn bits_do_not_depend_on_threads() {
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fuse(sphere_seen_from_all_around(), &FusionOptions { triangles: Some(500), ..FusionOptions::default() }).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn simplified_meshes_keep_the_surface_and_the_vertices_values() {
    let options = FusionOptions { voxel: Some(0.04), ..FusionOptions::default() };
    let (whole, _) = fuse(sphere_seen_from_all_around(), &options).unwrap();
    let (few, report) = fuse(sphere_seen_from_all_around(), &FusionOptions { triangles: Some(400), ..options }).unwrap();
    assert_eq!(report.triangles_before, whole.triangles.len());
    assert!((300..=400).contains(&few.triangles.len()), "{}", few.triangles.len());
    assert_eq!(open_edges(&few), 0);
    for (n, position) in few.positions.iter().enumerate() {
        let of_whole = whole.positions.iter().position(|p| p == position).unwrap();
        assert_eq!((few.normals[n], few.radiance[n]), (whole.normals[of_whole], whole.radiance[of_whole]));
    }
}

#[test]
fn lengths_scale_with_the_scene() {
    let scaled = |scale: f64| {
        let frame = |eye: DVec3| {
            let mut frame = image(scale * eye, sphere(DVec3::ZERO, scale * RADIUS));
            frame.spread.fill((0.01 * scale) as f32);
            frame
        };
        fuse(around(60, 1.8).into_iter().map(frame).collect(), &FusionOptions::default()).unwrap()
    };
    let ((one, small), (thousand, large)) = (scaled(1.0), scaled(1024.0));
    assert!((large.lengths.voxel / small.lengths.voxel / 1024.0 - 1.0).abs() < 1e-5);
    let ratio = thousand.triangles.len() as f64 / one.triangles.len() as f64;
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}

#[test]
fn what_makes_no_mesh_is_an_error() {
    let frames = sphere_seen_from_all_around();
    let error = |frames: &[DepthFrame], options: &FusionOptions| fuse(frames.to_vec(), options).unwrap_err();
    let usual = FusionOptions::default();
    assert_eq!(error(&frames[..2], &usual), MeshError::TooFewFrames { found: 2, expected: 3 });
    let empty: Vec<DepthFrame> = around(3, 1.8).into_iter().map(|eye| image(eye, |_, _| None)).collect();
    assert!(matches!(error(&empty, &usual), MeshError::NoSurface { .. }));
    assert_eq!(error(&frames, &FusionOptions { voxel: Some(-1.0), ..usual }), MeshError::Length { name: "voxel", value: -1.0 });
    assert!(matches!(
        error(&frames, &FusionOptions { voxel: Some(1e-3), max_bytes: 1 << 20, ..usual }),
        MeshError::TooLarge { limit_mebibytes: 1, .. }
    ));
    assert!(matches!(error(&frames, &FusionOptions { voxel: Some(1e-12), ..usual }), MeshError::TooLarge { .. }));
    // Cameras that look at three different things.
    let apart = [0.0, 9.0, 18.0].map(|x| {
        let mut frame = frames[0].clone();
        frame.camera.camera_from_world.translation.x += x;
        frame
    });
    assert_eq!(error(&apart, &usual), MeshError::Empty { frames: 3, least: 3 });
    let mut broken = frames;
    broken[1].alpha.pop();
    assert!(error(&broken, &usual).to_string().starts_with("depth image 1: arrays of"));
}

#[test]
fn a_horizon_does_not_make_voxels_coarse() {
    let near = sphere(DVec3::ZERO, RADIUS);
    // The ball fills most of an image.
    let seen = |depth_behind: Option<f64>| {
        around(60, 1.1).into_iter().map(|eye| image(eye, |eye, ray| near(eye, ray).or(depth_behind))).collect::<Vec<_>>()
    };
    let [alone, before] = [seen(None), seen(Some(1000.0))];
    let [(_, alone), (_, before)] = [alone, before].map(|frames| fuse(frames, &FusionOptions::default()).unwrap());
    assert!(before.lengths.extent <= 1.05 * alone.lengths.extent, "{} {}", before.lengths.extent, alone.lengths.extent);
}

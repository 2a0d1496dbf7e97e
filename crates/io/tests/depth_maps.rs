//! Depth maps beside a data set: found, checked and described.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::fmt::Write as _;

use common::TestScene;
use luxel_io::{DepthKind, DepthReport, IoError, LoadOptions, find_depth};

/// Depth of the wall that the scene's points lie on, left to right.
fn wall(x: f64) -> f64 {
    2.0 + 0.3 * x
}

/// Writes a COLMAP model of three cameras side by side that see 15 points on a wall.
fn scene() -> TestScene {
    let scene = TestScene::new();
    scene.write("sparse/0/cameras.txt", "1 PINHOLE 16 8 20 20 8 4\n");
    let (mut images, mut points) = (String::new(), vec![String::new(); 15]);
    for i in 0..3 {
        scene.exr(&format!("images/{i}.exr"), |_, _| [0.5; 3]);
        writeln!(images, "{} 1 0 0 0 {} 0 0 1 {i}.jpg", i + 1, -0.05 * f64::from(i)).unwrap();
        for (k, point) in points.iter_mut().enumerate() {
            let x = (k as f64 - 7.0) * 0.08;
            let (z, y) = (wall(x), 0.05);
            write!(images, "{} {} {k} ", 8.0 + 20.0 * (x - 0.05 * f64::from(i)) / z, 4.0 + 20.0 * y / z).unwrap();
            if i == 0 {
                *point = format!("{k} {x} {y} {z} 1 2 3 0.1");
            }
            write!(point, " {} {k}", i + 1).unwrap();
        }
        images.push('\n');
    }
    scene.write("sparse/0/images.txt", images);
    scene.write("sparse/0/points3D.txt", points.join("\n"));
    scene.write("split.json", r#"{"train": ["0", "1", "2"], "test": []}"#);
    scene
}

/// Returns a little-endian PFM of 32 x 16 pixels of what the wall's depth becomes in view `i`.
fn pfm(i: u32, of: impl Fn(f64) -> f64) -> Vec<u8> {
    let mut bytes = b"Pf\n32 16\n-1.0\n".to_vec();
    for _ in 0..16 {
        for column in 0..32 {
            // The column's ray meets the wall: x = e + a z, z = 2 + 0.3 x.
            let (a, e) = ((f64::from(column) + 0.5 - 16.0) / 40.0, 0.05 * f64::from(i));
            let x = (e + 2.0 * a) / (1.0 - 0.3 * a);
            bytes.extend((of(wall(x)) as f32).to_le_bytes());
        }
    }
    bytes
}

fn report(scene: &TestScene) -> Result<DepthReport, IoError> {
    let data = scene.read(&LoadOptions::default()).unwrap();
    find_depth(scene.path(), &data)?.unwrap().report(&data)
}

#[test]
fn points_tell_metric_relative_and_inverse_depth() {
    let scene = scene();
    let data = scene.read(&LoadOptions::default()).unwrap();
    assert_eq!(find_depth(scene.path(), &data).unwrap(), None);
    let write = |of: &dyn Fn(u32, f64) -> f64| (0..3).for_each(|i| drop(scene.write(&format!("depth/{i}.pfm"), pfm(i, |z| of(i, z)))));
    write(&|_, z| 1000.0 * z);
    let found = report(&scene).unwrap();
    assert_eq!((found.maps, found.views, found.kind, found.coverage), (3, 3, Some(DepthKind::Metric), 1.0));
    assert!((found.scale.unwrap() - 0.001).abs() < 2e-5, "{:?}", found.scale);
    assert!(found.range[0] > 1700.0 && found.range[1] < 2400.0, "{:?}", found.range);
    assert_eq!((found.kind_from.as_str(), found.sizes_px), ("as the points of 3 views show", vec![[32, 16]]));
    write(&|i, z| z * f64::from(1 + 2 * i));
    assert_eq!(report(&scene).unwrap().kind, Some(DepthKind::Relative));
    write(&|i, z| 1.0 / z + f64::from(i));
    assert_eq!(report(&scene).unwrap().kind, Some(DepthKind::Disparity));
    scene.write("depth/depth.json", r#"{"kind": "metric", "scale": 2}"#);
    let stated = report(&scene).unwrap();
    assert_eq!((stated.kind, stated.scale), (Some(DepthKind::Metric), Some(2.0)));
    assert!(stated.warnings[0].contains("depth.json says metric, but the points of 3 views show disparity"), "{:?}", stated.warnings);
}

#[test]
fn maps_are_checked_against_their_views() {
    let scene = scene();
    scene.write("depth/other.pfm", pfm(0, |z| z));
    let error = || report(&scene).unwrap_err().to_string();
    assert!(error().contains("no depth map is named like an image, expected 0.exr"), "{}", error());
    scene.write("depth/images/0_depth.pfm", pfm(0, |z| z));
    let found = report(&scene).unwrap();
    assert_eq!(found.maps, 1);
    assert!(found.warnings[0].contains("no depth map for 2 of 3 views"), "{:?}", found.warnings);
    scene.png("depth/1.png", |_, _| [9, 9, 9, 255]);
    assert!(error().contains("1.png: an image of 8 bits, expected 16 or floating point"), "{}", error());
    std::fs::remove_file(scene.path().join("depth/1.png")).unwrap();
    scene.write("depth/1.pfm", [&b"Pf\n8 8\n-1.0\n"[..], &[0; 256]].concat());
    assert!(error().contains("a depth map of 8 x 8 pixels, its view \"images/1\" has 16 x 8: expected the same shape"), "{}", error());
    scene.write("depth/1.pfm", &pfm(0, |z| z)[..100]);
    assert!(error().contains("1.pfm") && error().contains("the file is damaged"), "{}", error());
    scene.write("depth/depth.json", "{\"kind\": 3}");
    assert!(error().contains("depth.json"), "{}", error());
}

#[test]
fn maps_of_integers_beside_floating_point_ones_are_warned_of() {
    let scene = scene();
    (0..2).for_each(|i| drop(scene.write(&format!("depth/{i}.pfm"), pfm(i, |z| z))));
    assert!(report(&scene).unwrap().warnings.iter().all(|warning| !warning.contains("integers")));
    let mut png = std::io::Cursor::new(Vec::new());
    image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(32, 16, image::Luma([2000])).write_to(&mut png, image::ImageFormat::Png).unwrap();
    scene.write("depth/2.png", png.into_inner());
    let warnings = report(&scene).unwrap().warnings;
    assert!(warnings.iter().any(|warning| warning.contains("1 of 3 depth maps hold integers, the others floating-point")), "{warnings:?}");
}

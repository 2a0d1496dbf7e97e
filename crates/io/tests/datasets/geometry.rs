//! Points and their observations; cameras of reduced and smaller images.

use super::*;

#[test]
fn observations_follow_undistortion_and_reduction() {
    let lens = Distortion { k1: -0.2, k2: 0.05, p1: 0.002, p2: -0.001 };
    let points = [DVec3::new(0.5, 0.2, 0.0), DVec3::new(-0.3, -0.4, 1.0), DVec3::new(0.0, 0.0, -2.0)];
    let files = ["a.exr", "b.exr", "c.exr"];
    for (camera, distortion) in [(PINHOLE, Distortion::default()), ("1 OPENCV 16 8 20 20 8 4 -0.2 0.05 0.002 -0.001", lens)] {
        let scene = TestScene::new();
        for file in files {
            // Every pixel holds its own coordinates.
            scene.exr(&format!("images/{file}"), |x, y| [x as f32 + 0.5, y as f32 + 0.5, 0.0]);
        }
        colmap(&scene, "sparse/0", camera, distortion, &files, &points);
        for downscale in [1, 2] {
            let data = load_dataset(scene.path(), &LoadOptions { downscale: downscale.into(), ..LoadOptions::default() }).unwrap();
            assert_eq!((names(&data.train), names(&data.test)), (vec!["images/b", "images/c"], vec!["images/a"]));
            assert_eq!(data.points.len(), 3);
            assert_eq!(data.points[0].rgb8, Some([1, 2, 3]));
            let (worst, count) = reprojection(&data);
            // Features outside of the small image are dropped, and those of the held-out view.
            assert!((2..=6).contains(&count), "{count}");
            assert!(worst < 1e-4, "{worst}");
            for point in &data.points {
                for o in &point.observations {
                    let view = &data.train[o.view as usize];
                    let p = glam::Vec3::from(point.position).as_dvec3() - view.camera.eye();
                    let feature = distortion.distort(DVec2::new(p.x, -p.y) / -p.z) * 20.0 + DVec2::new(8.0, 4.0);
                    let [x, y, _] = view.image.at(o.pixel_px[0] as usize, o.pixel_px[1] as usize);
                    // Half a pixel of the view, and what the lens stretches it by.
                    let off = DVec2::new(f64::from(x), f64::from(y)) - feature;
                    assert!(off.abs().max_element() <= 0.6 * f64::from(downscale), "{off}");
                }
            }
            let camera = &data.train[0].camera;
            assert!(camera.distortion.is_none());
            assert_eq!(camera.size_px.map(|s| s as usize), [data.train[0].image.width, data.train[0].image.height]);
        }
    }
}

#[test]
fn colmap_points_beside_transforms_share_the_cameras_frame() {
    let scene = TestScene::new();
    let files = ["images/a.exr", "images/b.exr"];
    scene.exrs(files);
    scene.write("split.json", r#"{"train": ["a", "b"], "test": []}"#);
    colmap(&scene, "sparse/0", PINHOLE, Distortion::default(), &["a.png", "b.png"], &[DVec3::new(0.5, 0.2, 0.0)]);
    scene.write("transforms.json", transforms(LENS, &files));
    let data = scene.load();
    assert_eq!(data.format, "nerfstudio transforms.json");
    assert_eq!(reprojection(&data).1, 2);
    assert!(reprojection(&data).0 < 1e-5);
    // A frame of its own without a word of how: the points would be wrong.
    let moved = transforms(LENS, &files).replace(&pose(1.0), &pose(3.0));
    scene.write("transforms.json", moved);
    let data = scene.load();
    assert!(data.points.is_empty() && data.warnings[0].contains("do not share a coordinate frame"), "{:?}", data.warnings);
    // With the word, they are moved along: here everything is twice as large.
    let scaled = format!("{LENS}, \"applied_transform\": [[2,0,0,0],[0,2,0,0],[0,0,2,0]]");
    let eyes = transforms(&scaled, &files).replace("[1,0,0,1]", "[1,0,0,2]").replace("[0,0,1,4]", "[0,0,1,8]");
    scene.write("transforms.json", eyes);
    let data = scene.load();
    assert_eq!(data.points[0].position, [1.0, 0.4, 0.0]);
    assert!(reprojection(&data).0 < 1e-5);
}

#[test]
fn ply_points_are_read() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    let ply = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 4 5 6\n7 8 9 10 11 12\n";
    scene.write("cloud.ply", ply);
    scene.write("transforms.json", transforms(&format!(r#"{LENS}, "ply_file_path": "./cloud.ply""#), &["a.exr"]));
    let data = scene.load();
    assert_eq!(data.points[1].position, [7.0, 8.0, 9.0]);
    assert_eq!(data.points[1].rgb8, Some([10, 11, 12]));
    scene.write("cloud.ply", &ply[..ply.len() - 8]);
    assert!(scene.error().contains("cloud.ply"));
    scene.write("cloud.ply", ply.replace("vertex 2", "vertex 1099511627776"));
    assert!(scene.error().contains("cloud.ply"));
}

#[test]
fn smaller_copies_of_the_images_scale_their_cameras() {
    let scene = TestScene::new();
    scene.exrs(["a.exr"]);
    let lens = LENS.replace("16", "32").replace("\"h\": 8", "\"h\": 16");
    scene.write("transforms.json", transforms(&lens, &["a.exr"]));
    let camera = scene.load().train[0].camera.clone();
    assert_eq!((camera.size_px, camera.focal_px, camera.center_px), ([16, 8], DVec2::splat(10.0), DVec2::new(4.0, 2.0)));
}

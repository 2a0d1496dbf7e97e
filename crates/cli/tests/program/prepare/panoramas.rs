//! Panoramas: what is cut out of them, and the cameras that come of the cut-outs' poses.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use luxel_capture::panorama::{CutoutLens, Face};
use luxel_io::colmap::read_colmap_model;

use super::*;

const WIDE: usize = 64;

/// Panoramas of two places, each in three exposures.
fn panoramas(folder: &Path) {
    for view in 0..2 {
        for k in 0..3 {
            let size = [WIDE, WIDE / 2];
            let shot = Shot { seconds: Some(0.0025 * 4f64.powi(k)), at: 20 * view as u32 + k as u32, view, size, ..SHOT };
            write(folder, &format!("P_{:04}.JPG", 3 * view as i32 + k + 1), &shot);
        }
    }
}

fn pose(view: usize) -> DAffine3 {
    let matrix3 = DMat3::from_quat(DQuat::from_xyzw(0.1, 0.4 * view as f64 - 0.2, 0.05, 0.9).normalize());
    DAffine3 { matrix3, translation: -(matrix3 * DVec3::new(view as f64, 0.1, -0.3)) }
}

/// A model of some cut-outs of both places, where COLMAP would leave it, with a point that two
/// faces of the second place see.
fn write_cutouts(output: &Path) {
    let lens = CutoutLens::for_width(WIDE);
    let side = lens.side_px;
    let model = output.join("work/sparse/0");
    std::fs::create_dir_all(&model).unwrap();
    std::fs::write(model.join("cameras.txt"), format!("1 SIMPLE_PINHOLE {side} {side} {} {m} {m}\n", lens.focal_px, m = side as f64 / 2.0))
        .unwrap();
    let point = pose(1).inverse().transform_point3(DVec3::new(2.0, 0.3, 1.9));
    let mut images = String::new();
    let mut track = String::new();
    let seen = [
        (0, "P_0001", Face::Front),
        (0, "P_0001", Face::Right),
        (1, "P_0004", Face::Right),
        (1, "P_0004", Face::Front),
        (1, "P_0004", Face::Up),
    ];
    for (id, (view, name, face)) in (1..).zip(seen) {
        let cutout_from_panorama = face.panorama_from_cutout().transpose();
        let pose = DAffine3 { matrix3: cutout_from_panorama, translation: DVec3::ZERO } * pose(view);
        let (q, t) = (DQuat::from_mat3(&pose.matrix3).normalize(), pose.translation);
        images += &format!("{id} {} {} {} {} {} {} {} 1 {}-{side}px/{name}.jpg\n", q.w, q.x, q.y, q.z, t.x, t.y, t.z, face.name());
        let p = pose.transform_point3(point);
        let at = |v: f64| v / p.z * lens.focal_px + side as f64 / 2.0;
        let is_seen = p.z > 0.0 && (0.0..side as f64).contains(&at(p.x)) && (0.0..side as f64).contains(&at(p.y));
        images += &if is_seen { format!("{} {} 1\n", at(p.x), at(p.y)) } else { "\n".to_owned() };
        track += &if is_seen { format!(" {id} 0") } else { String::new() };
    }
    assert!(track.split(' ').count() >= 7, "{track}");
    std::fs::write(model.join("images.txt"), images).unwrap();
    std::fs::write(model.join("points3D.txt"), format!("1 {} {} {} 9 9 9 0.5{track}\n", point.x, point.y, point.z)).unwrap();
}

#[test]
fn panoramas_become_a_data_set_of_panoramas() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    panoramas(&photos);
    let options = ["--response", "srgb", "--keep-coordinates"];
    let run = prepare(&photos, &output, &options);
    assert!(run.status.success() && said(&run).contains("taken as equirectangular panoramas"), "{}", said(&run));
    assert!(said(&run).contains("give --projection pinhole"), "{}", said(&run));
    for face in Face::ALL {
        assert!(output.join(format!("proxies/{}-24px/P_0004.jpg", face.name())).is_file(), "{face:?}");
    }
    let script = std::fs::read_to_string(output.join("colmap.sh")).unwrap();
    assert!(script.contains("if [ $rigs = yes ]; then colmap rig_configurator"), "{script}");
    assert_eq!(script.matches("colmap mapper").count(), 2);
    assert_eq!(script.matches("--Mapper.ba_refine_sensor_from_rig 0").count(), 1);
    let radiance = read_image(&output.join("work/radiance/P_0004.exr"), &ReadOptions::default()).unwrap().image;
    write_cutouts(&output);
    let run = prepare(&photos, &output, &options);
    assert!(run.status.success() && said(&run).contains("2 of 2 views have poses"), "{}", said(&run));
    assert_eq!(report(&output)["projection"].as_str(), Some("equirectangular"));
    // The panorama is as it was, and its camera is that of its cut-outs.
    let image = read_image(&output.join("images/P_0004.exr"), &ReadOptions::default()).unwrap().image;
    assert!(image.pixels == radiance.pixels && [image.width, image.height] == [WIDE, WIDE / 2]);
    let model = read_colmap_model(&output.join("sparse/0")).unwrap();
    assert_eq!(model.images.iter().map(|image| image.name.as_str()).collect::<Vec<_>>(), ["P_0001.exr", "P_0004.exr"]);
    for (view, image) in model.images.iter().enumerate() {
        let camera = image.camera().unwrap();
        assert!(camera.camera_from_world.abs_diff_eq(pose(view), 1e-9) && camera.projection.name() == "equirectangular");
        // The point is where the panorama's camera sees it, once.
        let (at, _) = camera.project(model.points[0].position).unwrap();
        let feature = image.features_px[0].map(f64::from);
        assert!(image.features_px.len() == 1 && at.distance(glam::DVec2::from(feature)) < 1e-3, "{at} {feature:?}");
    }
    assert_eq!(model.points[0].track, [[0, 0], [1, 0]]);
    assert!(said(&prepare(&photos, &output, &options)).contains("up to date"));
    let info = Command::cargo_bin("luxel").unwrap().arg("info").arg(&output).output().unwrap();
    assert!(info.status.success() && said(&info).contains("equirectangular"), "{}", said(&info));
    // A cut-out that is gone is made again.
    std::fs::remove_file(output.join("proxies/up-24px/P_0001.jpg")).unwrap();
    std::fs::remove_file(output.join("sparse/0/cameras.txt")).unwrap();
    assert!(prepare(&photos, &output, &options).status.success() && output.join("proxies/up-24px/P_0001.jpg").is_file());
}

#[test]
fn what_panoramas_have_no_use_for_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (photos, output) = (folder.path().join("photos"), folder.path().join("set"));
    panoramas(&photos);
    let refused = |more: &[&str]| {
        let run = prepare(&photos, &output, more);
        assert_eq!(run.status.code(), Some(1), "{}", said(&run));
        said(&run)
    };
    let text = refused(&["--camera-model", "opencv"]);
    assert!(text.contains("panoramas have no lens to fit") && text.contains("leave --camera-model out"), "{text}");
    assert!(prepare(&photos, &output, &["--projection", "pinhole", "--camera-model", "opencv"]).status.success());
    assert!(output.join("proxies/P_0001.jpg").is_file());
    write(&photos, "P_0007.JPG", &Shot { at: 60, ..SHOT });
    let text = refused(&["--projection", "equirectangular"]);
    assert!(text.contains("P_0007.JPG: 48 x 32 pixels, expected a panorama twice as wide as high"), "{text}");
}

//! Data sets whose cameras another program wrote: the same scene in each layout, with known points
//! at known pixels, and wrong and odd files.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

mod common;

use std::path::Path;

use common::TestScene;
use glam::{DVec2, DVec3};
use luxel_core::{CameraProjection, Dataset};
use luxel_io::{DatasetFormat, LoadOptions, detect_format, load_dataset};

/// Place of a camera that looks along -x with y up, 20 px of focal length.
const EYE: DVec3 = DVec3::new(1.0, 2.0, 3.0);

/// Writes an image of one colour for each name.
fn images(scene: &TestScene, names: &[&str]) {
    for (i, name) in names.iter().enumerate() {
        scene.exr(name, |_, _| [i as f32 + 0.5; 3]);
    }
}

fn load(scene: &TestScene) -> Dataset {
    scene.read(&LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn error(scene: &TestScene) -> String {
    scene.read(&LoadOptions::default()).unwrap_err().to_string()
}

/// Returns the views in order of name, tests among them.
fn views(data: &Dataset) -> Vec<&luxel_core::View> {
    let mut views: Vec<_> = data.train.iter().chain(&data.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    views
}

/// Returns a point of the world in the data set's coordinates.
fn local(data: &Dataset, point: DVec3) -> DVec3 {
    data.world_from_local.inverse().point(point)
}

/// Checks that the first view is the camera of [`EYE`], and its names.
fn check(data: &Dataset, names: &[&str]) {
    let found = views(data);
    assert_eq!(found.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), names);
    let camera = &found[0].camera;
    assert!((data.world_from_local.point(camera.eye()) - EYE).length() < 1e-6, "{}", camera.eye());
    // Two units ahead, 0.4 to the right (-z), 0.3 up.
    let point = local(data, EYE + DVec3::new(-2.0, 0.3, -0.4));
    let (px, _) = camera.project(point).unwrap();
    assert!(px.distance(DVec2::new(8.0 + 20.0 * 0.2, 4.0 - 20.0 * 0.15)) < 1e-6, "{px}");
}

fn npy(rows: &[[f64; 17]]) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 17), }}", rows.len());
    let header = format!("{header:<117}\n");
    let samples: Vec<u8> = rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), &samples].concat()
}

/// Down, right and back of the camera, its place, and height, width and focal length.
fn llff_row(z: f64, [height, width, focal]: [f64; 3]) -> [f64; 17] {
    let (down, right, back) = ([0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let row = |i: usize| [down[i], right[i], back[i], [1.0, 2.0, z][i], [height, width, focal][i]];
    let mut out = [0.0; 17];
    for i in 0..3 {
        out[5 * i..5 * i + 5].copy_from_slice(&row(i));
    }
    out[15..].copy_from_slice(&[0.5, 9.0]);
    out
}

#[test]
fn llff_folders_are_read_with_their_images_in_order() {
    let scene = TestScene::new();
    images(&scene, &["images/a.exr", "images/b.exr"]);
    scene.write("poses_bounds.npy", npy(&[llff_row(3.0, [8.0, 16.0, 20.0]), llff_row(4.0, [8.0, 16.0, 20.0])]));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::Llff);
    let data = load(&scene);
    check(&data, &["images/a", "images/b"]);
    assert_eq!((data.format.as_str(), data.warnings.len()), ("LLFF", 0), "{:?}", data.warnings);
    // One image more than rows.
    images(&scene, &["images/c.exr"]);
    assert!(error(&scene).contains("2 rows, but"), "{}", error(&scene));
}

#[test]
fn llff_images_of_other_sizes_are_scaled_and_said() {
    // Reduced folders alone, by 4, as the table is for 64 x 32.
    let scene = TestScene::new();
    images(&scene, &["images_4/a.exr", "images_4/b.exr"]);
    scene.write("images_8/a.exr", "not looked at");
    let rows = [llff_row(3.0, [32.0, 64.0, 80.0]), llff_row(4.0, [32.0, 64.0, 80.0])];
    scene.write("poses_bounds.npy", npy(&rows));
    let data = load(&scene);
    check(&data, &["images_4/a", "images_4/b"]);
    assert!(data.warnings[0].contains("no images/: the reduced images of"), "{:?}", data.warnings);
    // By 3.
    let rows = [llff_row(3.0, [24.0, 48.0, 60.0]), llff_row(4.0, [24.0, 48.0, 60.0])];
    scene.write("poses_bounds.npy", npy(&rows));
    let data = load(&scene);
    check(&data, &["images_4/a", "images_4/b"]);
    assert!(
        data.warnings[0].contains("16 x 8 pixels, the table's 48 x 24: the focal length is multiplied by 0.3333"),
        "{:?}",
        data.warnings
    );
    // Of another shape.
    scene.write("poses_bounds.npy", npy(&[llff_row(3.0, [48.0, 48.0, 60.0]), llff_row(4.0, [24.0, 48.0, 60.0])]));
    assert!(error(&scene).contains("row 0 (\"a.exr\"): the image is 16 x 8 pixels, its row's 48 x 48: another shape"), "{}", error(&scene));
    // Mirrored axes.
    let mut mirrored = llff_row(3.0, [24.0, 48.0, 60.0]);
    mirrored[5] = 1.0;
    scene.write("poses_bounds.npy", npy(&[rows[0], mirrored]));
    assert!(error(&scene).contains("row 1: "), "{}", error(&scene));
}

const CSV: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n";

#[test]
fn realityscans_table_is_read() {
    let scene = TestScene::new();
    images(&scene, &["images/a.exr", "images/b.exr", "images/c.exr"]);
    // The program's world has z up: heading 270 looks along -x, its right is y.
    scene.write("cameras.csv", format!("{CSV}a.jpg,1,2,3,270,90,0,45,0,0,0,0,0,0,0,0\nb.jpg,1,3,3,270,90,0,45,0,0,0.1,0,0.01,0,0,0\n"));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::RealityScan);
    let data = load(&scene);
    let found = views(&data);
    assert_eq!(found.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), ["images/a", "images/b"]);
    let (px, _) = found[0].camera.project(local(&data, EYE + DVec3::new(-2.0, 0.4, 0.3))).unwrap();
    assert!(px.distance(DVec2::new(8.0 + 20.0 * 0.2, 4.0 - 20.0 * 0.15)) < 1e-6, "{px}");
    let warnings = data.warnings.join("\n");
    assert!(warnings.contains("2 images are read in another format than the cameras name"), "{warnings}");
    assert!(warnings.contains("1 of 3 images have no camera with a pose and are left out (images/c)"), "{warnings}");
    // The copies that the program ran on are passed over.
    scene.png("images/a.jpg.png", |_, _| [255; 4]);
    assert_eq!(views(&load(&scene))[0].image.at(0, 0), [0.5; 3]);
    std::fs::remove_file(scene.path().join("images/a.jpg.png")).unwrap();
    // Named itself; a missing image; two tables.
    assert_eq!(load_dataset(&scene.path().join("cameras.csv"), &LoadOptions::default()).unwrap().fingerprint, data.fingerprint);
    scene.write("cameras.csv", format!("{CSV}missing.jpg,1,2,3,0,90,0,20,0,0,0,0,0,0,0,0\n"));
    assert!(error(&scene).contains("line 2 (\"missing.jpg\"): no image of this name, expected it in"), "{}", error(&scene));
    scene.write("more.csv", CSV);
    assert!(error(&scene).contains("2 tables of cameras (cameras.csv, more.csv), expected one"), "{}", error(&scene));
}

fn xmp(pose: &str) -> String {
    format!(
        r#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description
        xcr:DistortionModel="brown3" xcr:FocalLength35mm="45" xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">{pose}</rdf:Description></rdf:RDF></x:xmpmeta>"#
    )
}

#[test]
fn realityscans_xmp_files_are_read() {
    let scene = TestScene::new();
    images(&scene, &["images/a.exr", "images/b.exr"]);
    let pose = "<xcr:Rotation>0 0 -1 0 -1 0 -1 0 0</xcr:Rotation><xcr:Position>1 2 3</xcr:Position>";
    scene.write("images/a.xmp", xmp(pose));
    scene.write("images/b.xmp", xmp(""));
    // Of another program.
    scene.write("images/c.xmp", "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\"/>");
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::RealityScan);
    let data = load(&scene);
    check(&data, &["images/a"]);
    assert!(data.warnings.iter().any(|line| line == "1 of 2 XMP files hold no pose: their images are left out"), "{:?}", data.warnings);
    scene.write("images/a.xmp", xmp(""));
    assert!(error(&scene).contains("no cameras with a pose"), "{}", error(&scene));
}

fn metashape(kind: &str, calibration: &str, camera: &str) -> String {
    format!(
        r#"<document version="2.0.0"><chunk label="Chunk 1"><sensors><sensor id="0" type="{kind}"><resolution width="16" height="8"/>{calibration}</sensor></sensors>
        <cameras><camera id="0" sensor_id="0" label="a"><transform>{camera}</transform></camera><camera id="1" sensor_id="0" label="b"/></cameras></chunk></document>"#
    )
}

#[test]
fn metashapes_cameras_are_read_with_every_sensor() {
    let scene = TestScene::new();
    images(&scene, &["images/a.exr", "images/b.exr"]);
    // Right is -z, down is -y, forward is -x.
    let pose = "0 0 -1 1 0 -1 0 2 -1 0 0 3 0 0 0 1";
    let calibrated = |kind: &str, more: &str| format!(r#"<calibration type="{kind}" class="adjusted"><f>20</f>{more}</calibration>"#);
    scene.write("cameras.xml", metashape("frame", &calibrated("frame", ""), pose));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::Metashape);
    let data = load(&scene);
    check(&data, &["images/a"]);
    assert!(data.warnings.contains(&"left out, as not aligned: 1 camera (b)".to_owned()), "{:?}", data.warnings);
    // A fisheye stays one; with terms that no camera has they are removed.
    for more in ["<k1>0.01</k1>", "<k1>0.01</k1><p1>0.001</p1><b1>0.5</b1><b2>-0.5</b2>"] {
        scene.write("cameras.xml", metashape("fisheye", &calibrated("fisheye", more), pose));
        let data = load(&scene);
        assert!(matches!(data.train[0].camera.projection, CameraProjection::Fisheye(_)), "{more}");
        assert!(data.train[0].camera.distortion.is_none());
    }
    scene.write("cameras.xml", metashape("spherical", "", pose));
    let panorama = load(&scene);
    let camera = &panorama.train[0].camera;
    assert_eq!((camera.projection, camera.period_px()), (CameraProjection::Equirectangular, Some(16.0)));
    // Right of the camera is a quarter to the right.
    assert!(camera.project(local(&panorama, EYE + DVec3::new(0.0, 0.0, -1.0))).unwrap().0.distance(DVec2::new(12.0, 4.0)) < 1e-9);
}

#[test]
fn phones_exports_are_read() {
    let scene = TestScene::new();
    images(&scene, &["keyframes/corrected_images/17.exr", "keyframes/corrected_images/18.exr", "keyframes/images/17.exr"]);
    let camera = |z: f64| {
        format!(
            r#"{{"fx": 20, "fy": 20, "cx": 8, "cy": 4, "width": 16, "height": 8, "t_00": 0, "t_01": 0, "t_02": 1, "t_03": 1,
            "t_10": 0, "t_11": 1, "t_12": 0, "t_13": 2, "t_20": -1, "t_21": 0, "t_22": 0, "t_23": {z}}}"#
        )
    };
    scene.write("keyframes/corrected_cameras/17.json", camera(3.0));
    scene.write("keyframes/corrected_cameras/18.json", camera(4.0));
    scene.write("mesh_info.json", "{}");
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::Polycam);
    let data = load(&scene);
    check(&data, &["corrected_images/17", "corrected_images/18"]);
    assert_eq!(data.format, "Polycam (corrected cameras)");

    let scene = TestScene::new();
    images(&scene, &["rgb/0.exr", "rgb/1.exr"]);
    let half = 0.5f64.sqrt();
    let poses: Vec<String> = [3, 4, 5].map(|z| format!("[0, {half}, 0, {half}, 1, 2, {z}]")).to_vec();
    let json = format!(r#"{{"w": 16, "h": 8, "K": [20, 0, 0, 0, 20, 0, 8, 4, 1], "poses": [{}]}}"#, poses.join(", "));
    scene.write("metadata.json", json);
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::Record3d);
    let data = load(&scene);
    check(&data, &["rgb/0", "rgb/1"]);
    assert!(data.warnings.contains(&"1 of 3 poses have no image in rgb/".to_owned()), "{:?}", data.warnings);
    images(&scene, &["rgb/7.exr"]);
    assert!(error(&scene).contains("the name is not the number of a pose, expected 0 to 2"), "{}", error(&scene));
}

/// A stage with a camera below a prim that turns and moves it; `samples` are its heights over time.
fn stage(camera: &str) -> String {
    format!(
        r#"#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "World" (
    kind = "group"
)
{{
    double3 xformOp:translate = (1, 2, 0)
    float3 xformOp:rotateXYZ = (0, 90, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    def Mesh "Wall" {{ point3f[] points = [(0, 0, 0), (1, 2, 3)] }}
{camera}
}}
"#
    )
}

const USD_LENS: &str = "        float focalLength = 20\n        float horizontalAperture = 16\n        float verticalAperture = 8\n";

#[test]
fn usd_cameras_over_time_are_read() {
    let scene = TestScene::new();
    images(&scene, &["images/shot.1001.exr", "images/shot.1002.exr", "images/shot.1003.exr", "images/shot.1010.exr"]);
    let moving = format!(
        "    def Camera \"Shot\"\n    {{\n{USD_LENS}        matrix4d xformOp:transform.timeSamples = {{\n            1001: ((1,0,0,0),(0,1,0,0),(0,0,1,0),(-3,0,0,1)),\n            1003: ((1,0,0,0),(0,1,0,0),(0,0,1,0),(-5,0,0,1)),\n        }}\n        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}"
    );
    scene.write("shot.usda", stage(&moving));
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::Usd);
    let data = load(&scene);
    check(&data, &["images/shot.1001", "images/shot.1002", "images/shot.1003"]);
    // Between two samples.
    assert!(views(&data)[1].camera.eye().distance(local(&data, DVec3::new(1.0, 2.0, 4.0))) < 1e-9);
    assert_eq!(data.format, "USD cameras (Y up, 0.01 m a unit)");
    assert!(data.warnings.iter().any(|line| line.contains("1 of 4 images have no camera")), "{:?}", data.warnings);
    // Orthographic.
    scene.write("shot.usda", stage(&moving.replace("float focalLength", "token projection = \"orthographic\"\n        float focalLength")));
    assert!(error(&scene).contains("camera /World/Shot at time 1001: an orthographic camera"), "{}", error(&scene));
    scene.write("shot.usda", stage(&moving.replace("(1,0,0,0),(0,1,0,0)", "(1,0,0,0),(0,2,0,0)")));
    assert!(error(&scene).contains("not a rotation"), "{}", error(&scene));
}

#[test]
fn usd_cameras_named_like_images_are_read() {
    let scene = TestScene::new();
    images(&scene, &["images/000-a.exr", "images/b.exr"]);
    let still = |name: &str, z: f64, more: &str| {
        format!(
            "    def Camera \"{name}\"\n    {{\n{USD_LENS}        double3 xformOp:translate = ({z}, 0, 0)\n{more}        uniform token[] xformOpOrder = [\"xformOp:translate\"]\n    }}\n"
        )
    };
    let shifted = "        float horizontalApertureOffset = 2\n        float verticalApertureOffset = -1\n";
    scene.write("cameras.usda", stage(&(still("_000_a", -3.0, "") + &still("b", -4.0, shifted))));
    let data = load(&scene);
    check(&data, &["images/000-a", "images/b"]);
    // The aperture moves to the right and down: the principal point to the left and up.
    assert!(views(&data)[1].camera.center_px.distance(DVec2::new(8.0 - 2.0, 4.0 - 1.0)) < 1e-9);
    // In order, where no name fits; too few.
    scene.write("cameras.usda", stage(&(still("One", -3.0, "") + &still("Two", -4.0, ""))));
    let data = load(&scene);
    check(&data, &["images/000-a", "images/b"]);
    assert!(data.warnings[0].contains("2 images are taken in order, images/000-a for /World/One first"), "{:?}", data.warnings);
    scene.write("cameras.usda", stage(&still("One", -3.0, "")));
    assert!(error(&scene).contains("2 images (images/000-a, images/b), none named like a camera (/World/One)"), "{}", error(&scene));
    scene.write("cameras.usda", stage(&still("One", -3.0, "")).replace("def Camera \"One\"", "def Camera \"One\" {"));
    assert!(error(&scene).contains("cameras.usda"), "{}", error(&scene));
}

#[test]
fn cameras_of_two_programs_need_a_choice() {
    let scene = TestScene::new();
    images(&scene, &["images/a.exr"]);
    scene.write("cameras.csv", format!("{CSV}a.jpg,1,2,3,270,90,0,45,0,0,0,0,0,0,0,0\n"));
    scene.write("cameras.xml", metashape("spherical", "", "0 0 -1 1 0 -1 0 2 -1 0 0 3 0 0 0 1"));
    let found = scene.read(&LoadOptions::default()).unwrap_err();
    assert!(found.message.contains("cameras of several programs, of formats metashape and realityscan"), "{found}");
    assert!(found.remedy.is_some_and(|remedy| remedy.options().any(|option| option == "format")));
    let chosen = LoadOptions { format: Some(DatasetFormat::RealityScan), ..LoadOptions::default() };
    assert_eq!(scene.read(&chosen).unwrap().format, "RealityScan (CSV)");
    // transforms.json goes before all of them.
    scene.write(
        "transforms.json",
        r#"{"fl_x": 20, "frames": [{"file_path": "images/a.exr", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#,
    );
    assert_eq!(detect_format(scene.path()).unwrap(), DatasetFormat::Transforms);
    assert_eq!(detect_format(Path::new("nowhere")).unwrap_err().kind, luxel_io::IoErrorKind::System);
}

//! Data sets of every layout, good and bad, written to a temporary folder and read back.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail the test")]

#[path = "../common/mod.rs"]
mod common;
mod faults;
mod geometry;
mod layouts;
mod pixels;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use common::TestScene;
use glam::{DVec2, DVec3};
use luxel_core::{BadPixels, ColorSpace, Dataset, Distortion};
use luxel_io::{
    DatasetFormat, Downscale, IoErrorKind, LoadOptions, Transfer, choose_downscale, detect_format, load_dataset, parse_block, parse_split,
    parse_transforms,
};
use proptest::prelude::*;

impl TestScene {
    /// Writes images of one colour each.
    fn exrs<S: AsRef<str>>(&self, names: impl IntoIterator<Item = S>) {
        for (i, name) in names.into_iter().enumerate() {
            self.exr(name.as_ref(), |_, _| [i as f32 + 0.5; 3]);
        }
    }

    fn load(&self) -> Dataset {
        self.read(&LoadOptions::default()).unwrap()
    }

    fn error(&self) -> String {
        self.read(&LoadOptions::default()).unwrap_err().to_string()
    }
}

/// Returns the rows of a camera-to-world matrix that looks along -z from (x, 0, 4).
fn pose(x: f64) -> String {
    format!("[[1,0,0,{x}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]")
}

const LENS: &str = r#""fl_x": 20, "fl_y": 20, "cx": 8, "cy": 4, "w": 16, "h": 8"#;

/// Returns a transforms.json with these file paths, one unit apart.
fn transforms<S: AsRef<str>>(lens: &str, file_paths: &[S]) -> String {
    let frame = |(i, file): (usize, &S)| format!(r#"{{"file_path": {:?}, "transform_matrix": {}}}"#, file.as_ref(), pose(i as f64));
    let frames: Vec<String> = file_paths.iter().enumerate().map(frame).collect();
    format!("{{{lens}, \"frames\": [{}]}}", frames.join(", "))
}

/// Writes a COLMAP text model of the same cameras: `points` see each point in every image.
fn colmap(scene: &TestScene, folder: &str, camera: &str, lens: Distortion, names: &[&str], points: &[DVec3]) {
    scene.write(&format!("{folder}/cameras.txt"), camera);
    let (mut images, mut tracks) = (String::new(), vec![String::new(); points.len()]);
    for (i, name) in names.iter().enumerate() {
        // The rotation by half a turn about x takes OpenGL's axes to OpenCV's.
        writeln!(images, "{} 0 1 0 0 {} 0 4 1 {name}", i + 1, -(i as f64)).unwrap();
        for (k, p) in points.iter().enumerate() {
            let seen = lens.distort(DVec2::new(p.x - i as f64, -p.y) / (4.0 - p.z)) * 20.0 + DVec2::new(8.0, 4.0);
            write!(images, "{} {} {k} ", seen.x, seen.y).unwrap();
            write!(tracks[k], " {} {k}", i + 1).unwrap();
        }
        images.push('\n');
    }
    scene.write(&format!("{folder}/images.txt"), images);
    let point = |(k, p): (usize, &DVec3)| format!("{k} {} {} {} 1 2 3 0.1{}\n", p.x, p.y, p.z, tracks[k]);
    scene.write(&format!("{folder}/points3D.txt"), points.iter().enumerate().map(point).collect::<String>());
}

const PINHOLE: &str = "1 PINHOLE 16 8 20 20 8 4";

fn names(views: &[luxel_core::View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}

/// Returns the largest distance of an observation from where its point projects, and how many there
/// are.
fn reprojection(data: &Dataset) -> (f64, usize) {
    let (mut worst, mut count) = (0.0f64, 0);
    for point in &data.points {
        for o in &point.observations {
            let camera = &data.train[o.view as usize].camera;
            let (px, _) = camera.project(glam::Vec3::from(point.position).as_dvec3()).unwrap();
            worst = worst.max(px.distance(glam::Vec2::from(o.pixel_px).as_dvec2()));
            count += 1;
        }
    }
    (worst, count)
}

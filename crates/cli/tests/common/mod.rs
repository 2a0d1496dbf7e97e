//! A tiny data set and a way to run the program.
#![allow(missing_docs, dead_code, unreachable_pub, clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use luxel_core::Image;
use luxel_io::{ExrOptions, ExrSample};

/// Pixels a side.
pub const SIDE: usize = 24;
pub const VIEWS: usize = 9;
pub const FOCAL_PX: f64 = 30.0;

/// Balls of light: place, radius and radiance; the last is a lamp a thousand times brighter than the first.
const BALLS: [([f64; 3], f64, [f32; 3]); 3] =
    [([0.0, 0.0, 0.0], 0.6, [0.02, 0.03, 0.05]), ([0.7, 0.3, 0.2], 0.3, [0.4, 0.1, 0.05]), ([-0.5, 0.5, 0.4], 0.15, [40.0, 36.0, 25.0])];

/// A folder that goes away with it.
pub struct Workplace {
    folder: tempfile::TempDir,
}

impl Workplace {
    /// With a data set in `data`.
    pub fn new() -> Self {
        let place = Self::empty();
        write_dataset(&place.path("data"));
        place
    }

    pub fn empty() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The program, in this folder.
    pub fn luxel(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
        command.current_dir(self.folder.path()).env_remove("RUST_LOG").args(args);
        // Graphics drivers complain on stderr where it is missing.
        command.env("XDG_RUNTIME_DIR", self.folder.path());
        command
    }

    /// Runs to success; stdout.
    pub fn ok(&self, args: &[&str]) -> String {
        let output = self.luxel(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{args:?}: {:?}\n{stderr}", output.status);
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs to a failure with this exit code; stderr.
    pub fn fails(&self, code: i32, args: &[&str]) -> String {
        let output = self.luxel(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{args:?}\n{stderr}");
        stderr
    }

    /// Runs to an error; its message must have every one of `parts`.
    pub fn error(&self, args: &[&str], parts: &[&str]) {
        let stderr = self.fails(1, args);
        assert!(stderr.lines().any(|line| line.starts_with("error: ")), "{args:?}\n{stderr}");
        assert!(!stderr.contains("panicked"), "{args:?}\n{stderr}");
        for part in parts {
            assert!(stderr.contains(part), "{args:?}: no \"{part}\" in\n{stderr}");
        }
    }

    /// Runs to success with a reader of stdout that has left.
    pub fn ok_unread(&self, args: &[&str]) {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_luxel"));
        let status =
            command.current_dir(self.folder.path()).args(args).stdout(writer).stderr(std::process::Stdio::null()).status().unwrap();
        assert!(status.success(), "{args:?}: {status:?}");
    }

    /// Trains `run` for a few steps.
    pub fn train(&self, run: &str, more: &[&str]) -> String {
        let mut args = vec!["train", "data", "-o", run];
        args.extend(QUICK);
        args.extend(more);
        self.ok(&args)
    }

    /// Runs to success with events on stdout, one JSON object a line; those of this name.
    pub fn events(&self, args: &[&str], name: &str) -> Vec<serde_json::Value> {
        let told = self.ok(&[args, &["--log-format", "json"]].concat());
        let events =
            told.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{args:?}: {error} in {line}\n{told}")));
        events.filter(|event: &serde_json::Value| event["event"] == name).collect()
    }

    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).unwrap()).unwrap()
    }
}

/// Options of the shortest run that means something.
pub const QUICK: [&str; 6] = ["--iterations", "40", "--init-points", "300", "--threads", "2"];

/// Cameras on an arc, looking at the origin, and what they see.
pub fn write_dataset(folder: &Path) {
    let mut frames = Vec::new();
    for view in 0..VIEWS {
        let angle = (view as f64 / VIEWS as f64 - 0.5) * 1.6;
        let (sin, cos) = angle.sin_cos();
        let eye = [3.0 * sin, 0.4, 3.0 * cos];
        let back = normalized(eye);
        let right = normalized([back[2], 0.0, -back[0]]);
        let up = cross(back, right);
        let image = render(eye, right, up, back);
        let name = format!("images/{view:03}.exr");
        write_image(&folder.join(&name), &image);
        let row = |i: usize| [right[i], up[i], back[i], eye[i]];
        frames.push(serde_json::json!({ "file_path": name, "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]] }));
    }
    let half = SIDE as f64 / 2.0;
    let transforms = serde_json::json!({
        "w": SIDE, "h": SIDE, "fl_x": FOCAL_PX, "fl_y": FOCAL_PX, "cx": half, "cy": half, "frames": frames
    });
    std::fs::write(folder.join("transforms.json"), transforms.to_string()).unwrap();
}

/// A float EXR.
pub fn write_image(path: &Path, image: &Image) {
    luxel_io::write_exr(path, image, &ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() }).unwrap();
}

fn render(eye: [f64; 3], right: [f64; 3], up: [f64; 3], back: [f64; 3]) -> Image {
    let half = SIDE as f64 / 2.0;
    let mut image = Image::filled(SIDE, SIDE, [0.001; 3]);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (((i % SIDE) as f64 + 0.5 - half) / FOCAL_PX, (half - (i / SIDE) as f64 - 0.5) / FOCAL_PX);
        let direction = normalized(std::array::from_fn(|k| x * right[k] + y * up[k] - back[k]));
        let mut nearest = f64::INFINITY;
        for (center, radius, radiance) in BALLS {
            let to: [f64; 3] = std::array::from_fn(|k| center[k] - eye[k]);
            let along = dot(to, direction);
            let miss2 = dot(to, to) - along * along;
            if miss2 < radius * radius && along < nearest {
                (nearest, *pixel) = (along, radiance);
            }
        }
    }
    image
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn normalized(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

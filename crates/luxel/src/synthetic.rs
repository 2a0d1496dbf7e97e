//! Small made-up scenes and data sets: for examples, tests and measurements that need no files.

use std::path::Path;

use luxel_core::{ColorSpace, Image, RadianceScale, RasterConfig};
use luxel_io::{ExrOptions, ExrSample};
use serde_json::json;

pub use luxel_core::synthetic::room_camera;

use crate::error::Context;
use crate::{Result, Scene};

/// Returns a room of `count` splats of spherical harmonics; equal seeds give equal scenes.
/// [`room_camera`] stands in its middle.
pub fn room(count: usize, seed: u64) -> Scene {
    let splats = luxel_core::synthetic::room(count, seed);
    let (color_space, raster) = (ColorSpace::default(), RasterConfig::default());
    Scene::from(luxel_core::Scene {
        splats,
        radiance_scale: RadianceScale::ONE,
        color_space,
        raster,
        edits: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
    })
}

/// Size and number of the images of [`write_dataset`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BallsOptions {
    /// Pixels along each side of an image.
    pub side_px: usize,
    /// Number of images; every 8th is held out.
    pub views: usize,
}

impl Default for BallsOptions {
    /// Nine views of 24x24 pixels.
    fn default() -> Self {
        Self { side_px: 24, views: 9 }
    }
}

/// A ball of light.
struct Ball {
    center: [f64; 3],
    radius: f64,
    radiance: [f32; 3],
}

/// The last ball is a lamp, a thousand times brighter than the first.
const BALLS: [Ball; 3] = [
    Ball { center: [0.0, 0.0, 0.0], radius: 0.6, radiance: [0.02, 0.03, 0.05] },
    Ball { center: [0.7, 0.3, 0.2], radius: 0.3, radiance: [0.4, 0.1, 0.05] },
    Ball { center: [-0.5, 0.5, 0.4], radius: 0.15, radiance: [40.0, 36.0, 25.0] },
];

/// Radiance behind the balls.
const BACKGROUND: [f32; 3] = [0.001; 3];

/// Focal length as a multiple of the image's side.
const FOCAL: f64 = 1.25;

/// Axes and place of a camera, world; the axes are OpenGL's: right, up and back.
struct Pose {
    right: [f64; 3],
    up: [f64; 3],
    back: [f64; 3],
    eye: [f64; 3],
}

impl Pose {
    /// Returns the camera at `turn`, -0.5 to 0.5, of an arc around the origin.
    fn on_arc(turn: f64) -> Self {
        let (sin, cos) = (1.6 * turn).sin_cos();
        let eye = [3.0 * sin, 0.4, 3.0 * cos];
        let back = normalised(eye);
        let right = normalised([back[2], 0.0, -back[0]]);
        Self { right, up: cross(back, right), back, eye }
    }

    /// Returns the `transform_matrix` of a `transforms.json`.
    fn matrix(&self) -> [[f64; 4]; 4] {
        let row = |i: usize| [self.right[i], self.up[i], self.back[i], self.eye[i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }
}

/// Writes a tiny HDR data set into `folder`: three balls of light, one of them a lamp, as OpenEXR
/// images of 32 bits with a `transforms.json`.
///
/// ```
/// use luxel::{Dataset, synthetic};
///
/// # fn main() -> luxel::Result<()> {
/// let folder = tempfile::tempdir().unwrap();
/// synthetic::write_dataset(folder.path(), synthetic::BallsOptions::default())?;
/// let dataset = Dataset::open(folder.path())?;
/// assert_eq!((dataset.train.len(), dataset.test.len()), (7, 2));
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// The file system's refusal.
pub fn write_dataset(folder: impl AsRef<Path>, options: BallsOptions) -> Result<()> {
    let (folder, side) = (folder.as_ref(), options.side_px);
    let mut frames = Vec::with_capacity(options.views);
    for view in 0..options.views {
        let pose = Pose::on_arc(view as f64 / options.views as f64 - 0.5);
        let name = format!("images/{view:03}.exr");
        let exr = ExrOptions { sample: ExrSample::Float, ..ExrOptions::default() };
        luxel_io::write_exr(&folder.join(&name), &image(&pose, side), &exr).context("cannot write an image")?;
        frames.push(json!({ "file_path": name, "transform_matrix": pose.matrix() }));
    }
    let (focal_px, center_px) = (FOCAL * side as f64, side as f64 / 2.0);
    let transforms =
        json!({ "w": side, "h": side, "fl_x": focal_px, "fl_y": focal_px, "cx": center_px, "cy": center_px, "frames": frames });
    Ok(luxel_io::write_bytes(&folder.join("transforms.json"), transforms.to_string().as_bytes())?)
}

/// Returns what the camera sees: the nearest ball along each pixel's ray.
fn image(pose: &Pose, side: usize) -> Image {
    let (half, focal_px) = (side as f64 / 2.0, FOCAL * side as f64);
    let mut image = Image::filled(side, side, BACKGROUND);
    for (i, pixel) in image.pixels.iter_mut().enumerate() {
        let (x, y) = (((i % side) as f64 + 0.5 - half) / focal_px, (half - (i / side) as f64 - 0.5) / focal_px);
        let direction = normalised(std::array::from_fn(|k| x * pose.right[k] + y * pose.up[k] - pose.back[k]));
        let mut nearest = f64::INFINITY;
        for ball in &BALLS {
            let to: [f64; 3] = std::array::from_fn(|k| ball.center[k] - pose.eye[k]);
            let along = dot(to, direction);
            let miss2 = dot(to, to) - along * along;
            if miss2 < ball.radius * ball.radius && along < nearest {
                (nearest, *pixel) = (along, ball.radiance);
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

fn normalised(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

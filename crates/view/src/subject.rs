//! The subject of a viewer: facts about the scene, its cameras and their ground truth.
//!
//! In: a scene and its data set, if there is one; out: the JSON of `/api/scene`, and views by name.
//! Degenerate: a scene without splats has bounds of zero size; without a data set there are no
//! cameras.

use std::path::Path;
use std::sync::Arc;

use glam::{DMat3, DVec3};
use luxel::export::{Up, UpAxis, file_from_world};
use luxel::{Result, Scene};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Image, Mask, PixelValues, View};
use serde::Serialize;

use crate::folder::Folder;

/// Weights of linear Rec.709 in luminance (ITU-R BT.709).
const REC709_LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The part of splats on each side that the inner bounds leave out.
const TAIL: f64 = 0.05;

/// A scene to look at: facts, cameras, ground truth.
#[derive(Clone, Debug)]
pub struct Subject {
    pub(crate) color_space: ColorSpace,
    pub(crate) facts: Facts,
    pub(crate) views: Vec<Shown>,
    /// Where the page may save; `None` for nowhere.
    pub(crate) folder: Option<Folder>,
}

/// A camera of the data set and its ground truth.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub(crate) name: String,
    pub(crate) split: &'static str,
    pub(crate) camera: Camera,
    /// Radiance; `None` for captured LDR values.
    pub(crate) truth: Option<Arc<Image>>,
    pub(crate) mask: Option<Arc<Mask>>,
}

/// Facts about a scene, as `/api/scene` gives them.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Facts {
    pub(crate) name: String,
    pub(crate) splats: usize,
    /// Corners of the box around the centres of all splats, world.
    bounds: [[f32; 3]; 2],
    /// The same without the outer twentieth on each side of each axis.
    inner_bounds: [[f32; 3]; 2],
    color_space: &'static str,
    /// Rows of the matrix to linear Rec.709.
    rec709_from_scene: [[f64; 3]; 3],
    /// Weights of the scene's R, G and B in luminance.
    pub(crate) luminance_weights: [f64; 3],
    /// Data-set radiance of one normalised unit.
    pub(crate) radiance_scale: f32,
    /// Direction that is up, world.
    up: [f64; 3],
    /// Edits of light since training.
    edits: Vec<String>,
}

/// A camera in JSON: pose and lens as `transforms.json` has them.
#[derive(Serialize)]
struct CameraJson<'a> {
    name: &'a str,
    split: &'a str,
    has_ground_truth: bool,
    transform_matrix: [[f64; 4]; 4],
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    w: u32,
    h: u32,
}

impl Subject {
    /// Returns what is shown of a scene called `name`, with the cameras and images of a data set.
    ///
    /// # Errors
    /// A data set whose cameras have no up direction that can be used.
    pub fn new(name: impl Into<String>, scene: &Scene, dataset: Option<&Dataset>) -> Result<Self> {
        let world_from_file = file_from_world(Up::Default, UpAxis::PlusY, dataset, 1.0)?.rotation().transpose();
        let conversion = Conversion::between(scene.color_space, luxel::ColorSpace::LinearRec709);
        let rows = conversion.rows();
        let luminance_weights = [0, 1, 2].map(|c| (0..3).map(|row| REC709_LUMINANCE[row] * rows[row][c]).sum());
        let [bounds, inner_bounds] = [0.0, TAIL].map(|tail| bounds(&scene.splats.position, tail));
        let facts = Facts {
            name: name.into(),
            splats: scene.splats.len(),
            bounds,
            inner_bounds,
            color_space: scene.color_space.name(),
            rec709_from_scene: rows,
            luminance_weights,
            radiance_scale: scene.radiance_scale.get(),
            up: (world_from_file * DVec3::Y).to_array(),
            edits: scene.edits.clone(),
        };
        let mut views: Vec<Shown> = Vec::new();
        if let Some(dataset) = dataset {
            views.extend(dataset.train.iter().map(|view| Shown::new(view, "train")));
            views.extend(dataset.test.iter().map(|view| Shown::new(view, "test")));
            views.sort_by(|a, b| a.name.cmp(&b.name));
        }
        Ok(Self { color_space: scene.color_space, facts, views, folder: None })
    }

    /// Lets the page make new files in a folder: that of the run or of the scene file. Nothing there is
    /// ever replaced.
    ///
    /// # Errors
    /// The folder is not there.
    pub fn saving_to(self, folder: &Path) -> Result<Self> {
        Ok(Self { folder: Some(Folder::new(folder)?), ..self })
    }

    /// Returns the view of this name, or of this last part of a name if there is only one.
    pub(crate) fn view(&self, name: &str) -> Result<&Shown, String> {
        if let Some(view) = self.views.iter().find(|view| view.name == name) {
            return Ok(view);
        }
        let mut views = self.views.iter().filter(|view| view.name.rsplit('/').next() == Some(name));
        match (views.next(), views.next()) {
            (Some(view), None) => Ok(view),
            (Some(_), Some(_)) => Err(format!("several views are called \"{}\", give the folder too", name.escape_default())),
            (None, _) => Err(format!("no view \"{}\", expected one of the {} of /api/scene", name.escape_default(), self.views.len())),
        }
    }

    /// Returns the JSON of the cameras.
    pub(crate) fn cameras(&self) -> impl Serialize + '_ {
        self.views.iter().map(Shown::json).collect::<Vec<_>>()
    }
}

impl Shown {
    fn new(view: &View, split: &'static str) -> Self {
        let truth = (view.values == PixelValues::Radiance).then(|| Arc::clone(&view.image));
        Self { name: view.name.clone(), split, camera: view.camera.clone(), truth, mask: view.mask.clone() }
    }

    fn json(&self) -> CameraJson<'_> {
        let Camera { camera_from_world: pose, focal_px, center_px, size_px: [w, h], .. } = &self.camera;
        let axes = pose.matrix3.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let eye = self.camera.eye();
        let row = |i: usize| [axes.col(0)[i], axes.col(1)[i], axes.col(2)[i], eye[i]];
        CameraJson {
            name: &self.name,
            split: self.split,
            has_ground_truth: self.truth.is_some(),
            transform_matrix: [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            fl_x: focal_px.x,
            fl_y: focal_px.y,
            cx: center_px.x,
            cy: center_px.y,
            w: *w,
            h: *h,
        }
    }
}

/// Returns the corners of the box around the points, without this part of them on each side.
fn bounds(points: &[[f32; 3]], tail: f64) -> [[f32; 3]; 2] {
    let mut corners = [[0.0; 3]; 2];
    for axis in 0..3 {
        let mut values: Vec<f32> = points.iter().map(|point| point[axis]).collect();
        values.sort_unstable_by(f32::total_cmp);
        let Some(last) = values.len().checked_sub(1) else { continue };
        let skipped = (tail * last as f64) as usize;
        corners[0][axis] = values[skipped];
        corners[1][axis] = values[last - skipped];
    }
    corners
}

#[cfg(test)]
mod tests {
    use luxel::synthetic;

    use super::*;

    #[test]
    fn views_are_found_by_name_and_by_its_last_part() {
        let folder = tempfile::tempdir().unwrap();
        synthetic::write_dataset(folder.path(), synthetic::BallsOptions::default()).unwrap();
        let dataset = luxel::Dataset::open(folder.path()).unwrap();
        let subject = Subject::new("balls", &synthetic::room(50, 1), Some(&dataset)).unwrap();
        assert_eq!(subject.views.len(), 9);
        assert_eq!(subject.view("images/003").unwrap().name, "images/003");
        assert_eq!(subject.view("003").unwrap().name, "images/003");
        assert!(subject.view("nothing").unwrap_err().contains("no view \"nothing\""));
        assert_eq!(subject.views.iter().filter(|view| view.split == "test").count(), 2);
    }

    #[test]
    fn poses_are_those_of_transforms_json() {
        let camera = synthetic::room_camera([40, 30]);
        let shown = Shown { name: "a".into(), split: "train", camera: camera.clone(), truth: None, mask: None };
        let json = serde_json::json!({ "frames": [shown.json()] }).to_string().replace("\"name\"", "\"file_path\"");
        let read = luxel::decode_cameras("cameras.json", json.as_bytes()).unwrap().remove(0).camera;
        assert_eq!((read.focal_px, read.center_px, read.size_px), (camera.focal_px, camera.center_px, camera.size_px));
        assert!((read.eye() - camera.eye()).length() < 1e-9 && (read.forward() - camera.forward()).length() < 1e-9);
    }

    #[test]
    fn inner_bounds_leave_strays_out() {
        let mut points: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32, -1.0, 2.0]).collect();
        points.push([1e6, -1.0, 2.0]);
        assert_eq!(bounds(&points, 0.0), [[0.0, -1.0, 2.0], [1e6, -1.0, 2.0]]);
        assert_eq!(bounds(&points, 0.05), [[5.0, -1.0, 2.0], [96.0, -1.0, 2.0]]);
        assert_eq!(bounds(&[], 0.05), [[0.0; 3]; 2]);
    }
}

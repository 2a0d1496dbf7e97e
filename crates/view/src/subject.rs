//! The subject of a viewer: facts about the scene, its cameras and their ground truth.
//!
//! In: a scene and its data set, if there is one; out: the JSON of `/api/scene`, and views by name.
//! Degenerate: a scene without splats has bounds of zero size; without a data set there are no
//! cameras.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use bytes::Bytes;
use glam::{DMat3, DVec3};
use luxel::display_lut::DisplayLut;
use luxel::export::{Up, UpAxis, file_from_world};
use luxel::probe::Surroundings;
use luxel::{Result, Scene};
use luxel_core::{Camera, ColorSpace, Conversion, Dataset, Image, Mask, OnDemand, PixelValues, Similarity, View};
use serde::Serialize;
use serde_json::Value;

use crate::display::{DisplayFacts, ShownDisplay};
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
    /// Up direction and resolution of light probes.
    pub(crate) surroundings: Surroundings,
    /// The folder that the page may save into, if any.
    pub(crate) folder: Option<Folder>,
    /// The same as the user named it.
    pub(crate) given_folder: PathBuf,
    /// A proxy mesh in binary glTF, if the page is to have one.
    pub(crate) mesh: Option<Bytes>,
    /// A display of OpenColorIO, if the page is to have one.
    pub(crate) display: Option<ShownDisplay>,
    /// From the axes of exported glTF to the world.
    world_from_file: DMat3,
    /// From each scene's local coordinates to the world; the first is that of the subject.
    world_from_local: Vec<Similarity>,
}

/// A camera of the data set and its ground truth.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub(crate) name: String,
    pub(crate) split: &'static str,
    /// In the local coordinates of the first scene; a training that refines poses moves it.
    camera: Arc<RwLock<Camera>>,
    /// Radiance; `None` for captured LDR values.
    pub(crate) truth: Option<OnDemand<Image>>,
    pub(crate) mask: Option<OnDemand<Mask>>,
}

/// Facts about a proxy mesh.
#[derive(Clone, Debug, Serialize)]
struct MeshFacts {
    /// Rows of the turn from the file's axes to the world.
    world_from_file: [[f64; 3]; 3],
}

/// Facts about a scene, as `/api/scene` gives them.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Facts {
    pub(crate) name: String,
    /// The run or scene file as it was named on the command line.
    path: String,
    pub(crate) splats: usize,
    /// Corners of the box around the centres of all splats, world.
    bounds: [[f64; 3]; 2],
    /// The same without the outer twentieth on each side of each axis.
    pub(crate) inner_bounds: [[f64; 3]; 2],
    color_space: &'static str,
    /// Whether the scene's colours are a display's. Pictures for the page are of their light.
    is_display: bool,
    /// Rows of the matrix to linear Rec.709.
    rec709_from_scene: [[f64; 3]; 3],
    /// Weights of the scene's R, G and B in luminance.
    pub(crate) luminance_weights: [f64; 3],
    /// Data-set radiance of one normalised unit.
    pub(crate) radiance_scale: f32,
    /// Direction that is up, world.
    pub(crate) up: [f64; 3],
    /// Luminance in cd/m2 of one unit of the data set; `None` where nothing tells.
    cd_m2_per_unit: Option<f64>,
    /// Length of a world unit in metres; `None` where nothing tells.
    metres_per_unit: Option<f64>,
    /// A proxy mesh.
    mesh: Option<MeshFacts>,
    /// A display of OpenColorIO.
    display: Option<DisplayFacts>,
    /// From the coordinates that the splats are held in to the world, for a page that renders by
    /// itself.
    world_from_local: FrameJson,
    /// Edits of light since training.
    edits: Vec<String>,
    /// Other scenes of the same place, by their index less one.
    others: Vec<OtherFacts>,
}

/// A similarity in JSON: a point is turned by the rows of `rotation`, multiplied, and moved.
#[derive(Clone, Copy, Debug, Serialize)]
struct FrameJson {
    rotation: [[f64; 3]; 3],
    scale: f64,
    translation: [f64; 3],
}

/// Facts about a scene that is compared with.
#[derive(Clone, Debug, Serialize)]
struct OtherFacts {
    name: String,
    splats: usize,
    color_space: &'static str,
    /// Rows of the matrix from its colour space to that of the first scene.
    first_from_scene: [[f64; 3]; 3],
    luminance_weights: [f64; 3],
    radiance_scale: f32,
}

/// A camera in JSON: pose and lens as `transforms.json` has them.
#[derive(Serialize)]
struct CameraJson<'a> {
    name: &'a str,
    split: &'a str,
    has_ground_truth: bool,
    transform_matrix: [[f64; 4]; 4],
    /// Focal lengths, and the projection of a camera that is no pinhole.
    #[serde(flatten)]
    lens: BTreeMap<&'static str, Value>,
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
        let world_from_local = scene.world_from_local;
        let world_from_file = file_from_world(Up::Default, UpAxis::PlusY, dataset, 1.0)?.rotation().transpose();
        let dataset = dataset.map(|dataset| dataset.in_frame(world_from_local));
        let dataset = dataset.as_deref();
        let local_from_file = file_from_world(Up::Default, UpAxis::PlusY, dataset, 1.0)?.rotation().transpose();
        let conversion = Conversion::between(scene.color_space, ColorSpace::LinearRec709);
        let rows = conversion.rows();
        let [bounds, inner_bounds] = [0.0, TAIL].map(|tail| world_bounds(scene, tail));
        let facts = Facts {
            path: String::new(),
            name: name.into(),
            splats: scene.splats.len(),
            bounds,
            inner_bounds,
            color_space: scene.color_space.name(),
            is_display: !scene.color_space.is_linear(),
            rec709_from_scene: rows,
            luminance_weights: luminance_weights(rows),
            radiance_scale: scene.radiance_scale.get(),
            up: (world_from_local.rotation() * (local_from_file * DVec3::Y)).to_array(),
            cd_m2_per_unit: None,
            metres_per_unit: scene.metres_per_unit,
            mesh: None,
            display: None,
            world_from_local: FrameJson {
                rotation: world_from_local.rotation().transpose().to_cols_array_2d(),
                scale: world_from_local.scale(),
                translation: world_from_local.translation().to_array(),
            },
            edits: scene.edits.clone(),
            others: Vec::new(),
        };
        let mut views: Vec<Shown> = Vec::new();
        if let Some(dataset) = dataset {
            views.extend(dataset.train.iter().map(|view| Shown::new(view, "train")));
            views.extend(dataset.test.iter().map(|view| Shown::new(view, "test")));
            views.sort_by(|a, b| a.name.cmp(&b.name));
        }
        let surroundings = Surroundings::new(Up::Default, dataset)?;
        Ok(Self {
            color_space: scene.color_space,
            facts,
            views,
            surroundings,
            folder: None,
            given_folder: PathBuf::new(),
            mesh: None,
            world_from_file,
            display: None,
            world_from_local: vec![world_from_local],
        })
    }

    /// Lets the page make new files in a folder: that of the run or of the scene file. Nothing
    /// there is ever replaced.
    ///
    /// # Errors
    /// The folder is not there.
    pub fn saving_to(self, folder: &Path) -> Result<Self> {
        Ok(Self { folder: Some(Folder::new(folder)?), given_folder: folder.to_owned(), ..self })
    }

    /// Tells the page what the user named on the command line, for commands that it shows.
    pub fn opened_as(mut self, path: &Path) -> Self {
        self.facts.path = path.display().to_string();
        self
    }

    /// Sets the luminance of one unit of the data set, cd/m2; `None` where it is not calibrated.
    #[must_use]
    pub fn with_cd_m2_per_unit(mut self, cd_m2_per_unit: Option<f64>) -> Self {
        self.facts.cd_m2_per_unit = cd_m2_per_unit;
        self
    }

    /// Lets the page walk on a proxy mesh: the content of a binary glTF file as `luxel mesh` writes
    /// it of this scene.
    #[must_use]
    pub fn with_mesh(mut self, glb: Vec<u8>) -> Self {
        // Rows.
        self.facts.mesh = Some(MeshFacts { world_from_file: self.world_from_file.transpose().to_cols_array_2d() });
        Self { mesh: Some(glb.into()), ..self }
    }

    /// Lets the page show the scene as a display of OpenColorIO does.
    #[must_use]
    pub fn with_display(mut self, lut: &DisplayLut) -> Self {
        let shown = ShownDisplay::new(lut);
        self.facts.display = Some(shown.facts.clone());
        Self { display: Some(shown), ..self }
    }

    /// Adds a scene that is compared with `first`.
    pub(crate) fn add_other(&mut self, name: String, first: &Scene, other: &Scene) {
        let rows = Conversion::between(other.color_space, ColorSpace::LinearRec709).rows();
        self.world_from_local.push(other.world_from_local);
        self.facts.others.push(OtherFacts {
            name,
            splats: other.splats.len(),
            color_space: other.color_space.name(),
            first_from_scene: Conversion::between(other.color_space, first.color_space).rows(),
            luminance_weights: luminance_weights(rows),
            radiance_scale: other.radiance_scale.get(),
        });
    }

    /// Returns the number of scenes.
    pub(crate) fn scenes(&self) -> usize {
        self.world_from_local.len()
    }

    /// Returns the weights of a scene's R, G and B in luminance.
    pub(crate) fn luminance_weights(&self, scene: usize) -> [f64; 3] {
        scene.checked_sub(1).and_then(|i| self.facts.others.get(i)).map_or(self.facts.luminance_weights, |other| other.luminance_weights)
    }

    fn frame(&self, scene: usize) -> Similarity {
        self.world_from_local.get(scene).copied().unwrap_or(Similarity::IDENTITY)
    }

    /// Returns a camera of the first scene's local coordinates in those of a scene.
    pub(crate) fn to_scene(&self, camera: &Camera, scene: usize) -> Camera {
        match self.frame(0) == self.frame(scene) {
            true => camera.clone(),
            false => self.local_camera(&self.to_world(camera, 0), scene),
        }
    }

    /// Returns a camera of a scene's local coordinates in the world.
    pub(crate) fn to_world(&self, camera: &Camera, scene: usize) -> Camera {
        let mut camera = camera.clone();
        self.frame(scene).apply_to_camera(&mut camera);
        camera
    }

    /// Returns a camera of the world in a scene's local coordinates.
    pub(crate) fn local_camera(&self, camera: &Camera, scene: usize) -> Camera {
        let mut camera = camera.clone();
        self.frame(scene).inverse().apply_to_camera(&mut camera);
        camera
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
        self.views.iter().map(|view| view.json(self.to_world(&view.camera(), 0))).collect::<Vec<_>>()
    }

    /// Moves the views to refined cameras; returns whether one of them was elsewhere.
    pub(crate) fn move_views(&self, cameras: &BTreeMap<String, Camera>) -> bool {
        let mut has_moved = false;
        for view in &self.views {
            let Some(refined) = cameras.get(&view.name) else { continue };
            let refined = self.local_camera(refined, 0);
            let mut camera = view.camera.write().unwrap_or_else(PoisonError::into_inner);
            has_moved |= *camera != refined;
            *camera = refined;
        }
        has_moved
    }
}

impl Shown {
    fn new(view: &View, split: &'static str) -> Self {
        let truth = (view.values == PixelValues::Radiance).then(|| view.image.clone());
        let camera = Arc::new(RwLock::new(view.camera.clone()));
        Self { name: view.name.clone(), split, camera, truth, mask: view.mask.clone() }
    }

    /// Returns the camera, in the local coordinates of the first scene.
    pub(crate) fn camera(&self) -> Camera {
        self.camera.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the JSON of the view, whose camera in the world is given.
    fn json(&self, camera: Camera) -> CameraJson<'_> {
        let eye = camera.eye();
        let lens = luxel_io::lens_fields(&camera).into_iter().collect();
        let Camera { camera_from_world: pose, center_px, size_px: [w, h], .. } = camera;
        let axes = pose.matrix3.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let row = |i: usize| [axes.col(0)[i], axes.col(1)[i], axes.col(2)[i], eye[i]];
        CameraJson {
            name: &self.name,
            split: self.split,
            has_ground_truth: self.truth.is_some(),
            transform_matrix: [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            lens,
            cx: center_px.x,
            cy: center_px.y,
            w,
            h,
        }
    }
}

/// Returns the weights of R, G and B in luminance, from the rows of their matrix to Rec.709.
fn luminance_weights(rows: [[f64; 3]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|c| (0..3).map(|row| REC709_LUMINANCE[row] * rows[row][c]).sum())
}

/// Returns the corners of the box in the world around the splats, without this part of them on each
/// side.
fn world_bounds(scene: &Scene, tail: f64) -> [[f64; 3]; 2] {
    let [low, high] = bounds(&scene.splats.position, tail).map(|corner| DVec3::from_array(corner.map(f64::from)));
    let corners = (0..8).map(|i| DVec3::select(glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), high, low));
    let corners: Vec<DVec3> = corners.map(|corner| scene.world_from_local.point(corner)).collect();
    [corners.iter().copied().reduce(DVec3::min), corners.iter().copied().reduce(DVec3::max)]
        .map(|corner| corner.unwrap_or_default().to_array())
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
    use luxel_core::{CameraProjection, Fisheye};

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
        let pinhole = synthetic::room_camera([40, 30]);
        let lens = Fisheye { max_angle_rad: 1.4, ..Fisheye::new([0.01, 0.02, 0.0, -0.001]) };
        let fisheye = Camera { projection: CameraProjection::Fisheye(lens), ..pinhole.clone() };
        for (camera, tolerance) in [(Camera::panorama(pinhole.camera_from_world, 64), 1e-9), (fisheye, 0.0), (pinhole, 0.0)] {
            let shown = Shown { name: "a".into(), split: "train", camera: Arc::new(RwLock::new(camera.clone())), truth: None, mask: None };
            let json = serde_json::json!({ "frames": [shown.json(camera.clone())] }).to_string().replace("\"name\"", "\"file_path\"");
            let read = luxel::decode_cameras("cameras.json", json.as_bytes()).unwrap().remove(0).camera;
            assert!((read.focal_px - camera.focal_px).length() <= tolerance);
            assert_eq!(
                (read.center_px, read.size_px, read.projection.name()),
                (camera.center_px, camera.size_px, camera.projection.name())
            );
            assert!((read.eye() - camera.eye()).length() < 1e-9 && (read.forward() - camera.forward()).length() < 1e-9);
        }
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

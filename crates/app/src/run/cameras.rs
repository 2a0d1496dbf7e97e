//! `cameras.json` of the run folder: the cameras of a run whose poses were refined.
//!
//! In: the cameras of the training views as training left them, and of the test views as they were
//! aligned to the scene. Out: a `transforms.json` with a lens for each frame (world of the data
//! set, camera-to-world in OpenGL axes), which everything that reads camera paths reads; and the
//! data set seen through these cameras, for commands that render a run.
//!
//! Degenerate: a run without the file, or whose file is of another step, has the cameras of its
//! data set.

use std::borrow::Cow;
use std::collections::BTreeMap;

use luxel::Result;
use luxel::error::Context;
use luxel::refined_views::{cameras_in_world, share_lenses};
use luxel_core::{Camera, Dataset, View};
use luxel_io::PathCamera;
use serde_json::{Value, json};

use super::RunFolder;
use crate::{files, schema};

/// A line a number, and some kilobytes a view: far more views than a data set has.
const LIMIT_BYTES: u64 = 1 << 30;

/// Refined cameras by the names of their views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunCameras {
    iteration: u32,
    /// World coordinates.
    by_name: BTreeMap<String, Camera>,
}

impl RunCameras {
    /// Returns cameras found after `iteration` steps, in the local coordinates of `dataset`.
    pub fn new<'a>(iteration: u32, dataset: &Dataset, views: impl IntoIterator<Item = &'a View>) -> Self {
        Self { iteration, by_name: cameras_in_world(dataset, views) }
    }

    /// Writes the file.
    ///
    /// # Errors
    /// The file system's refusal.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        let named = |(name, camera): (&String, &Camera)| PathCamera::new(name, camera.clone());
        let cameras: Vec<PathCamera> = self.by_name.iter().map(named).collect();
        let mut content: Value = serde_json::from_str(&luxel_io::camera_file_text(&cameras)).context("cannot encode the cameras")?;
        content["iteration"] = json!(self.iteration);
        files::write_json(&folder.cameras(), schema::CAMERAS, &content)
    }

    /// Reads the cameras of a run after `iteration` steps; none if there is no file, or it is of
    /// another step.
    ///
    /// # Errors
    /// A file that cannot be read or has another content.
    pub fn read_at(folder: &RunFolder, iteration: u32) -> Result<Self> {
        let path = folder.cameras();
        if !path.is_file() {
            return Ok(Self::default());
        }
        let text = files::read_text(&path, LIMIT_BYTES)?;
        let read = || -> Result<Self> {
            let content: Value = serde_json::from_str(&text).context("not JSON")?;
            let found = content["iteration"]
                .as_u64()
                .and_then(|n| u32::try_from(n).ok())
                .context("no \"iteration\", expected a number of steps")?;
            let names = content["frames"].as_array().context("no \"frames\"")?.iter();
            let names = names.map(|frame| frame["file_path"].as_str().map(str::to_owned));
            let names: Vec<String> = names.collect::<Option<_>>().context("a frame has no \"file_path\"")?;
            let cameras = luxel_io::decode_camera_path(&path, text.as_bytes(), None)?;
            let by_name = names.into_iter().zip(cameras).map(|(name, named)| (name, named.camera)).collect();
            Ok(if found == iteration { Self { iteration, by_name } } else { Self::default() })
        };
        let named = read().with_context(|| format!("{}: not a file of cameras", path.display()));
        named.map_err(|error| error.with_remedy(super::state::continue_run()))
    }

    /// Returns the refined camera of a view, in world coordinates.
    pub fn camera(&self, view: &str) -> Option<&Camera> {
        self.by_name.get(view)
    }

    /// Returns whether there are no refined cameras.
    pub fn is_empty(&self) -> bool {
        self.by_name.is_empty()
    }

    /// Gives the views of these names their refined cameras, at the resolution of their images. The
    /// cameras become those of the data set's local coordinates.
    pub fn apply<'a>(&self, dataset_frame: &luxel_core::Similarity, views: impl IntoIterator<Item = &'a mut View>) {
        let local_from_world = dataset_frame.inverse();
        for view in views {
            let Some(refined) = self.by_name.get(&view.name) else { continue };
            let mut refined = refined.clone();
            local_from_world.apply_to_camera(&mut refined);
            let ratio = [0, 1].map(|i| f64::from(view.camera.size_px[i]) / f64::from(refined.size_px[i].max(1)));
            view.camera.camera_from_world = refined.camera_from_world;
            view.camera.focal_px = refined.focal_px * glam::DVec2::from_array(ratio);
        }
    }

    /// Returns the data set with the refined cameras of its training views; test views keep their
    /// poses and get the lenses.
    pub fn seen_by_training<'a>(&self, mut dataset: Cow<'a, Dataset>) -> Cow<'a, Dataset> {
        if !self.is_empty() {
            let dataset = dataset.to_mut();
            let given = dataset.train.clone();
            self.apply(&dataset.world_from_local, &mut dataset.train);
            share_lenses(&given, &dataset.train, &mut dataset.test);
        }
        dataset
    }

    /// Gives all views of a data set their refined cameras.
    pub fn apply_to_dataset(&self, dataset: &mut Dataset) {
        let frame = dataset.world_from_local;
        self.apply(&frame, dataset.train.iter_mut().chain(&mut dataset.test));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel::synthetic;

    #[test]
    fn cameras_of_the_same_step_are_found_again_at_any_resolution() {
        let place = tempfile::tempdir().unwrap();
        let data = place.path().join("data");
        synthetic::write_dataset(&data, synthetic::BallsOptions { side_px: 16, views: 4 }).unwrap();
        let opened = luxel::Dataset::open(&data).unwrap();
        let mut dataset: Dataset = (*opened).clone();
        dataset.world_from_local = luxel_core::Similarity::new(glam::DMat3::IDENTITY, 2.0, glam::DVec3::new(100.0, -50.0, 3.0)).unwrap();
        let given = dataset.clone();
        let motion = luxel_core::CameraMotion::IDENTITY.then(glam::DVec3::new(0.01, -0.02, 0.03), glam::DVec3::new(0.1, 0.2, -0.1));
        for view in dataset.train.iter_mut().chain(&mut dataset.test) {
            view.camera = motion.apply(&view.camera);
            view.camera.focal_px *= 1.01;
        }
        let folder = RunFolder::at(place.path());
        RunCameras::new(7, &dataset, dataset.train.iter().chain(&dataset.test)).write(&folder).unwrap();
        assert!(RunCameras::read_at(&folder, 8).unwrap().is_empty());
        let read = RunCameras::read_at(&folder, 7).unwrap();
        let mut seen = given.clone();
        read.apply_to_dataset(&mut seen);
        for (found, expected) in seen.train.iter().chain(&seen.test).zip(dataset.train.iter().chain(&dataset.test)) {
            assert!(found.camera.camera_from_world.abs_diff_eq(expected.camera.camera_from_world, 1e-9), "{}", found.name);
            assert!((found.camera.focal_px - expected.camera.focal_px).length() < 1e-9);
        }
        let mut halved = given.train[0].clone();
        halved.camera = halved.camera.downscaled(2);
        read.apply(&given.world_from_local, [&mut halved]);
        assert!((halved.camera.focal_px * 2.0 - dataset.train[0].camera.focal_px).length() < 1e-9);
        // What reads camera paths reads the file.
        assert_eq!(luxel_io::read_camera_path(&folder.cameras(), None).unwrap().len(), 4);
        std::fs::write(folder.cameras(), "{\"iteration\": 7}").unwrap();
        assert!(RunCameras::read_at(&folder, 7).unwrap_err().to_string().contains("not a file of cameras"));
    }
}

//! A scene that is named on the command line: a run's newest, or a file; and the data set that goes with it.

use std::path::{Path, PathBuf};

use anyhow::Result;
use luxel_core::{Dataset, Scene};

use crate::cli::LoadArgs;
use crate::config::RunConfig;
use crate::console::Console;
use crate::run_folder::RunFolder;
use crate::{data, run_state, text};

/// A scene and the run it comes from.
pub(crate) struct SceneSource {
    /// The scene.
    pub(crate) scene: Scene,
    /// `None` for a file.
    pub(crate) run: Option<(RunFolder, RunConfig)>,
}

/// How a data set is asked for.
#[derive(Clone, Copy)]
pub(crate) struct DataRequest<'a> {
    /// `--data`.
    pub(crate) data: Option<&'a Path>,
    /// How it is read.
    pub(crate) load: &'a LoadArgs,
    /// Ids of the options on the command line.
    pub(crate) said: &'a [String],
}

impl DataRequest<'_> {
    /// The data set asked for, read as is said, or that of a run, read as the run did but for what is said.
    pub(crate) fn of_run(&self, folder: &RunFolder, config: &RunConfig) -> (PathBuf, LoadArgs) {
        match self.data {
            Some(path) => (path.into(), self.load.clone()),
            None => (config.dataset_path(folder.root()), load_args(self.load, self.said, &config.load)),
        }
    }
}

impl SceneSource {
    /// Reads the scene at `path`.
    pub(crate) fn open(path: &Path, console: &Console) -> Result<Self> {
        if path.is_dir() {
            let (folder, config) = RunFolder::open(path)?;
            let (iteration, scene) = run_state::newest_scene(&folder, console)?;
            console.note(&format!("scene of step {iteration}: {}", text::plural(scene.splats.len(), "splat")));
            return Ok(Self { scene, run: Some((folder, config)) });
        }
        Ok(Self { scene: run_state::read_scene(path)?, run: None })
    }

    /// The data set asked for, or the run's own; `None` if there is neither.
    pub(crate) fn dataset(&self, request: DataRequest<'_>, console: &Console) -> Result<Option<Dataset>> {
        match (request.data, &self.run) {
            (_, Some((folder, config))) => {
                let (path, load) = request.of_run(folder, config);
                Ok(Some(data::load(&path, &load, console)?))
            }
            (Some(path), None) => Ok(Some(data::load(path, request.load, console)?)),
            (None, None) => {
                LoadArgs::refuse(request.said, &[], "and a scene file comes without one; give --data DATASET, or leave it out")?;
                Ok(None)
            }
        }
    }

    /// Radiance behind everything, normalised units: as asked (units of the data set), else as in training, else black.
    pub(crate) fn background(&self, asked: Option<[f32; 3]>) -> [f32; 3] {
        match (asked, &self.run) {
            (Some(rgb), _) => rgb.map(|v| v / self.scene.radiance_scale),
            (None, Some((_, config))) => config.background(self.scene.radiance_scale),
            (None, None) => [0.0; 3],
        }
    }
}

/// How a run's own data set is read: as the run did, but for what is said now.
fn load_args(now: &LoadArgs, said: &[String], run: &LoadArgs) -> LoadArgs {
    let is_said = |option: &str| said.iter().any(|id| id == option);
    LoadArgs {
        format: now.format.or(run.format),
        transfer: now.transfer.or(run.transfer),
        color_space: now.color_space.or(run.color_space),
        downscale: if is_said("downscale") { now.downscale } else { run.downscale },
        supervision: if is_said("supervision") { now.supervision } else { run.supervision },
        exposures: if is_said("exposures") { now.exposures.clone() } else { run.exposures.clone() },
        masks: if is_said("masks") { now.masks.clone() } else { run.masks.clone() },
    }
}

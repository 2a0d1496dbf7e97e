//! The scene named on the command line, a run's newest or a file, and the data set that goes with
//! it.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use luxel::{LoadOptions, Remedy};
use luxel_app::non_splat::NonSplatScene;
use luxel_app::run::{ExplicitArgs, RunCameras, RunConfig, RunFolder, state};
use luxel_app::text;
use luxel_core::{Dataset, Scene};

use super::data;
use crate::args::{LoadArgs, SceneDataArgs, flag};
use crate::output::console::Console;

/// A scene and the run it comes from.
pub(crate) struct SceneSource {
    /// The scene; that of a field or of anchors has their units and place, and no splats.
    pub(crate) scene: Scene,
    /// The radiance field, or the anchors, rendered in place of splats.
    pub(crate) non_splat: Option<NonSplatScene>,
    /// `None` for a file.
    pub(crate) run: Option<(RunFolder, RunConfig)>,
    /// Steps of training after which the scene is as it is; 0 for a file.
    iteration: u32,
}

/// The data set that a command line asks for.
#[derive(Clone, Copy)]
pub(crate) struct DataRequest<'a> {
    /// `--data`.
    pub(crate) data: Option<&'a Path>,
    /// Options of reading it.
    pub(crate) load: &'a LoadArgs,
    /// The options that were given.
    pub(crate) explicit: &'a ExplicitArgs,
}

impl<'a> DataRequest<'a> {
    /// Returns the data set that goes with a scene.
    pub(crate) fn new(input: &'a SceneDataArgs, explicit: &'a ExplicitArgs) -> Self {
        Self { data: input.data.as_deref(), load: &input.load, explicit }
    }

    /// Returns the data set asked for and how it is read; without one that of a run, read as the
    /// run did but for explicit options.
    ///
    /// # Errors
    /// A run whose data set is no longer there.
    pub(crate) fn of_run(&self, folder: &RunFolder, config: &RunConfig) -> Result<(PathBuf, LoadOptions)> {
        Ok(match self.data {
            Some(path) => (path.into(), self.load.options()),
            None => {
                let path = config.find_dataset(folder.root(), Remedy::give("data"))?;
                (path, load_options(self.load, self.explicit, &config.load))
            }
        })
    }
}

impl SceneSource {
    /// Returns the luminance of one unit of the scene's data set, cd/m2; `None` where it is not
    /// calibrated.
    pub(crate) fn cd_m2_per_unit(&self, request: DataRequest<'_>) -> Option<f64> {
        let path = match (&self.run, request.data) {
            (Some((folder, config)), _) => request.of_run(folder, config).ok()?.0,
            (None, Some(path)) => path.to_owned(),
            (None, None) => return None,
        };
        luxel_app::prepare::cd_m2_per_unit(&path)
    }

    /// Reads the scene at `path`.
    pub(crate) fn open(path: &Path, console: &Console) -> Result<Self> {
        if path.is_dir() {
            let (folder, config) = RunFolder::open(path)?;
            let (iteration, scene) = state::newest_scene(&folder, console)?;
            console.note(&format!("scene of step {iteration}: {}", text::plural(scene.splats.len(), "splat")));
            return Ok(Self { scene, non_splat: None, run: Some((folder, config)), iteration });
        }
        Ok(Self { scene: luxel::Scene::open_reporting(path, console)?.into_core(), non_splat: None, run: None, iteration: 0 })
    }

    /// Reads the scene at `path`, of splats, of a radiance field or of anchors, to render it.
    pub(crate) fn open_to_render(path: &Path, console: &Console) -> Result<Self> {
        if path.is_dir() {
            let (folder, config) = RunFolder::open(path)?;
            if !config.train.method.stores_splats() {
                let (iteration, found) = luxel_app::non_splat::newest_scene(&folder, console)?;
                console.note(&format!("step {iteration}: {}", found.summary()));
                return Ok(Self { scene: found.place.clone(), non_splat: Some(found), run: Some((folder, config)), iteration });
            }
        }
        Self::open(path, console)
    }

    /// Reads the data set asked for, or the run's own, for its cameras, which become those of the
    /// scene's local coordinates, as training refined them; `None` if there is neither.
    pub(crate) fn dataset(&self, request: DataRequest<'_>, console: &Console) -> Result<Option<Dataset>> {
        let Some(dataset) = self.dataset_in_its_frame(request, console)? else { return Ok(None) };
        let mut dataset = dataset.in_frame(self.scene.world_from_local).into_owned();
        self.refine_cameras(request, &mut dataset)?;
        Ok(Some(dataset))
    }

    /// Gives a run's own data set the cameras that training refined, if it did.
    fn refine_cameras(&self, request: DataRequest<'_>, dataset: &mut Dataset) -> Result<()> {
        let Some((folder, config)) = &self.run else { return Ok(()) };
        let own = config.dataset_path(folder.root());
        if request.data.is_none_or(|path| luxel_app::output::is_same(path, &own)) {
            RunCameras::read_at(folder, self.iteration)?.apply_to_dataset(dataset);
        }
        Ok(())
    }

    fn dataset_in_its_frame(&self, request: DataRequest<'_>, console: &Console) -> Result<Option<Dataset>> {
        self.check_color_space(request)?;
        match (request.data, &self.run) {
            (_, Some((folder, config))) => {
                let (path, load) = request.of_run(folder, config)?;
                Ok(Some(data::load(&path, &load, console)?))
            }
            (Some(path), None) => Ok(Some(data::load(path, &request.load.options(), console)?)),
            (None, None) => {
                LoadArgs::refuse(request.explicit, &[], "and a scene file comes without one; give --data DATASET, or leave it out")?;
                Ok(None)
            }
        }
    }

    /// Refuses an explicit colour space of images whose pixels are not used: it decides nothing,
    /// unless the data set cannot be read without it.
    fn check_color_space(&self, request: DataRequest<'_>) -> Result<()> {
        if !request.explicit.contains("color_space") {
            return Ok(());
        }
        let without = LoadArgs { color_space: None, ..request.load.clone() };
        let request = DataRequest { load: &without, ..request };
        let (path, load) = match (&self.run, request.data) {
            (Some((folder, config)), _) => request.of_run(folder, config)?,
            (None, Some(path)) => (path.to_owned(), without.options()),
            (None, None) => return Ok(()),
        };
        ensure!(
            luxel::Dataset::open_with(&path, &load).is_err(),
            "{} sets the primaries of images, of which only the cameras are used; leave it out, or give the colour space of the files \
             that are written with --output-color-space",
            flag("color_space")
        );
        Ok(())
    }

    /// Returns the radiance behind everything in normalised units: as asked (units of the data
    /// set), else as in training, else black.
    pub(crate) fn background(&self, asked: Option<[f32; 3]>) -> [f32; 3] {
        match (asked, &self.run) {
            (Some(rgb), _) => self.scene.radiance_scale.normalised(rgb),
            (None, Some((_, config))) => config.background(self.scene.radiance_scale),
            (None, None) => [0.0; 3],
        }
    }
}

#[cfg(feature = "view")]
impl SceneSource {
    /// Returns the radiance behind everything, in the units of the data set: as in training, else
    /// black.
    pub(crate) fn background_radiance(&self) -> [f32; 3] {
        self.run.as_ref().map_or([0.0; 3], |(_, config)| config.train.background)
    }
}

/// Returns how a run's own data set is read: as the run did, but for explicit options.
fn load_options(now: &LoadArgs, explicit: &ExplicitArgs, run: &LoadOptions) -> LoadOptions {
    let now = now.options();
    LoadOptions {
        format: now.format.or(run.format),
        transfer: now.transfer.or(run.transfer),
        color_space: now.color_space.or(run.color_space),
        downscale: if explicit.contains("downscale") { now.downscale } else { run.downscale },
        supervision: if explicit.contains("supervision") { now.supervision } else { run.supervision },
        exposures: if explicit.contains("exposures") { now.exposures } else { run.exposures.clone() },
        masks: if explicit.contains("masks") { now.masks } else { run.masks.clone() },
        layer: now.layer.or_else(|| run.layer.clone()),
    }
}

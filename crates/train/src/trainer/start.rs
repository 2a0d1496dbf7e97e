//! The start of a run, and its continuation from a snapshot.
//!
//! In: a data set, a configuration or a snapshot, an engine. Out: a [`Trainer`] whose engine holds
//! the scene. Degenerate: views or states that cannot be trained are errors.

use luxel_core::engine::ParameterRows;
use luxel_core::{Antialias, CameraProjection, Dataset, Engine, EngineError, Remedy, Scene, SingleProcess, Snapshot, View, spatial_order};

use super::health::Visibility;
use super::scene_start::{check_scene, start_of_scene, with_raster};
use super::{Trainer, VecDeque};
use crate::average::Average;
use crate::camera_response::CameraResponse;
use crate::pixel_weights::ToneScale;
use crate::poses::Poses;
use crate::recorded::{is_recorded, learns_response};
use crate::reduce::BatchMean;
use crate::state::{Start, State};
use crate::step_method::{StepMethod, StepMethods, TrainingMeans, resumed};
use crate::validation_views::validation_views;
use crate::views::{TrainingViews, largest_px};
use crate::vignetting::{Lenses, check_lenses};
use crate::{Initial, NamedChoice, Representation, Schedule, TrainConfig, TrainError, free_space, initialise};

/// Factor between the greatest distance of a camera from the cameras' centroid and the scene's
/// extent (Kerbl et al. 2023).
const EXTENT_MARGIN: f64 = 1.1;

impl Trainer {
    /// Starts a new run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if an option is out of range, if there is nothing to train on, or
    /// if the engine refuses the scene.
    pub fn new<'m>(dataset: &Dataset, config: TrainConfig, means: impl Into<TrainingMeans<'m>>) -> Result<Self, TrainError> {
        if config.freezes_geometry() {
            let reason = "there is no scene whose geometry could be kept".to_owned();
            return Err(TrainError::NeedsScene { reason, remedy: Remedy::give("from") });
        }
        Self::start(dataset, None, config, means.into())
    }

    /// Starts a new run from the splats of a scene, in place of new ones.
    ///
    /// Their order stays. With [`crate::Freeze::Geometry`] positions, rotations, scales, opacities,
    /// the 3D filter and the settings of the rasteriser are the scene's throughout, and colours
    /// begin anew, from the images. Otherwise colours begin as the scene's, in the data set's own
    /// radiance scale, and everything is trained as in any run.
    ///
    /// # Errors
    /// Those of [`Self::new`]; a scene that does not go with the data set or the options.
    pub fn from_scene<'m>(
        dataset: &Dataset,
        scene: &Scene,
        config: TrainConfig,
        means: impl Into<TrainingMeans<'m>>,
    ) -> Result<Self, TrainError> {
        let config = if config.freezes_geometry() {
            with_raster(config, &scene.raster)?
        } else {
            config.with_degrees(dataset.is_developed, Some(scene.splats.color_model))
        };
        check_scene(dataset, scene, &config)?;
        Self::start(dataset, Some(scene), config, means.into())
    }

    fn start(dataset: &Dataset, scene: Option<&Scene>, config: TrainConfig, means: TrainingMeans<'_>) -> Result<Self, TrainError> {
        let TrainingMeans { mut engine, methods } = means;
        config.validate()?;
        check_method(&config)?;
        check_views(dataset)?;
        check_batch(dataset, &config)?;
        check_focal(dataset, &config)?;
        check_lenses(dataset, &config)?;
        check_own_steps(methods, dataset, &config, &*engine)?;
        let config = TrainConfig { samples: Some(config.samples_for(largest_px(&dataset.train))), ..config };
        let config = config.with_degrees(dataset.is_developed, None);
        let response = is_recorded(&dataset.train)?.then(|| CameraResponse::new(config.unit_exposure, &dataset.train));
        let knots = response.as_ref().map(CameraResponse::knots);
        let response = if learns_response(dataset, &config)? { response } else { None };
        let Initial { splats, radiance_scale } = match scene {
            Some(scene) => start_of_scene(scene, dataset, &config, knots)?,
            None => {
                let Initial { splats, radiance_scale } = initialise(dataset, &config, knots)?;
                Initial { splats: splats.select(spatial_order(&splats.position)), radiance_scale }
            }
        };
        let has_own_steps = config.method.has_own_steps();
        let splats = if has_own_steps { methods.first_splats(splats, radiance_scale, dataset, &config)? } else { splats };
        let method = if has_own_steps { Some(methods.start(dataset, &config, splats.len())?) } else { None };
        let extent = scene_extent(&dataset.train, &splats.position);
        engine.set_moment_format(config.moments)?;
        engine.load(&splats, None)?;
        tracing::info!(
            splats = splats.len(),
            radiance_scale = radiance_scale.get(),
            extent,
            model = config.color_model().name(),
            "initialised"
        );
        let clearances = match f64::from(config.clearance) {
            part if part > 0.0 && !config.freezes_geometry() => free_space::radii(&dataset.train, &splats.position, part),
            _ => Vec::new(),
        };
        let state = State::new(dataset, Start { config, extent, radiance_scale, response, clearances });
        let mut trainer = Self::assemble(dataset, Parts { state, average: None, engine, method });
        trainer.warn_of_average();
        trainer.check_pose_steps()?;
        if trainer.state.config.antialias == Antialias::Mip && !trainer.state.config.freezes_geometry() {
            trainer.update_smoothing()?;
        }
        Ok(trainer)
    }

    /// Resumes the run that `snapshot` was taken of, with the configuration of that run.
    ///
    /// # Errors
    /// Returns a [`TrainError`] if the snapshot belongs to another data set or is damaged, or if
    /// the engine refuses it.
    pub fn resume<'m>(dataset: &Dataset, snapshot: Snapshot, means: impl Into<TrainingMeans<'m>>) -> Result<Self, TrainError> {
        let TrainingMeans { mut engine, methods } = means.into();
        check_views(dataset)?;
        let mut state = State::from_snapshot(&snapshot, dataset)?;
        let method = resumed(methods, state.networks.take().as_ref(), &state.config, snapshot.scene.splats.len())?;
        check_own_steps(methods, dataset, &state.config, &*engine)?;
        let Snapshot { scene, moments, stats, average, .. } = snapshot;
        let parts = [("scene", &scene.splats), ("first moments", &moments.first), ("second moments", &moments.second)];
        for (what, splats) in parts.into_iter().chain(average.iter().map(|average| ("average", average))) {
            splats.validate().map_err(|source| TrainError::Checkpoint { what, source })?;
        }
        if average.as_ref().is_some_and(|average| [average.len(), average.sh.len()] != [scene.splats.len(), scene.splats.sh.len()]) {
            return Err(TrainError::State("the average of the parameters is of other splats than the scene's".to_owned()));
        }
        engine.set_moment_format(state.config.moments)?;
        engine.load(&scene.splats, Some(&moments))?;
        engine.set_densify_stats(&stats)?;
        let average = average.map(|mean| Average::new(mean, state.averaged));
        Ok(Self::assemble(dataset, Parts { state, average, engine, method }))
    }

    fn assemble(dataset: &Dataset, parts: Parts) -> Self {
        let Parts { state, average, engine, method } = parts;
        let config = &state.config;
        let color_model = config.color_model();
        let schedule = Schedule::new(config, state.planned_iterations, state.extent);
        let side_px = dataset.train.iter().flat_map(|view| view.camera.size_px).min().unwrap_or(1);
        let stages = super::plan::stages(config, &schedule, side_px);
        let tone = ToneScale { radiance_scale: state.radiance_scale, mu: config.mu };
        let views = TrainingViews::new(&dataset.train, stages, config.noise_model, tone);
        let lenses = state.vignetting.is_some().then(|| Lenses::new(dataset));
        let engine = match &method {
            None => engine,
            Some(method) => method.rendering(engine),
        };
        let poses = state.poses.is_some().then(|| Poses::of_views(dataset, state.extent));
        let has_validation = config.has_validation_views() && state.response.is_none();
        let validation = if has_validation { validation_views(&dataset.train, config.validation_share, state.extent) } else { Vec::new() };
        let mut trainer = Self {
            engine,
            views,
            color_space: dataset.color_space,
            world_from_local: dataset.world_from_local,
            metres_per_unit: dataset.metres_per_unit,
            schedule,
            state,
            average,
            recent: VecDeque::new(),
            visibility: Visibility::default(),
            poses,
            lenses,
            method,
            validation,
            exchange: Box::new(SingleProcess),
            batch_mean: BatchMean::new(ParameterRows { color_model }),
            step_views: Vec::new(),
            wants_to_stop: false,
            is_asked_to_stop: false,
        };
        trainer.restore_poses();
        trainer
    }
}

/// The parts of a trainer at its start.
struct Parts {
    state: State,
    average: Option<Average>,
    engine: Box<dyn Engine>,
    method: Option<Box<dyn StepMethod>>,
}

/// Refuses methods that train no splats.
fn check_method(config: &TrainConfig) -> Result<(), TrainError> {
    let (method, trained) = (config.method.name(), config.method.spec().representation);
    match trained {
        Representation::Splats => Ok(()),
        _ => Err(TrainError::config("method", format!("{method} trains {}, not splats", trained.noun()))),
    }
}

/// Checks the properties of views that every step relies on.
pub(crate) fn check_views(dataset: &Dataset) -> Result<(), TrainError> {
    if dataset.train.is_empty() {
        return Err(TrainError::NoTrainViews);
    }
    dataset.train.iter().try_for_each(View::validate)?;
    Ok(())
}

/// Checks that there is a view for each slot of a batch.
fn check_batch(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
    match dataset.train.len() {
        views if views < config.batch as usize => {
            Err(TrainError::config("batch", format!("found {}, expected at most {views}, the number of training views", config.batch)))
        }
        _ => Ok(()),
    }
}

/// Checks that the data set has what a method with steps of its own trains on, and the engine what
/// its steps need.
fn check_own_steps(methods: &dyn StepMethods, dataset: &Dataset, config: &TrainConfig, engine: &dyn Engine) -> Result<(), TrainError> {
    if !config.method.has_own_steps() {
        return Ok(());
    }
    methods.check(dataset, config)?;
    if engine.differentiable().is_none() {
        let method = config.method.name();
        let message = format!("method {method} is trained on the CPU: this engine has no rasteriser with gradients for its images");
        return Err(EngineError::invalid(message).with_remedy(Remedy::set("device", "cpu")).into());
    }
    Ok(())
}

/// Checks that focal lengths can be optimised, if they are to be: those of pinhole cameras can.
fn check_focal(dataset: &Dataset, config: &TrainConfig) -> Result<(), TrainError> {
    let is_wide = |view: &&View| view.camera.projection != CameraProjection::Pinhole;
    match dataset.train.iter().find(is_wide).filter(|_| config.refine_focal) {
        Some(view) => {
            let kind = if view.camera.projection == CameraProjection::Equirectangular { "panorama" } else { "fisheye" };
            let reason =
                format!("view {} is a {kind}, expected pinhole cameras, whose focal lengths are optimised; leave it out", view.name);
            Err(TrainError::config("refine_focal", reason))
        }
        None => Ok(()),
    }
}

/// Returns the size of the scene, world units: the spread of the cameras (Kerbl et al. 2023) or the
/// median distance of the splats from the cameras' centroid, whichever is larger.
///
/// Cameras around a scene are about as far apart as they are from it. For cameras side by side,
/// their spread underestimates the scene, and pruning by it would remove the walls.
pub(crate) fn scene_extent(train: &[View], positions: &[[f32; 3]]) -> f32 {
    let centroid = train.iter().map(|view| view.camera.eye()).sum::<glam::DVec3>() / train.len().max(1) as f64;
    let radius = train.iter().map(|view| (view.camera.eye() - centroid).length()).fold(0.0, f64::max);
    let mut distances: Vec<f64> =
        positions.iter().map(|[x, y, z]| (glam::DVec3::new((*x).into(), (*y).into(), (*z).into()) - centroid).length()).collect();
    let at = distances.len() / 2;
    let typical = if distances.is_empty() { 1.0 } else { *distances.select_nth_unstable_by(at, f64::total_cmp).1 };
    let extent = (EXTENT_MARGIN * radius).max(typical) as f32;
    if extent.is_finite() && extent > f32::MIN_POSITIVE { extent } else { 1.0 }
}

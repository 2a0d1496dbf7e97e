//! The contract of a run with what it trains: a place that is learned from views, step by step,
//! whatever it is made of.
//!
//! In: steps. Out: images through an engine, the scene for its file, and the state for a
//! checkpoint, all in normalised units ([`RadianceScale`]). A run with a folder asks for nothing
//! else, so that its loop, log, evaluations and files are the same for splats, anchors and fields.
//! Degenerate: whatever a kind of scene does not have (refined poses, vignetting, gains, a mean of
//! its last states) has a default that says so.

use luxel_core::{Camera, Engine, Knots, RadianceScale, RenderOptions, Scene, StepReport};

use crate::{LensVignetting, PoseReport, RunState, ToneMapperRecord, TrainConfig, TrainError, Trainer};

/// The numbers of parts of a scene in training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneSize {
    /// A scene of splats.
    Splats(usize),
    /// A scene of anchors, and the splats that they can decode.
    Anchors {
        /// Number of anchors.
        anchors: usize,
        /// Number of splats.
        splats: usize,
    },
    /// A radiance field of so many parameters.
    Field(usize),
}

impl SceneSize {
    /// Returns the number of splats that images can be blended from; 0 for a field.
    pub fn splats(self) -> usize {
        match self {
            Self::Splats(splats) | Self::Anchors { splats, .. } => splats,
            Self::Field(_) => 0,
        }
    }

    /// Returns the number of parameters of a field.
    pub fn field_parameters(self) -> Option<usize> {
        match self {
            Self::Field(parameters) => Some(parameters),
            Self::Splats(_) | Self::Anchors { .. } => None,
        }
    }
}

/// An array of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileArray {
    /// Name of the array.
    pub name: String,
    /// Lengths along its axes, slowest first.
    pub shape: Vec<usize>,
    /// Values, as many as the product of the lengths.
    pub values: Vec<f32>,
}

/// The kind of files of arrays that hold a radiance field.
pub const FIELD_FORMAT: &str = "luxel-field";
/// The kind of files of arrays that hold anchors.
pub const ANCHOR_FORMAT: &str = "luxel-anchors";

/// The content of a file of named arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct ArrayFile {
    /// Name of the kind of file.
    pub format: &'static str,
    /// Description of the arrays, as JSON.
    pub description: String,
    /// The arrays.
    pub arrays: Vec<FileArray>,
}

/// A scene as its file stores it.
#[derive(Clone, Debug)]
pub enum SceneContent {
    /// Splats.
    Splats(Box<Scene>),
    /// Arrays of another kind of scene.
    Arrays(ArrayFile),
}

/// The state of a run as its checkpoint stores it.
pub enum SavedRun<'a> {
    /// The state of a training of splats, to be read piece by piece.
    Splats(Box<RunState<'a>>),
    /// The state of another training.
    Arrays(ArrayFile),
}

/// A reconstruction in progress. Equal seeds and inputs give equal bits, resumed or not.
pub trait Reconstruction: Send {
    /// Returns the configuration in force.
    fn config(&self) -> &TrainConfig;

    /// Returns the number of steps done.
    fn iteration(&self) -> u32;

    /// Sets the step after which the run ends; the schedule stays as planned at the start.
    fn set_iterations(&mut self, iterations: u32);

    /// Performs one step of training. An engine that works ahead may report an earlier step.
    ///
    /// # Errors
    /// A loss or a parameter that is not finite, a scene that has lost all its parts, an image that
    /// cannot be read again, or an engine that failed.
    fn step(&mut self) -> Result<StepReport, TrainError>;

    /// Returns the numbers of the scene's parts.
    fn size(&self) -> SceneSize;

    /// Returns the radiance of one normalised unit, in the units of the data set.
    fn radiance_scale(&self) -> RadianceScale;

    /// Returns the options to render the current scene with.
    fn render_options(&self) -> RenderOptions;

    /// Returns an engine that renders the current scene.
    fn engine(&mut self) -> &mut dyn Engine;

    /// Returns the response of the camera that captured the training images, or `None` if it is not
    /// learned.
    fn response(&self) -> Option<Knots>;

    /// Returns the current scene as its file stores it.
    ///
    /// # Errors
    /// A failing engine; a description that has no form as text.
    fn content(&mut self) -> Result<SceneContent, TrainError>;

    /// Returns everything needed to resume from here bit for bit.
    ///
    /// # Errors
    /// Those of [`Self::content`].
    fn saved(&mut self) -> Result<SavedRun<'_>, TrainError>;

    /// Returns whether all steps are done.
    fn is_finished(&self) -> bool {
        self.iteration() >= self.config().iterations
    }

    /// Returns whether the parts of a step's loss, L1 and SSIM, are reported. Those of a method
    /// that compares rays are not.
    fn compares_images(&self) -> bool {
        true
    }

    /// Returns whether a render takes much longer than a comparison: such renders are made less
    /// often, and kept while a run is measured.
    fn renders_slowly(&self) -> bool {
        false
    }

    /// Returns the factor by which the sides of the next step's images are reduced.
    fn downscale(&self) -> u32 {
        1
    }

    /// Returns the steps that are left, in steps as costly as the last `made` ones on average, if
    /// the cost of steps is known.
    fn steps_left_at_pace(&self, _made: u32) -> Option<f64> {
        None
    }

    /// Makes the mean of the last states the scene if all steps are done and it is not yet; returns
    /// whether it did.
    ///
    /// # Errors
    /// A failing engine.
    fn finish_average(&mut self) -> Result<bool, TrainError> {
        Ok(false)
    }

    /// Returns whether to stop before the next step, where this process would if it is `asked` to:
    /// the processes of a distributed run agree on it.
    fn agrees_to_stop(&mut self, asked: bool) -> bool {
        asked
    }

    /// Returns ln gain of every training view by channel, in the order of the views, or `None` if
    /// gains are not optimised.
    fn log_gains(&self) -> Option<&[[f32; 3]]> {
        None
    }

    /// Returns the vignetting of each lens, or `None` if it is not optimised.
    fn vignetting(&self) -> Option<Vec<LensVignetting>> {
        None
    }

    /// Returns the corrections of the poses in numbers, or `None` if poses are not optimised.
    fn pose_report(&self) -> Option<PoseReport> {
        None
    }

    /// Returns the optimised cameras of the training views, in the order of the views, or `None` if
    /// poses are not optimised.
    fn refined_cameras(&self) -> Option<Vec<Camera>> {
        None
    }

    /// Returns the tone mappers of the method, or `None` if it has none.
    fn tone_mappers(&self) -> Option<ToneMapperRecord> {
        None
    }

    /// Returns the training of splats, if that is what it is: for viewers and distributed runs,
    /// which need splats.
    fn as_splats(&mut self) -> Option<&mut Trainer> {
        None
    }
}

impl Reconstruction for Trainer {
    fn config(&self) -> &TrainConfig {
        self.config()
    }

    fn iteration(&self) -> u32 {
        self.iteration()
    }

    fn set_iterations(&mut self, iterations: u32) {
        self.set_iterations(iterations);
    }

    fn step(&mut self) -> Result<StepReport, TrainError> {
        self.step()
    }

    fn size(&self) -> SceneSize {
        SceneSize::Splats(self.splats_len())
    }

    fn radiance_scale(&self) -> RadianceScale {
        self.radiance_scale()
    }

    fn render_options(&self) -> RenderOptions {
        self.render_options()
    }

    fn engine(&mut self) -> &mut dyn Engine {
        self.engine()
    }

    fn response(&self) -> Option<Knots> {
        self.response()
    }

    fn content(&mut self) -> Result<SceneContent, TrainError> {
        Ok(SceneContent::Splats(Box::new(self.scene()?)))
    }

    fn saved(&mut self) -> Result<SavedRun<'_>, TrainError> {
        Ok(SavedRun::Splats(Box::new(self.saved_state()?)))
    }

    fn downscale(&self) -> u32 {
        self.downscale()
    }

    fn steps_left_at_pace(&self, made: u32) -> Option<f64> {
        Some(self.steps_left_at_pace(made))
    }

    fn finish_average(&mut self) -> Result<bool, TrainError> {
        self.finish_average()
    }

    fn agrees_to_stop(&mut self, asked: bool) -> bool {
        self.announce_stop(asked);
        self.is_asked_to_stop()
    }

    fn log_gains(&self) -> Option<&[[f32; 3]]> {
        self.log_gains()
    }

    fn vignetting(&self) -> Option<Vec<LensVignetting>> {
        self.vignetting()
    }

    fn pose_report(&self) -> Option<PoseReport> {
        self.pose_report()
    }

    fn refined_cameras(&self) -> Option<Vec<Camera>> {
        self.config().refine_poses.then(|| self.cameras())
    }

    fn tone_mappers(&self) -> Option<ToneMapperRecord> {
        self.tone_mappers()
    }

    fn as_splats(&mut self) -> Option<&mut Trainer> {
        Some(self)
    }
}

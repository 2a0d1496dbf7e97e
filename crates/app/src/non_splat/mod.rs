//! Training of scenes that are not stored as splats, with a run folder: radiance fields, and
//! anchors, whose splats networks decode for each view.
//!
//! [`crate::run`] starts and drives such a run as any other. Its checkpoints hold a scene and the
//! state of its training, and `field/iteration_N/` or `anchors/iteration_N/` is what `point_cloud/`
//! is for splats. Whatever needs splats refuses it by name ([`refuse`]).
//!
//! In: a [`RunFolder`] of such a method. Out: its scene, as an engine that renders. Fields and
//! anchors are trained and rendered on the processor. Without the feature `methods` every such run
//! is refused.

#[cfg(not(feature = "methods"))]
mod absent;
#[cfg(feature = "methods")]
mod newest;
#[cfg(feature = "methods")]
mod scene;
#[cfg(feature = "methods")]
mod start;

use std::path::Path;

#[cfg(not(feature = "methods"))]
pub(crate) use absent::{Checkpoint, open_dataset, resume, seconds_per_step, start};
#[cfg(not(feature = "methods"))]
pub use absent::{NonSplatScene, newest_scene};
use luxel::{DeviceOptions, Error, Remedy, Result, SelectedEngine};
use luxel_core::Engine;
use luxel_train::{ANCHOR_FORMAT, FIELD_FORMAT, Method, Representation};
#[cfg(feature = "methods")]
pub use newest::newest_scene;
#[cfg(feature = "methods")]
pub use scene::NonSplatScene;
#[cfg(feature = "methods")]
pub(crate) use start::{Checkpoint, open_dataset, resume, seconds_per_step, start};

use crate::run::{RunConfig, RunFolder};

/// The means of a training on the processor.
#[cfg_attr(not(feature = "methods"), expect(dead_code, reason = "what is refused uses nothing"))]
pub(crate) struct Processor {
    /// Threads of a field.
    pub(crate) threads: usize,
    /// The engine of splats that anchors are trained on.
    pub(crate) engine: Box<dyn Engine>,
}

/// Why a field is not computed on a GPU.
const FIELD_ON_PROCESSOR: &str = "radiance fields are computed on the processor";
/// Why anchors are not.
const ANCHORS_ON_PROCESSOR: &str = "anchors are decoded and trained on the processor";

/// Returns why a method is computed on the processor.
fn on_processor(method: Method) -> &'static str {
    match method.spec().representation {
        Representation::Anchors => ANCHORS_ON_PROCESSOR,
        _ => FIELD_ON_PROCESSOR,
    }
}

/// Opens the processor for a method that stores no splats.
///
/// # Errors
/// A GPU that was asked for.
pub fn open_processor(options: &DeviceOptions, method: Method) -> Result<SelectedEngine> {
    SelectedEngine::on_processor(options, on_processor(method))
}

/// Refuses a run without stored splats where splats are needed.
///
/// # Errors
/// The run is one of a radiance field or of anchors; its configuration cannot be read.
pub fn refuse(folder: &RunFolder) -> Result<()> {
    let (_, config) = RunFolder::open(folder.root())?;
    match config.train.method.stores_splats() {
        true => Ok(()),
        false => Err(no_splats(folder.root(), &config)),
    }
}

fn no_splats(root: &Path, config: &RunConfig) -> Error {
    let (root, method) = (root.display(), config.method_name());
    let message = match config.train.method.spec().representation {
        Representation::Anchors => format!("{root}: holds anchors ({method}), which have no splats but those that they decode for a view"),
        _ => format!("{root}: holds a radiance field ({method}), which has no splats"),
    };
    Error::new(message).with_remedy(Remedy::advice("render or evaluate it, or train splats with another method, such as lcd"))
}

/// Reads the field or the anchors of a file, `field.safetensors`, `anchors.safetensors` or a
/// checkpoint; `None` if the file holds something else.
///
/// # Errors
/// A file of such a scene that is damaged or of another version.
pub fn open_file(path: &Path) -> Result<Option<NonSplatScene>> {
    match [FIELD_FORMAT, ANCHOR_FORMAT].into_iter().any(|format| luxel_io::holds_arrays(path, format)) {
        true => NonSplatScene::read(path).map(Some),
        false => Ok(None),
    }
}
